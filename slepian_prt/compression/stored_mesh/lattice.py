"""Positions as whole numbers: on lattices whose steps differ by powers of two, so that shared places stay shared."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

# Of the largest side of the box.
STEPS = (1 << 16) - 1

# Mean edges are no shorter than this, so that computed normals are those of the source, and all but the shortest of a
# hundred no shorter than that, so that details of something large keep their shape; but finer than so many powers of
# two is nothing for it, as Draco's wrapper holds 24 bits.
_STEPS_OF_EDGE = 200.0
_STEPS_OF_SHORT_EDGE, _SHORT = 16.0, 0.01
_MUCH_FINER = 7

# In float64, what is finer than this power of two of a step is not told apart, nor what is further away than so many.
_FINEST = 36
_FURTHEST = 2.0**52


class Lattice(NamedTuple):
    """Where the whole numbers of some vertices are: at low + (first + number) step / 2^shift.

    Attributes
    ----------
    low : (3,) float64
    step : float
        Both of the whole mesh.
    shift : int
    first : (3,) int64
    """

    low: NDArray[np.float64]
    step: float
    shift: int = 0
    first: NDArray[np.int64] = np.zeros(3, dtype=np.int64)

    @property
    def fine_step(self) -> float:
        """Between neighbours; what is rounded moves by at most half of it along each axis."""
        return self.step * 2.0**-self.shift

    def coordinates(self, positions: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n, 3) not rounded yet."""
        return (positions - self.low) / self.fine_step - self.first

    def places(self, positions: NDArray[np.float64]) -> NDArray[np.int64]:
        """(n, 3) the nearest whole numbers."""
        whole = np.clip(np.rint((positions - self.low) / self.fine_step), -_FURTHEST, _FURTHEST)
        return whole.astype(np.int64) - self.first

    def positions(self, places: NDArray[np.int64]) -> NDArray[np.float64]:
        """(n, 3) float64."""
        return self.low + (self.first + places) * self.fine_step

    def holds(self, positions: NDArray[np.float64]) -> bool:
        """Whether none is too far away, as no vertex of a face is."""
        return bool(np.abs((positions - self.low) / self.fine_step).max(initial=0.0) < _FURTHEST)


def find_lattices(positions: NDArray[np.float64], faces: Sequence[NDArray]) -> list[Lattice]:
    """A lattice for the vertices of each of several lists of faces (F, 3).

    The largest side of the box of all has `STEPS` steps; that of each list has half as many at least, as far as float64
    tells them apart.
    """
    used = [positions[_vertices(own)] for own in faces]
    everything = np.concatenate(used)
    if len(everything) == 0:
        everything = positions
    low, extent = everything.min(axis=0), float(np.ptp(everything, axis=0).max())
    step = max(extent / STEPS, 2.0**-1000) if extent > 0.0 else 1.0
    lattices = []
    for points, own in zip(used, faces, strict=True):
        lattice = Lattice(low, step, _shift(points, positions, own, step))
        lattices.append(lattice._replace(first=lattice.places(points).min(axis=0)) if len(points) else lattice)
    return lattices


def _vertices(faces: NDArray) -> NDArray[np.int64]:
    """Those that faces use, ascending; np.unique would sort them."""
    if not faces.size:
        return np.zeros(0, dtype=np.int64)
    first, last = int(faces.min()), int(faces.max())
    used = np.zeros(last + 1 - first, dtype=bool)
    used[faces - first] = True
    return np.flatnonzero(used) + first


def _shift(points: NDArray[np.float64], positions: NDArray[np.float64], faces: NDArray, step: float) -> int:
    extent = float(np.ptp(points, axis=0).max()) if len(points) else 0.0
    if extent <= 0.0:
        return 0
    needed = max(0, math.floor(math.log2(STEPS * step / extent) + 1e-9))
    lengths = np.empty(faces.shape)
    for corner in range(3):  # one after the other: all corners of all faces take six times the memory
        away = positions[faces[:, corner]] - positions[faces[:, corner - 1]]
        lengths[:, corner] = np.linalg.norm(away, axis=1)
    edges = lengths[lengths > 0.0]
    if edges.size == 0:
        return min(needed, _FINEST)
    short = np.partition(edges, int(_SHORT * edges.size))[int(_SHORT * edges.size)]
    shortest = min(edges.mean() / _STEPS_OF_EDGE, short / _STEPS_OF_SHORT_EDGE)
    wanted = math.ceil(math.log2(step / shortest))
    return min(max(needed, wanted), needed + _MUCH_FINER, _FINEST)
