"""Relit results on the mesh itself: meshes with colours and textures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.relighting.drawing.pictures import Picture, exposure, to_srgb
from slepian_prt.relighting.files.bitmap_detail import source_detail
from slepian_prt.relighting.files.coloured_mesh import as_in_source, write_ply, write_textured_ply
from slepian_prt.relighting.files.glb_file import write_glb
from slepian_prt.relighting.files.painted_mesh import paint_exposure, paint_mesh
from slepian_prt.relighting.files.surfaces import textured_faces
from slepian_prt.relighting.files.wishes import GLB, PLY
from slepian_prt.relighting.relight import white_radiance
from slepian_prt.relighting.series import Series
from slepian_prt.scene.mesh import Mesh
from slepian_prt.scene.reflectance.surface_detail import SurfaceDetail
from slepian_prt.scene.scene import Part


def write_coloured_mesh(
    path: str | Path, mesh: Mesh, radiance: NDArray, scale: float | None = None, factor: float = 1.0
) -> float:
    """``.ply`` with tone-mapped sRGB colours per vertex, those of its source where the mesh knows which they are.

    Returns the exposure that they were scaled with: ``scale``, by default that of `exposure`, times ``factor``.
    """
    vertices = Picture(radiance[None].astype(np.float32), mesh.receivers.active[None].astype(np.float32))
    scale = (exposure(vertices) if scale is None else scale) * factor
    own, colours = as_in_source(mesh, to_srgb(vertices, scale)[0])
    write_ply(path, own, np.rint(colours).astype(np.uint8))
    return scale


@dataclass(frozen=True, eq=False)
class Canvas:
    """A mesh under B lights, to be written with colours.

    Attributes
    ----------
    mesh : Mesh
    parts : tuple of Part
    radiance : (B, V, 3)
    white : (B, V, 3) or None
        What it would be for unit albedo, where there are textures to multiply it.
    detail : SurfaceDetail or None
        The textures.
    up : str
        The axis that is up in the mesh.
    """

    mesh: Mesh
    parts: tuple[Part, ...]
    radiance: NDArray[np.float32]
    white: NDArray[np.float32] | None = None
    detail: SurfaceDetail | None = None
    up: str = "y"

    def exposure(self) -> float:
        """What suits all lights: the exposure of the brightest."""
        lights = range(len(self.radiance))
        return min(paint_exposure(self.mesh, self.radiance[n], self._white(n), self.detail) for n in lights)

    def _white(self, number: int) -> NDArray[np.float32] | None:
        return None if self.white is None else self.white[number]

    def write(
        self,
        path: str | Path,
        number: int,
        scale: float | None = None,
        factor: float = 1.0,
        folder: str | Path | None = None,
    ) -> str:
        """Write the mesh under one light, ``.glb`` or ``.ply``; a line about its colours.

        Parameters
        ----------
        path : path
        number : int
            Of the light.
        scale, factor
            As of `paint_mesh`.
        folder : path, optional
            Where the file is moved to afterwards.
        """
        painted = paint_mesh(
            self.mesh, self.parts, self.radiance[number], self._white(number), self.detail, scale, factor
        )
        textured = any(piece.texture is not None for piece in painted.pieces)
        if Path(path).suffix.lower() == GLB:
            write_glb(path, painted, self.up)
            what = "radiance of white surfaces, which textures multiply," if textured else "radiance"
            return f"colours are {what} x {painted.scale:.4g}, linear"
        if textured:
            write_textured_ply(path, painted, folder)
            what = "radiance of white surfaces, which the texture multiplies,"
            return f"colours are {what} x {painted.scale:.4g}, tone-mapped"
        used = write_coloured_mesh(path, self.mesh, self.radiance[number], scale, factor)
        return f"colours are radiance x {used:.4g}, tone-mapped"


class Wanted(NamedTuple):
    """What is asked of a mesh with colours: the kind of file, what is up, and the path of its scene if it is given."""

    suffix: str
    up: str = "y"
    scene: str | None = None


def make_canvas(
    mi: Any,
    packed: CompressedTransfer,
    series: Series,
    wish: Wanted,
    file: str,
    report: Callable[[str], None],
) -> Canvas:
    """The mesh of a transfer file with the textures of what it was made from, where that can be found.

    Raises
    ------
    UserError
        The scene is named and cannot be used.
    """
    detail = source_detail(mi, packed, wish.scene, file, report)
    if detail is not None and wish.suffix == PLY and np.ptp(textured_faces(packed.mesh, detail)) > 0:
        report(
            ".ply holds one texture for the whole of a model, so that these are colours of vertices; .glb holds them"
        )
        detail = None
    white = None
    if detail is not None:
        white = white_radiance(packed, series.lighting, series.fixed_lights)
    return Canvas(packed.mesh, packed.parts, series.radiance, white, detail, wish.up)
