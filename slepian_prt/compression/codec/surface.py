"""The receivers of caps as the codec visits them: coarse to fine along the surface, each with its predictors.

Everything here is integer arithmetic on what the file holds, so that encoder and decoder agree on any machine.
"""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.machine.kept import Kept
from slepian_prt.scene.receivers import Receivers, morton

if TYPE_CHECKING:
    from scipy.sparse import csr_array

# Positions are rounded to this part of the bounding box, normals to this part of one.
_PLACES = 1 << 18
_TURNS = 1 << 8

# A neighbour whose normal differs by δ counts as one that is √40 δ edges further away; both ends of an edge and a
# vertex beside it differ by at least this part of an edge.
_TURN_COUNTS = 40
_NEAREST = 20

# Weights of neighbours are multiples of one part in this: so coarse that sums of products are exact in float64.
WEIGHT = 1 << 8

# Neighbours of neighbours are looked at where fewer than so many neighbours are known, and those twice as far on
# levels from this depth on, unless a fan of triangles makes them too many.
_FEW = 5
_WIDE_DEPTH = 2
_MANY_SECOND = 256
_MANY_FOURTH = 2048
_NEXT, _SECOND, _FOURTH = range(3)

# No more neighbours than these are predicted from, the coarsest first.
_MOST = 64

# Rows take some 300 bytes per vertex; those of larger meshes are made each time they are needed.
_REMEMBERED = 1 << 17

# Levels are told apart up to this one from the finest.
DEPTHS = 5

_FIRST = 62  # the level of the first receiver of a cap, above all others


@dataclass(frozen=True, eq=False)
class Level:
    """Receivers that are coded together, all predicted from those of earlier levels.

    Attributes
    ----------
    rows : slice
        Which rows of the `CapRows`.
    depth : int
        0 for the finest level, and so on up to DEPTHS - 1 for all coarser ones.
    sources : sparse (n, rows.start) float64, or None
        Weights, integers, of what each is predicted from; None for the first receivers of caps.
    totals : (n,) float64
        Their sums.
    on_curve : (n,) bool
        True where no neighbour on the surface is known, so that those on the curve stand in.
    counts : (caps,)
        Rows of each cap.
    """

    rows: slice
    depth: int
    sources: csr_array | None
    totals: NDArray[np.float64]
    on_curve: NDArray[np.bool_]
    counts: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class CapRows:
    """Receivers of some caps in the order of coding: by level, from coarse to fine, then by cap.

    Attributes
    ----------
    places : (n,)
        Where each row stands among the members of all caps, those of one cap after those of another.
    caps : (n,)
        Cap of each row, as numbered here.
    sizes : (caps,)
        Rows of each cap.
    levels : tuple of Level
    """

    places: NDArray[np.int64]
    caps: NDArray[np.int64]
    sizes: NDArray[np.int64]
    levels: tuple[Level, ...]

    def __len__(self) -> int:
        return len(self.places)

    @cached_property
    def by_member(self) -> list[NDArray[np.int64]]:
        """For each cap, the row of each of its members."""
        row = np.empty(len(self.places), dtype=np.int64)
        row[self.places] = np.arange(len(self.places))
        return np.split(row, np.cumsum(self.sizes)[:-1])


def surface_of(receivers: Receivers) -> Surface:
    """The surface of receivers, made once, so that all that code or decode the same caps share it."""
    return _surfaces.of(receivers, lambda: Surface(receivers))


