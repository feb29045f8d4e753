"""Triangles of polygons of any size, also of those that are not convex."""

from __future__ import annotations

from dataclasses import dataclass

import mapbox_earcut
import numpy as np
from numpy.typing import NDArray

# Sine of the smallest turn that makes a corner: float32 coordinates on a straight line turn by less.
_STRAIGHT = 1e-6

# Corners of the largest polygon that is spanned with least area, which takes their number cubed; and how much such
# work is done for all of a file: that of ten of these.
_MOST_SPANNED = 100
_MOST_SPANNING = 10 * _MOST_SPANNED**3

# Clipping ears takes the corners squared at most, and cubed where a polygon crosses itself or goes round again: up to
# _FEW_CORNERS nobody looks, and of those with more so much is done for all of a file, some ten seconds.
_FEW_CORNERS = 200
_MOST_CLIPPED = 20_000
_MOST_CLIPPING = 10 * 1000**3

# Pairs of sides that are looked at for crossings.
_MOST_PAIRS = 4_000_000


class TangledError(ValueError):
    """A polygon that cannot be cut into triangles in reasonable time.

    Attributes
    ----------
    polygon, size : int
        Its number, and that of its corners.
    """

    def __init__(self, polygon: int, size: int) -> None:
        super().__init__(f"polygon {polygon} of {size} corners")
        self.polygon = polygon
        self.size = size


class _TooLongError(Exception):
    def __init__(self, row: int) -> None:
        super().__init__()
        self.row = row


@dataclass
class _Budget:
    """Work that is left for the polygons of a file."""

    spanning: int = _MOST_SPANNING
    clipping: int = _MOST_CLIPPING


def triangulate(
    positions: NDArray[np.float64], sizes: NDArray[np.int64], corners: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Cut polygons into triangles of the same winding.

    Convex polygons become fans around their first corner, quadrilaterals are cut along the diagonal that lies inside,
    and the ears of others are clipped in their plane of best fit, whose normal is Newell's (Sutherland, Sproull &
    Schumacker 1974). Corners on a straight line are corners of triangles too. Bent polygons that cross themselves in
    that plane are spanned with the least area (Barequet & Sharir 1995). Polygons without an area of a known side, or
    with corners that are not finite, become fans.

    Parameters
    ----------
    positions : (V, 3)
    sizes : (P,)
        Number of corners of each polygon; those of fewer than three, repeated ones counted once, are left out.
    corners : (sum of sizes,)
        Vertices of the polygons, in [0, V).

    Returns
    -------
    triangles : (T, 3) int64
        Positions in ``corners``, so that other attributes of the corners can follow.
    owners : (T,) int64
        The polygon of each, in ascending order.

    Raises
    ------
    TangledError
        A flat polygon of thousands of corners is not convex and crosses itself, goes round again, or has too many.
    """
    numbers = np.arange(len(corners), dtype=np.int64)
    if np.all(sizes == 3):
        return numbers.reshape(-1, 3), np.arange(len(sizes), dtype=np.int64)
    numbers, sizes = _without_repeats(sizes, corners, numbers)
    starts = np.cumsum(sizes) - sizes
    triangles, owners = [np.empty((0, 3), dtype=np.int64)], [np.empty(0, dtype=np.int64)]
    budget = _Budget()
    for size in np.unique(sizes[sizes >= 3]):
        polygons = np.flatnonzero(sizes == size)
        rows = numbers[starts[polygons, None] + np.arange(size)]
        try:
            cut, row = _cut(positions, corners, rows, budget)
        except _TooLongError as error:
            raise TangledError(int(polygons[error.row]), int(size)) from None
        triangles.append(rows[row[:, None], cut])
        owners.append(polygons[row])
    owner = np.concatenate(owners)
    order = np.argsort(owner, kind="stable")
    return np.concatenate(triangles)[order], owner[order]


def _without_repeats(
    sizes: NDArray[np.int64], corners: NDArray[np.int64], numbers: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Numbers of the corners that differ from the one after them, and how many each polygon has of them."""
    filled = sizes > 0
    starts = (np.cumsum(sizes) - sizes)[filled]
    after = numbers + 1
    after[starts + sizes[filled] - 1] = starts
    kept = corners != corners[after]
    if kept.all():
        return numbers, sizes
    counts = np.zeros_like(sizes)
    counts[filled] = np.add.reduceat(kept, starts, dtype=np.int64)
    return numbers[kept], counts


