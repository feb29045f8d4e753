"""Which faces rays meet, looked up by the number of the shape.

To ask a Mitsuba shape what was met is a virtual call, which Dr.Jit traces for every shape that is alive in the process,
and in every instance of a group for all of these again: a thousand instances took a minute for each call.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray


class FaceTable:
    """Faces of some Mitsuba meshes, one mesh after the other.

    Parameters
    ----------
    mi : Mitsuba
    shapes : sequence of Mitsuba meshes
    first_faces : sequence of int
        Where the faces of each begin.
    corners : (F, 3, 3)
        Of the faces, in the order that tells their front.
    """

    def __init__(self, mi: Any, shapes: Sequence[Any], first_faces: Sequence[int], corners: NDArray) -> None:
        self._mi = mi
        numbers = shape_numbers(mi, shapes)
        first = np.full(int(numbers.max(initial=0)) + 1, -1, dtype=np.int32)
        first[numbers] = np.asarray(first_faces, dtype=np.int32)
        self._first = mi.Int32(first)
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        self._normals = mi.Vector3f((normals / np.where(length > 0.0, length, 1.0)).T.astype(np.float32))

    def met(self, hit: Any) -> Any:
        """Int32 rows of the faces that rays met (a preliminary intersection); negative for other shapes and the sky."""
        import drjit as dr

        mi = self._mi
        valid = hit.is_valid() & (hit.instance == None)  # noqa: E711 (of an instance the shape is one of its group)
        number: Any = dr.reinterpret_array(mi.UInt32, hit.shape)
        valid &= number < dr.width(self._first)
        first = dr.gather(mi.Int32, self._first, number, valid)
        return dr.select(valid & (first >= 0), first + mi.Int32(hit.prim_index), -1)

    def normals(self, face: Any) -> Any:
        """Unit normals of faces; zero for degenerate ones and where rows are negative."""
        import drjit as dr

        return dr.gather(self._mi.Vector3f, self._normals, face, face >= 0)


def interactions(mi: Any, shapes: Sequence[Any], ray: Any, hit: Any, flags: Any) -> Any:
    """What rays met of some shapes (a preliminary intersection), as a SurfaceInteraction3f; not valid elsewhere.

    The shapes are no instances, and are asked one by one. Tangents are any that the shading normal has.
    """
    import drjit as dr

    if not shapes:
        return dr.zeros(mi.SurfaceInteraction3f, dr.width(ray))
    numbers = shape_numbers(mi, shapes)
    place = np.full(int(numbers.max()) + 1, len(shapes), dtype=np.uint32)
    place[numbers] = np.arange(len(shapes))
    number: Any = dr.reinterpret_array(mi.UInt32, hit.shape)
    known = hit.is_valid() & (hit.instance == None) & (number < len(place))  # noqa: E711
    index = dr.gather(mi.UInt32, mi.UInt32(place), number, known)
    known &= index < len(shapes)

    def asked(shape: Any) -> Any:
        return lambda ray, hit, active: shape.compute_surface_interaction(ray, hit, flags, active)

    met = dr.switch(index, [asked(shape) for shape in shapes], ray, hit, active=known)
    met.t = dr.select(known, met.t, dr.inf)
    met.sh_frame = mi.Frame3f(met.sh_frame.n)
    met.wi = met.to_local(-ray.d)
    return met


def shape_numbers(mi: Any, shapes: Sequence[Any]) -> NDArray[np.int64]:
    """(n,) the numbers that Dr.Jit knows Mitsuba's shapes by."""
    import drjit as dr

    pointers = [dr.reinterpret_array(mi.UInt32, mi.ShapePtr(shape)) for shape in shapes]
    return np.array([np.array(pointer)[0] for pointer in pointers], dtype=np.int64)
