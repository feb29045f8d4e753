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
from scipy.sparse import csc_array

from slepian_prt.sphere.rotation import rotate_sh
from slepian_prt.transport.directions import QUARTERS, DirectionSet
from slepian_prt.transport.visibility import VisibilitySamples, disagreements

# The constant harmonic's coefficient times this is the part of the hemisphere.
MEAN = np.float32(math.sqrt(4.0 * math.pi))

# No part of the hemisphere is known to less than this, and none is scaled by more than that.
LEAST, MOST = 1e-6, 0.5


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
        The tables of `DirectionSet.tables`.
    sky : ((L+1)²,) float32
        What all nodes make together.
    turns : (n,)
        What each node adds to how often outlines turn, where it is blocked.
    triangles : (T, 3)
    edges : list of two (3 T,)
        Those from corner k of triangle t, at 3 t + k, to corners k + 1 and k + 2.
    run_towards : list of two (3 T,) bool
        Whether they run towards it.
    """

    def __init__(self, directions: DirectionSet, bandlimit: int) -> None:
        self.nodes, self.corners = directions.tables(bandlimit)
        self.sky = self.nodes.sum(axis=0, dtype=np.float64).astype(np.float32)
        self.triangles = directions.triangles
        self.turns = _turns_at_nodes(directions)
        self._with_turns = np.column_stack([self.nodes, self.turns]).astype(np.float32)
        sides, ends = directions.triangle_edges, directions.triangles
        self.edges = [sides.ravel(), np.roll(sides, 1, axis=1).ravel()]
        self.run_towards = [directions.edges[edge, 0] != ends.ravel() for edge in self.edges]

    def open(self, samples: VisibilitySamples) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """(1/π) ∫ V (n·ω)₊ y_lm dω, (n, (L+1)²), in the world frame, and (n,) the blocked part of each hemisphere.

        Exactly zero and one where all nodes are blocked.
        """
        local = self.blocked_in_frames(samples)
        closed = np.all(samples.blocked, axis=0)
        part = np.where(closed, np.float32(1.0), local[:, 0] * MEAN)
        np.subtract(self.sky, local, out=local)  # before the rotation, where it is one vector for all
        local[closed] = 0.0
        return rotate_sh(local, samples.frames), part

    def blocked(self, samples: VisibilitySamples) -> NDArray[np.float32]:
        """(1/π) ∫ (1 - V) (n·ω)₊ y_lm dω, (n, (L+1)²), in the world frame."""
        return rotate_sh(self.blocked_in_frames(samples), samples.frames).astype(np.float32, copy=False)

    def blocked_in_frames(self, samples: VisibilitySamples) -> NDArray[np.float32]:
        """The same in the receivers' own frames, whose z is the normal."""
        sums = samples.blocked.T.astype(np.float32) @ self._with_turns
        corners = self._cut_triangles(samples.blocked, samples.quarter)
        local = sums[:, :-1]
        local += corners @ self.corners
        self._restore_bulges(local, sums[:, -1] + corners.sum(axis=1) / 6.0)
        return local

    def _restore_bulges(self, local: NDArray[np.float32], turns: NDArray[np.float32]) -> None:
        """Scale what is blocked, or what is open where that is what bulges, by what chords cut off in the mean.

        In degrees 0 and 1 alone, which hardly tell a region's rim from its middle: those of radiance under smooth light
        gain 5 to 9 % of accuracy, and higher ones would lose.
        """
        lost = turns / (2.0 * len(self.triangles))
        closed = local[:, 0] * MEAN
        wider = np.clip(lost / np.maximum(closed, LEAST), 0.0, MOST)
        narrower = np.clip(-lost / np.maximum(1.0 - closed, LEAST), 0.0, MOST)
        low = local[:, :4]
        low *= (1.0 + wider + narrower).astype(np.float32)[:, None]
        low -= narrower.astype(np.float32)[:, None] * self.sky[:4]

    def _cut_triangles(self, blocked: NDArray[np.bool_], quarter: NDArray[np.uint8]) -> csc_array:
        """Rows of the table of corners that each receiver adds or subtracts: (n, 48 T), entries 1 and -1.

        By columns, so that a product reads the table once: it is larger than caches, what it is added to is not.
        """
        triangle, place = disagreements(blocked, self.triangles)
        a, b, c = (blocked[self.triangles[triangle, k], place] for k in range(3))
        lone = np.where(b == c, 0, np.where(a == c, 1, 2))  # the corner that disagrees with the other two
        corner = 3 * triangle + lone
        row = corner
        for edge, towards in zip(self.edges, self.run_towards, strict=True):
            # Quarters count from the edge's first node; here from the corner.
            counted = quarter[edge[corner], place] ^ np.where(towards[corner], QUARTERS - 1, 0)
            row = row * QUARTERS + counted
        lone_is_blocked = np.where(lone == 0, a, np.where(lone == 1, b, c))
        sign = np.where(lone_is_blocked, np.float32(1.0), np.float32(-1.0))
        return csc_array((sign, (place, row)), shape=(blocked.shape[1], len(self.corners)))


def _turns_at_nodes(directions: DirectionSet) -> NDArray[np.float64]:
    """(n,) what each blocked node adds to how often outlines turn inside the disk; triangles cut there add the rest.

    The outlines of what is blocked turn, in all and negatively round what is open, 2π (χ - f - t/4) times: χ the Euler
    characteristic of the blocked nodes and what lies between them, f the part of the disk's border that is blocked, t
    the ends of outlines there, which meet it at right angles in the mean. Edges and triangles are counted by their
    nodes: a blocked node adds 1 - edges/2 + triangles/3, and a triangle with one blocked node is counted for 1/6 too
    little, one with two for 1/6 too much. With t, which halves of edges are counted by too, nothing is left of t.
    """
    triangles, edges = directions.triangles, directions.edges
    of_edges, of_triangles = (np.bincount(part.ravel(), minlength=directions.size) for part in (edges, triangles))
    border = edges[np.bincount(directions.triangle_edges.ravel(), minlength=len(edges)) == 1]
    lengths = np.linalg.norm(np.diff(directions.points[border], axis=1)[:, 0], axis=1)
    along = np.bincount(border.ravel(), np.repeat(0.5 * lengths / lengths.sum(), 2), minlength=directions.size)
    return 1.0 - of_edges / 2.0 + of_triangles / 3.0 - along
