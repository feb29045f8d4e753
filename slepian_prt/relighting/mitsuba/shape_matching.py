"""Which shape of a Mitsuba scene is which part of a transfer file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.compression.files.vertex_order import landmarks, rounding_of
from slepian_prt.errors import UserError
from slepian_prt.relighting.mitsuba.placement import (
    MOVED,
    UNMOVED,
    Anchor,
    Placement,
    changed,
    find_placement,
    fit_similarity,
    misfit,
)
from slepian_prt.relighting.mitsuba.reach import PlacedPart, find_reaches, part_faces, remeshed
from slepian_prt.scene.face_matching import match_faces
from slepian_prt.scene.mesh import degenerate_faces
from slepian_prt.scene.scene import Part

# Shapes whose vertices, if they have any, are not those that transfer is computed at.
_TESSELLATED = {"Sphere", "Rectangle", "Disk", "Cylinder", "Cube"}


@dataclass(frozen=True, eq=False)
class MatchedMesh:
    """A mesh of a scene that has the very vertices of a part, in whatever order.

    Attributes
    ----------
    shape : Mitsuba mesh
    part : Part
    faces : (F, 3) int64
        Its faces as it numbers them, of vertices as the file numbers those.
    """

    shape: Any
    part: Part
    faces: NDArray[np.int64]

    def vertices(self, mi: Any) -> NDArray[np.int64]:
        """(V',) which vertex of the file each one of the mesh is, as far as faces use it; else the part's first."""
        numbers = np.full(self.part.count, self.part.first, dtype=np.int64)
        numbers[mesh_faces(mi, self.shape)] = self.faces
        return numbers


@dataclass(frozen=True, eq=False)
class MatchedShapes:
    """The parts of a file in one Mitsuba scene.

    Attributes
    ----------
    meshes : tuple of MatchedMesh
    by_place : tuple of PlacedPart
        Parts whose shape has other vertices, or is merged with others, or stands in an instance: they are found by
        where they are.
    placement : Placement
    positions : (V, 3) float64
        Vertices of the file in the scene.
    handles : tuple of (Mitsuba mesh, Float)
        Vertex positions of meshes as they were when matched; held, so that no other array gets the same index.
    """

    meshes: tuple[MatchedMesh, ...]
    by_place: tuple[PlacedPart, ...]
    placement: Placement
    positions: NDArray[np.float64]
    handles: tuple[tuple[Any, Any], ...]

    def vertices_changed(self, mi: Any) -> bool:
        """Whether vertices of the scene were moved since."""
        return any(before.index != _vertex_handle(mi, mesh).index for mesh, before in self.handles)


def match_shapes(mi: Any, scene: Any, packed: CompressedTransfer, file: str) -> MatchedShapes:
    """Find the parts of a file in a scene.

    Shapes are found by id; a mesh must have the file's vertices, or be cut finer there. Shapes that the file has finer
    vertices of (spheres, rectangles, …), meshes that Mitsuba has merged and instances are found by where they are.

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
    same, placed, anchors = [], [], []
    for part in packed.parts:
        shape = _shape_of(mi, shapes, part, packed)
        own = shape is not None and _has_own_vertices(shape)
        anchor = _anchor(mi, shape, part, packed) if own else None
        if anchor is not None:
            anchors.append(anchor)
        elif own and not shape.has_face_normals():  # faces that are drawn flat have vertices of their own in a file
            raise UserError(remeshed(shape, part, file))
        if anchor is not None and shape.vertex_count() == part.count:
            same.append((shape, part))
        else:
            placed.append(PlacedPart(part, shape, flat=own))
    placement = find_placement(anchors, file)
    positions = placement(packed.mesh.positions)
    placed = [replace(one, moved=placement.scale * rounding_of(packed, one.part)) for one in placed]
    reached = find_reaches(mi, scene, placed, positions, packed.mesh.faces, file)
    meshes = [MatchedMesh(*one, _faces_in_file(mi, *one, positions, packed.mesh.faces, file)) for one in same]
    own_meshes = [shape for shape in shapes if _has_own_vertices(shape) and _is_known(shape, same, placed)]
    handles = tuple((mesh, _vertex_handle(mi, mesh)) for mesh in own_meshes)
    return MatchedShapes(tuple(meshes), reached, placement, positions, handles)


def part_vertices(part: Part) -> slice:
    """Of the vertices of the file, those on the front."""
    return slice(part.first, part.first + part.count)


def _shape_of(mi: Any, shapes: Sequence[Any], part: Part, packed: CompressedTransfer) -> Any:
    """The shape of the scene that the part was computed on; None if it must be found by its place."""
    for shape in shapes:
        if shape.id() == part.name:
            return shape
    if len(packed.parts) > 1:
        return None
    # A mesh file has no ids: the only mesh without another name that has the same vertices.
    alike = []
    for shape in shapes:
        if _has_own_vertices(shape) and shape.vertex_count() == part.count:
            anchor = _known_vertices(mi, shape, part, packed)
            if misfit(fit_similarity(anchor.in_scene, anchor.in_file), anchor) <= MOVED:
                alike.append(shape)
    return alike[0] if len(alike) == 1 else None


def _anchor(mi: Any, mesh: Any, part: Part, packed: CompressedTransfer) -> Anchor | None:
    """Vertices that a mesh of the scene and its part have in common: of all, or of those before it was cut finer."""
    count = mesh.vertex_count()
    if count > part.count:
        return None
    anchor = _known_vertices(mi, mesh, part, packed)
    if count < part.count and misfit(fit_similarity(anchor.in_scene, anchor.in_file), anchor) > MOVED:
        return None
    return anchor


def _known_vertices(mi: Any, mesh: Any, part: Part, packed: CompressedTransfer) -> Anchor:
    """All vertices of a mesh if they are in the order of the part, else those that the file knows by their number."""
    in_scene, in_file = _mesh_positions(mi, mesh), packed.mesh.positions[part_vertices(part)]
    same_order = Anchor(part.name, in_scene, in_file[: len(in_scene)])
    if misfit(fit_similarity(same_order.in_scene, same_order.in_file), same_order) <= MOVED:
        return same_order
    now, before = landmarks(packed, part)
    chosen = before < len(in_scene)
    if not chosen.any():
        return same_order
    return Anchor(part.name, in_scene[before[chosen]], packed.mesh.positions[now[chosen]])


def _faces_in_file(
    mi: Any, shape: Any, part: Part, positions: NDArray[np.float64], faces: NDArray, file: str
) -> NDArray[np.int64]:
    """(F', 3) faces of a mesh of the scene, of vertices as the file numbers them.

    Parameters
    ----------
    mi, shape, part, file
        As of `match_shapes`.
    positions : (V, 3)
        Vertices of the file in the scene.
    faces : (F, 3)
        Of the file.

    Raises
    ------
    UserError
        They are not those of the file.
    """
    there, own = _mesh_positions(mi, shape), mesh_faces(mi, shape)
    anchor = Anchor(part.name, there, positions[part_vertices(part)])
    if misfit(UNMOVED, anchor) <= MOVED:
        return own + part.first
    kept = np.flatnonzero(~degenerate_faces(there, own))  # no ray meets the others
    others = part_faces(faces, part).astype(np.int64)
    tolerance = MOVED * float(np.linalg.norm(np.ptp(there, axis=0)))
    matched = match_faces(there[own[kept]], positions[others], tolerance)
    if np.any(matched.faces < 0):
        raise UserError(changed(part.name, file))
    result = np.full_like(own, part.first)
    result[kept] = matched.of_corners(others)
    return result


def _has_own_vertices(shape: Any) -> bool:
    return bool(shape.is_mesh()) and shape.class_name() not in _TESSELLATED


def _is_known(shape: Any, same: Sequence[tuple[Any, Part]], placed: Sequence[PlacedPart]) -> bool:
    known = [mesh for mesh, _ in same] + [one.shape for one in placed if one.shape is not None]
    return any(shape.ptr == other.ptr for other in known)


def _mesh_positions(mi: Any, shape: Any) -> NDArray[np.float64]:
    """(V', 3) vertices of a mesh of the scene."""
    import drjit as dr

    return np.array(shape.vertex_position(dr.arange(mi.UInt32, shape.vertex_count())), dtype=np.float64).T


def mesh_faces(mi: Any, shape: Any) -> NDArray[np.int64]:
    """(F, 3) of a Mitsuba mesh, in the order that it numbers them."""
    import drjit as dr

    return np.array(shape.face_indices(dr.arange(mi.UInt32, shape.face_count())), dtype=np.int64).T


def _vertex_handle(mi: Any, shape: Any) -> Any:
    """A copy of the handle of a mesh's vertex positions."""
    return mi.Float(mi.traverse(shape)["vertex_positions"])
