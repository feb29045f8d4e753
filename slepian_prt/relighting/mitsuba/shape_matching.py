"""Which shape of a Mitsuba scene is which part of a transfer file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.errors import UserError
from slepian_prt.relighting.mitsuba.placement import MOVED, Anchor, Placement, find_placement, fit_similarity, misfit
from slepian_prt.relighting.mitsuba.reach import PlacedPart, find_reaches, remeshed
from slepian_prt.scene.scene import Part

# Shapes whose vertices, if they have any, are not those that transfer is computed at.
_TESSELLATED = {"Sphere", "Rectangle", "Disk", "Cylinder", "Cube"}


@dataclass(frozen=True, eq=False)
class MatchedShapes:
    """The parts of a file in one Mitsuba scene.

    Attributes
    ----------
    meshes : tuple of (Mitsuba mesh, Part)
        Meshes of the scene that have the very vertices of a part.
    by_place : tuple of PlacedPart
        Parts whose shape has other vertices, or is merged with others, or stands in an instance: they are found by
        where they are.
    placement : Placement
    positions : (V, 3) float64
        Vertices of the file in the scene.
    handles : tuple of (Mitsuba mesh, Float)
        Vertex positions of meshes as they were when matched; held, so that no other array gets the same index.
    """

    meshes: tuple[tuple[Any, Part], ...]
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
    meshes, placed, anchors = [], [], []
    for part in packed.parts:
        shape = _shape_of(mi, shapes, part, packed)
        own = shape is not None and _has_own_vertices(shape)
        anchor = _anchor(mi, shape, part, packed) if own else None
        if anchor is not None:
            anchors.append(anchor)
        elif own and not shape.has_face_normals():  # faces that are drawn flat have vertices of their own in a file
            raise UserError(remeshed(shape, part, file))
        if anchor is not None and shape.vertex_count() == part.count:
            meshes.append((shape, part))
        else:
            placed.append(PlacedPart(part, shape, flat=own))
    placement = find_placement(anchors, file)
    positions = placement(packed.mesh.positions)
    reached = find_reaches(mi, scene, placed, positions, packed.mesh.faces, file)
    own_meshes = [shape for shape in shapes if _has_own_vertices(shape) and _is_known(shape, meshes, placed)]
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
            anchor = Anchor(part.name, _mesh_positions(mi, shape), packed.mesh.positions[part_vertices(part)])
            if misfit(fit_similarity(anchor.in_scene, anchor.in_file), anchor) <= MOVED:
                alike.append(shape)
    return alike[0] if len(alike) == 1 else None


def _anchor(mi: Any, mesh: Any, part: Part, packed: CompressedTransfer) -> Anchor | None:
    """The vertices that a mesh of the scene and its part have in common: all, or those before it was cut finer."""
    count = mesh.vertex_count()
    anchor = Anchor(part.name, _mesh_positions(mi, mesh), packed.mesh.positions[part_vertices(part)][:count])
    if count == part.count:
        return anchor
    if count > part.count or misfit(fit_similarity(anchor.in_scene, anchor.in_file), anchor) > MOVED:
        return None
    return anchor


def _has_own_vertices(shape: Any) -> bool:
    return bool(shape.is_mesh()) and shape.class_name() not in _TESSELLATED


def _is_known(shape: Any, meshes: Sequence[tuple[Any, Part]], placed: Sequence[PlacedPart]) -> bool:
    known = [mesh for mesh, _ in meshes] + [one.shape for one in placed if one.shape is not None]
    return any(shape.ptr == other.ptr for other in known)


def _mesh_positions(mi: Any, shape: Any) -> NDArray[np.float64]:
    """(V', 3) vertices of a mesh of the scene."""
    import drjit as dr

    return np.array(shape.vertex_position(dr.arange(mi.UInt32, shape.vertex_count())), dtype=np.float64).T


def _vertex_handle(mi: Any, shape: Any) -> Any:
    """A copy of the handle of a mesh's vertex positions."""
    return mi.Float(mi.traverse(shape)["vertex_positions"])
