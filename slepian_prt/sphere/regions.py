"""Regions of the sphere: caps and their combinations, polygons, masks; and quadrature rules on them.

A rule has positive weights and integrates products of bandlimited functions to rounding. It is made ring by ring:
between the polar angles at which the boundary changes its course, its azimuths are smooth functions of the angle but
for square roots at both ends, which a sine substitution removes; and on each arc of a ring the integrand is a
trigonometric polynomial.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slepian_prt.errors import UserError, check_half_angle
from slepian_prt.sphere.directions import check_directions
from slepian_prt.sphere.quadrature import gauss_legendre

_TURN = 2.0 * math.pi
_SPLITS = 12
Contains = Callable[[NDArray], NDArray]


@dataclass(frozen=True)
class CircleRegion:
    """A region whose boundary runs along circles of the sphere. Combine with ``|``, ``&``, ``-`` and ``~``.

    Attributes
    ----------
    circles : (k, 4)
        Axis (unit) and offset h of each circle {ω : a·ω = h}; the boundary is a part of their union.
    contains : callable
        Takes (n, 3) unit directions, returns (n,) bool.
    """

    circles: NDArray[np.float64]
    contains: Contains

    def __or__(self, other: CircleRegion) -> CircleRegion:
        return self._combined(other, np.logical_or)

    def __and__(self, other: CircleRegion) -> CircleRegion:
        return self._combined(other, np.logical_and)

    def __sub__(self, other: CircleRegion) -> CircleRegion:
        return self._combined(other, lambda mine, theirs: mine & ~theirs)

    def __invert__(self) -> CircleRegion:
        return CircleRegion(self.circles, lambda directions: ~self.contains(directions))

    def _combined(self, other: CircleRegion, combine: Callable[[NDArray, NDArray], NDArray]) -> CircleRegion:
        return CircleRegion(
            np.concatenate([self.circles, other.circles]),
            lambda directions: combine(self.contains(directions), other.contains(directions)),
        )

    def rule(self, degree: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(n, 3) directions and (n,) weights, exact to rounding for spherical polynomials up to ``degree``."""
        return _assemble(self._rings(degree), degree)

    def _rings(self, degree: int) -> Iterator[_Ring]:
        angles = self._breaks()
        for low, high in pairwise(angles):
            yield from self._panel(low, high, degree, _SPLITS)

    def _panel(self, low: float, high: float, degree: int, splits: int) -> list[_Ring]:
        """Rings between two polar angles; halved until the length of the arcs is integrated to rounding."""
        # The substitution makes the fastest oscillation π/2 times faster; the rest is for the course of the boundary.
        least = _nodes_for(0.5 * math.pi * degree * (high - low))
        coarse, fine = (self._sampled(low, high, least + n) for n in (0, 12))
        areas = [sum(ring.weight * sum(b - a for a, b in ring.arcs) for ring in rings) for rings in (coarse, fine)]
        if splits == 0 or abs(areas[0] - areas[1]) <= 1e-14:
            return fine
        middle = 0.5 * (low + high)
        return self._panel(low, middle, degree, splits - 1) + self._panel(middle, high, degree, splits - 1)

    def _sampled(self, low: float, high: float, count: int) -> list[_Ring]:
        rule = gauss_legendre(count)
        t = 0.5 * (1.0 + rule.nodes)
        theta = low + (high - low) * np.sin(0.5 * math.pi * t) ** 2
        weights = 0.25 * math.pi * rule.weights * (high - low) * np.sin(math.pi * t) * np.sin(theta)
        return [_Ring(float(a), float(w), self._arcs(a)) for a, w in zip(theta, weights, strict=True)]

    def _breaks(self) -> list[float]:
        """Polar angles at which a circle starts or ends, or two circles meet."""
        found = {0.0, math.pi}
        axes, offsets = self.circles[:, :3], self.circles[:, 3]
        for axis, offset in zip(axes, offsets, strict=True):
            tilt, width = math.acos(np.clip(axis[2], -1, 1)), math.acos(np.clip(offset, -1, 1))
            found |= {abs(tilt - width), math.pi - abs(math.pi - tilt - width)}
        for i in range(len(axes)):
            for j in range(i):
                line = np.cross(axes[i], axes[j])
                squared = line @ line
                if squared < 1e-24:
                    continue
                base = (offsets[i] * np.cross(axes[j], line) + offsets[j] * np.cross(line, axes[i])) / squared
                rest = (1.0 - base @ base) / squared
                if rest >= 0.0:
                    for sign in (1, -1):
                        x, y, z = base + sign * math.sqrt(rest) * line
                        found.add(math.atan2(math.hypot(x, y), z))
        ordered = sorted(found)
        return [a for i, a in enumerate(ordered) if i == 0 or a - ordered[i - 1] > 1e-15]

    def _arcs(self, theta: float) -> list[tuple[float, float]]:
        z, sine = math.cos(theta), math.sin(theta)
        crossings: list[float] = []
        for ax, ay, az, offset in self.circles:
            reach = sine * math.hypot(ax, ay)
            if reach > 0.0 and abs(offset - z * az) < reach:
                middle, half = math.atan2(ay, ax), math.acos((offset - z * az) / reach)
                crossings += [(middle - half) % _TURN, (middle + half) % _TURN]
        crossings = sorted(set(crossings))
        if not crossings:
            return [(0.0, _TURN)] if self.contains(np.array([[sine, 0.0, z]]))[0] else []
        ends = [*crossings[1:], crossings[0] + _TURN]
        middles = 0.5 * (np.array(crossings) + ends)
        probes = np.column_stack([sine * np.cos(middles), sine * np.sin(middles), np.full(middles.size, z)])
        inside = self.contains(probes)
        if inside.all():
            return [(0.0, _TURN)]
        return [(a, b) for a, b, keep in zip(crossings, ends, inside, strict=True) if keep]


