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
    turns : (V,)
        Angles of the frames about their normals.
    """

    def __init__(self, scene: Scene, directions: DirectionSet, seed: int, points: SurfacePoints | None = None) -> None:
        self.mi, self.geometry = scene.mi, scene.geometry
        self.directions, self.rays = directions, 0
        if points is None:
            self._normals, self._origins = scene.receivers.normals, scene.ray_origins
        else:
            self._normals, self._origins = points.normals, RayOrigins.above(points.origins)
        self.turns = np.random.default_rng(seed).random(len(self._normals)) * 2.0 * math.pi
        self._vectors = upload_vectors(scene.mi, directions.vectors)

    def frames(self, vertices: NDArray) -> NDArray[np.float64]:
        """(n, 3, 3) rotations that take z to the normal, after a turn about z."""
        return turned_frames(self._normals[vertices], self.turns[vertices])

    def rays_from(self, vertices: NDArray, frames: NDArray) -> Callable[[Any, Any], Any]:
        """Upload receivers; returns a function that makes Mitsuba rays of (place among them, direction of the set)."""
        import drjit as dr

        mi, local = self.mi, self._vectors
        origin = upload_origins(mi, self._origins, vertices)
        to_world = upload_frames(mi, frames)

        def rays(place: Any, direction: Any) -> Any:
            self.rays += dr.width(place)
            outward = to_world(place, local(direction))
            return mi.Ray3f(origin(place, outward), outward)

        return rays

    def to_nodes(self, count: int) -> tuple[Any, Any]:
        """Places and directions of all nodes for ``count`` receivers, those of one receiver side by side."""
        return pairs(self.mi, count, self.directions.size)


def pairs(mi: Any, count: int, size: int) -> tuple[Any, Any]:
    """UInt32 numbers of the rows and columns of a table (count, size), row after row."""
    import drjit as dr

    return divided(mi, dr.arange(mi.UInt32, count * size), size)


def divided(mi: Any, number: Any, size: int) -> tuple[Any, Any]:
    """UInt32 quotients and remainders of UInt32 numbers by ``size``."""
    import drjit as dr

    # A half is further from whole numbers than float64 rounds: exact. Vectors of integers cannot be divided on a
    # processor but one after the other, which took a tenth of the time of the rays.
    quotient = mi.UInt32((mi.Float64(number) + 0.5) * dr.opaque(mi.Float64, 1.0 / size))
    return quotient, number - quotient * dr.opaque(mi.UInt32, size)


def upload_vectors(mi: Any, vectors: NDArray) -> Callable[[Any], Any]:
    """Give Mitsuba vectors (n, 3); returns a function that picks some of them by their places."""
    import drjit as dr

    padded = np.zeros((len(vectors), 4), dtype=np.float32)
    padded[:, :3] = vectors
    flat = mi.Float(padded.ravel())

    def pick(place: Any) -> Any:
        # Four numbers side by side are one load; three arrays would be three gathers, which cost twice as much.
        x, y, z, _ = dr.gather(mi.Vector4f, flat, place)
        return mi.Vector3f(x, y, z)

    return pick


def upload_origins(mi: Any, origins: RayOrigins, vertices: NDArray) -> Callable[[Any, Any], Any]:
    """Give Mitsuba the origins of some receivers; returns a function of (place among them, direction in the world)."""
    import drjit as dr

    front = upload_vectors(mi, origins.front[vertices])
    if not origins.sheets[vertices].any():
        return lambda place, _: mi.Point3f(front(place))
    back, axis = (upload_vectors(mi, part[vertices]) for part in (origins.back, origins.axes))

    def origin(place: Any, outward: Any) -> Any:
        return mi.Point3f(dr.select(dr.dot(axis(place), outward) < 0.0, back(place), front(place)))

    return origin


def upload_frames(mi: Any, frames: NDArray) -> Callable[[Any, Any], Any]:
    """Give Mitsuba rotations (n, 3, 3); returns a function that rotates vectors, each by the frame of its place."""
    x, y, z = (upload_vectors(mi, frames[:, :, axis]) for axis in range(3))
    return lambda place, local: x(place) * local.x + y(place) * local.y + z(place) * local.z


def turned_frames(axes: NDArray, turns: NDArray) -> NDArray[np.float64]:
    """(n, 3, 3) rotations that take z to each axis, after a turn about z by the angles given, in radians."""
    frames = rotation_to(axes)
    c, s = np.cos(turns)[:, None], np.sin(turns)[:, None]
    x, y = frames[:, :, 0].copy(), frames[:, :, 1].copy()
    frames[:, :, 0], frames[:, :, 1] = c * x + s * y, c * y - s * x
    return frames
