"""Lengths of boundaries against closed forms, and against brute force on both sides of every arc."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slepian_prt.errors import UserError
from slepian_prt.sphere.boundaries import boundary_length
from slepian_prt.sphere.caps import cap_boundary
from slepian_prt.sphere.regions import cap_region, mask_region, polygon_region, region_area, region_boundary
from tests.conftest import random_directions

POLE = (0.0, 0.0, 1.0)
OCTANT = polygon_region(np.eye(3))


@given(st.integers(0, 2**32 - 1), st.floats(0.0, math.pi))
@settings(max_examples=30, deadline=None)
def test_of_a_cap_anywhere(seed, half_angle):
    region = cap_region(random_directions(np.random.default_rng(seed), 1)[0], half_angle)
    assert region_boundary(region) == pytest.approx(cap_boundary(half_angle), rel=1e-14)
    assert region_boundary(~region) == pytest.approx(cap_boundary(half_angle), rel=1e-14)


def test_of_two_caps_that_overlap():
    # The lens of two equal circles β about axes at a distance 2d: cos β = cos d cos h, and arcs of 2 asin(sin h/sin β).
    beta, d = 0.5, 0.3
    one, other = (cap_region((math.sin(s), 0.0, math.cos(s)), beta) for s in (-d, d))
    h = math.acos(math.cos(beta) / math.cos(d))
    lens = 2.0 * math.sin(beta) * 2.0 * math.asin(math.sin(h) / math.sin(beta))
    whole = 2.0 * cap_boundary(beta)
    assert region_boundary(one & other) == pytest.approx(lens, rel=1e-13)
    assert region_boundary(one | other) == pytest.approx(whole - lens, rel=1e-13)
    assert region_boundary(one - other) == pytest.approx(cap_boundary(beta), rel=1e-13)  # arcs of equal circles


@pytest.mark.parametrize(
    ("region", "length"),
    [
        (cap_region(POLE, 0.6) - cap_region(POLE, 0.3), cap_boundary(0.6) + cap_boundary(0.3)),
        (cap_region(POLE, 0.3) | cap_region((1, 0, 0), 0.4), cap_boundary(0.3) + cap_boundary(0.4)),
        (cap_region(POLE, 0.3) & cap_region(POLE, 0.6), cap_boundary(0.3)),
        (OCTANT, 1.5 * math.pi),
        (~OCTANT, 1.5 * math.pi),
        (OCTANT & cap_region(POLE, 0.4), 0.8 + 0.5 * math.pi * math.sin(0.4)),
        (OCTANT | cap_region(POLE, 0.4), 1.5 * math.pi - 0.8 + 1.5 * math.pi * math.sin(0.4)),
    ],
    ids=["ring", "apart", "nested", "octant", "its complement", "slice", "ice cream"],
)
def test_of_combinations(region, length):
    assert region_boundary(region) == pytest.approx(length, rel=1e-13)


def test_what_regions_share_is_no_boundary_and_counts_once():
    neighbour = polygon_region([[0, 1, 0], [-1, 0, 0], [0, 0, 1]])
    assert region_boundary(OCTANT | neighbour) == pytest.approx(2.0 * math.pi, rel=1e-13)
    cap = cap_region((0.3, -0.5, 0.6), 0.7)
    for same in (cap | cap, cap & cap, cap - ~cap):
        assert region_boundary(same) == pytest.approx(cap_boundary(0.7), rel=1e-13)
    for nothing in (cap - cap, cap | ~cap, cap & ~cap, OCTANT - OCTANT):
        assert region_boundary(nothing) == 0.0


def test_of_an_l_in_the_plane():
    # Six corners next to each other: the plane's L, whose edges are 2, 1, 1, 1, 1 and 2, but for curvature of size².
    size = 1e-6
    corners = np.array([[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]], dtype=float)
    region = polygon_region(np.column_stack([size * corners, np.ones(6)]))
    assert region_boundary(region) == pytest.approx(8.0 * size, rel=1e-10)
    assert region_area(region) == pytest.approx(3.0 * size**2, rel=1e-9)
    # The same of two rectangles, which share an edge's part.
    tall, low = ([[0, 0], [1, 0], [1, 2], [0, 2]], [[1, 0], [2, 0], [2, 1], [1, 1]])
    parts = [polygon_region(np.column_stack([size * np.array(part, dtype=float), np.ones(4)])) for part in (tall, low)]
    assert region_boundary(parts[0] | parts[1]) == pytest.approx(8.0 * size, rel=1e-7)


def test_of_polygons_by_their_edges():
    rng = np.random.default_rng(3)
    azimuth = np.linspace(0.0, 2.0 * math.pi, 40, endpoint=False)
    polar = rng.uniform(0.3, 1.2, 40)
    v = np.column_stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)])
    edges = np.arccos(np.sum(v * np.roll(v, -1, axis=0), axis=1)).sum()
    region = polygon_region(v)
    assert region_boundary(region) == pytest.approx(edges, rel=1e-12)
    # Cut up and tested on both sides, as combinations are.
    assert boundary_length(region.arcs, region.contains) == pytest.approx(edges, rel=1e-12)


def test_of_random_combinations_by_brute_force():
    rng = np.random.default_rng(0)
    for _ in range(6):
        a, b, c = (cap_region(random_directions(rng, 1)[0], rng.uniform(0.3, 2.2)) for _ in range(3))
        region = (a | b) - c
        length, steps = 0.0, 4000
        for part in (a, b, c):
            axis, angle = part.arcs.axes[0], float(part.arcs.angles[0])
            first = np.cross(axis, [0.6, 0.48, 0.64])
            first /= np.linalg.norm(first)
            t = 2.0 * math.pi * (np.arange(steps) + 0.5) / steps
            around = np.cos(t)[:, None] * first + np.sin(t)[:, None] * np.cross(axis, first)
            inner, outer = (
                region.contains(math.cos(x) * axis + math.sin(x) * around) for x in (angle - 1e-6, angle + 1e-6)
            )
            length += cap_boundary(angle) * float((inner != outer).mean())
        # Each arc that is found has two ends, each off by half a step at most.
        assert region_boundary(region) == pytest.approx(length, abs=12 * 2.0 * math.pi / steps)


def test_of_masks():
    mask = np.zeros((8, 16))
    mask[2:4, [15, 0, 1]] = 1.0  # across the seam
    circles = (math.sin(2 * math.pi / 8) + math.sin(4 * math.pi / 8)) * 3 * 2 * math.pi / 16
    assert region_boundary(mask_region(mask)) == pytest.approx(circles + 2 * 2 * math.pi / 8, rel=1e-14)
    assert region_boundary(~mask_region(mask)) == pytest.approx(circles + 2 * 2 * math.pi / 8, rel=1e-14)
    half = mask_region(np.repeat([[1], [0]], 4, axis=1))
    assert region_boundary(half) == pytest.approx(2.0 * math.pi, rel=1e-14)
    assert region_boundary(mask_region(np.ones((4, 6)))) == 0.0


@pytest.mark.parametrize("measure", [region_area, region_boundary])
def test_what_is_no_region(measure):
    with pytest.raises(UserError, match=r"must come from cap_region, polygon_region or mask_region, not 0\.5"):
        measure(0.5)
