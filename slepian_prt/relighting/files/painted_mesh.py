"""A relit mesh whose light is in colours at the vertices, and what it reflects in textures where it has them.

Viewers multiply the two, so that a texture is as sharp as its image however coarse the mesh is.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slepian_prt.relighting.drawing.pictures import Picture, exposure, roll_off
from slepian_prt.scene.formats.joining import join_equal
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


def textured_faces(mesh: Mesh, detail: SurfaceDetail | None) -> NDArray[np.int64]:
    """(F,) the texture of each face that colours can be multiplied by; -1 where metal has a texture of its own."""
    if detail is None:
        return np.full(len(mesh.faces), -1)
    return np.where(detail.metallic_choice >= 0, -1, detail.choice).astype(np.int64)


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
    texture = textured_faces(mesh, detail)
    ends = np.array([part.end for part in parts])
    of_part = np.minimum(np.searchsorted(ends, mesh.faces[:, 0], side="right"), len(parts) - 1)
    keys, which = np.unique(np.stack([of_part, texture], axis=1), axis=0, return_inverse=True)
    pieces = []
    for number, (part, chosen) in enumerate(keys.tolist()):
        faces = np.flatnonzero(which.ravel() == number)
        name = parts[part].name
        if chosen < 0 or detail is None or white is None:
            pieces.append(_plain_piece(name, mesh, faces, radiance * scale))
        else:
            pieces.append(_textured_piece(name, mesh, faces, white * scale, detail, chosen))
    return PaintedMesh(mesh, tuple(pieces), scale)


def _plain_piece(name: str, mesh: Mesh, faces: NDArray[np.int64], exposed: NDArray) -> Piece:
    vertices, corners = np.unique(mesh.faces[faces], return_inverse=True)
    return Piece(name, None, vertices.astype(np.int64), None, roll_off(exposed[vertices]), corners.reshape(-1, 3))


def _textured_piece(
    name: str, mesh: Mesh, faces: NDArray[np.int64], exposed: NDArray, detail: SurfaceDetail, chosen: int
) -> Piece:
    vertices = mesh.faces[faces].astype(np.int64).ravel()
    uv = detail.uv[faces].reshape(-1, 2)
    factors = (detail.colors[faces] * (1.0 - detail.metallic[faces])[:, None, None]).reshape(-1, 3)
    first, joined = join_equal(vertices[:, None], uv, factors)
    vertices = vertices[first]
    # What reflects more than all light was clipped when it was precomputed.
    colors = roll_off(exposed[vertices]) * np.clip(factors[first], 0.0, 1.0)
    return Piece(name, detail.textures[chosen], vertices, uv[first], colors, joined.reshape(-1, 3))
