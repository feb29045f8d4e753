"""How long edges may be: as short as what stands near them asks for.

A ground of a hundred metres, cut alike everywhere, would have no vertex in the shadow of the cup that stands on it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

# Edges at a thing are no longer than this part of its size, those of its own no longer than that; away from it they
# grow with the distance.
_AT_THINGS, _OWN = 1.0 / 12.0, 1.0 / 6.0
_GROWTH = 0.25

# Things stand for what is larger by this at least.
_SMALLER = 0.5

# A box is as near as the nearest of so many points along each of its sides.
_POINTS = 3


class EdgeLengths(NamedTuple):
    """How long edges of a piece of surface may be.

    Attributes
    ----------
    most : float
        Anywhere.
    near : tuple of (KDTree, float)
        Points of smaller things, and how long edges may be right there.
    """

    most: float
    near: tuple[tuple[Any, float], ...] = ()

    @property
    def least(self) -> float:
        """The shortest that is asked for anywhere."""
        return min([self.most, *(length for _, length in self.near)])

    def at(self, points: NDArray) -> NDArray[np.float64]:
        """(n,) for edges whose middles are at points (n, 3)."""
        result = np.full(len(points), self.most)
        for tree, length in self.near:
            reach = (result.max(initial=0.0) - length) / _GROWTH
            if reach > 0.0:
                distance, _ = tree.query(points, distance_upper_bound=reach)
                result = np.minimum(result, length + _GROWTH * distance)
        return result


class Things:
    """What stands in a scene, by its size.

    Parameters
    ----------
    boxes : (n, 2, 3)
        Lowest and highest corners.
    """

    def __init__(self, boxes: NDArray[np.float64]) -> None:
        size = np.linalg.norm(boxes[:, 1] - boxes[:, 0], axis=1)
        known = np.isfinite(size) & (size > 0.0)
        boxes, size = boxes[known], size[known]
        octave = np.floor(np.log2(size)).astype(np.int64)
        steps = np.linspace(0.0, 1.0, _POINTS)
        inside = np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3)
        from scipy.spatial import KDTree  # only here: scenes alone have things that stand near each other

        self._by_size: list[tuple[float, Any, float]] = []
        for value in np.unique(octave):
            some = octave == value
            low, high = boxes[some, None, 0], boxes[some, None, 1]
            tree = KDTree((low + (high - low) * inside).reshape(-1, 3))
            self._by_size.append((float(size[some].max()), tree, _AT_THINGS * float(size[some].min())))

    def lengths(self, own: NDArray, most: float) -> EdgeLengths:
        """Of a piece with vertices ``own`` (V, 3), whose edges are no longer than ``most`` anywhere."""
        size = _size_of(own)
        near = [(tree, length) for largest, tree, length in self._by_size if largest <= _SMALLER * size]
        return EdgeLengths(min(most, _OWN * size), tuple(one for one in near if one[1] < most))


def lengths_alone(own: NDArray, most: float) -> EdgeLengths:
    """As `Things.lengths` where nothing else counts."""
    return EdgeLengths(min(most, _OWN * _size_of(own)))


def boxes_of(shapes: Sequence[Any]) -> NDArray[np.float64]:
    """(n, 2, 3) boxes of Mitsuba shapes."""
    corners = [(np.array(box.min), np.array(box.max)) for box in (shape.bbox() for shape in shapes)]
    return np.array(corners, dtype=np.float64).reshape(-1, 2, 3)


def _size_of(positions: NDArray) -> float:
    return float(np.linalg.norm(np.ptp(positions, axis=0)))