def _cut(
    positions: NDArray[np.float64], corners: NDArray[np.int64], rows: NDArray[np.int64], budget: _Budget
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Triangles (T, 3) in columns of ``rows`` (R, n), and the row of each; ``budget`` is what spanning may take."""
    count, size = rows.shape
    fan = np.stack([np.zeros(size - 2, dtype=np.int64), np.arange(1, size - 1), np.arange(2, size)], axis=1)
    if size == 3:
        return np.tile(fan, (count, 1)), np.arange(count)
    points = positions[corners[rows]]
    # Numbers next to the limits of float64 overflow, and those that are not finite compare as false: both end as fans.
    with np.errstate(all="ignore"):
        points = points - points[:, :1]
        points = points / np.abs(points).max(axis=(1, 2), keepdims=True)
        normals = _newell(points)
        if size == 4:
            return _cut_quads(points, normals)
        flat = _project(points, normals)
        plain = _are_convex(flat) | ~(np.linalg.norm(normals, axis=1) > 1e-12)
    if size > _FEW_CORNERS:
        for number in np.flatnonzero(~plain):
            budget.clipping -= 0 if _is_simple(flat[number]) else size**3
            if size > _MOST_CLIPPED or budget.clipping < 0:
                if not _is_bent(points[number]):
                    raise _TooLongError(int(number))
                plain[number] = True
    cuts = [_clip_ears(flat[row], points[row], fan, budget) for row in np.flatnonzero(~plain)]
    simple = np.flatnonzero(plain)
    row = np.concatenate([np.repeat(simple, size - 2), np.repeat(np.flatnonzero(~plain), [len(cut) for cut in cuts])])
    return np.concatenate([np.tile(fan, (len(simple), 1)), *cuts]), row


def _newell(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """(R, 3) twice the vector areas of polygons (R, n, 3)."""
    return np.cross(points, np.roll(points, -1, axis=1)).sum(axis=1)


def _cut_quads(points: NDArray[np.float64], normals: NDArray[np.float64]) -> tuple[NDArray, NDArray]:
    def areas(*corners: int) -> NDArray[np.float64]:
        a, b, c = (points[:, corner] for corner in corners)
        return np.einsum("ij,ij->i", np.cross(b - a, c - a), normals)

    first = np.minimum(areas(0, 1, 2), areas(0, 2, 3))
    second = np.minimum(areas(1, 2, 3), areas(1, 3, 0))
    total = np.einsum("ij,ij->i", normals, normals)
    turned = ~(first > _STRAIGHT * total) & (second > first)
    cuts = np.array([[[0, 1, 2], [0, 2, 3]], [[1, 2, 3], [1, 3, 0]]])
    return cuts[turned.astype(np.int64)].reshape(-1, 3), np.repeat(np.arange(len(points)), 2)


def _project(points: NDArray[np.float64], normals: NDArray[np.float64]) -> NDArray[np.float64]:
    """(R, n, 2) the polygons seen against their normals: anticlockwise."""
    unit = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    axis = np.eye(3)[np.argmin(np.abs(unit), axis=1)]
    right = np.cross(axis, unit)
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    return np.einsum("rnk,rkc->rnc", points, np.stack([right, np.cross(unit, right)], axis=2))


def _sines(u: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.float64]:
    """Of the angles from u to v (…, 2)."""
    cross = u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]
    return cross / (np.hypot(u[..., 0], u[..., 1]) * np.hypot(v[..., 0], v[..., 1]))


def _are_convex(flat: NDArray[np.float64]) -> NDArray[np.bool_]:
    """(R,) whether every corner turns left and is seen from the first in order, which a star's are not."""
    sides = np.roll(flat, -1, axis=1) - flat
    turns = _sines(sides, np.roll(sides, -1, axis=1))
    seen = flat[:, 1:] - flat[:, :1]
    return np.all(turns > _STRAIGHT, axis=1) & np.all(_sines(seen[:, :-1], seen[:, 1:]) > _STRAIGHT, axis=1)


def _is_simple(flat: NDArray[np.float64]) -> bool:
    """Whether a polygon (n, 2) goes round once and meets itself at most along bridges to its holes.

    A bridge is gone to and fro, so that it names two places once more and has two sides that are each other's reverse.
    """
    sides = np.roll(flat, -1, axis=0) - flat
    after = np.roll(sides, -1, axis=0)
    turns = np.arctan2(sides[:, 0] * after[:, 1] - sides[:, 1] * after[:, 0], np.sum(sides * after, axis=1))
    if round(float(turns.sum() / (2 * np.pi))) != 1:
        return False
    places = np.unique(flat, axis=0, return_inverse=True)[1].reshape(-1)
    count = int(places.max()) + 1
    there, back = places * count + np.roll(places, -1), np.roll(places, -1) * count + places
    bridges = np.count_nonzero(np.isin(there, back))
    once_each = len(np.unique(there)) == len(there)
    return once_each and bridges == len(flat) - count and not _meets_itself(flat, places)


def _meets_itself(flat: NDArray[np.float64], places: NDArray[np.int64]) -> bool:
    """Whether sides that share no end touch; also where too many pairs of them lie above each other to see."""
    order, counts = min((_pairs_along(flat[:, k]) for k in range(2)), key=lambda pairs: int(pairs[1].sum()))
    if counts.sum() > _MOST_PAIRS:
        return True
    begin, end = flat[order], np.roll(flat, -1, axis=0)[order]
    i = np.repeat(np.arange(len(flat)), counts)
    j = i + 1 + np.arange(len(i)) - np.repeat(np.cumsum(counts) - counts, counts)
    low, high = np.minimum(begin, end), np.maximum(begin, end)
    near = np.all((low[i] <= high[j]) & (low[j] <= high[i]), axis=1)
    first, last = places[order], np.roll(places, -1)[order]
    near &= (first[i] != first[j]) & (first[i] != last[j]) & (last[i] != first[j]) & (last[i] != last[j])
    i, j = i[near], j[near]

    def side(a: NDArray[np.float64], b: NDArray[np.float64], c: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.sign((b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0]))

    across = side(begin[i], end[i], begin[j]) * side(begin[i], end[i], end[j]) <= 0
    return bool(np.any(across & (side(begin[j], end[j], begin[i]) * side(begin[j], end[j], end[i]) <= 0)))


def _pairs_along(x: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The sides in the order of their beginnings along an axis, and how many after each begin before its end."""
    low, high = np.minimum(x, np.roll(x, -1)), np.maximum(x, np.roll(x, -1))
    order = np.argsort(low, kind="stable")
    return order, np.searchsorted(low[order], high[order], side="right") - np.arange(1, len(x) + 1)


def _clip_ears(
    flat: NDArray[np.float64], points: NDArray[np.float64], fan: NDArray[np.int64], budget: _Budget
) -> NDArray[np.int64]:
    """Triangles (T, 3) of one polygon (n, 3), anticlockwise as it is in its plane (n, 2)."""
    ends = np.array([len(flat)], dtype=np.uint32)
    triangles = mapbox_earcut.triangulate_float64(np.ascontiguousarray(flat), ends).reshape(-1, 3)
    if len(triangles) == len(flat) - 2:
        return triangles.astype(np.int64)
    # A corner left out of a bent polygon would be a hole in the surface, and out of a flat one is none.
    if _is_bent(points):
        budget.spanning -= len(flat) ** 3
        return _span(points) if len(flat) <= _MOST_SPANNED and budget.spanning >= 0 else fan
    return triangles.astype(np.int64) if len(triangles) else fan


def _is_bent(points: NDArray[np.float64]) -> bool:
    """Whether corners (n, 3) are in no plane."""
    return bool(np.linalg.svd(points - points.mean(axis=0), compute_uv=False)[2] > _STRAIGHT)


def _span(points: NDArray[np.float64]) -> NDArray[np.int64]:
    """Triangles (n - 2, 3) of least area between all sides of a polygon (n, 3).

    Between corners i and j it is a triangle with one corner k between them and the least between i and k, and k and j.
    """
    count = len(points)
    least = np.zeros((count, count))
    corner = np.zeros((count, count), dtype=np.int64)
    for apart in range(2, count):
        for i in range(count - apart):
            j = i + apart
            between = points[i + 1 : j] - points[i]
            areas = 0.5 * np.linalg.norm(np.cross(between, points[j] - points[i]), axis=1)
            areas += least[i, i + 1 : j] + least[i + 1 : j, j]
            corner[i, j] = i + 1 + np.argmin(areas)
            least[i, j] = areas.min()
    triangles, waiting = [], [(0, count - 1)]
    while waiting:
        i, j = waiting.pop()
        if j - i > 1:
            k = int(corner[i, j])
            triangles.append((i, k, j))
            waiting += [(i, k), (k, j)]
    return np.array(triangles, dtype=np.int64)
