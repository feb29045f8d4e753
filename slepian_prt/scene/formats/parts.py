"""What a mesh file holds, in the same words for every format: parts with their geometry and material."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Wrap = Literal["repeat", "clamp", "mirror"]


@dataclass(frozen=True, eq=False)
class Texture:
    """An encoded image, and how it continues beyond its borders.

    Attributes
    ----------
    name : str
        For messages.
    source : bytes or Path
        A PNG, JPEG or the like: its content, or the file that it is in (which may be missing).
    wrap : (2,) of str
        Along u and along v.
    """

    name: str
    source: bytes | Path
    wrap: tuple[Wrap, Wrap] = ("repeat", "repeat")


@dataclass(frozen=True, eq=False)
class Material:
    """What a surface reflects.

    Attributes
    ----------
    name : str
    color : (3,) of float
        Linear RGB reflectance, a factor of ``texture`` and of vertex colours.
    texture : Texture or None
        Of reflectance; sRGB as such images are.
    metallic : float
        Part of the surface that is metal, which reflects nothing diffusely; a factor of ``metallic_texture``.
    metallic_texture : Texture or None
        Linear; its blue channel counts.
    not_simulated : tuple of str
        What else the material has, as the name of an effect: ``transparency``, ``transmission``, ``emitted light``,
        ``normal map``, ….
    """

    name: str
    color: tuple[float, float, float] = (1.0, 1.0, 1.0)
    texture: Texture | None = None
    metallic: float = 0.0
    metallic_texture: Texture | None = None
    not_simulated: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class MeshPart:
    """Triangles of one material.

    Attributes
    ----------
    name : str
    positions : (V, 3) float64
        In the space of the whole file, as exact as the file has them.
    faces : (F, 3) int64
        Polygons are already triangulated. Not checked yet.
    normals : (V, 3) float64 or None
        As the file gives them, not normalised; zero or NaN where it gives none. None: it gives none at all.
    colors : (V, 3) float32 or None
        Linear RGB of the vertices, a factor of the material's.
    points : (V,) int64 or None
        Vertices of the same number, in whatever part, are one point of the surface, from 0 on, and share a computed
        normal. None: each vertex is its own.
    uv : (F, 3, 2) float32 or None
        Texture coordinates of the corners of the faces for ``material.texture``. The first texel of the first row of
        the image is at (0, 0), its last at (1, 1): v runs down, as in glTF. Formats whose v runs up give 1 - v.
    metallic_uv : (F, 3, 2) float32 or None
        The same for ``material.metallic_texture``; None if they are those of ``uv``.
    material : Material or None
        None if the file says nothing of one.
    source : (n, 2) int64 or None
        Pairs of a vertex of the file and one of the part at its place; None: they have the same numbers, or the file
        numbers none.
    """

    name: str
    positions: NDArray[np.float64]
    faces: NDArray[np.int64]
    normals: NDArray[np.float64] | None = None
    colors: NDArray[np.float32] | None = None
    points: NDArray[np.int64] | None = None
    uv: NDArray[np.float32] | None = None
    metallic_uv: NDArray[np.float32] | None = None
    material: Material | None = None
    source: NDArray[np.int64] | None = None


@dataclass(frozen=True, eq=False)
class MeshFile:
    """All parts of a file.

    Attributes
    ----------
    parts : tuple of MeshPart
    notes : tuple of str
        What the reader did that its user should know, one sentence each without a full stop: "3 points and lines left
        out", "skins stand in their bind pose".
    """

    parts: tuple[MeshPart, ...]
    notes: tuple[str, ...] = ()


def share_textures(file: MeshFile) -> MeshFile:
    """The same, with one object for textures of the same image that continue alike, so that it is decoded once."""
    known: dict[tuple[bytes | Path, tuple[Wrap, Wrap]], Texture] = {}

    def shared(texture: Texture | None) -> Texture | None:
        return None if texture is None else known.setdefault((texture.source, texture.wrap), texture)

    materials = {id(part.material): part.material for part in file.parts if part.material is not None}
    changed = {
        key: replace(material, texture=shared(material.texture), metallic_texture=shared(material.metallic_texture))
        for key, material in materials.items()
    }
    return replace(file, parts=tuple(replace(p, material=changed.get(id(p.material))) for p in file.parts))
