"""Regions of the sphere: caps and their combinations, polygons, masks; and quadrature rules on them.

A rule has positive weights and integrates products of bandlimited functions to rounding; see `sphere.rings`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slepian_prt.errors import UserError, check_half_angle
from slepian_prt.sphere.boundaries import arc_lengths, boundary_length
from slepian_prt.sphere.caps import angular_distance
from slepian_prt.sphere.directions import check_directions
from slepian_prt.sphere.polygons import make_polygon
from slepian_prt.sphere.quadrature import gauss_legendre
from slepian_prt.sphere.rings import TURN, Arcs, Contains, Strip, join_arcs, nodes_for, region_rule, spread_nodes


@dataclass(frozen=True)
class CircleRegion:
    """A region whose boundary runs along circles of the sphere. Combine with ``|``, ``&``, ``-`` and ``~``.

    Attributes
    ----------
    arcs : Arcs
        The boundary is a part of them.
    contains : callable
        Takes (n, 3) unit directions, returns (n,) bool.
    pole : (3,)
        Unit vector next to the smallest part; rules have their rings about it.
    size : float
        How far that part reaches from the pole, radians.
    whole : bool
        Whether the arcs bound it on all of their length, as in a cap or polygon that is not combined with another.
    """

    arcs: Arcs
    contains: Contains
    pole: NDArray[np.float64]
    size: float
    whole: bool = True

    def __or__(self, other: CircleRegion) -> CircleRegion:
        return self._combined(other, np.logical_or)

    def __and__(self, other: CircleRegion) -> CircleRegion:
        return self._combined(other, np.logical_and)

    def __sub__(self, other: CircleRegion) -> CircleRegion:
        return self._combined(other, lambda mine, theirs: mine & ~theirs)

    def __invert__(self) -> CircleRegion:
        return replace(self, contains=lambda directions: ~self.contains(directions))

    def _combined(self, other: CircleRegion, combine: Callable[[NDArray, NDArray], NDArray]) -> CircleRegion:
        small = min(self, other, key=lambda region: region.size)
        return CircleRegion(
            join_arcs(self.arcs, other.arcs),
            lambda directions: combine(self.contains(directions), other.contains(directions)),
            small.pole,
            small.size,
            whole=False,
        )

    def rule(self, degree: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(n, 3) directions and (n,) weights, exact to rounding for spherical polynomials up to ``degree``."""
        return region_rule(self.arcs, self.contains, self.pole, degree)

    def boundary(self) -> float:
        """Length in radians of what separates inside from outside."""
        return arc_lengths(self.arcs) if self.whole else boundary_length(self.arcs, self.contains)


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
        azimuth = np.arctan2(directions[:, 1], directions[:, 0]) % TURN
        row = np.minimum((polar / math.pi * height).astype(int), height - 1)
        return self.mask[row, np.minimum((azimuth / TURN * width).astype(int), width - 1)]

    def rule(self, degree: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """As `CircleRegion.rule`."""
        theta, azimuths, weights = spread_nodes(self._strips(degree), degree)
        sine = np.sin(theta)
        return np.column_stack([sine * np.cos(azimuths), sine * np.sin(azimuths), np.cos(theta)]), weights

    def boundary(self) -> float:
        """As `CircleRegion.boundary`."""
        height, width = self.mask.shape
        along_meridians = np.count_nonzero(self.mask != np.roll(self.mask, 1, axis=1)) * math.pi / height
        changes = np.count_nonzero(self.mask[1:] != self.mask[:-1], axis=1)
        circles = np.sin(math.pi * np.arange(1, height) / height)
        return float(along_meridians + changes @ circles * TURN / width)

    def _strips(self, degree: int) -> Iterator[Strip]:
        height, width = self.mask.shape
        # In the polar angle the integrand is a trigonometric polynomial of degree + 1, over an angle of π/H.
        rule = gauss_legendre(nodes_for((degree + 1) * math.pi / height))
        for row, cells in enumerate(self.mask):
            if not cells.any():
                continue
            starts = np.flatnonzero(cells & ~np.roll(cells, 1))
            counts = np.array([width])
            if starts.size:
                ends = np.flatnonzero(cells & ~np.roll(cells, -1)) + 1
                counts = np.roll(ends, -int(np.searchsorted(ends, starts[0], side="right"))) - starts
                counts[counts < 0] += width
            else:
                starts = np.array([0])
            theta = math.pi * (row + 0.5 * (1.0 + rule.nodes)) / height
            weights = 0.5 * rule.weights * math.pi / height * np.sin(theta)
            azimuths, widths = (np.tile(TURN * cells / width, (theta.size, 1)) for cells in (starts, counts))
            yield Strip(theta, weights, azimuths, widths)


Region = CircleRegion | MaskRegion


def cap_region(center: ArrayLike, half_angle: float) -> CircleRegion:
    """The directions within ``half_angle`` (radians, [0, π]) of ``center``."""
    axis, angle = check_directions(center, "center")[0], check_half_angle(half_angle)
    if angle > 0.5 * math.pi:
        return ~_small_cap(-axis, math.pi - angle)
    return _small_cap(axis, angle)


def _small_cap(axis: NDArray, angle: float) -> CircleRegion:
    chord = 4.0 * math.sin(0.5 * angle) ** 2
    circle = axis[None]
    arcs = Arcs(circle, np.array([angle]), np.array([True]), circle, circle, np.zeros((0, 3)))
    return CircleRegion(arcs, lambda directions: np.sum((directions - axis) ** 2, axis=1) <= chord, axis, angle)


def polygon_region(vertices: ArrayLike) -> CircleRegion:
    """The spherical polygon to the left of its edges (counter-clockwise seen from outside), convex or not.

    Clockwise vertices give all but what they surround; so a polygon may be larger than a hemisphere, and hold poles.

    Parameters
    ----------
    vertices : (n, 3), 3 <= n <= 20,000
        Joined by the shorter arcs of great circles; the last to the first. They need not have unit length. Each
        is named once: the last vertex of a closed ring is left out.

    Raises
    ------
    UserError
        Fewer than three vertices, two successive ones equal or opposite, or edges that cross, touch or overlap: that
        come within 1e-14 radians of each other, where the digits of float64 end.
    """
    polygon = make_polygon(vertices)
    edges = polygon.edges
    count = len(edges.starts)
    quarter = np.full(count, 0.5 * math.pi)
    arcs = Arcs(edges.normals, quarter, np.zeros(count, dtype=bool), edges.starts, edges.ends, edges.starts)
    size = float(angular_distance(edges.starts, polygon.middle).max())
    return CircleRegion(arcs, polygon.contains, polygon.middle, size)


def mask_region(mask: ArrayLike) -> MaskRegion:
    """The cells of an equirectangular (H, W) grid, z up, that are true, or any number but zero; see `MaskRegion`.

    Row j spans the polar angles πj/H to π(j+1)/H, column k the azimuths 2πk/W to 2π(k+1)/W: a mask is an area, and its
    edges are where its cells end. The grids of SHTOOLS (DH) are samples at points instead, at the polar angles πj/H and
    the azimuths 2πk/W: half a cell up and to the left of the middle of ours. Samples as cells about their points are

        rows = np.minimum((np.arange(2 * H) + 1) // 2, len(mask) - 1)
        columns = (np.arange(2 * W) + 1) // 2 % W
        region = sp.mask_region(mask[np.ix_(rows, columns)])

    of a mask (H, W), or (H + 1, W + 1) with ``extend=True``. Maps of light are neither: see `project_environment`.

    Raises
    ------
    UserError
        Not two-dimensional, empty, not of numbers, or with cells that are not finite or hidden by a masked array.
    """
    try:
        cells = np.asarray(mask)
    except ValueError:
        raise UserError("mask must have shape (H, W): its rows differ in length") from None
    if cells.ndim != 2 or cells.size == 0:
        raise UserError(f"mask must have shape (H, W), not {cells.shape}")
    if cells.dtype.kind not in "biuf":
        raise UserError(f"mask must hold true and false, or numbers, not {cells.dtype}")
    for wrong, what in ((~np.isfinite(cells), "be finite"), (np.ma.getmaskarray(np.ma.asarray(mask)), "not be hidden")):
        if wrong.any():
            row, column = (int(x[0]) for x in np.nonzero(wrong))
            raise UserError(f"mask[{row}, {column}] must {what}; set it to 0 to leave the cell out, to 1 to keep it")
    return MaskRegion(cells != 0)


def region_area(region: Region) -> float:
    """Area in steradians: of a cap to its last digits, however small; else as of a boundary up to 1e-14 radians off.

    Parameters
    ----------
    region : from `cap_region` (and ``|``, ``&``, ``-``, ``~``), `polygon_region` or `mask_region`
    """
    return float(_check_region(region).rule(0)[1].sum())


def region_boundary(region: Region) -> float:
    """Length of the boundary in radians: of all parts of circles and cell borders with the region on one side only.

    Parameters
    ----------
    region : as in `region_area`
    """
    return _check_region(region).boundary()


def _check_region(region: Region) -> Region:
    if not isinstance(region, Region):
        raise UserError(f"region must come from cap_region, polygon_region or mask_region, not {region!r}")
    return region
