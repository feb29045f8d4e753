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

# Of an additive recurrence in two dimensions (Roberts 2018), by the root of x³ = x + 1, in 32 bits.
_STEPS = tuple(int(step * 2**32) for step in (0.7548776662466927, 0.5698402909980532))
_UNIT = (1.0 - 2.0**-24) * 2.0**-32

# The side of the square, in pixels, that corners are anywhere in.
_ABOUT_CORNER = 0.5

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
        """For NumPy."""
        face, u, v = (np.array(part) for part in (self.face, self.u, self.v))
        reflectance = np.ones((face.size, 1), dtype=np.float32)
        return Seen(face, u, v, reflectance if self.reflectance is None else np.array(self.reflectance).T)

    def differ(self, mi: Any, one: Any, other: Any) -> tuple[Any, Any, Any]:
        """Whether something ends between some rays and others, how far apart they are (squared), and the cosine there.

        Something ends where it is another kind of thing, or a point far from the plane of the other, or its reflectance
        is another.
        """
        import drjit as dr

        face, others = dr.gather(mi.Int32, self.face, one), dr.gather(mi.Int32, self.face, other)
        both = (face >= 0) & (others >= 0)
        normal, facing = _gathered(mi, self.normal, one, both), _gathered(mi, self.direction, one, both)
        apart = _gathered(mi, self.point, other, both) - _gathered(mi, self.point, one, both)
        across = dr.squared_norm(apart) - dr.square(dr.dot(apart, facing))
        off_plane = dr.square(dr.dot(apart, normal)) > _OFF_PLANE**2 * across
        turned = dr.dot(_gathered(mi, self.normal, other, both), normal) < _COHERENT
        ends = (dr.minimum(face, 0) != dr.minimum(others, 0)) | (both & (off_plane | turned))
        if self.reflectance is not None:
            change = _gathered(mi, self.reflectance, one, both) - _gathered(mi, self.reflectance, other, both)
            ends |= both & (dr.max(dr.abs(change)) > _SAME_REFLECTANCE)
        return ends, across, dr.abs(dr.dot(normal, facing))


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

    def see_many(self, pixels: NDArray, dx: NDArray, dy: NDArray) -> Iterator[tuple[slice, Seen, NDArray[np.bool_]]]:
        """What pixels (n,) show through some places each, (n, k) float32 from their middles; of so many at a time.

        With it comes for each pixel whether something ends in it.
        """
        import drjit as dr

        mi, count = self.scene.mi, dx.shape[1]
        step = max(1, _RAYS // count)
        for begin in range(0, len(pixels), step):
            block = slice(begin, begin + step)
            x = (pixels[block] % self.size[0] + 0.5).astype(np.float32)[:, None] + dx[block]
            y = (pixels[block] // self.size[0] + 0.5).astype(np.float32)[:, None] + dy[block]
            lane = dr.arange(mi.UInt32, x.size)
            met = self._meet(_aligned(mi, x.ravel()), _aligned(mi, y.ravel()))
            first = lane - lane % dr.opaque(mi.UInt32, count)
            ends, _, _ = met.differ(mi, first, lane)
            yield block, met.seen(), np.asarray(np.array(ends).reshape(x.shape).any(axis=1))

    def _meet(self, x: Any, y: Any) -> _Met:
        import drjit as dr

        mi, scene = self.scene.mi, self.scene
        columns, rows = self.size
        place = mi.Point2f(x / dr.opaque(mi.Float, columns), y / dr.opaque(mi.Float, rows))
        ray, _ = self.view.sample_ray(0.0, 0.5, place, mi.Point2f(0.5, 0.5))
        # By itself: Mitsuba writes the size of the film into the kernel, and that of tracing takes long to compile.
        dr.eval(ray)
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
    """What is seen through the corners of all pixels and through a place within each, one ray for each.

    Either the corners or the middles are not met exactly, so that no thin thing lies between the rows of all rays.

    Parameters
    ----------
    rays : CameraRays
    in_middle : bool
        Whether it is the middles that count: then corners are taken a little off. Else any place within a pixel serves.
    """

    def __init__(self, rays: CameraRays, *, in_middle: bool) -> None:
        import drjit as dr

        self._mi, self._rays = rays.scene.mi, rays
        self.columns, self.rows = rays.size
        mi = self._mi
        lane = dr.arange(mi.UInt32, self.first_middle + self.columns * self.rows)
        first_middle, wide, narrow = self._opaque()
        middle = lane >= first_middle
        place = dr.select(middle, lane - first_middle, lane)
        width = dr.select(middle, narrow, wide)
        row = place // width
        anywhere = mi.Point2f(*(mi.Float(place * mi.UInt32(step)) * _UNIT for step in _STEPS))
        if in_middle:
            shift = dr.select(middle, mi.Point2f(0.5), (anywhere - 0.5) * _ABOUT_CORNER)
        else:
            shift = dr.select(middle, anywhere, mi.Point2f(0.0))
        self._met = rays._meet(mi.Float(place - row * width) + shift.x, mi.Float(row) + shift.y)
        self.seen = self._met.seen()

    def around(self, pixels: NDArray[np.int32]) -> NDArray[np.int32]:
        """(n, 5) rays within pixels and through their corners."""
        first = pixels // self.columns * (self.columns + 1) + pixels % self.columns
        below = first + self.columns + 1
        return np.stack([self.first_middle + pixels, first, first + 1, below, below + 1], axis=1)

    def sort(self, areas: NDArray[np.float64]) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Pixels (H, W) in which something ends, and those that show faces too small for few rays.

        Parameters
        ----------
        areas : (V,)
            Of the faces about each receiver, in the space that Mitsuba traces in.
        """
        import drjit as dr

        mi, met = self._mi, self._met
        pixel = dr.arange(mi.UInt32, self.columns * self.rows)
        first_middle, wide, narrow = self._opaque()
        first, middle = pixel + pixel // narrow, pixel + first_middle
        edge, distance, cosine = mi.Bool(False), mi.Float(0.0), mi.Float(0.0)
        for corner in (first, first + 1, first + wide, first + wide + 1):
            ends, across, cosine = met.differ(mi, middle, corner)
            edge |= ends
            distance = dr.maximum(distance, across)
        face = dr.gather(mi.Int32, met.face, middle)
        shown = face >= 0
        of_face = np.append(areas[self._rays.corners].mean(axis=1), 0.0)
        area = dr.gather(mi.Float, mi.Float(of_face), mi.UInt32(dr.maximum(face, 0)), shown)
        # The farthest corner is at least half a diagonal away.
        small = shown & (cosine * area < _SMALL_FACE * 2.0 * distance)
        dr.eval(edge, small)
        shape = self.rows, self.columns
        return np.array(edge).reshape(shape), np.array(small).reshape(shape)

    @property
    def first_middle(self) -> int:
        """Number of the first ray that goes through no corner."""
        return (self.columns + 1) * (self.rows + 1)

    def _opaque(self) -> tuple[Any, Any, Any]:
        """The number of the first middle, and how many corners and middles are in a row: the same kernel for any."""
        import drjit as dr

        numbers = (self.first_middle, self.columns + 1, self.columns)
        return tuple(dr.opaque(self._mi.UInt32, number) for number in numbers)


def _aligned(mi: Any, values: NDArray[np.float32]) -> Any:
    """A Float that Dr.Jit has allocated: its kernels depend on alignment, which that of NumPy's arrays is by chance."""
    import drjit as dr

    owned = mi.Float(values) * dr.opaque(mi.Float, 1.0)
    dr.eval(owned)
    return owned


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
