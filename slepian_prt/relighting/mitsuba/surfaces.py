"""Where rays meet the surfaces of a transfer file, and what its vertices weigh there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.relighting.mitsuba.reach import PlacedPart, part_faces
from slepian_prt.relighting.mitsuba.shape_matching import MatchedShapes
from slepian_prt.scene.mesh import Mesh

# Cosine between the normals of what a ray meets and of the file's surface close by, if that is the same surface.
_SAME_SURFACE = 0.7

# Surfaces of a file that are looked at, one behind the other, before a point is given up.
_LAYERS = 8


@dataclass(frozen=True, eq=False)
class SurfaceHit:
    """What rays meet of the surfaces of a file, on Mitsuba's arrays.

    Attributes
    ----------
    valid : Bool
        Whether it is a side of such a surface that the file holds.
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
    scene : Mitsuba scene
        What rays meet it in, by whose side the triangles are traced.
    """

    def __init__(self, mi: Any, matched: MatchedShapes, mesh: Mesh, scene: Any) -> None:
        self._mi = mi
        # Faces are those of matched meshes as Mitsuba numbers them, one mesh after the other, then those by place.
        faces = [one.faces for one in matched.meshes]
        parts = [one.part for one in matched.meshes]
        ends = np.cumsum([0, *(len(some) for some in faces)])
        self._first_face = _by_shape(mi, [one.shape for one in matched.meshes], ends[:-1])
        self._placed: PlacedSurfaces | None = None
        if matched.by_place:
            self._placed = PlacedSurfaces(mi, matched.by_place, matched.positions, mesh, int(ends[-1]), scene)
            faces += [part_faces(mesh.faces, one.part).astype(np.int64) for one in matched.by_place]
            parts += [one.part for one in matched.by_place]
        corners = np.concatenate(faces).astype(np.uint32)
        self._corners = tuple(mi.UInt32(np.ascontiguousarray(corners[:, i])) for i in range(3))
        # How many vertices later those of the back are; 0 where the back is not held.
        backs = [part.count if part.sides == 2 else 0 for part in parts]
        self._any_back = any(backs)
        self._to_back = mi.UInt32(np.repeat(backs, [len(some) for some in faces]).astype(np.uint32))

    def intersect(self, ray: Any, hit: Any, si: Any, active: Any) -> SurfaceHit:
        """What rays meet of the surfaces.

        Parameters
        ----------
        ray : Ray3f
        hit : PreliminaryIntersection3f
            Of the rays with the scene.
        si : SurfaceInteraction3f
            Of the same, with shading normals.
        active : Bool
        """
        import drjit as dr

        mi = self._mi
        active = active & hit.is_valid()
        first = _of_shape(mi, self._first_face, hit.shape, active)
        valid = active & (first >= 0)
        # The front is that of the shading normals: faces of mirrored meshes run against them.
        back = (dr.dot(si.n, ray.d) > 0.0) ^ (dr.dot(si.n, si.sh_frame.n) < 0.0)
        face = mi.UInt32(first) + hit.prim_index
        u, v = mi.Float(hit.prim_uv.x), mi.Float(hit.prim_uv.y)
        if self._placed is not None:
            near = self._placed.find(ray, hit, si, active & ~valid)
            face, back = dr.select(near.valid, near.face, face), dr.select(near.valid, near.back, back)
            u, v = dr.select(near.valid, near.u, u), dr.select(near.valid, near.v, v)
            valid |= near.valid
        vertices = [dr.gather(mi.UInt32, corner, face, valid) for corner in self._corners]
        if self._any_back:
            later = dr.gather(mi.UInt32, self._to_back, face, valid)
            valid &= ~back | (later > 0)
            vertices = [vertex + dr.select(back, later, 0) for vertex in vertices]
        else:
            valid &= ~back
        return SurfaceHit(valid, (vertices[0], vertices[1], vertices[2]), (1.0 - u - v, u, v))


@dataclass(frozen=True, eq=False)
class NearFace:
    """The face of a file close to what rays meet: whether there is one, its number, its back, and where on it."""

    valid: Any
    face: Any
    back: Any
    u: Any
    v: Any


class PlacedSurfaces:
    """Parts of a file that are found by where they are.

    Parameters
    ----------
    mi : Mitsuba, in the variant of the scene
    placed : sequence of PlacedPart
    positions : (V, 3)
        Vertices of the file in the scene.
    mesh : Mesh
        Of the file.
    first : int
        Number of the first of their faces.
    scene : Mitsuba scene
        That is traced in the same kernels.
    """

    def __init__(
        self, mi: Any, placed: Sequence[PlacedPart], positions: NDArray[np.float64], mesh: Mesh, first: int, scene: Any
    ) -> None:
        self._mi, self._first = mi, first
        # From one surface to what may be the next: beyond what rounding moves it.
        self._step = 4.0 * float(np.spacing(np.float32(np.abs(positions).max(initial=0.0))))
        faces = [part_faces(mesh.faces, one.part) for one in placed]
        self._scene = triangle_scene(mi, positions, np.concatenate(faces), scene)
        # Parts by face, and reaches by part; a shape that is known has no other part.
        self._part_of = mi.Int32(np.repeat(np.arange(len(placed)), [len(some) for some in faces]).astype(np.int32))
        self._reach = mi.Float(np.array([one.reach for one in placed], dtype=np.float32))
        known = [(one.shape, i) for i, one in enumerate(placed) if one.shape is not None]
        self._own_part = _by_shape(mi, [shape for shape, _ in known], np.array([i for _, i in known], dtype=np.int32))
        self._is_free = mi.Bool([one.shape is None for one in placed])
        self._free_reach = max((one.reach for one in placed if one.shape is None), default=0.0)

    def find(self, ray: Any, hit: Any, si: Any, active: Any) -> NearFace:
        """The nearest face along the normal to either side that may be what rays meet; arguments as of `Surfaces`."""
        import drjit as dr

        mi = self._mi
        own = _of_shape(mi, self._own_part, hit.shape, active)
        reach = dr.select(own >= 0, dr.gather(mi.Float, self._reach, mi.UInt32(own), active & (own >= 0)), 0.0)
        reach = dr.select(own >= 0, reach, self._free_reach)
        normal = dr.mulsign(si.n, -dr.dot(si.n, ray.d))  # on the side that is seen
        place = si.p

        def look(on: Any, depth: Any, layers: Any, nearest: Any, face: Any, back: Any, u: Any, v: Any) -> Any:
            probe = mi.Ray3f(place + (reach - depth) * normal, -normal)
            probe.maxt = 2.0 * reach - depth
            met = self._scene.ray_intersect_preliminary(probe, active=on)
            on = on & met.is_valid()
            there = met.compute_surface_interaction(probe, mi.RayFlags.Minimal, on)
            depth = depth + met.t
            part = dr.gather(mi.Int32, self._part_of, met.prim_index, on)
            right = dr.select(own >= 0, part == own, dr.gather(mi.Bool, self._is_free, mi.UInt32(part), on))
            cosine, distance = dr.dot(there.n, normal), dr.abs(depth - reach)
            right &= on & (dr.abs(cosine) > _SAME_SURFACE) & (distance < nearest)
            right &= distance <= dr.gather(mi.Float, self._reach, mi.UInt32(part), on)
            nearest, face = dr.select(right, distance, nearest), dr.select(right, met.prim_index, face)
            back = dr.select(right, cosine < 0.0, back)
            u, v = dr.select(right, met.prim_uv.x, u), dr.select(right, met.prim_uv.y, v)
            depth += self._step
            # What lies farther below than this one above is farther.
            on &= (layers < _LAYERS) & (depth < 2.0 * reach) & (depth - reach < nearest)
            return on, depth, layers + 1, nearest, face, back, u, v

        start = (
            active & (reach > 0.0), mi.Float(0.0), mi.UInt32(1), mi.Float(dr.inf), mi.UInt32(0), mi.Bool(False),
            mi.Float(0.0), mi.Float(0.0),
        )  # fmt: skip
        _, _, _, nearest, face, back, u, v = dr.while_loop(start, lambda on, *_: on, look)
        return NearFace(active & dr.isfinite(nearest), face + self._first, back, u, v)


def _by_shape(mi: Any, shapes: list[Any], values: NDArray) -> Any:
    """Int32 table of a value for each shape, by its number in Mitsuba's registry (0 is no shape); -1 for others."""
    import drjit as dr

    numbers = [int(mi.UInt32(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(shape)))[0]) for shape in shapes]
    table = np.full(max(numbers, default=0) + 1, -1, dtype=np.int32)
    table[numbers] = values
    return mi.Int32(table)


