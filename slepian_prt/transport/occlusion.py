"""Blocked directions as spherical harmonics: sums of rows of tables.

Visibility is known at the nodes of a triangulated set of directions, and along its edges to a quarter. What that blocks
is put together from thirds of triangles about the nodes and from corners that are cut off, whose integrals are
tabulated (`DirectionSet.tables`): one matrix product and one sparse product for a block of receivers.

The outline of what blocks is so followed by chords, which cut off where it bulges. How much that is in the mean is
known: an outline that turns once loses A/2π of the disk, A the area of a triangle (by Crofton's formulas, whatever its
shape), and how often the outlines of a region turn follows from its topology (Gauss–Bonnet). That much is added, which
takes the bias from shadows of small things, at no ray.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from slepian_prt.sphere.rotation import rotate_sh
from slepian_prt.transport.directions import QUARTERS, DirectionSet
from slepian_prt.transport.visibility import VisibilitySamples

# The constant harmonic's coefficient times this is the part of the hemisphere.
_MEAN = np.float32(math.sqrt(4.0 * math.pi))

# No part of the hemisphere is known to less than this, and none is scaled by more than that.
_LEAST, _MOST = 1e-6, 0.5


class OcclusionTables:
    """Projects what was found blocked on spherical harmonics.

    Parameters
    ----------
    directions : DirectionSet
        That visibility was sampled along.
    bandlimit : int

    Attributes
    ----------
    nodes, corners : (…, (L+1)²) float32
        The tables.
    """

    def __init__(self, directions: DirectionSet, bandlimit: int) -> None:
        self.nodes, self.corners = directions.tables(bandlimit)
        self._directions, self._triangles = directions, directions.triangles
        used = np.bincount(directions.triangle_edges.ravel(), minlength=len(directions.edges))
        self._border = directions.edges[used == 1]
        lengths = np.linalg.norm(np.diff(directions.points[self._border], axis=1)[:, 0], axis=1)
        self._border_lengths = lengths / lengths.sum()
        sides, ends = directions.triangle_edges, directions.triangles
        # For corner k of triangle t, at 3 t + k: its edges to corners k + 1 and k + 2, and whether they run towards it.
        self._edges = [sides.ravel(), np.roll(sides, 1, axis=1).ravel()]
        self._run_towards = [directions.edges[edge, 0] != ends.ravel() for edge in self._edges]

    def blocked(self, samples: VisibilitySamples) -> NDArray[np.float32]:
        """(1/π) ∫ (1 - V) (n·ω)₊ y_lm dω, (n, (L+1)²), in the world frame."""
        return rotate_sh(self.blocked_in_frames(samples), samples.frames).astype(np.float32, copy=False)

    def blocked_in_frames(self, samples: VisibilitySamples) -> NDArray[np.float32]:
        """The same in the receivers' own frames, whose z is the normal."""
        local = samples.blocked.T.astype(np.float32) @ self.nodes
        local += self._cut_triangles(samples.blocked, samples.quarter) @ self.corners
        self._restore_bulges(local, samples.blocked)
        return local

    def _restore_bulges(self, local: NDArray[np.float32], blocked: NDArray[np.bool_]) -> None:
        """Scale what is blocked, or what is open where that is what bulges, by what chords cut off in the mean.

        In degrees 0 and 1 alone, which hardly tell a region's rim from its middle: those of radiance under smooth light
        gain 5 to 9 % of accuracy, and higher ones would lose.
        """
        lost = self._turns(blocked) / (2.0 * len(self._triangles))
        closed = local[:, 0] * _MEAN
        wider = np.clip(lost / np.maximum(closed, _LEAST), 0.0, _MOST)
        narrower = np.clip(-lost / np.maximum(1.0 - closed, _LEAST), 0.0, _MOST)
        low, whole = local[:, :4], self.nodes[:, :4].sum(axis=0)
        low *= (1.0 + wider + narrower).astype(np.float32)[:, None]
        low -= narrower.astype(np.float32)[:, None] * whole

    def _turns(self, blocked: NDArray[np.bool_]) -> NDArray[np.float64]:
        """(n,) how often the outlines of what is blocked turn inside the disk, in all; negative round what is open.

        2π (χ - f - t/4): χ the Euler characteristic of the blocked nodes and what lies between them, f the part of the
        disk's border that is blocked, t the ends of outlines there, which meet it at right angles in the mean.
        """
        directions = self._directions
        edges = blocked[directions.edges[:, 0]] & blocked[directions.edges[:, 1]]
        a, b, c = (blocked[self._triangles[:, k]] for k in range(3))
        counts = [np.count_nonzero(parts, axis=0) for parts in (blocked, edges, a & b & c)]
        begin, end = blocked[self._border].transpose(1, 0, 2)
        along = self._border_lengths @ (0.5 * (begin.astype(np.float64) + end))
        return np.asarray(counts[0] - counts[1] + counts[2] - along - 0.25 * np.count_nonzero(begin != end, axis=0))

    def _cut_triangles(self, blocked: NDArray[np.bool_], quarter: NDArray[np.uint8]) -> csr_array:
        """Rows of the table of corners that each receiver adds or subtracts: (n, 48 T), entries 1 and -1."""
        a, b, c = (blocked[self._triangles[:, k]] for k in range(3))
        triangle, place = np.divmod(np.flatnonzero((a != b) | (b != c)), blocked.shape[1])
        a, b, c = a[triangle, place], b[triangle, place], c[triangle, place]
        lone = np.where(b == c, 0, np.where(a == c, 1, 2))  # the corner that disagrees with the other two
        corner = 3 * triangle + lone
        row = corner
        for edge, towards in zip(self._edges, self._run_towards, strict=True):
            # Quarters count from the edge's first node; here from the corner.
            counted = quarter[edge[corner], place] ^ np.where(towards[corner], QUARTERS - 1, 0)
            row = row * QUARTERS + counted
        lone_is_blocked = np.where(lone == 0, a, np.where(lone == 1, b, c))
        sign = np.where(lone_is_blocked, np.float32(1.0), np.float32(-1.0))
        return csr_array((sign, (place, row)), shape=(blocked.shape[1], len(self.corners)))
