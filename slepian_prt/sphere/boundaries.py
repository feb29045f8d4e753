"""How long the boundary of a region is: which parts of the circles that it was made of have it on one side only."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slepian_prt.sphere.rings import TURN, Arcs, Contains

# Points nearer to an arc than this are on it: some fifty roundings of a unit vector.
_ON_ARC = 1e-14
# How far from a piece, relative to what else is near, the two directions lie that tell its sides apart.
_ASIDE = 1e-3
_PAIRS = 1_000_000


class _Pieces(NamedTuple):
    """Parts of arcs between corners, on which nothing changes.

    Attributes
    ----------
    lengths : (n,)
        Radians.
    probes : (n, 3)
        A direction on each.
    arcs : (n,) int
        Numbers of the arcs.
    """

    lengths: NDArray[np.float64]
    probes: NDArray[np.float64]
    arcs: NDArray[np.int64]


def arc_lengths(arcs: Arcs) -> float:
    """Length of all the arcs, radians."""
    second = np.cross(arcs.axes, arcs.starts)
    along = np.sum((arcs.ends - arcs.starts) * second, axis=1), np.sum(arcs.ends * arcs.starts, axis=1)
    return float(np.where(arcs.whole, TURN * np.sin(arcs.angles), np.arctan2(*along)).sum())


def boundary_length(arcs: Arcs, contains: Contains) -> float:
    """Length, in radians, of the parts of the arcs that have the region on one side only; shared parts count once."""
    pieces = _cut(arcs)
    if not pieces.arcs.size:
        return 0.0
    clear, repeated = _surroundings(arcs, pieces)
    axes = arcs.axes[pieces.arcs]
    # Both sides in one call, so that regions which test in chunks do so once.
    inward = axes - np.sum(axes * pieces.probes, axis=1, keepdims=True) * pieces.probes
    inward /= np.linalg.norm(inward, axis=1, keepdims=True)
    aside = _ASIDE * np.minimum(clear, pieces.lengths)[:, None] * inward
    inside = contains(np.concatenate([pieces.probes + aside, pieces.probes - aside]))
    one, other = np.split(inside, 2)
    return float(pieces.lengths[(one != other) & ~repeated].sum())


def _cut(arcs: Arcs) -> _Pieces:
    lengths, probes, numbers = [np.zeros(0)], [np.zeros((0, 3))], [np.zeros(0, dtype=np.int64)]
    for i in map(int, np.flatnonzero(arcs.angles > 0.0)):
        axis, angle, whole = arcs.axes[i], arcs.angles[i], arcs.whole[i]
        first, second, end = _frame(arcs, i)
        sine, cosine = math.sin(angle), math.cos(angle)
        near = arcs.corners[_distances(arcs, np.array([i]), arcs.corners)[:, 0] <= 100.0 * _ON_ARC]
        turns = np.arctan2((near - sine * first) @ second, near @ first)
        turns = turns % TURN if whole else turns[(turns > 0.0) & (turns < end)]
        cuts = np.unique(np.concatenate([[0.0], turns, [end]]))
        widths = np.diff(cuts)
        # Not the middle: in a symmetric region another arc may touch there.
        at = cuts[:-1] + 0.382 * widths
        probes.append(cosine * axis + sine * (np.cos(at)[:, None] * first + np.sin(at)[:, None] * second))
        lengths.append(sine * widths)
        numbers.append(np.full(widths.size, i))
    return _Pieces(np.concatenate(lengths), np.concatenate(probes), np.concatenate(numbers))


def _frame(arcs: Arcs, i: int) -> tuple[NDArray, NDArray, float]:
    """Directions from the axis to the start of an arc and at right angles to it, and the angle by which it turns."""
    axis = arcs.axes[i]
    if arcs.whole[i]:
        first = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
        first /= np.linalg.norm(first)
        return first, np.cross(axis, first), TURN
    first = arcs.starts[i]
    second = np.cross(axis, first)
    chord = arcs.ends[i] - first
    return first, second, math.atan2(float(chord @ second), float(arcs.ends[i] @ first))


def _surroundings(arcs: Arcs, pieces: _Pieces) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """How far the nearest other arc is from each probe, and whether an earlier arc passes there too."""
    count = len(arcs.axes)
    clear, repeated = np.empty(len(pieces.arcs)), np.empty(len(pieces.arcs), dtype=bool)
    step = max(1, _PAIRS // count)
    everyone = np.arange(count)
    for begin in range(0, len(pieces.arcs), step):
        part = slice(begin, begin + step)
        distances = _distances(arcs, everyone, pieces.probes[part])
        on = distances <= _ON_ARC
        repeated[part] = np.any(on & (everyone < pieces.arcs[part, None]), axis=1)
        distances[on] = np.inf
        distances[np.arange(len(distances)), pieces.arcs[part]] = np.inf
        clear[part] = distances.min(axis=1)
    return clear, repeated


def _distances(arcs: Arcs, which: NDArray, points: NDArray) -> NDArray[np.float64]:
    """Chords from unit vectors (rows) to the nearest direction of each arc (columns); angles to whole circles."""
    axes, starts, ends = arcs.axes[which], arcs.starts[which], arcs.ends[which]
    from_axes = np.linalg.norm(points[:, None] - axes, axis=2), np.linalg.norm(points[:, None] + axes, axis=2)
    to_circle = np.abs(2.0 * np.arctan2(*from_axes) - arcs.angles[which])
    to_ends = np.minimum(
        np.linalg.norm(points[:, None] - starts, axis=2), np.linalg.norm(points[:, None] - ends, axis=2)
    )
    past_start = np.sum(np.cross(axes, starts) * (points[:, None] - starts), axis=2) >= 0.0
    before_end = np.sum(np.cross(axes, ends) * (points[:, None] - ends), axis=2) <= 0.0
    return np.where(arcs.whole[which] | (past_start & before_end), to_circle, to_ends)
