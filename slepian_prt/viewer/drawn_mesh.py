"""A mesh as a page draws it: surfaces one after the other, vertices in the order in which faces name them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError
from slepian_prt.relighting.drawing.camera import is_back
from slepian_prt.relighting.files.surfaces import Surface
from slepian_prt.scene.formats.parts import Texture
from slepian_prt.scene.mesh import Mesh
from slepian_prt.scene.scene import Part
from slepian_prt.viewer.buffers import Buffers

# The largest side of the mesh in steps of the lattice of its positions. Steps are halved until the largest side of each
# surface and its mean edge have so many too, at most `_HALVINGS` times, as float32 holds no more.
_STEPS = (1 << 16) - 1
_STEPS_OF_SURFACE, _STEPS_OF_EDGE, _HALVINGS = 4096.0, 16.0, 8

# Reflectance and texture coordinates: the latter in parts of the square that all of them need.
_UNORM = 65535.0
_UV_STEPS = (1 << 22) - 1


class DrawnFaces(NamedTuple):
    """Faces ``first : first + size`` of a drawn mesh.

    Attributes
    ----------
    name : str
        Of the part.
    first, size : int
    texture : int or None
        Of `DrawnMesh.textures`.
    back : bool
        Whether they are the backs of two-sided faces.
    """

    name: str
    first: int
    size: int
    texture: int | None
    back: bool


@dataclass(frozen=True, eq=False)
class DrawnMesh:
    """N vertices and F faces.

    Attributes
    ----------
    receivers : (N,) int64
        The vertex of the mesh that each is; one is there several times where a texture has a seam.
    positions : (N, 3) float64
    faces : (F, 3) int64
        Each vertex is named first after those before it.
    surfaces : tuple of DrawnFaces
    reflectance : (N, 3) float64
    uv : (N, 2) float32 or None
        Texture coordinates, v down; zero where a vertex has none. None where no surface has a texture.
    textures : tuple of Texture
    """

    receivers: NDArray[np.int64]
    positions: NDArray[np.float64]
    faces: NDArray[np.int64]
    surfaces: tuple[DrawnFaces, ...]
    reflectance: NDArray[np.float64]
    uv: NDArray[np.float32] | None
    textures: tuple[Texture, ...]

    def of_receivers(self, receivers: NDArray[np.int64]) -> DrawnMesh:
        """The same mesh, of whose vertices other transfer has other numbers (N,)."""
        return replace(self, receivers=receivers)

    def entry(self, buffers: Buffers, first_texture: int = 0) -> dict[str, Any]:
        """What the payload says of it; ``first_texture`` is the number of the first of `textures` there."""
        low, step = _lattice(self)
        places = np.rint((self.positions - low) / step).astype(np.uint32)
        extent = places.max(axis=0, initial=0) * step
        kind = np.uint16 if places.max(initial=0) <= _STEPS else np.uint32
        reflectance = uv = receivers = None
        if np.any(self.reflectance != 1.0):
            unorm = np.rint(self.reflectance * _UNORM).astype(np.uint16)
            reflectance = buffers.add(unorm, "steps")
        if self.uv is not None:
            uv = _uv_entry(buffers, self.uv)
        distinct, numbers = _first_use(self.receivers)
        if len(distinct) < len(self.receivers):
            receivers = buffers.add(numbers.astype(np.uint32), "corners")
        return {
            "center": (low + 0.5 * extent).tolist(),
            "vertexCount": len(self.positions),
            "faceCount": len(self.faces),
            "receiverCount": len(distinct),
            "positions": buffers.add(places.astype(kind), "steps", scale=step, offset=(-0.5 * extent).tolist()),
            "faces": buffers.add(self.faces.astype(np.uint32).ravel(), "corners"),
            "surfaces": [
                {
                    "name": one.name,
                    "firstFace": one.first,
                    "faceCount": one.size,
                    "texture": None if one.texture is None else first_texture + one.texture,
                    "back": one.back,
                }
                for one in self.surfaces
            ],
            "reflectance": reflectance,
            "uv": uv,
            "receivers": receivers,
        }


def draw_mesh(mesh: Mesh, parts: Sequence[Part], surfaces: Sequence[Surface]) -> DrawnMesh:
    """The surfaces of a mesh as one mesh; what no face uses is left out.

    Parameters
    ----------
    mesh : Mesh
    parts : sequence of Part
    surfaces : sequence of Surface
        As of `split_surfaces`.

    Raises
    ------
    UserError
        There are no faces.
    """
    if not sum(len(surface.faces) for surface in surfaces):
        raise UserError(f"{mesh.name}: has no faces, so there is nothing to draw")
    textures: dict[int, Texture] = {}
    drawn: list[DrawnFaces] = []
    faces: list[NDArray[np.int64]] = []
    start = first = 0
    for surface in surfaces:
        if surface.texture is not None:
            textures.setdefault(id(surface.texture), surface.texture)
        number = None if surface.texture is None else list(textures).index(id(surface.texture))
        backs = is_back(parts, surface.vertices[surface.faces])
        for side in (False, True):
            own = surface.faces[backs == side]
            if len(own):
                drawn.append(DrawnFaces(surface.name, first, len(own), number, side))
                faces.append(own + start)
                first += len(own)
        start += len(surface.vertices)
    order, corners = _first_use(np.concatenate(faces).ravel())
    receivers = np.concatenate([surface.vertices for surface in surfaces])[order]
    uv = None
    if textures:
        uv = np.concatenate([np.zeros((len(s.vertices), 2), np.float32) if s.uv is None else s.uv for s in surfaces])[
            order
        ]
    return DrawnMesh(
        receivers,
        mesh.positions[receivers],
        corners.reshape(-1, 3),
        tuple(drawn),
        np.concatenate([surface.reflectance for surface in surfaces])[order],
        uv,
        tuple(textures.values()),
    )


def _first_use(numbers: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The numbers that are there, in the order in which they appear; and which of those each one is."""
    distinct, first, which = np.unique(numbers, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = np.arange(len(order))
    return distinct[order], rank[which.ravel()]


def _lattice(drawn: DrawnMesh) -> tuple[NDArray[np.float64], float]:
    """The lowest corner (3,) of the lattice of positions, and its step."""
    low = drawn.positions.min(axis=0)
    extent = float(np.ptp(drawn.positions, axis=0).max())
    step = extent / _STEPS if extent > 0.0 else 1.0
    finest = step
    for surface in drawn.surfaces:
        corners = drawn.positions[drawn.faces[surface.first : surface.first + surface.size]]
        edge = float(np.linalg.norm(corners[:, 0] - corners[:, 1], axis=1).mean())
        size = float(np.ptp(corners.reshape(-1, 3), axis=0).max())
        finest = min([finest, *(x for x in (edge / _STEPS_OF_EDGE, size / _STEPS_OF_SURFACE) if x > 0.0)])
    halvings = min(_HALVINGS, math.ceil(math.log2(step / finest)))
    return low, step * 2.0**-halvings


def _uv_entry(buffers: Buffers, uv: NDArray[np.float32]) -> dict[str, Any]:
    low = uv.min(axis=0).astype(np.float64)
    step = max(float(np.ptp(uv.astype(np.float64), axis=0).max()) / _UV_STEPS, 1e-30)
    places = np.rint((uv - low) / step).astype(np.uint32)
    return buffers.add(places, "steps", scale=step, offset=low.tolist())
