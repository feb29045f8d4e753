"""Which face of one mesh is which of another, whose vertices are numbered otherwise or a little elsewhere."""

from __future__ import annotations

from itertools import permutations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

# Transfer files round positions to 1/65,535 of the largest side of the mesh: how far corners move, in that side, with
# a little for what rounding does to the coordinates themselves.
ROUNDED = 0.9 / 65_535

# Faces with their middles about the same place that are compared: backs of others, and what lies on each other.
_NEAREST = 4

# Faces at a time.
_BLOCK = 1 << 14

# The ways in which corners may be those of another face, the same way round first.
_WAYS = np.array(sorted(permutations(range(3)), key=lambda way: way not in ((0, 1, 2), (1, 2, 0), (2, 0, 1))))
_TURNED = 3


class MatchedFaces(NamedTuple):
    """Faces of another mesh.

    Attributes
    ----------
    faces : (F,) int64
        The face that each one is; -1 for none.
    corners : (F, 3) int64
        Which corner of that each corner is.
    """

    faces: NDArray[np.int64]
    corners: NDArray[np.int64]

    def of_corners(self, values: NDArray) -> NDArray:
        """(F, 3, …) what the other mesh has at its corners (G, 3, …)."""
        return values[self.faces[:, None], self.corners]


def match_faces(corners: NDArray[np.float64], others: NDArray[np.float64], tolerance: float) -> MatchedFaces:
    """The nearest face of another mesh, for each face of one.

    Of several the same way round comes first.

    Parameters
    ----------
    corners : (F, 3, 3)
    others : (G, 3, 3)
    tolerance : float
        Distance of corners, along each axis, up to which they are the same.
    """
    faces, ways = np.full(len(corners), -1, dtype=np.int64), np.zeros(len(corners), dtype=np.int64)
    if len(others) and len(corners):
        tree, count = cKDTree(others.mean(axis=1)), min(_NEAREST, len(others))
        for begin in range(0, len(corners), _BLOCK):
            rows = slice(begin, begin + _BLOCK)
            own = corners[rows]
            near = tree.query(own.mean(axis=1), k=count)[1].reshape(len(own), count)
            apart = np.stack([np.abs(own[:, None] - others[near][:, :, way]).max(axis=(2, 3)) for way in _WAYS], axis=2)
            apart[..., _TURNED:] += 1e-3 * tolerance
            best = apart.reshape(len(own), -1).argmin(axis=1)
            number, way = np.divmod(best, len(_WAYS))
            there = np.arange(len(own))
            found = apart[there, number, way] <= 1.001 * tolerance
            faces[rows], ways[rows] = np.where(found, near[there, number], -1), way
    return MatchedFaces(faces, _WAYS[ways])
