"""Where rays meet the surfaces of a transfer file, and what its vertices weigh there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.relighting.mitsuba.shape_matching import MatchedShapes, part_faces
from slepian_prt.scene.mesh import Mesh

# Cosine between the normals of what a ray meets and of the file's surface close by, if that is the same surface.
_SAME_SURFACE = 0.7


@dataclass(frozen=True, eq=False)
class SurfaceHit:
    """What rays meet of the surfaces of a file, on Mitsuba's arrays.

    Attributes
    ----------
    valid : Bool
        Whether it is the front of such a surface.
    vertices : three UInt32
        Of the triangle there.
    weights : three Float
        Barycentric.
    """

    valid: Any
    vertices: tuple[Any, Any, Any]
    weights: tuple[Any, Any, Any]


class Surfaces:
    """The triangles of a file in one Mitsuba scene.

    Parameters
    ----------
    mi : Mitsuba, in the variant of the scene
    matched : MatchedShapes
    mesh : Mesh
        Of the file.
    """

    def __init__(self, mi: Any, matched: MatchedShapes, mesh: Mesh) -> None:
        self._mi, self._reach = mi, matched.reach
        # Faces are those of matched meshes as Mitsuba numbers them, one mesh after the other, then those by place.
        faces = [mesh_faces(mi, shape) + part.first for shape, part in matched.meshes]
        ends = np.cumsum([0, *(len(some) for some in faces)])
        self._first_face = _by_shape(mi, [shape for shape, _ in matched.meshes], ends[:-1])
        self._first_by_place = int(ends[-1])
        self._by_place: Any = None
        if matched.by_place:
            faces.append(part_faces(mesh, matched.by_place).astype(np.int64))
            self._by_place = _triangle_scene(mi, matched.positions, faces[-1])
        corners = np.concatenate(faces).astype(np.uint32)
        self._corners = tuple(mi.UInt32(np.ascontiguousarray(corners[:, i])) for i in range(3))

    def intersect(self, ray: Any, hit: Any, si: Any, active: Any) -> SurfaceHit:
        """What rays meet of the surfaces.

        Parameters
        ----------
        ray : Ray3f
        hit : PreliminaryIntersection3f
            Of the rays with the scene.
        si : SurfaceInteraction3f
            Of the same, minimal.
        active : Bool
        """
        import drjit as dr

        mi = self._mi
        active = active & hit.is_valid()
        number: Any = dr.reinterpret_array(mi.UInt32, hit.shape)
        known = active & (number < dr.width(self._first_face))
        first = dr.select(known, dr.gather(mi.Int32, self._first_face, number, known), -1)
        valid = active & (first >= 0) & (dr.dot(si.n, ray.d) < 0.0)
        face = mi.UInt32(first) + hit.prim_index
        u, v = mi.Float(hit.prim_uv.x), mi.Float(hit.prim_uv.y)
        if self._by_place is not None:
            near, here = self._intersect_by_place(ray, si, active & (first < 0))
            face = dr.select(here, mi.UInt32(self._first_by_place) + near.prim_index, face)
            u, v = dr.select(here, near.prim_uv.x, u), dr.select(here, near.prim_uv.y, v)
            valid |= here
        vertices = tuple(dr.gather(mi.UInt32, corner, face, valid) for corner in self._corners)
        return SurfaceHit(valid, vertices, (1.0 - u - v, u, v))

    def _intersect_by_place(self, ray: Any, si: Any, active: Any) -> tuple[Any, Any]:
        """The file's surface close to what rays meet (PreliminaryIntersection3f), and whether its front is there."""
        import drjit as dr

        mi = self._mi
        # From a little above what was met, back along the normal on the side that is seen.
        normal = dr.mulsign(si.n, -dr.dot(si.n, ray.d))
        probe = mi.Ray3f(si.p + self._reach * normal, -normal)
        probe.maxt = 2.0 * self._reach
        near = self._by_place.ray_intersect_preliminary(probe, active=active)
        there = near.compute_surface_interaction(probe, mi.RayFlags.Minimal, active & near.is_valid())
        # The front of the same surface, and not that of another one close by.
        same = (dr.dot(there.n, normal) > _SAME_SURFACE) & (dr.dot(there.n, ray.d) < 0.0)
        return near, active & near.is_valid() & same


def mesh_faces(mi: Any, shape: Any) -> NDArray[np.int64]:
    """(F, 3) of a Mitsuba mesh, in the order that it numbers them."""
    import drjit as dr

    return np.array(shape.face_indices(dr.arange(mi.UInt32, shape.face_count())), dtype=np.int64).T


def _by_shape(mi: Any, shapes: list[Any], values: NDArray) -> Any:
    """Int32 table of a value for each shape, by its number in Mitsuba's registry (0 is no shape); -1 for others."""
    import drjit as dr

    numbers = [int(mi.UInt32(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(shape)))[0]) for shape in shapes]
    table = np.full(max(numbers, default=0) + 1, -1, dtype=np.int32)
    table[numbers] = values
    return mi.Int32(table)


def _triangle_scene(mi: Any, positions: NDArray, faces: NDArray) -> Any:
    """A Mitsuba scene of nothing but triangles."""
    mesh = mi.Mesh("transfer", len(positions), len(faces))
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = mi.Float(positions.astype(np.float32).ravel())
    parameters["faces"] = mi.UInt32(faces.astype(np.uint32).ravel())
    parameters.update()
    return mi.load_dict({"type": "scene", "mesh": mesh})
