"""Rays of a camera: few where a pixel shows one smooth surface, many where something ends in it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slepian_prt.relighting.drawing.texture_lookup import TextureLookup
from slepian_prt.scene.scene import Scene

# What a ray meets that meets no face of a receiver: nothing, or something else. Else the number of the face.
NOTHING, OTHER = -2, -1

# At a time.
_RAYS = 1 << 21

# Of neighbouring rays that meet one smooth surface: the cosine between its normals, how far its points may lie off the
# plane of one of them in distances between the rays, and how much its reflectance may differ.
_COHERENT = 0.8
_OFF_PLANE = 0.7
_SAME_REFLECTANCE = 0.01

# Faces of fewer square pixels than this are seen too coarsely by the corners of pixels.
_SMALL_FACE = 2.0


class Seen(NamedTuple):
    """What P rays meet.

    Attributes
    ----------
    face : (P,) int32
        `NOTHING`, `OTHER`, or a row of `CameraRays.corners`.
    u, v : (P,) float32
        Weights of the second and third corner there.
    reflectance : (P, 1 or 3) float32
        By textures; one without any.
    """

    face: NDArray[np.int32]
    u: NDArray[np.float32]
    v: NDArray[np.float32]
    reflectance: NDArray[np.float32]

    def of(self, rays: NDArray) -> Seen:
        """What some of them meet."""
        return Seen(*(values[rays] for values in self))


class _Met(NamedTuple):
    """The same on Dr.Jit's arrays, with points, normals and directions in the space that Mitsuba traces in."""

    face: Any
    u: Any
    v: Any
    reflectance: Any
    point: Any
    normal: Any
    direction: Any

    def seen(self) -> Seen:
        face, u, v = (np.array(part) for part in (self.face, self.u, self.v))
        reflectance = np.ones((face.size, 1), dtype=np.float32)
        return Seen(face, u, v, reflectance if self.reflectance is None else np.array(self.reflectance).T)


