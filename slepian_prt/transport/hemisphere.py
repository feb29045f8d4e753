"""Rays over the hemispheres of receivers, along one set of directions that all of them share."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slepian_prt.scene.ray_origins import RayOrigins
from slepian_prt.scene.scene import Scene
from slepian_prt.sphere.rotation import rotation_to
from slepian_prt.transport.directions import DirectionSet


class SurfacePoints(NamedTuple):
    """Points that rays start at beside the receivers of a scene.

    Attributes
    ----------
    normals : (n, 3)
    origins : (n, 3)
        In the space that Mitsuba traces in, just above the surface.
    """

    normals: NDArray[np.float64]
    origins: NDArray[np.float64]


class HemisphereRays:
    """Rays from receivers along a set of directions, each receiver in its own frame.

    The frames are turned about the normals by angles at random, so that errors do not band. Other ``points`` can take
    the place of the receivers.

    Attributes
    ----------
    directions : DirectionSet
    geometry : Mitsuba scene
    rays : int
        Number traced so far.
    """

    def __init__(self, scene: Scene, directions: DirectionSet, seed: int, points: SurfacePoints | None = None) -> None:
        mi = scene.mi
        self.mi, self.geometry = mi, scene.geometry
        self.directions, self.rays = directions, 0
        if points is None:
            self._normals, self._origins = scene.receivers.normals, scene.ray_origins
        else:
            self._normals, self._origins = points.normals, RayOrigins.above(points.origins)
        self._turns = np.random.default_rng(seed).random(len(self._normals)) * 2.0 * math.pi
        self._vectors = mi.Vector3f(directions.vectors.T.astype(np.float32))

    def frames(self, vertices: NDArray) -> NDArray[np.float64]:
        """(n, 3, 3) rotations that take z to the normal, after a turn about z."""
        return turned_frames(self._normals[vertices], self._turns[vertices])

    def rays_from(self, vertices: NDArray, frames: NDArray) -> Callable[[Any, Any], Any]:
        """Upload receivers; returns a function that makes Mitsuba rays of (place among them, direction of the set)."""
        import drjit as dr

        mi = self.mi
        origin = upload_origins(mi, self._origins, vertices)
        to_world = upload_frames(mi, frames)

        def rays(place: Any, direction: Any) -> Any:
            self.rays += dr.width(place)
            outward = to_world(place, dr.gather(mi.Vector3f, self._vectors, direction))
            return mi.Ray3f(origin(place, outward), outward)

        return rays

    def to_nodes(self, count: int) -> tuple[Any, Any]:
        """Places and directions of all nodes for ``count`` receivers, those of one receiver side by side."""
        import drjit as dr

        size = dr.opaque(self.mi.UInt32, self.directions.size)
        lane = dr.arange(self.mi.UInt32, count * self.directions.size)
        place = lane // size
        return place, lane - place * size


def upload_origins(mi: Any, origins: RayOrigins, vertices: NDArray) -> Callable[[Any, Any], Any]:
    """Give Mitsuba the origins of some receivers; returns a function of (place among them, direction in the world)."""
    import drjit as dr

    front = mi.Point3f(origins.front[vertices].T.astype(np.float32))
    if not origins.sheets[vertices].any():
        return lambda place, _: dr.gather(mi.Point3f, front, place)
    back = mi.Point3f(origins.back[vertices].T.astype(np.float32))
    axis = mi.Vector3f(origins.axes[vertices].T.astype(np.float32))

    def origin(place: Any, outward: Any) -> Any:
        behind = dr.dot(dr.gather(mi.Vector3f, axis, place), outward) < 0.0
        return dr.select(behind, dr.gather(mi.Point3f, back, place), dr.gather(mi.Point3f, front, place))

    return origin


def upload_frames(mi: Any, frames: NDArray) -> Callable[[Any, Any], Any]:
    """Give Mitsuba rotations (n, 3, 3); returns a function that rotates vectors, each by the frame of its place."""
    import drjit as dr

    x, y, z = (mi.Vector3f(frames[:, :, axis].T.astype(np.float32)) for axis in range(3))

    def to_world(place: Any, local: Any) -> Any:
        return (
            dr.gather(mi.Vector3f, x, place) * local.x
            + dr.gather(mi.Vector3f, y, place) * local.y
            + dr.gather(mi.Vector3f, z, place) * local.z
        )

    return to_world


def turned_frames(axes: NDArray, turns: NDArray) -> NDArray[np.float64]:
    """(n, 3, 3) rotations that take z to each axis, after a turn about z by the angles given, in radians."""
    frames = rotation_to(axes)
    c, s = np.cos(turns)[:, None], np.sin(turns)[:, None]
    x, y = frames[:, :, 0].copy(), frames[:, :, 1].copy()
    frames[:, :, 0], frames[:, :, 1] = c * x + s * y, c * y - s * x
    return frames
