"""Which shape of a Mitsuba scene is which part of a transfer file, and how the file's model was moved."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.errors import UserError
from slepian_prt.scene.mesh import Mesh
from slepian_prt.scene.scene import Part

# Vertices of a shape may be this far, in diagonals of it, from where transfer was computed.
_MOVED = 1e-4

# Points at which a shape without the file's own vertices is searched, and the fraction that must be found.
_PROBES = 512
_FOUND = 0.97

# How far from the surface of a scene that of the file may be, in mean lengths of an edge.
_REACH = 0.3

# Shapes whose vertices, if they have any, are not those that transfer is computed at.
_TESSELLATED = {"Sphere", "Rectangle", "Disk", "Cylinder", "Cube"}


@dataclass(frozen=True, eq=False)
class Placement:
    """Where the file's world is in that of a scene: ``scale`` R x + ``offset``.

    Distant light is the same everywhere, so what was precomputed holds for a moved, turned and scaled model too.
    """

    rotation: NDArray[np.float64]
    scale: float
    offset: NDArray[np.float64]

    def __call__(self, positions: NDArray) -> NDArray[np.float64]:
        return self.scale * positions @ self.rotation.T + self.offset


@dataclass(frozen=True, eq=False)
class MatchedShapes:
    """The parts of a file in one Mitsuba scene.

    Attributes
    ----------
    meshes : tuple of (Mitsuba mesh, Part)
        Meshes of the scene that have the very vertices of a part.
    by_place : tuple of Part
        Parts whose shape has other vertices, or is merged with others: they are found by where they are.
    placement : Placement
    positions : (V, 3) float64
        Vertices of the file in the scene.
    reach : float
        How far from the surface of the scene a part that is found by place may be.
    handles : tuple of Float
        Vertex positions of ``meshes`` as they were when matched; held, so that no other array gets the same index.
    """

    meshes: tuple[tuple[Any, Part], ...]
    by_place: tuple[Part, ...]
    placement: Placement
    positions: NDArray[np.float64]
    reach: float
    handles: tuple[Any, ...]

    def vertices_changed(self, mi: Any) -> bool:
        """Whether vertices of the scene were moved since."""
        now = (_vertex_handle(mi, shape) for shape, _ in self.meshes)
        return any(a.index != b.index for a, b in zip(self.handles, now, strict=True))


def match_shapes(mi: Any, scene: Any, packed: CompressedTransfer, file: str) -> MatchedShapes:
    """Find the parts of a file in a scene.

    Shapes are found by id; a mesh must have the file's vertices. Shapes that the file has finer vertices of (spheres,
    rectangles, …) and meshes that Mitsuba has merged are found by where they are.

    Parameters
    ----------
    mi : Mitsuba, in the variant of the scene
    scene : Mitsuba scene
    packed : CompressedTransfer
    file : str
        Its name, for messages.

    Raises
    ------
    UserError
        A part that is not in the scene, or has other vertices there.
    """
    shapes = list(scene.shapes())
    named = [(_mesh_of(mi, shapes, part, packed, file), part) for part in packed.parts]
    meshes = tuple((shape, part) for shape, part in named if shape is not None)
    by_place = tuple(part for shape, part in named if shape is None)
    placement = _find_placement(mi, meshes, packed.mesh, file)
    positions = placement(packed.mesh.positions)
    corners = positions[part_faces(packed.mesh, by_place)]
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    reach = _REACH * float(edges.mean()) if by_place else 0.0
    handles = tuple(_vertex_handle(mi, shape) for shape, _ in meshes)
    matched = MatchedShapes(meshes, by_place, placement, positions, reach, handles)
    for part in by_place:
        _check_surface_there(mi, scene, part, matched, packed.mesh, file)
    return matched


def part_vertices(part: Part) -> slice:
    """Of the vertices of the file."""
    return slice(part.first, part.first + part.count)


def part_faces(mesh: Mesh, parts: Sequence[Part]) -> NDArray[np.int32]:
    """(F', 3) faces of some parts of a file's mesh."""
    first = mesh.faces[:, 0]
    chosen = np.zeros(len(first), dtype=bool)
    for part in parts:
        chosen |= (first >= part.first) & (first < part.first + part.count)
    return mesh.faces[chosen]


# --- By id and vertices ----------------------------------------------------------------------------------------------


def _mesh_of(mi: Any, shapes: Sequence[Any], part: Part, packed: CompressedTransfer, file: str) -> Any:
    """The mesh of the scene that has the part's vertices; None if the part must be found by its place.

    Raises
    ------
    UserError
        A mesh of that id with another number of vertices.
    """
    for shape in shapes:
        if shape.id() != part.name:
            continue
        if not _has_own_vertices(shape):
            return None
        if shape.vertex_count() != part.count:
            raise UserError(
                f"{file}: shape '{part.name}' has {part.count} vertices there and {shape.vertex_count()} in the scene; "
                "it was remeshed since, so precompute it again"
            )
        return shape
    # A mesh file has no ids: the only mesh without another name that has the same vertices.
    positions = packed.mesh.positions[part_vertices(part)]
    alike = [
        shape
        for shape in shapes
        if _has_own_vertices(shape)
        and shape.vertex_count() == part.count
        and _fit_similarity(_mesh_positions(mi, shape), positions)[1] <= _MOVED
    ]
    return alike[0] if len(alike) == 1 and len(packed.parts) == 1 else None


def _has_own_vertices(shape: Any) -> bool:
    return bool(shape.is_mesh()) and shape.class_name() not in _TESSELLATED


def _find_placement(mi: Any, meshes: Sequence[tuple[Any, Part]], mesh: Mesh, file: str) -> Placement:
    """Where the file's world is, from the vertices that both have.

    Raises
    ------
    UserError
        Shapes whose vertices are not those of the file, in the same order, moved as one.
    """
    unmoved = Placement(np.eye(3), 1.0, np.zeros(3))
    if not meshes:
        return unmoved
    in_scene = [_mesh_positions(mi, shape) for shape, _ in meshes]
    in_file = [mesh.positions[part_vertices(part)] for _, part in meshes]

    def misfits(placement: Placement) -> list[float]:
        return [_misfit(placement, a, b) for a, b in zip(in_scene, in_file, strict=True)]

    placement = unmoved
    if max(misfits(unmoved)) > _MOVED:
        placement = _fit_similarity(np.concatenate(in_scene), np.concatenate(in_file))[0]
    remaining = misfits(placement)
    worst = int(np.argmax(remaining))
    if remaining[worst] > _MOVED or not np.isfinite(remaining[worst]):
        name = meshes[worst][1].name
        raise UserError(
            f"{file}: shape '{name}' of the scene has the {meshes[worst][1].count} vertices of '{name}' there, but in "
            "another order or at other places; it was changed since, so precompute it again"
        )
    return placement


def _fit_similarity(in_scene: NDArray, in_file: NDArray) -> tuple[Placement, float]:
    """The similarity that takes ``in_file`` to ``in_scene`` (Umeyama 1991), and its misfit."""
    scene_mean, file_mean = in_scene.mean(axis=0), in_file.mean(axis=0)
    a, b = in_scene - scene_mean, in_file - file_mean
    u, singular, vt = np.linalg.svd(a.T @ b)
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    rotation = (u * sign) @ vt
    scale = float(np.sum(singular * sign) / max(float(np.sum(b * b)), 1e-300))
    placement = Placement(rotation, scale, scene_mean - scale * rotation @ file_mean)
    return placement, _misfit(placement, in_scene, in_file)


def _misfit(placement: Placement, in_scene: NDArray, in_file: NDArray) -> float:
    """Largest distance of a vertex from where it should be, in diagonals, beyond what rounding to float32 moves it."""
    diagonal = float(np.linalg.norm(np.ptp(in_scene, axis=0)))
    distance = float(np.abs(placement(in_file) - in_scene).max())
    rounding = 4.0 * float(np.spacing(np.float32(np.abs(in_scene).max())))
    return max(distance - rounding, 0.0) / max(diagonal, 1e-300)


def _mesh_positions(mi: Any, shape: Any) -> NDArray[np.float64]:
    """(V', 3) vertices of a mesh of the scene."""
    import drjit as dr

    return np.array(shape.vertex_position(dr.arange(mi.UInt32, shape.vertex_count())), dtype=np.float64).T


def _vertex_handle(mi: Any, shape: Any) -> Any:
    """A copy of the handle of a mesh's vertex positions."""
    return mi.Float(mi.traverse(shape)["vertex_positions"])


# --- By place --------------------------------------------------------------------------------------------------------


def _check_surface_there(mi: Any, scene: Any, part: Part, matched: MatchedShapes, mesh: Mesh, file: str) -> None:
    """Raise UserError unless the scene has a surface where a part is."""
    faces = np.random.default_rng(0).permutation(part_faces(mesh, [part]))[:_PROBES]
    corners = matched.positions[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    start = corners.mean(axis=1) + matched.reach * normals
    ray = mi.Ray3f(mi.Point3f(start.T.astype(np.float32)), mi.Vector3f(-normals.T.astype(np.float32)))
    ray.maxt = 2.0 * matched.reach
    if np.mean(np.array(scene.ray_test(ray))) < _FOUND:
        shapes = ", ".join(f"'{shape.id()}'" for shape in scene.shapes()) or "none"
        raise UserError(
            f"{file}: its shape '{part.name}' ({part.count} vertices) is not in the scene, which has the shapes "
            f"{shapes}; give the shape that id; it may be moved, turned and evenly scaled, but not changed"
        )