@dataclass(frozen=True, eq=False)
class CameraRays:
    """A camera of a scene.

    Attributes
    ----------
    scene : Scene
    view : Mitsuba sensor
    backs : (V,)
        The receiver on the back of each; -1 where there is none.
    textures : TextureLookup or None
    """

    scene: Scene
    view: Any
    backs: NDArray[np.integer]
    textures: TextureLookup | None = None

    @cached_property
    def size(self) -> tuple[int, int]:
        """Columns and rows of the film."""
        columns, rows = (int(n) for n in self.view.film().size())
        return columns, rows

    @cached_property
    def corners(self) -> NDArray[np.int32]:
        """(2 F', 3) receivers at the corners of the fronts of all faces, and then of their backs; -1 without any."""
        fronts = self.scene.faces
        return np.concatenate([fronts, self.backs[fronts]]).astype(np.int32)

    def see(self, x: NDArray, y: NDArray) -> Seen:
        """What is seen through places on the film, in pixels, float32."""
        mi = self.scene.mi
        return self._meet(mi.Float(x), mi.Float(y)).seen()

    def see_many(self, pixels: NDArray, dx: NDArray, dy: NDArray) -> Iterator[tuple[slice, Seen]]:
        """The same of pixels (n,), through some places each, (n, k) from their middles; of so many pixels at a time."""
        step = max(1, _RAYS // dx.shape[1])
        for begin in range(0, len(pixels), step):
            block = slice(begin, begin + step)
            x = (pixels[block] % self.size[0] + 0.5).astype(np.float32)[:, None]
            y = (pixels[block] // self.size[0] + 0.5).astype(np.float32)[:, None]
            yield block, self.see((x + dx[block]).ravel(), (y + dy[block]).ravel())

    def _meet(self, x: Any, y: Any) -> _Met:
        import drjit as dr

        mi, scene = self.scene.mi, self.scene
        columns, rows = self.size
        place = mi.Point2f(x / dr.opaque(mi.Float, columns), y / dr.opaque(mi.Float, rows))
        ray, _ = self.view.sample_ray(0.0, 0.5, place, mi.Point2f(0.5, 0.5))
        hit = scene.geometry.ray_intersect_preliminary(ray)
        # A ray that slips through an edge of a closed mesh meets its back too: without this test, bright speckles.
        si = hit.compute_surface_interaction(ray, mi.RayFlags.Minimal, hit.is_valid())
        count = len(scene.faces)
        face = mi.Int32(scene.hit_faces(hit))
        side = face + dr.select(dr.dot(si.n, ray.d) < 0.0, 0, dr.opaque(mi.Int32, count))
        seen = face >= 0
        if (self.corners < 0).any():
            seen &= dr.gather(mi.Bool, mi.Bool((self.corners >= 0).all(axis=1)), mi.UInt32(side), seen)
        shown = dr.select(seen, side, dr.select(hit.is_valid(), OTHER, NOTHING))
        reflectance = None
        if self.textures is not None:
            reflectance = self.textures.reflectance(hit.prim_index, hit.prim_uv.x, hit.prim_uv.y, seen)
        met = _Met(shown, hit.prim_uv.x, hit.prim_uv.y, reflectance, si.p, si.n, ray.d)
        dr.eval(*(part for part in met if part is not None))  # at once: each array would trace the rays again
        return met


class Corners:
    """What is seen through the corners of all pixels and through their middles, one ray for each."""

    def __init__(self, rays: CameraRays) -> None:
        import drjit as dr

        self._mi, self._rays = rays.scene.mi, rays
        self.columns, self.rows = rays.size
        mi = self._mi
        lane = dr.arange(mi.UInt32, (self.columns + 1) * (self.rows + 1) + self.columns * self.rows)
        first_middle, wide, narrow = self._opaque()
        middle = lane >= first_middle
        place = dr.select(middle, lane - first_middle, lane)
        width = dr.select(middle, narrow, wide)
        row = place // width
        shift = dr.select(middle, mi.Float(0.5), 0.0)
        self._met = rays._meet(mi.Float(place - row * width) + shift, mi.Float(row) + shift)
        self.seen = self._met.seen()

    def around(self, pixels: NDArray) -> NDArray[np.int64]:
        """(n, 5) rays of the middles and of the corners of pixels."""
        first = pixels // self.columns * (self.columns + 1) + pixels % self.columns
        below = first + self.columns + 1
        return np.stack([self._first_middle + pixels, first, first + 1, below, below + 1], axis=1)

    def directions(self) -> NDArray[np.float32]:
        """(H, W, 3) through the middles."""
        found = np.array(self._met.direction, dtype=np.float32).T[self._first_middle :]
        return np.ascontiguousarray(found).reshape(self.rows, self.columns, 3)

    def sort(self, areas: NDArray[np.float64], reach: int) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Pixels (H W,) in which or near which something ends, and others that show faces too small for few rays.

        Parameters
        ----------
        areas : (V,)
            Of the faces about each receiver, in the space that Mitsuba traces in.
        reach : int
            How near, in pixels.
        """
        import drjit as dr

        mi, met = self._mi, self._met
        pixel = dr.arange(mi.UInt32, self.columns * self.rows)
        first_middle, wide, narrow = self._opaque()
        row = pixel // narrow
        first, middle = pixel + row, pixel + first_middle
        face = dr.gather(mi.Int32, met.face, middle)
        shown = face >= 0
        normal, point, facing = (_gathered(mi, part, middle, shown) for part in (met.normal, met.point, met.direction))
        edge, off, across, varied = mi.Bool(False), mi.Float(0.0), mi.Float(0.0), mi.Float(0.0)
        for corner in (first, first + 1, first + wide, first + wide + 1):
            other = dr.gather(mi.Int32, met.face, corner)
            edge |= (dr.minimum(face, 0) != dr.minimum(other, 0)) | (
                shown & (dr.dot(_gathered(mi, met.normal, corner, shown), normal) < _COHERENT)
            )
            apart = _gathered(mi, met.point, corner, shown) - point
            off = dr.maximum(off, dr.abs(dr.dot(apart, normal)))
            across += 0.25 * (dr.squared_norm(apart) - dr.square(dr.dot(apart, facing)))
            if met.reflectance is not None:
                here, there = (_gathered(mi, met.reflectance, place, shown) for place in (middle, corner))
                varied = dr.maximum(varied, dr.max(dr.abs(here - there)))
        edge |= shown & ((dr.square(off) > _OFF_PLANE**2 * across) | (varied > _SAME_REFLECTANCE))
        # A corner is half a diagonal away from the middle.
        of_face = np.append(areas[self._rays.corners].mean(axis=1), 0.0)
        area = dr.gather(mi.Float, mi.Float(of_face), mi.UInt32(dr.maximum(face, 0)), shown)
        small = shown & (dr.abs(dr.dot(normal, facing)) * area < _SMALL_FACE * 2.0 * across)
        dr.eval(edge, small)
        wide_edge = widened(np.array(edge).reshape(self.rows, self.columns), reach).ravel()
        return wide_edge, np.array(small) & ~wide_edge

    @property
    def _first_middle(self) -> int:
        return (self.columns + 1) * (self.rows + 1)

    def _opaque(self) -> tuple[Any, Any, Any]:
        """The number of the first middle, and how many corners and middles are in a row: the same kernel for any."""
        import drjit as dr

        numbers = (self._first_middle, self.columns + 1, self.columns)
        return tuple(dr.opaque(self._mi.UInt32, number) for number in numbers)


def _gathered(mi: Any, vectors: Any, index: Any, active: Any) -> Any:
    """Some of many vectors, or colours."""
    import drjit as dr

    return mi.Vector3f(*(dr.gather(mi.Float, part, index, active) for part in (vectors.x, vectors.y, vectors.z)))


def widened(mask: NDArray[np.bool_], reach: int) -> NDArray[np.bool_]:
    """Places no farther than ``reach`` rows and columns from those of a mask."""
    height, width = mask.shape
    wide = np.pad(mask, reach)
    wide = np.logical_or.reduce([wide[:, step : step + width] for step in range(2 * reach + 1)])
    return np.logical_or.reduce([wide[step : step + height] for step in range(2 * reach + 1)])
