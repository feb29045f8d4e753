"""A relit mesh whose light is in colours at the vertices, and what it reflects in textures where it has them.

Viewers multiply the two, so that a texture is as sharp as its image however coarse the mesh is.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slepian_prt.relighting.drawing.pictures import Picture, exposure, roll_off
from slepian_prt.relighting.files.surfaces import split_surfaces, textured_faces
from slepian_prt.scene.formats.parts import Texture
from slepian_prt.scene.mesh import Mesh
from slepian_prt.scene.reflectance.surface_detail import SurfaceDetail
from slepian_prt.scene.scene import Part


class Piece(NamedTuple):
    """Faces of one part and one texture.

    Attributes
    ----------
    name : str
        Of the part.
    texture : Texture or None
    vertices : (n,) int64
        Of the mesh; one is there several times where a texture has a seam.
    uv : (n, 2) float32 or None
        Texture coordinates, v down.
    colors : (n, 3) float64
        Linear, exposed, in [0, 1]: radiance, or with a texture what it is to be multiplied by.
    faces : (F', 3) int64
        Of ``vertices``.
    """

    name: str
    texture: Texture | None
    vertices: NDArray[np.int64]
    uv: NDArray[np.float32] | None
    colors: NDArray[np.float64]
    faces: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class PaintedMesh:
    """A mesh in pieces.

    Attributes
    ----------
    mesh : Mesh
    pieces : tuple of Piece
    scale : float
        What radiance was multiplied by.
    """

    mesh: Mesh
    pieces: tuple[Piece, ...]
    scale: float


def paint_exposure(mesh: Mesh, radiance: NDArray, white: NDArray | None, detail: SurfaceDetail | None) -> float:
    """What radiance is multiplied by, so that colours are well seen.

    Parameters
    ----------
    mesh : Mesh
    radiance, white : (V, 3)
        Of the vertices, and what it would be for unit albedo.
    detail : SurfaceDetail or None
    """
    shown = radiance
    if detail is not None and white is not None:
        under_texture = np.zeros(len(mesh.positions), dtype=bool)
        under_texture[mesh.faces[textured_faces(mesh, detail) >= 0]] = True
        shown = np.where(under_texture[:, None], white, radiance)
    return exposure(Picture(shown[None].astype(np.float32), mesh.receivers.active[None].astype(np.float32)))


def paint_mesh(
    mesh: Mesh,
    parts: tuple[Part, ...],
    radiance: NDArray,
    white: NDArray | None = None,
    detail: SurfaceDetail | None = None,
    scale: float | None = None,
    factor: float = 1.0,
) -> PaintedMesh:
    """Split a mesh by parts and textures, and give it colours.

    Parameters
    ----------
    mesh : Mesh
    parts : tuple of Part
    radiance, white, detail
        As of `paint_exposure`.
    scale : float, optional
        By default that of `paint_exposure`.
    factor : float
        Of it.
    """
    scale = (paint_exposure(mesh, radiance, white, detail) if scale is None else scale) * factor
    pieces = []
    # Without what white surfaces would send, radiance is what there is, with the albedo of the vertices in it.
    for surface in split_surfaces(mesh, parts, None if white is None else detail):
        if surface.texture is None or white is None:
            colors = roll_off(radiance[surface.vertices] * scale)
        else:
            colors = roll_off(white[surface.vertices] * scale) * surface.reflectance
        pieces.append(Piece(surface.name, surface.texture, surface.vertices, surface.uv, colors, surface.faces))
    return PaintedMesh(mesh, tuple(pieces), scale)
