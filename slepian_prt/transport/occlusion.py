"""Blocked directions as spherical harmonics: sums of rows of tables.

Visibility is known at the nodes of a triangulated set of directions, and along its edges to a quarter. What that blocks
is put together from thirds of triangles about the nodes and from corners that are cut off, whose integrals are
tabulated (`DirectionSet.tables`): one matrix product and one sparse product for a block of receivers.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from slepian_prt.sphere.rotation import rotate_sh
from slepian_prt.transport.directions import QUARTERS, DirectionSet
from slepian_prt.transport.visibility import VisibilitySamples


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
        self._triangles = directions.triangles
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
        return local

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
