"""The receivers of a cap as the codec visits them: coarse to fine along the surface, each with its predictors.

Everything here is integer arithmetic on what the file holds, so that encoder and decoder agree on any machine.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cached_property
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from slepian_prt.scene.receivers import Receivers, morton

# Positions are rounded to this part of the bounding box, normals to this part of one.
_PLACES = 1 << 18
_TURNS = 1 << 8

# A neighbour whose normal differs by δ counts as one that is √40 δ edges further away; both ends of an edge and a
# vertex beside it differ by at least this part of an edge.
_TURN_COUNTS = 40
_NEAREST = 20

# Weights of neighbours are multiples of one part in this.
_WEIGHT = 1 << 16

# Neighbours of neighbours are looked at too, unless a fan of triangles makes them more than this per vertex.
_MANY = 64

# Caps take some 300 bytes per vertex; those of larger meshes are made each time they are needed.
_REMEMBERED = 1 << 17


@dataclass(frozen=True)
class Level:
    """Receivers that are coded together, all predicted from those of earlier levels.

    Attributes
    ----------
    rows : (n,)
        Which of the cap's receivers, in surface order.
    sources : sparse (n, N) int64
        Weights of what each is predicted from.
    totals : (n,) int64
        Their sums.
    on_curve : (n,) bool
        True where no neighbour on the surface is known, so that those on the curve stand in.
    """

    rows: NDArray[np.int64]
    sources: csr_array
    totals: NDArray[np.int64]
    on_curve: NDArray[np.bool_]


@dataclass(frozen=True)
class CapSurface:
    """One cap's receivers in the order of coding.

    Attributes
    ----------
    order : (N,)
        Their indices.
    levels : tuple of Level
        All but the first, from coarse to fine.
    """

    order: NDArray[np.int64]
    levels: tuple[Level, ...]


def surface_of(receivers: Receivers) -> Surface:
    """The surface of receivers, made once, so that all that code or decode the same caps share them."""
    known = _surfaces.get(receivers)
    if known is None:
        known = _surfaces[receivers] = Surface(receivers)
    return known


class Surface:
    """Receivers and their neighbours as the codec sees them.

    Parameters
    ----------
    receivers : Receivers
        Normals count as the file holds them, in float32.
    """

    def __init__(self, receivers: Receivers) -> None:
        positions, count = receivers.positions, len(receivers)
        self._rank = np.empty(count, dtype=np.int64)
        order = np.arange(count) if receivers.order is None else receivers.order
        self._rank[order[np.argsort(morton(positions[order]), kind="stable")]] = np.arange(count)
        self._neighbours = _adjacency(receivers.neighbours, count)
        low = positions.min(axis=0)
        extent = float((positions.max(axis=0) - low).max())
        self._places = np.rint((positions - low) * (_PLACES / extent if extent > 0.0 else 0.0)).astype(np.int64)
        self._turns = np.rint(receivers.normals.astype(np.float32).astype(np.float64) * _TURNS).astype(np.int64)
        self._caps: dict[bytes, CapSurface] = {}

    @cached_property
    def _edge(self) -> int:
        """Mean squared length of an edge."""
        a, b = self._neighbours.nonzero()
        lengths = ((self._places[a] - self._places[b]) ** 2).sum(axis=1)
        return max(1, int(lengths.sum()) // max(1, lengths.size))

    def cap(self, members: NDArray) -> CapSurface:
        """The given receivers along a Z-order curve, and what each is predicted from."""
        if len(self._rank) > _REMEMBERED:
            return self._cap(members)
        key = hashlib.sha256(members.astype(np.int64).tobytes()).digest()
        if key not in self._caps:
            self._caps[key] = self._cap(members)
        return self._caps[key]

    def _cap(self, members: NDArray) -> CapSurface:
        order = members[np.argsort(self._rank[members], kind="stable")]
        near = self._neighbours[order][:, order]
        degree = np.diff(near.indptr)
        if degree[near.indices].sum() <= _MANY * len(order):
            near = (near @ near + near).tocsr()
        near.sort_indices()
        return CapSurface(order, tuple(self._levels(order, near)))

    def _levels(self, order: NDArray, near: csr_array) -> list[Level]:
        """Ranks that are odd multiples of 2^j are predicted from those that are multiples of 2^(j+1)."""
        count = len(order)
        levels = []
        stride = 1 << max(0, (count - 1).bit_length() - 1)
        while stride >= 1 and count > 1:
            rows = np.arange(stride, count, 2 * stride)
            among = near[rows]
            row = np.repeat(np.arange(rows.size), np.diff(among.indptr))
            known = among.indices % (2 * stride) == 0
            row, col = row[known], among.indices[known].astype(np.int64)
            on_curve = np.bincount(row, minlength=rows.size) == 0
            alone = np.flatnonzero(on_curve)
            after = rows[alone] + stride
            inside = after < count
            row = np.concatenate([row, alone, alone[inside]])
            col = np.concatenate([col, rows[alone] - stride, after[inside]])
            weights = self._weights(order[rows[row]], order[col])
            sources = csr_array((weights, (row, col)), shape=(rows.size, count))
            totals = np.asarray(sources.sum(axis=1)).astype(np.int64)
            levels.append(Level(rows, sources, totals, on_curve))
            stride //= 2
        return levels

    def _weights(self, a: NDArray, b: NDArray) -> NDArray[np.int64]:
        """1 / (squared distance in edges + 40 squared difference of normals + 1/20), in integers."""
        apart = ((self._places[a] - self._places[b]) ** 2).sum(axis=1)
        turned = ((self._turns[a] - self._turns[b]) ** 2).sum(axis=1)
        # In units of the squared edge; the largest possible product is below 2^62.
        edge = self._edge
        measure = apart + (_TURN_COUNTS * turned * edge) // (_TURNS * _TURNS) + edge // _NEAREST
        weights: NDArray[np.int64] = np.maximum(_WEIGHT * edge // np.maximum(measure, 1), 1)
        return weights


def _adjacency(neighbours: NDArray, count: int) -> csr_array:
    """(V, V) pattern of receivers that are neighbours."""
    a, b = neighbours.T
    return csr_array((np.ones(2 * a.size, dtype=np.int32), (np.r_[a, b], np.r_[b, a])), shape=(count, count))


_surfaces: WeakKeyDictionary[Receivers, Surface] = WeakKeyDictionary()