def _of_shape(mi: Any, table: Any, shape: Any, active: Any) -> Any:
    """What such a table says of shapes that rays met."""
    import drjit as dr

    number: Any = dr.reinterpret_array(mi.UInt32, shape)
    known = active & (number < dr.width(table))
    return dr.select(known, dr.gather(mi.Int32, table, number, known), -1)


def triangle_scene(mi: Any, positions: NDArray, faces: NDArray, beside: Any) -> Any:
    """A Mitsuba scene of nothing but triangles, to be traced in kernels that trace another scene too.

    OptiX allows a kernel one pipeline and one binding table, which the scene takes over from the one ``beside`` that it
    is given (and does not keep); of that, it must then have the same settings.
    """
    mesh = mi.Mesh("transfer", len(positions), len(faces))
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = mi.Float(positions.astype(np.float32).ravel())
    parameters["faces"] = mi.UInt32(faces.astype(np.uint32).ravel())
    parameters.update()
    # In Embree's robust mode no ray slips between two triangles.
    robust = {"embree_use_robust_intersections": True} if mi.variant().startswith("llvm_") else {}
    content = {"type": "scene", "mesh": mesh, "beside": beside, **robust}
    try:
        return mi.load_dict(content)
    except RuntimeError as error:
        if "compact_acceleration_structures" not in str(error):
            raise
        return mi.load_dict({**content, "compact_acceleration_structures": True})