class Surface:
    """Receivers and their neighbours as the codec sees them.

    Parameters
    ----------
    receivers : Receivers
        Normals count as the file holds them, in float32.
    """

    def __init__(self, receivers: Receivers) -> None:
        positions, count = receivers.positions, len(receivers)
        order = np.arange(count) if receivers.order is None else receivers.order
        self._rank = np.empty(count, dtype=np.int64)
        self._rank[order[np.argsort(morton(positions[order]), kind="stable")]] = np.arange(count)
        self._neighbours = receivers.neighbours
        low = positions.min(axis=0)
        extent = float((positions.max(axis=0) - low).max())
        places = np.rint((positions - low) * (_PLACES / extent if extent > 0.0 else 0.0))
        turns = np.rint(receivers.normals.astype(np.float32).astype(np.float64) * _TURNS)
        self._seen = np.hstack([places, turns]).astype(np.int64)
        self._remembered: dict[bytes, CapRows] = {}

    @cached_property
    def _beside(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """The edges by their first ends: where those of each receiver begin, and their other ends.

        So that the rows of a few caps take no time for the edges of all others.
        """
        a, b = self._neighbours.T
        order = np.argsort(a, kind="stable")
        return np.append(0, np.cumsum(np.bincount(a, minlength=len(self._rank)))), b[order]

    @cached_property
    def _edge(self) -> int:
        """Mean squared length of an edge."""
        a, b = self._neighbours.T
        away = self._seen[a, :3] - self._seen[b, :3]
        lengths = (away * away).sum(axis=1)
        return max(1, int(lengths.sum()) // max(1, lengths.size))

    def rows(self, members: Sequence[NDArray]) -> CapRows:
        """The receivers of some caps along a Z-order curve of each, and what each is predicted from."""
        if len(self._rank) > _REMEMBERED:
            return self._rows(members)
        key = hashlib.sha256(
            b"".join(np.append(part.size, part).astype(np.int64).tobytes() for part in members)
        ).digest()
        if key not in self._remembered:
            self._remembered[key] = self._rows(members)
        return self._remembered[key]

    def _rows(self, members: Sequence[NDArray]) -> CapRows:
        sizes = np.array([len(part) for part in members], dtype=np.int64)
        flat = np.concatenate([np.zeros(0, dtype=np.int64), *members]).astype(np.int64)
        caps = np.repeat(np.arange(sizes.size), sizes)
        along = np.lexsort((self._rank[flat], caps))
        # The number of each along the curve of its cap; an odd multiple of 2^j is predicted from multiples of 2^(j+1).
        number = np.arange(flat.size) - np.repeat(np.cumsum(sizes) - sizes, sizes)
        level = np.where(number == 0, _FIRST, np.frexp((number & -number).astype(np.float64))[1] - 1)
        order = np.argsort(-level, kind="stable")
        row = np.empty(flat.size, dtype=np.int64)
        row[order] = np.arange(flat.size)
        curve = _Curve(flat[along][order], caps[order], number[order], level[order], order, row)
        levels = self._levels(curve, sizes)
        return CapRows(along[order], caps[order], sizes, levels)

    def _levels(self, curve: _Curve, sizes: NDArray[np.int64]) -> tuple[Level, ...]:
        count = len(curve.receivers)
        source, on_curve = self._sources(curve, sizes)
        totals = np.asarray(source.sum(axis=1)).ravel()
        levels = []
        starts = np.flatnonzero(np.diff(curve.level, prepend=_FIRST + 1))
        for begin, end in itertools.pairwise([*starts.tolist(), count]):
            rows = slice(begin, end)
            first, last = source.indptr[begin], source.indptr[end]
            weights = _sparse(
                (source.data[first:last], source.indices[first:last], source.indptr[begin : end + 1] - first),
                shape=(end - begin, begin),
            )
            counts = np.bincount(curve.caps[rows], minlength=sizes.size)
            depth = min(int(curve.level[begin]), DEPTHS - 1)
            levels.append(Level(rows, depth, weights if begin else None, totals[rows], on_curve[rows], counts))
        return tuple(levels)

    def _sources(self, curve: _Curve, sizes: NDArray[np.int64]) -> tuple[csr_array, NDArray[np.bool_]]:
        """Weights (rows, rows) of what each row is predicted from, and which have none on the surface."""
        count = len(curve.receivers)
        row, col = self._known(curve)
        on_curve = (np.bincount(row, minlength=count) == 0) & (curve.level < _FIRST)
        alone = np.flatnonzero(on_curve)
        stride = np.left_shift(1, curve.level[alone])
        inside = curve.number[alone] + stride < sizes[curve.caps[alone]]
        along = curve.place[alone]
        row = np.concatenate([row, alone, alone[inside]])
        col = np.concatenate([col, curve.row_at[along - stride], curve.row_at[(along + stride)[inside]]])
        weights = self._weights(curve.receivers[row], curve.receivers[col])
        source = _sparse((weights.astype(np.float64), (row, col)), shape=(count, count))
        source.sort_indices()
        return _first_entries(source, _MOST), on_curve

    def _known(self, curve: _Curve) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Pairs of a row and a neighbour in its cap that is known by then."""
        count = len(curve.receivers)
        where = np.full(len(self._rank), -1, dtype=np.int64)
        where[curve.receivers] = np.arange(count)
        first, ends = self._beside
        begin = first[curve.receivers]
        among = first[curve.receivers + 1] - begin
        a = np.repeat(np.arange(count), among)
        b = where[ends[np.repeat(begin - np.cumsum(among) + among, among) + np.arange(a.size)]]
        inside = (b >= 0) & (curve.caps[a] == curve.caps[b])
        a, b = a[inside], b[inside]
        both = np.r_[a, b, np.arange(count)], np.r_[b, a, np.arange(count)]
        near = _sparse((np.ones(both[0].size, dtype=np.int32), both), shape=(count, count))
        row, col = _entries(near)
        degree = np.diff(near.indptr) - 1
        beside = np.bincount(row, degree[col], minlength=count) - degree  # neighbours of neighbours
        around = _ring(near, near, np.flatnonzero(beside <= _MANY_SECOND)) + near
        around.data[:] = 1
        known = curve.level[col] > curve.level[row]
        few = np.bincount(row[known], minlength=count) < _FEW
        coarse = curve.level >= _WIDE_DEPTH
        chosen = np.where(coarse | few, _SECOND, _NEXT)
        chosen[coarse & (around @ np.diff(around.indptr) <= _MANY_FOURTH)] = _FOURTH
        # What is further than two edges away counts only if it is known on the finest of these levels.
        pairs = []
        for kind, rings in (
            (_NEXT, near),
            (_SECOND, around),
            (_FOURTH, _ring(around, around, np.flatnonzero(chosen == _FOURTH), curve.level > _WIDE_DEPTH)),
        ):
            row, col = _entries(rings)
            known = (chosen[row] == kind) & (curve.level[col] > curve.level[row])
            pairs.append((row[known], col[known]))
        return np.concatenate([row for row, _ in pairs]), np.concatenate([col for _, col in pairs])

    def _weights(self, a: NDArray, b: NDArray) -> NDArray[np.int64]:
        """1 / (squared distance in edges + 40 squared difference of normals + 1/20), in integers."""
        away = self._seen.take(a, axis=0)
        away -= self._seen.take(b, axis=0)
        away *= away
        apart, turned = away[:, 0] + away[:, 1] + away[:, 2], away[:, 3] + away[:, 4] + away[:, 5]
        # In units of the squared edge; the largest possible product is below 2^62.
        edge = self._edge
        measure = apart + (_TURN_COUNTS * turned * edge) // (_TURNS * _TURNS) + edge // _NEAREST
        weights: NDArray[np.int64] = np.maximum(WEIGHT * edge // np.maximum(measure, 1), 1)
        return weights


@dataclass(frozen=True, eq=False)
class _Curve:
    """Rows in the order of coding: receiver, cap, number along the cap's curve, level.

    Attributes
    ----------
    place : (n,)
        Of each row along the curves of all caps, one after the other.
    row_at : (n,)
        The row of each place.
    """

    receivers: NDArray[np.int64]
    caps: NDArray[np.int64]
    number: NDArray[np.int64]
    level: NDArray[np.int64]
    place: NDArray[np.int64]
    row_at: NDArray[np.int64]


def _sparse(content: Any, shape: tuple[int, ...]) -> csr_array:
    """A sparse matrix; SciPy is imported by who makes one, so that a file is told about without it."""
    from scipy.sparse import csr_array

    return csr_array(content, shape=shape)


def _entries(matrix: csr_array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows and columns of what a matrix holds."""
    return np.repeat(np.arange(matrix.shape[0]), np.diff(matrix.indptr)), matrix.indices.astype(np.int64)


def _ring(
    near: csr_array, next_to: csr_array, rows: NDArray[np.int64], columns: NDArray[np.bool_] | None = None
) -> csr_array:
    """What the neighbours of some rows have next to them, if it is among the ``columns``; other rows have nothing."""
    if columns is not None:
        row, col = _entries(next_to)
        kept = columns[col]
        next_to = _sparse((next_to.data[kept], (row[kept], col[kept])), shape=next_to.shape)
    product = (near[rows] @ next_to).tocsr()
    held = np.zeros(near.shape[0], dtype=np.int64)
    held[rows] = np.diff(product.indptr)
    ends = np.append(0, np.cumsum(held))
    return _sparse((np.ones(product.nnz, dtype=np.int32), product.indices, ends), shape=near.shape)


def _first_entries(matrix: csr_array, count: int) -> csr_array:
    """The matrix with at most so many entries in each row."""
    held = np.diff(matrix.indptr)
    if held.max(initial=0) <= count:
        return matrix
    kept = np.arange(matrix.nnz) - np.repeat(matrix.indptr[:-1], held) < count
    ends = np.append(0, np.cumsum(np.minimum(held, count)))
    return _sparse((matrix.data[kept], matrix.indices[kept], ends), shape=matrix.shape)


_surfaces: Kept[Receivers, Surface] = Kept()