@dataclass(frozen=True)
class MaskRegion:
    """The cells of an equirectangular grid that are set.

    Attributes
    ----------
    mask : (H, W) bool
        Row j spans the polar angles πj/H to π(j+1)/H, column k the azimuths 2πk/W to 2π(k+1)/W.
    """

    mask: NDArray[np.bool_]

    def __invert__(self) -> MaskRegion:
        return MaskRegion(~self.mask)

    def contains(self, directions: NDArray) -> NDArray[np.bool_]:
        """(n,) bool for (n, 3) unit directions."""
        height, width = self.mask.shape
        polar = np.arctan2(np.hypot(directions[:, 0], directions[:, 1]), directions[:, 2])
        azimuth = np.arctan2(directions[:, 1], directions[:, 0]) % _TURN
        row = np.minimum((polar / math.pi * height).astype(int), height - 1)
        return self.mask[row, np.minimum((azimuth / _TURN * width).astype(int), width - 1)]

    def rule(self, degree: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """As `CircleRegion.rule`."""
        return _assemble(self._rings(degree), degree)

    def _rings(self, degree: int) -> Iterator[_Ring]:
        height, width = self.mask.shape
        # In the polar angle the integrand is a trigonometric polynomial of degree + 1, over an angle of π/H.
        rule = gauss_legendre(_nodes_for((degree + 1) * math.pi / height))
        for row, cells in enumerate(self.mask):
            if not cells.any():
                continue
            starts = np.flatnonzero(cells & ~np.roll(cells, 1))
            ends = np.flatnonzero(cells & ~np.roll(cells, -1)) + 1
            arcs = [(0.0, _TURN)]
            if starts.size:
                first = int(np.searchsorted(ends, starts[0], side="right"))
                ends = np.roll(ends, -first).astype(np.float64)
                ends[ends <= starts] += width
                arcs = [(_TURN * a / width, _TURN * b / width) for a, b in zip(starts, ends, strict=True)]
            theta = math.pi * (row + 0.5 * (1.0 + rule.nodes)) / height
            for angle, weight in zip(theta, 0.5 * rule.weights * math.pi / height * np.sin(theta), strict=True):
                yield _Ring(float(angle), float(weight), arcs)


Region = CircleRegion | MaskRegion


@dataclass(frozen=True)
class _Ring:
    """Azimuth intervals at one polar angle, with the weight of the angle."""

    theta: float
    weight: float
    arcs: list[tuple[float, float]]


def cap_region(center: ArrayLike, half_angle: float) -> CircleRegion:
    """The directions within ``half_angle`` (radians, [0, π]) of ``center``."""
    axis = check_directions(center, "center")[0]
    height = math.cos(check_half_angle(half_angle))
    return CircleRegion(np.array([[*axis, height]]), lambda directions: directions @ axis >= height)


def polygon_region(vertices: ArrayLike) -> CircleRegion:
    """The spherical polygon to the left of its edges (counter-clockwise seen from outside), convex or not.

    Parameters
    ----------
    vertices : (n, 3), n >= 3
        Joined by the shorter arcs of great circles; the last to the first.

    Raises
    ------
    UserError
        Fewer than three vertices, or two successive ones equal or opposite.
    """
    corners = check_directions(vertices, "vertices")
    if len(corners) < 3:
        raise UserError(f"vertices must hold at least three directions, not {len(corners)}")
    following = np.roll(corners, -1, axis=0)
    normals = np.cross(corners, following)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    if (length < 1e-12).any():
        first = int(np.argmin(length))
        raise UserError(f"vertices[{first}] and the next must be neither equal nor opposite")
    normals /= length
    # A point just left of the middle of the longest edge is inside; a path from it that crosses an even number of
    # edges ends inside.
    longest = int(np.argmax(length))
    inside = corners[longest] + following[longest]
    inside = inside / np.linalg.norm(inside) + 1e-7 * normals[longest]
    inside /= np.linalg.norm(inside)

    def contains(directions: NDArray) -> NDArray[np.bool_]:
        crossed = np.zeros(len(directions), dtype=int)
        path = np.cross(inside, directions)
        for a, b, normal in zip(corners, following, normals, strict=True):
            at_start, at_end = float(normal @ inside), directions @ normal
            from_a, from_b = path @ a, path @ b
            crossed += (at_start * at_end < 0) & (from_a * from_b < 0) & (at_start * from_b > 0)
        return crossed % 2 == 0

    return CircleRegion(np.column_stack([normals, np.zeros(len(normals))]), contains)


def mask_region(mask: ArrayLike) -> MaskRegion:
    """The cells that are true of an equirectangular (H, W) grid, z up; see `MaskRegion`.

    Raises
    ------
    UserError
        Not two-dimensional, or empty.
    """
    cells = np.asarray(mask)
    if cells.ndim != 2 or cells.size == 0:
        raise UserError(f"mask must have shape (H, W), not {cells.shape}")
    return MaskRegion(cells.astype(bool))


def region_area(region: Region) -> float:
    """Area in steradians."""
    return float(region.rule(0)[1].sum())


def _nodes_for(phase: float) -> int:
    """Gauss nodes that integrate an oscillation of ``phase`` radians over the interval to rounding.

    The error of n nodes is that of the Bessel function J_2n(phase/2), whose transition from oscillation to decay has
    a width of (phase/2)^⅓; eleven widths are 1e-16.
    """
    half = 0.5 * phase
    return math.ceil(0.5 * half + 5.75 * half ** (1.0 / 3.0)) + 12


def _assemble(rings: Iterator[_Ring], degree: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    directions, weights = [np.zeros((0, 3))], [np.zeros(0)]
    for ring in rings:
        z, sine = math.cos(ring.theta), math.sin(ring.theta)
        for start, end in ring.arcs:
            if end - start >= _TURN:
                phi = _TURN * np.arange(degree + 1) / (degree + 1)
                weight = np.full(degree + 1, _TURN / (degree + 1))
            else:
                rule = gauss_legendre(_nodes_for(degree * (end - start)))
                phi = start + 0.5 * (end - start) * (1.0 + rule.nodes)
                weight = 0.5 * (end - start) * rule.weights
            directions.append(np.column_stack([sine * np.cos(phi), sine * np.sin(phi), np.full(phi.size, z)]))
            weights.append(ring.weight * weight)
    return np.concatenate(directions), np.concatenate(weights)
