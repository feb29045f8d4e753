"""Whether straight ways between points are free, and what stands in them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from slepian_prt.scene.scene import Scene


def are_blocked(scene: Scene, begin: NDArray, end: NDArray) -> NDArray[np.bool_]:
    """(n,) whether something lies between points (n, 3), given in the space that Mitsuba traces in."""
    if len(begin) == 0:
        return np.zeros(0, dtype=bool)
    return np.asarray(scene.geometry.ray_test(*_segments(scene, begin, end)))


def met_faces(scene: Scene, begin: NDArray, end: NDArray) -> NDArray[np.int64]:
    """(n,) rows of ``scene.faces`` that are met first between points; negative for occluders and where nothing is."""
    if len(begin) == 0:
        return np.zeros(0, dtype=np.int64)
    ray, active = _segments(scene, begin, end)
    hit = scene.geometry.ray_intersect_preliminary(ray, active=active)
    return np.array(scene.hit_faces(hit), dtype=np.int64)


def _segments(scene: Scene, begin: NDArray, end: NDArray) -> tuple[Any, Any]:
    """Rays from points to points, and whether they are of any length: OptiX is given no ray without a direction."""
    import drjit as dr

    mi = scene.mi
    origin, target = (mi.Point3f(points.T.astype(np.float32)) for points in (begin, end))
    way = target - origin
    length = dr.norm(way)
    ray = mi.Ray3f(origin, way / dr.maximum(length, 1e-30))
    ray.maxt = length
    return ray, length > 0.0
