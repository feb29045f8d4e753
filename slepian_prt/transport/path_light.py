"""Light that comes to receivers by way of what vertices do not hold: mirrors, gloss, glass, holes, leaves, fog.

From a receiver rays leave by the cosine. Those that first meet the sky, or a surface that does nothing but reflect
diffusely, are left to `direct` and `interreflection`. The others go on as Mitsuba's BSDFs draw them until they escape,
which is a term β y_lm(ω) of E, or meet a face whose light is held at its vertices, which is an entry of S; so that

    T = T₀ + E + (R + S) diag(ρ) T

has no path twice, and none is left out. Two sets of rays, each with a shift of its own at each receiver, make
independent halves, whose difference tells the noise.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, vstack

from slepian_prt.paths.tracer import PathTracer
from slepian_prt.scene.reflectance.path_effects import densest_glass
from slepian_prt.scene.scene import Scene
from slepian_prt.sphere.harmonics import num_coefficients, real_sh
from slepian_prt.transport.estimator import overlapped
from slepian_prt.transport.first_rays import FirstRays
from slepian_prt.transport.held_faces import PATHS, Corners, HeldFaces

# Numbers in the harmonics of the directions that are added up at a time.
_NUMBERS = 1 << 23


class Ends(NamedTuple):
    """Where the paths of a block of n receivers ended: k that escaped, and m on held faces.

    Attributes
    ----------
    receivers : (n,)
    samples : int
        First directions of each; those of the second half come last.
    lanes : (k,), held_lanes : (m,)
        ``samples`` times the place of the receiver in the block, plus the number of the direction; ascending.
    directions : (k, 3)
        In the world.
    throughput : (k, 3), held_throughput : (m, 3)
    effects, held_effects : (k,), (m,)
        By what the paths went on first: places in `PATHS`, from 1 on.
    corners : Corners
        Of the held faces.
    further : (len(PATHS),)
        Rays beyond the first ones, by effect.
    rays : int
    """

    receivers: NDArray[np.int64]
    samples: int
    lanes: NDArray[np.int64]
    directions: NDArray[np.float64]
    throughput: NDArray[np.float32]
    effects: NDArray[np.uint32]
    held_lanes: NDArray[np.int64]
    held_throughput: NDArray[np.float32]
    held_effects: NDArray[np.uint32]
    corners: Corners
    further: NDArray[np.int64]
    rays: int


class PathRays:
    """Paths from receivers of a scene.

    Parameters
    ----------
    scene : Scene
    samples : int
        First directions of each receiver, an even number.
    effects : iterable of str
        Those of `PATHS` by which paths go on from what they meet first.
    seed : int

    Attributes
    ----------
    brightest : float
        See `PathLight`.
    """

    def __init__(self, scene: Scene, samples: int, effects: Iterable[str], seed: int) -> None:
        mi = scene.mi
        self._samples, self._held = samples, HeldFaces(scene)
        self._first = FirstRays(scene, scene.geometry, self._held, samples, effects, seed)
        self._tracer = PathTracer(mi, scene.geometry, self._held.materials, known=self._held)
        self.brightest = max((densest_glass(mi, material) for material in self._held.materials), default=1.0) ** 2

    def blocks(self, vertices: NDArray[np.int64]) -> list[NDArray[np.int64]]:
        """The receivers in blocks to trace."""
        return self._first.blocks(vertices)

    def trace(self, vertices: NDArray[np.int64]) -> Ends:
        """Follow the paths of a block of receivers."""
        import drjit as dr

        gone, rays = self._first.trace(vertices), vertices.size * self._samples
        lanes, effects = gone.lanes, gone.effects
        if lanes.size == 0:
            return _nothing(vertices, self._samples, rays)
        sampler = self._first.sampler(vertices, lanes.size)
        ends = self._tracer.follow(sampler, gone.ray, hit=gone.hit, medium=gone.medium, first_known=gone.first_known)
        dr.eval(ends.escaped, ends.held, ends.throughput, ends.ray, ends.hit, ends.points)
        out, on = np.flatnonzero(np.array(ends.escaped)), np.flatnonzero(np.array(ends.held))
        throughput = np.array(ends.throughput).T
        further = np.bincount(effects, np.array(ends.points), minlength=1 + len(PATHS))[1:].astype(np.int64)
        return Ends(
            vertices,
            self._samples,
            lanes[out],
            np.array(ends.ray.d).T[out].astype(np.float64),
            throughput[out],
            effects[out],
            lanes[on],
            throughput[on],
            effects[on],
            self._held.corners(ends.ray, ends.hit, on),
            further,
            rays + int(further.sum()),
        )


def _nothing(vertices: NDArray[np.int64], samples: int, rays: int) -> Ends:
    """A block whose first rays meet nothing to go on from."""
    lanes, directions, colours = np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 3), np.float32)
    first, corners = np.zeros(0, np.uint32), Corners(np.zeros((0, 3), np.int32), np.zeros((0, 3), np.float32))
    further = np.zeros(len(PATHS), np.int64)
    return Ends(vertices, samples, lanes, directions, colours, first, lanes, colours, first, corners, further, rays)


@dataclass(frozen=True, eq=False)
class PathLight:
    """E and S of n receivers, for unit albedo.

    Attributes
    ----------
    rows : (n,)
        The receivers.
    escaped : (n, channels, (L+1)²) float32
        E: what comes from the sky.
    escaped_error : (n, channels, (L+1)²) float32
        Half the difference of its halves.
    met : tuple of sparse (n, V), one for each channel
        S: how much of each vertex is seen.
    halves : (k,) int8
        Of the entries of S: 1 in the first half, -1 in the second.
    brightest : float
        How bright surroundings of 1 can look if no material reflects more than it gets: in glass, its index squared.
    rays : int
    """

    rows: NDArray[np.int64]
    escaped: NDArray[np.float32]
    escaped_error: NDArray[np.float32]
    met: tuple[csr_array, ...]
    halves: NDArray[np.int8]
    brightest: float
    rays: int

    def reflected(self, albedo: NDArray, values: NDArray, channel: int = 0) -> NDArray[np.float32]:
        """(V, k) light that paths bring from surfaces of ``albedo`` (V,) that shine by ``values`` (V, k)."""
        result = np.zeros_like(values)
        result[self.rows] = self._of(channel) @ (albedo[:, None] * values)
        return result

    def error(self, albedo: NDArray, values: NDArray, channel: int) -> NDArray[np.float32]:
        """(n, k) half the difference of the halves of what ``reflected`` gives."""
        met = self._of(channel)
        signed = csr_array((met.data * self.halves, met.indices, met.indptr), shape=met.shape)
        return signed @ (albedo[:, None] * values)

    def source(self, count: int, channel: int, columns: slice) -> NDArray[np.float32]:
        """(count, k) some columns of E, for all receivers."""
        result = np.zeros((count, self.escaped.shape[2]), dtype=np.float32)[:, columns]
        result[self.rows] = self.escaped[:, min(channel, self.escaped.shape[1] - 1), columns]
        return result

    def _of(self, channel: int) -> csr_array:
        return self.met[min(channel, len(self.met) - 1)]


def trace_paths(
    scene: Scene,
    vertices: NDArray[np.int64],
    samples: int,
    effects: Iterable[str],
    bandlimit: int,
    channels: int,
    seed: int,
    advance: Callable[[int], None] = lambda _: None,
) -> PathLight:
    """What paths bring to ``vertices`` that go on by some effects.

    Parameters
    ----------
    scene : Scene
    vertices : (n,) indices
    samples : int
        First directions of each, an even number.
    effects : iterable of str
        Of `PATHS`.
    bandlimit : int
    channels : 1 (their mean stands for all) or 3
    seed : int
    advance : callable
        Given the number of vertices finished since its last call.
    """
    rays = PathRays(scene, samples, effects, seed)
    blocks = rays.blocks(vertices)
    size = num_coefficients(bandlimit)
    result = LightSums(np.concatenate(blocks), len(scene.receivers), channels, size, rays.brightest)
    for count in overlapped(blocks, rays.trace, lambda ends: result.add(ends, bandlimit)):
        advance(count)
    return result.finished()


def join_light(parts: Sequence[PathLight]) -> PathLight:
    """The light of blocks of receivers, as if they had been one."""
    rows, escaped, error, halves = (
        np.concatenate([getattr(part, name) for part in parts])
        for name in ("rows", "escaped", "escaped_error", "halves")
    )
    met = tuple(vstack(blocks, format="csr") for blocks in zip(*(part.met for part in parts), strict=True))
    return PathLight(rows, escaped, error, met, halves, parts[0].brightest, sum(part.rays for part in parts))


class LightSums:
    """Paths added up, block by block in the order of ``rows``."""

    def __init__(self, rows: NDArray[np.int64], vertices: int, channels: int, size: int, brightest: float) -> None:
        self._rows, self._vertices, self._channels, self._brightest = rows, vertices, channels, brightest
        self._escaped = np.zeros((2, rows.size, channels, size), dtype=np.float32)
        self._entries: list[tuple[NDArray, NDArray, NDArray, NDArray]] = []
        self._done = self._rays = 0

    def add(self, ends: Ends, bandlimit: int) -> int:
        """Add a block; returns how many receivers it has."""
        count, samples = ends.receivers.size, ends.samples
        block = slice(self._done, self._done + count)
        throughput, held = (self._in_channels(values) / samples for values in (ends.throughput, ends.held_throughput))
        self._add_escaped(ends, throughput, bandlimit, block)
        row = ends.held_lanes // samples
        among = np.bincount(row, minlength=count)
        sign = np.where(ends.held_lanes % samples < samples // 2, 1, -1).astype(np.int8)
        values = (held[:, :, None] * ends.corners.weights[:, None]).transpose(1, 0, 2).reshape(self._channels, -1)
        self._entries.append((3 * among, ends.corners.vertices.ravel(), values.astype(np.float32), np.repeat(sign, 3)))
        self._done, self._rays = self._done + count, self._rays + ends.rays
        return count

    def finished(self) -> PathLight:
        counts, corners, values, signs = (np.concatenate(parts, axis=-1) for parts in zip(*self._entries, strict=True))
        self._entries.clear()
        starts = np.concatenate([[0], np.cumsum(counts)])
        wide = np.int64 if starts[-1] > np.iinfo(np.int32).max else np.int32
        shape = (self._rows.size, self._vertices)
        met = tuple(csr_array((data, corners.astype(wide), starts.astype(wide)), shape=shape) for data in values)
        return PathLight(self._rows, self._escaped[0], self._escaped[1], met, signs, self._brightest, self._rays)

    def _in_channels(self, values: NDArray) -> NDArray[np.float64]:
        values = values.astype(np.float64)
        return values if self._channels == 3 else values.mean(axis=1, keepdims=True)

    def _add_escaped(self, ends: Ends, throughput: NDArray, bandlimit: int, block: slice) -> None:
        """Sums of β y_lm over the paths, and over those of the first half less those of the second."""
        count, samples, size = ends.receivers.size, ends.samples, self._escaped.shape[3]
        sign = np.where(ends.lanes % samples < samples // 2, 1.0, -1.0)
        at_once = max(1, _NUMBERS // size)
        for begin in range(0, ends.lanes.size, at_once):
            some = slice(begin, begin + at_once)
            starts = np.concatenate([[0], np.cumsum(np.bincount(ends.lanes[some] // samples, minlength=count))])
            columns = np.arange(starts[-1])
            harmonics = real_sh(bandlimit, ends.directions[some]).astype(np.float32)
            for channel in range(self._channels):
                for half, weight in enumerate((throughput[some, channel], throughput[some, channel] * sign[some])):
                    rows = csr_array((weight.astype(np.float32), columns, starts), shape=(count, columns.size))
                    self._escaped[half, block, channel] += rows @ harmonics
