"""A mesh split by its parts and textures, as files and viewers draw it: white light times what is reflected."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slepian_prt.scene.formats.joining import join_equal
from slepian_prt.scene.formats.parts import Texture
from slepian_prt.scene.mesh import Mesh
from slepian_prt.scene.reflectance.surface_detail import SurfaceDetail
from slepian_prt.scene.scene import Part


class Surface(NamedTuple):
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
    reflectance : (n, 3) float64
        Linear factor in [0, 1] of the radiance that white surfaces would send: beside the texture, or all of it.
    faces : (F', 3) int64
        Of ``vertices``.
    """

    name: str
    texture: Texture | None
    vertices: NDArray[np.int64]
    uv: NDArray[np.float32] | None
    reflectance: NDArray[np.float64]
    faces: NDArray[np.int64]


def textured_faces(mesh: Mesh, detail: SurfaceDetail | None) -> NDArray[np.int64]:
    """(F,) the texture of each face that colours can be multiplied by; -1 where metal has a texture of its own."""
    if detail is None:
        return np.full(len(mesh.faces), -1)
    return np.where(detail.metallic_choice >= 0, -1, detail.choice).astype(np.int64)


def split_surfaces(mesh: Mesh, parts: tuple[Part, ...], detail: SurfaceDetail | None = None) -> tuple[Surface, ...]:
    """Split a mesh by parts and textures, in the order of the parts.

    Parameters
    ----------
    mesh : Mesh
    parts : tuple of Part
    detail : SurfaceDetail or None
        The textures; without, vertices reflect the albedo of the mesh.
    """
    texture = textured_faces(mesh, detail)
    ends = np.array([part.end for part in parts])
    of_part = np.minimum(np.searchsorted(ends, mesh.faces[:, 0], side="right"), len(parts) - 1)
    keys, which = np.unique(np.stack([of_part, texture], axis=1), axis=0, return_inverse=True)
    surfaces = []
    for number, (part, chosen) in enumerate(keys.tolist()):
        faces, name = np.flatnonzero(which.ravel() == number), parts[part].name
        if chosen < 0 or detail is None:
            surfaces.append(_plain_surface(name, mesh, faces))
        else:
            surfaces.append(_textured_surface(name, mesh, faces, detail, chosen))
    return tuple(surfaces)


def _plain_surface(name: str, mesh: Mesh, faces: NDArray[np.int64]) -> Surface:
    vertices, corners = np.unique(mesh.faces[faces], return_inverse=True)
    reflectance = mesh.albedo[vertices].astype(np.float64)
    return Surface(name, None, vertices.astype(np.int64), None, reflectance, corners.reshape(-1, 3))


def _textured_surface(name: str, mesh: Mesh, faces: NDArray[np.int64], detail: SurfaceDetail, chosen: int) -> Surface:
    vertices = mesh.faces[faces].astype(np.int64).ravel()
    uv = detail.uv[faces].reshape(-1, 2)
    factors = (detail.colors[faces] * (1.0 - detail.metallic[faces])[:, None, None]).reshape(-1, 3)
    first, joined = join_equal(vertices[:, None], uv, factors)
    # What reflects more than all light was clipped when it was precomputed.
    reflectance = np.clip(factors[first].astype(np.float64), 0.0, 1.0)
    texture = detail.textures[chosen]
    return Surface(name, texture, vertices[first], uv[first], reflectance, joined.reshape(-1, 3))
