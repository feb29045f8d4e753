"""Spherical caps: area, boundary, and the smallest cap around a set of directions."""

from __future__ import annotations

import math
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slepian_prt.errors import UserError, check_half_angle
from slepian_prt.sphere.directions import check_directions


class Cap(NamedTuple):
    """The directions within ``half_angle`` (radians) of the unit vector ``center``, shape (3,)."""

    center: NDArray[np.float64]
    half_angle: float


def cap_area(half_angle: float) -> float:
    """Area 2π(1 - cos Θ) = 4π sin²(Θ/2), free of cancellation at small Θ."""
    return 4.0 * math.pi * math.sin(check_half_angle(half_angle) / 2) ** 2


def cap_boundary(half_angle: float) -> float:
    """Length 2π sin Θ of the boundary circle."""
    half_angle = check_half_angle(half_angle)
    return 2.0 * math.pi * math.sin(min(half_angle, math.pi - half_angle))


def angular_distance(directions: ArrayLike, center: ArrayLike) -> NDArray[np.float64]:
    """Angles between unit vectors (n, 3) and one unit vector, accurate at every angle (arccos is not, near 0 and π)."""
    d, c = np.asarray(directions, dtype=np.float64), np.asarray(center, dtype=np.float64)
    return 2.0 * np.arctan2(np.linalg.norm(d - c, axis=-1), np.linalg.norm(d + c, axis=-1))


def minimal_enclosing_cap(directions: ArrayLike) -> Cap:
    """The smallest cap that holds all directions.

    Within a hemisphere this is an LP-type problem of dimension three: the cap rests on at most three of the points.
    We keep such a support, add the farthest outlier, solve the at most four points by trial, and repeat; the
    half-angle grows with every step, so the method ends, and it is exact to rounding. A set that no hemisphere holds
    leaves empty caps instead, each resting on a facet of its convex hull; what the largest of them leaves is the
    answer.

    Parameters
    ----------
    directions : (n, 3), n >= 1
        Need not be normalised. Duplicates, antipodal and nearly equal directions are allowed.

    Returns
    -------
    Cap

    Raises
    ------
    ValueError
        No direction, or one that is zero or not finite.
    """
    points = check_directions(directions)
    if points.shape[0] == 0:
        raise UserError("directions must hold at least one direction, not 0")
    mean = points.mean(axis=0)
    start = int(np.argmax(angular_distance(points, mean / np.linalg.norm(mean)))) if np.linalg.norm(mean) > 0 else 0
    support = [start]
    center, half_angle = points[start], 0.0
    for _ in range(points.shape[0] + 10):
        distances = angular_distance(points, center)
        farthest = int(np.argmax(distances))
        if distances[farthest] <= half_angle + 4e-16 or farthest in support:
            return Cap(center, float(distances[farthest]))
        solved = _smallest_of_few(points, [*support, farthest])
        if solved is None or solved[1] < half_angle:
            break
        center, half_angle, support = solved
    return _cap_beyond_hemisphere(points)


def _smallest_of_few(points: NDArray, indices: list[int]) -> tuple[NDArray, float, list[int]] | None:
    """Smallest cap around a few points among those that rest on two or three of them; None beyond a hemisphere."""
    chosen = points[indices]
    best: tuple[NDArray, float, list[int]] | None = None
    for size in (2, 3):
        for subset in combinations(range(len(indices)), size):
            corner = chosen[list(subset)]
            axis = corner[0] + corner[1] if size == 2 else _axis_through(*corner)
            length = np.linalg.norm(axis)
            if length <= 1e-12:
                continue
            axis = axis / length
            half_angle = float(angular_distance(corner, axis).max())
            if angular_distance(chosen, axis).max() > half_angle * (1 + 1e-15) + 1e-15 or half_angle > math.pi / 2:
                continue
            if best is None or half_angle < best[1]:
                best = (axis, half_angle, [indices[i] for i in subset])
    return best


def _axis_through(a: NDArray, b: NDArray, c: NDArray) -> NDArray:
    """Axis of the cap through three points, not normalised; zero if they are on one great circle's chord."""
    u, v = b - a, c - a
    normal = np.cross(u, v)
    squared = normal @ normal
    if squared <= 1e-28 * (u @ u) * (v @ v):
        return np.zeros(3)
    # The circumcentre is good for small triangles, whose normal is not (rounding of 1e-16 over their size); the
    # normal is good for those whose circle is nearly great, where the circumcentre is next to the origin.
    offset = np.cross((u @ u) * v - (v @ v) * u, normal) / (2.0 * squared)
    if offset @ offset < 0.5:
        return a + offset
    unit = normal / np.sqrt(squared)
    return unit if unit @ (a + b + c) >= 0 else -unit


def _cap_beyond_hemisphere(points: NDArray) -> Cap:
    """Complement of the largest empty cap, for sets that no hemisphere holds (antipodal pairs among them)."""
    from scipy.spatial import ConvexHull, QhullError  # only here, so that relighting starts without SciPy

    try:
        equations = ConvexHull(points).equations
        normals, offsets = equations[:, :3], -equations[:, 3]
    except QhullError:
        # All on one plane: a (great) circle, whose two sides are the only empty caps, or two antipodal points.
        _, _, rows = np.linalg.svd(points - points.mean(axis=0))
        normals = np.stack([rows[2], -rows[2]])
        offsets = (points @ normals.T).max(axis=0)
    emptiest = normals[int(np.argmin(offsets))]
    center = -emptiest / np.linalg.norm(emptiest)
    return Cap(center, float(angular_distance(points, center).max()))
