"""Quadrature rules on regions bounded by arcs of circles, ring by ring about a pole in or near the region.

Between the polar angles at which an arc starts, ends, turns back or meets another, the azimuths of the boundary are
smooth functions of the angle but for square roots at both ends, which a sine substitution removes; on each stretch of
a ring the integrand is a trigonometric polynomial. All weights are positive. Seen from a pole next to it the boundary
is known by its distances from the pole, not by coordinates of unit vectors: small regions keep their digits.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slepian_prt.sphere.quadrature import gauss_legendre
from slepian_prt.sphere.rotation import rotation_to

TURN = 2.0 * math.pi
_SPLITS = 12
_EPSILON = float(np.finfo(np.float64).eps)
Contains = Callable[[NDArray], NDArray]


class Arcs(NamedTuple):
    """Arcs of circles on the sphere.

    Attributes
    ----------
    axes : (k, 3)
        Unit vectors; an arc turns counter-clockwise about its own.
    angles : (k,)
        Of the circles from their axes, radians; π/2 where not ``whole``.
    whole : (k,) bool
        Whether it is a full circle, and not an arc (shorter than π) of a great circle.
    starts, ends : (k, 3)
        Unit vectors; of no meaning where ``whole``.
    corners : (m, 3)
        Where arcs start, end or cross.
    """

    axes: NDArray[np.float64]
    angles: NDArray[np.float64]
    whole: NDArray[np.bool_]
    starts: NDArray[np.float64]
    ends: NDArray[np.float64]
    corners: NDArray[np.float64]


@dataclass(frozen=True)
class Strip:
    """Stretches of r neighbouring rings, g on each.

    Attributes
    ----------
    theta, weights : (r,)
        Polar angles, with the weights of ∫ … sin θ dθ.
    starts, widths : (r, g)
        Azimuths; a width of 2π is the whole ring.
    """

    theta: NDArray[np.float64]
    weights: NDArray[np.float64]
    starts: NDArray[np.float64]
    widths: NDArray[np.float64]

    @property
    def area(self) -> float:
        return float(self.weights @ self.widths.sum(axis=1))


class _Stretch(NamedTuple):
    """Azimuths inside, between two crossings of a ring: numbers of their arcs, signs of their branches, full turns."""

    arcs: tuple[int, int]
    signs: tuple[int, int]
    turns: int


class _Panel(NamedTuple):
    """Polar angles from ``low`` to ``high``, between which rings cross the same arcs in the same order."""

    low: float
    high: float
    stretches: list[_Stretch]
    full: bool


def join_arcs(mine: Arcs, theirs: Arcs) -> Arcs:
    """Both boundaries in one, with the corners where they cross."""
    axes, angles, whole, starts, ends, corners = (np.concatenate([a, b]) for a, b in zip(mine, theirs, strict=True))
    return Arcs(axes, angles, whole, starts, ends, np.concatenate([corners, *_meetings(mine, theirs)]))


def _meetings(mine: Arcs, theirs: Arcs) -> Iterator[NDArray[np.float64]]:
    """Points where an arc of one boundary meets one of the other; a few beyond the ends do no harm."""
    for some, others in ((mine, theirs), (theirs, mine)):
        # A whole circle is a ring about its own axis.
        for axis, angle in zip(some.axes[some.whole], some.angles[some.whole], strict=True):
            seen = _look(others, axis)
            yield seen.directions(angle, seen.crossings(float(angle))[2])
    edges = _pick(theirs, np.flatnonzero(~theirs.whole))
    for i in np.flatnonzero(~mine.whole):
        one, lines = _pick(mine, np.array([i])), np.cross(mine.axes[i], edges.axes)
        lengths = np.linalg.norm(lines, axis=1)
        lines /= np.where(lengths > 1e-12, lengths, np.inf)[:, None]
        for points in (lines, -lines):
            yield points[(lengths > 1e-12) & _along(edges, points, points, 1e-12) & _along(one, points, points, 1e-12)]


@dataclass(frozen=True)
class _Seen:
    """Arcs seen from a pole: where rings about it cross them.

    Attributes
    ----------
    arcs : Arcs
    frame : (3, 3)
        A rotation whose last column is the pole.
    centers : (k,)
        Azimuths of the axes.
    differences, sums : (k,)
        β - α and β + α, of the circles' angles β and those α from the pole to their axes.
    low, high : (k,)
        Polar angles that each arc spans.
    breaks : list of float
        Those at which the boundary changes its course, ascending.
    """

    arcs: Arcs
    frame: NDArray[np.float64]
    centers: NDArray[np.float64]
    differences: NDArray[np.float64]
    sums: NDArray[np.float64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    breaks: list[float]

    def halves(self, arc: int | NDArray, theta: NDArray | float) -> NDArray[np.float64]:
        """Half of the azimuths that lie within a circle, on a ring.

        By the half-angle formula of the spherical triangle with the sides α, β and θ, tan²(φ/2) =
        sin((β+α-θ)/2) sin((β-α+θ)/2) / (sin((β+α+θ)/2) sin((θ-β+α)/2)), small differences keep their digits.
        """
        difference, total = self.differences[arc], self.sums[arc]
        above = np.sin(0.5 * (total - theta)) * np.sin(0.5 * (theta + difference))
        below = np.sin(0.5 * (total + theta)) * np.sin(0.5 * (theta - difference))
        return np.asarray(2.0 * np.arctan2(np.sqrt(np.maximum(above, 0.0)), np.sqrt(np.maximum(below, 0.0))))

    def crossings(self, theta: float) -> tuple[NDArray, NDArray, NDArray]:
        """Numbers of the arcs that a ring crosses, signs of the branches, and azimuths."""
        reached = np.flatnonzero((self.low < theta) & (theta < self.high))
        halves = self.halves(reached, theta)
        arcs, signs = np.tile(reached, 2), np.repeat([-1, 1], reached.size)
        azimuths = self.centers[arcs] + signs * np.tile(halves, 2)
        points = self.offsets(theta, azimuths)
        slack = 1e-13 * math.sin(theta)
        some, pole = _pick(self.arcs, arcs), self.frame[:, 2]
        on = _along(some, points - (some.starts - pole), points - (some.ends - pole), slack)
        return arcs[on], signs[on], azimuths[on]

    def offsets(self, theta: NDArray | float, azimuths: NDArray) -> NDArray[np.float64]:
        """Directions less the pole, (n, 3)."""
        sine, fall = np.sin(theta), np.asarray(-2.0 * np.sin(0.5 * theta) ** 2)
        local = np.column_stack(
            [sine * np.cos(azimuths), sine * np.sin(azimuths), np.broadcast_to(fall, azimuths.shape)]
        )
        return local @ self.frame.T

    def directions(self, theta: NDArray | float, azimuths: NDArray) -> NDArray[np.float64]:
        """Unit vectors, (n, 3)."""
        return self.frame[:, 2] + self.offsets(theta, azimuths)


def _look(arcs: Arcs, pole: NDArray) -> _Seen:
    frame = rotation_to(pole)
    frame[:, 2] = pole  # bit for bit: a cap's own axis is no distance away
    offsets = (arcs.axes - pole) @ frame
    # An edge's great circle passes the pole at an elevation that is formed from the difference to one of its ends.
    elevations = np.arctan2(_dots(arcs.axes, pole - arcs.starts), np.hypot(offsets[:, 0], offsets[:, 1]))
    tilts = _angles(arcs.axes, pole)
    differences = np.where(arcs.whole, arcs.angles - tilts, elevations)
    sums = np.where(arcs.whole, arcs.angles + tilts, math.pi - elevations)
    nearest, farthest = np.abs(differences), math.pi - np.abs(math.pi - sums)
    # The foot of the perpendicular from the pole, and from its opposite: on the arc, the polar angle turns there.
    turns_near, turns_far = _along(arcs, pole - arcs.starts, pole - arcs.ends), _along(arcs, -pole[None], -pole[None])
    at_start, at_end = _angles(arcs.starts, pole), _angles(arcs.ends, pole)
    low = np.where(turns_near, nearest, np.minimum(at_start, at_end))
    high = np.where(turns_far, farthest, np.maximum(at_start, at_end))
    found = np.concatenate([[0.0, math.pi], _angles(arcs.corners, pole), nearest[turns_near], farthest[turns_far]])
    breaks = np.unique(found)
    breaks = breaks[np.append(True, np.diff(breaks) > 4.0 * _EPSILON * breaks[1:])]
    centers = np.arctan2(offsets[:, 1], offsets[:, 0])
    return _Seen(arcs, frame, centers, differences, sums, low, high, _grade(breaks))


def _grade(breaks: NDArray) -> list[float]:
    """More breaks between those that differ by far in their distance from the pole, or from its opposite.

    An edge that passes at a distance d has a course that changes on the scale of the larger of d and θ. Rules of ever
    more nodes on the whole of it agree before they see that: the share of what is near, about d², does not show.
    """
    graded = breaks.tolist()
    for low, high in pairwise(breaks):
        graded += _steps(low, high)
        graded += [math.pi - distance for distance in _steps(math.pi - high, math.pi - low)]
    return sorted(graded)


def _steps(low: float, high: float) -> list[float]:
    """Between the two, in steps of at most a factor of 16."""
    if low <= 0.0:
        return []
    start, length = math.log(low), math.log(high) - math.log(low)
    count = math.ceil(length / math.log(16.0))
    return [math.exp(start + length * i / count) for i in range(1, count)]


def _pick(arcs: Arcs, which: NDArray) -> Arcs:
    return Arcs(
        arcs.axes[which], arcs.angles[which], arcs.whole[which], arcs.starts[which], arcs.ends[which], arcs.corners
    )


def _along(arcs: Arcs, from_starts: NDArray, from_ends: NDArray, slack: float = 0.0) -> NDArray[np.bool_]:
    """Whether points of the circles are on the arcs; given less the starts and less the ends of the arcs, or as is."""
    past_start = _dots(np.cross(arcs.axes, arcs.starts), from_starts) >= -slack
    before_end = _dots(np.cross(arcs.axes, arcs.ends), from_ends) <= slack
    return np.asarray(arcs.whole | (past_start & before_end))


def _angles(directions: NDArray, pole: NDArray) -> NDArray[np.float64]:
    return 2.0 * np.arctan2(np.linalg.norm(directions - pole, axis=1), np.linalg.norm(directions + pole, axis=1))


def _dots(a: NDArray, b: NDArray) -> NDArray[np.float64]:
    return np.sum(a * b, axis=1)


def region_rule(arcs: Arcs, contains: Contains, pole: NDArray, degree: int) -> tuple[NDArray, NDArray]:
    """(n, 3) directions and (n,) weights on the region about a pole; see `CircleRegion.rule`."""
    seen = _look(arcs, pole)
    panels = _panels(seen, contains)
    # Rings until each panel's share is good to rounding of the whole area, which a first look tells.
    area = sum(_sample(seen, panel, 12).area for panel in panels)
    strips = [strip for panel in panels for strip in _refine(seen, panel, degree, 1e-14 * min(area, 1.0), _SPLITS)]
    theta, azimuths, weights = spread_nodes(strips, degree)
    return seen.directions(theta, azimuths), weights


def _panels(seen: _Seen, contains: Contains) -> list[_Panel]:
    """Panels that are not outside as a whole; the directions that tell are tested all at once."""
    spans = list(pairwise(seen.breaks))
    found, probes = [], []
    for low, high in spans:
        middle = 0.5 * (low + high)
        arcs, signs, azimuths = seen.crossings(middle)
        order = np.argsort(azimuths % TURN)
        arcs, signs, azimuths = arcs[order], signs[order], azimuths[order]
        wrapped = azimuths % TURN
        ends = np.append(wrapped[1:], wrapped[:1] + TURN)
        # Not the middle: in a symmetric region another arc may come as close there as a direction's rounding.
        probes.append(seen.directions(middle, wrapped + 0.382 * (ends - wrapped) if arcs.size else np.array([0.382])))
        found.append((arcs, signs, np.rint((wrapped - azimuths) / TURN).astype(int)))
    inside = np.split(contains(np.concatenate(probes)), np.cumsum([len(part) for part in probes])[:-1])
    panels = [
        _Panel(low, high, [] if keep.all() else _stretches(*ring, keep), bool(keep.all()))
        for (low, high), ring, keep in zip(spans, found, inside, strict=True)
    ]
    return [panel for panel in panels if panel.full or panel.stretches]


def _stretches(arcs: NDArray, signs: NDArray, turns: NDArray, inside: NDArray) -> list[_Stretch]:
    """Join neighbouring stretches inside; ``inside[i]`` is about the one from crossing i to the next."""
    before = np.roll(inside, 1)
    begins, ends = np.flatnonzero(inside & ~before), np.flatnonzero(~inside & before)
    if begins.size and ends[0] < begins[0]:
        ends = np.roll(ends, -1)
    return [
        _Stretch(
            (int(arcs[a]), int(arcs[b])), (int(signs[a]), int(signs[b])), int(turns[b] - turns[a]) + (1 if b < a else 0)
        )
        for a, b in zip(begins, ends, strict=True)
    ]


def _refine(seen: _Seen, panel: _Panel, degree: int, tolerance: float, splits: int) -> list[Strip]:
    """Rings of a panel; it is cut up until the length of the stretches is integrated to rounding."""
    # The substitution makes the fastest oscillation π/2 times faster; the rest is for the course of the boundary.
    least = nodes_for(0.5 * math.pi * degree * (panel.high - panel.low))
    coarse, fine = (_sample(seen, panel, least + n) for n in (0, 12))
    # Azimuths up to 2π are rounded, each stretch has two.
    rounding = 4.0 * _EPSILON * float(fine.weights.sum()) * fine.widths.shape[1]
    if splits == 0 or abs(coarse.area - fine.area) <= tolerance + rounding:
        return [fine]
    middle = 0.5 * (panel.low + panel.high)
    parts = panel._replace(high=middle), panel._replace(low=middle)
    return [strip for part in parts for strip in _refine(seen, part, degree, tolerance, splits - 1)]


def _sample(seen: _Seen, panel: _Panel, count: int) -> Strip:
    rule = gauss_legendre(count)
    t = 0.5 * (1.0 + rule.nodes)
    length = panel.high - panel.low
    theta = panel.low + length * np.sin(0.5 * math.pi * t) ** 2
    weights = 0.25 * math.pi * rule.weights * length * np.sin(math.pi * t) * np.sin(theta)
    if panel.full:
        return Strip(theta, weights, np.zeros((count, 1)), np.full((count, 1), TURN))
    starts, widths = [], []
    for (a, b), (sign_a, sign_b), turns in panel.stretches:
        half_a, half_b = sign_a * seen.halves(a, theta), sign_b * seen.halves(b, theta)
        starts.append(seen.centers[a] + half_a)
        widths.append((seen.centers[b] - seen.centers[a] + TURN * turns) + (half_b - half_a))
    return Strip(theta, weights, np.column_stack(starts), np.clip(np.column_stack(widths), 0.0, TURN))


def spread_nodes(strips: Iterable[Strip], degree: int) -> tuple[NDArray, NDArray, NDArray]:
    """Polar angles, azimuths and weights (n,) of rules on the stretches, exact for trigonometric polynomials."""
    nodes = [np.zeros((3, 0))]
    for strip in strips:
        for start, width in zip(strip.starts.T, strip.widths.T, strict=True):
            longest = float(width.max())
            if float(width.min()) == TURN:
                places, shares = np.arange(degree + 1) / (degree + 1), np.full(degree + 1, 1.0 / (degree + 1))
            else:
                rule = gauss_legendre(_nodes_on_arc(degree * longest))
                places, shares = 0.5 * (1.0 + rule.nodes), 0.5 * rule.weights
            theta = np.repeat(strip.theta, places.size)
            azimuths = (start[:, None] + width[:, None] * places).ravel()
            nodes.append(np.stack([theta, azimuths, np.outer(strip.weights * width, shares).ravel()]))
    theta, azimuths, weights = np.concatenate(nodes, axis=1)
    return theta, azimuths, weights


def nodes_for(phase: float) -> int:
    """Gauss nodes that integrate an oscillation of ``phase`` radians over the interval to rounding.

    The error of n nodes is that of the Bessel function J_2n(phase/2), whose transition from oscillation to decay has
    a width of (phase/2)^⅓; eleven widths are 1e-16.
    """
    half = 0.5 * phase
    return math.ceil(0.5 * half + 5.75 * half ** (1.0 / 3.0)) + 12


def _nodes_on_arc(phase: float) -> int:
    """As `nodes_for`, without its allowance for the course of a boundary: few for a small phase.

    The error of n nodes for an oscillation is at most 2^(2n+1) n!⁴ / ((2n+1) (2n)!³) (phase/2)^(2n) (Abramowitz and
    Stegun 1964, 25.4.30).
    """
    most = nodes_for(phase)
    if phase == 0.0:
        return 1
    for n in range(1, most):
        constant = (2 * n + 1) * math.log(2.0) + 4.0 * math.lgamma(n + 1) - 3.0 * math.lgamma(2 * n + 1)
        if constant - math.log(2 * n + 1) + 2 * n * math.log(0.5 * phase) <= math.log(1e-17):
            return n
    return most
