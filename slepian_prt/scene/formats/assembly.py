"""From polygons of several materials to parts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError
from slepian_prt.scene.formats.joining import join_equal
from slepian_prt.scene.formats.parts import Material, MeshFile, MeshPart
from slepian_prt.scene.formats.polygons import TangledError, triangulate


@dataclass(frozen=True, eq=False)
class Vertices:
    """What the vertices of a file have.

    Attributes
    ----------
    positions : (V, 3) float64
    normals : (V, 3) float64 or None
    colors : (V, 3) float32 or None
    points : (V,) int64 or None
        Vertices of one number are one point of the surface and share a computed normal. None: each is its own.
    source : (n, 2) int64 or None
        As of `MeshPart`.
    """

    positions: NDArray[np.float64]
    normals: NDArray[np.float64] | None = None
    colors: NDArray[np.float32] | None = None
    points: NDArray[np.int64] | None = None
    source: NDArray[np.int64] | None = None


@dataclass(frozen=True, eq=False)
class Polygons:
    """Polygons with what their corners have.

    Attributes
    ----------
    sizes : (P,) int64
        Numbers of corners.
    corners : (C,) int64
        Vertices, from 0 on.
    uv : (C, 2) float32 or None
        As in `MeshPart`.
    materials : (P,) int64 or None
        Indices, -1 for none. None: no polygon has one.
    line : callable or None
        Gives the line of the file where a polygon is, in files of text that tell.
    """

    sizes: NDArray[np.int64]
    corners: NDArray[np.int64]
    uv: NDArray[np.float32] | None = None
    materials: NDArray[np.int64] | None = None
    line: Callable[[int], int] | None = None


def assemble(
    path: Path, vertices: Vertices, polygons: Polygons, materials: Sequence[Material] = (), notes: Sequence[str] = ()
) -> MeshFile:
    """Triangulate polygons and make a part of each material.

    A single part has all vertices in their order. Several have those that they use, and say which of them are one point
    of the surface, which goes on from one material to the next.

    Raises
    ------
    UserError
        A polygon names a vertex that does not exist; none of some polygons has three different corners; one of
        them is too long to be cut.
    """
    check_corners(path, polygons, len(vertices.positions))
    try:
        triangles, owners = triangulate(vertices.positions, polygons.sizes, polygons.corners)
    except TangledError as error:
        line = f"line {polygons.line(error.polygon)}: " if polygons.line else ""
        raise UserError(
            f"{path}: {line}face {error.polygon} has {error.size} corners, and is too long, or crosses itself too "
            "much, to be cut into triangles; export triangles"
        ) from None
    notes = list(notes)
    lost = len(polygons.sizes) - np.count_nonzero(np.diff(owners, prepend=-1))
    if lost and not len(triangles):
        raise UserError(f"{path}: all {lost} faces of it have fewer than three different corners; export it again")
    if lost:
        notes.append(f"{lost} faces of fewer than three different corners left out")
    faces = polygons.corners[triangles]
    uv = None if polygons.uv is None else polygons.uv[triangles]
    numbers = np.array([-1]) if polygons.materials is None else polygons.materials[owners]
    used = np.unique(numbers)
    if len(used) > 1 and vertices.points is None:
        vertices = replace(vertices, points=np.arange(len(vertices.positions)))
    if len(used) <= 1:
        material = materials[used[0]] if len(used) and used[0] >= 0 else None
        return MeshFile((_part(path.stem, vertices, faces, uv, material),), tuple(notes))
    parts = []
    order = np.argsort(numbers, kind="stable")
    for chosen in np.split(order, np.searchsorted(numbers[order], used[1:])):
        number = numbers[chosen[0]]
        material = materials[number] if number >= 0 else None
        kept, renumbered = np.unique(faces[chosen], return_inverse=True)
        own = Vertices(
            vertices.positions[kept],
            None if vertices.normals is None else vertices.normals[kept],
            None if vertices.colors is None else vertices.colors[kept],
            None if vertices.points is None else vertices.points[kept],
            _source_of(vertices, kept),
        )
        name = material.name if material else path.stem
        parts.append(_part(name, own, renumbered.reshape(-1, 3), None if uv is None else uv[chosen], material))
    return MeshFile(tuple(parts), tuple(notes))


def single_uv(uv: NDArray) -> NDArray[np.float32]:
    """Texture coordinates in float32; what that does not hold is infinite, and says of no place in an image."""
    with np.errstate(over="ignore"):
        return uv.astype(np.float32)


def check_corners(path: Path, polygons: Polygons, count: int) -> None:
    """Raise UserError if polygons name vertices outside of [0, count)."""
    bad = np.flatnonzero((polygons.corners < 0) | (polygons.corners >= count))
    if bad.size:
        face = int(np.searchsorted(np.cumsum(polygons.sizes), bad[0], side="right"))
        raise UserError(
            f"{path}: {bad.size} corners of faces name vertices that do not exist (face {face} names vertex "
            f"{polygons.corners[bad[0]]}, the mesh has {count} vertices, numbered from 0); export the mesh again"
        )


def join_split(vertices: Vertices) -> tuple[Vertices, NDArray[np.int64]]:
    """Join vertices without normals where position and colour are equal; those of equal position are one point.

    Returns
    -------
    vertices : Vertices
    joined : (V,) int64
        The number of each vertex among them.
    """
    first, joined = join_equal(vertices.positions)
    if vertices.colors is None:
        return Vertices(vertices.positions[first], source=source_of_joined(joined)), joined
    places, point = first, joined
    first, joined = join_equal(vertices.positions, vertices.colors)
    points = point[first] if len(first) > len(places) else None
    source = source_of_joined(joined)
    return Vertices(vertices.positions[first], None, vertices.colors[first], points, source), joined


def source_of_joined(joined: NDArray[np.int64]) -> NDArray[np.int64] | None:
    """As ``source`` of `Vertices`, of vertices of the file that became ``joined`` (N,); None if each is its own."""
    numbers = np.arange(len(joined))
    return None if np.all(joined == numbers) else np.stack([numbers, joined], axis=1)


def _source_of(vertices: Vertices, kept: NDArray[np.int64]) -> NDArray[np.int64]:
    """As ``source`` of `Vertices`, of some of them, ascending."""
    if vertices.source is None:
        return np.stack([kept, np.arange(len(kept))], axis=1)
    there = np.isin(vertices.source[:, 1], kept)
    return np.stack([vertices.source[there, 0], np.searchsorted(kept, vertices.source[there, 1])], axis=1)


def _part(
    name: str,
    vertices: Vertices,
    faces: NDArray[np.int64],
    uv: NDArray[np.float32] | None,
    material: Material | None,
) -> MeshPart:
    textured = material is not None and (material.texture is not None or material.metallic_texture is not None)
    return MeshPart(
        name=name,
        positions=vertices.positions,
        faces=faces,
        normals=vertices.normals,
        colors=vertices.colors,
        points=vertices.points,
        source=vertices.source,
        uv=uv if textured else None,
        material=material,
    )
