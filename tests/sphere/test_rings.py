import math

import numpy as np
import pytest

from slepian_prt.sphere.harmonics import real_sh
from slepian_prt.sphere.regions import cap_region, mask_region, polygon_region
from slepian_prt.sphere.rings import Strip, spread_nodes
from slepian_prt.sphere.rotation import rotation_to
from tests.conftest import random_directions


def integrals(region, bandlimit):
    directions, weights = region.rule(bandlimit)
    assert (weights >= 0.0).all()
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0, atol=1e-15)
    return weights @ real_sh(bandlimit, directions)


def test_parts_add_up_in_every_harmonic(rng):
    # Each part is seen from another pole, so that nothing but the integrals is the same.
    octant = np.eye(3)
    middle = octant.sum(axis=0)
    whole = integrals(polygon_region(octant), 15)
    parts = [integrals(polygon_region([octant[i], octant[(i + 1) % 3], middle]), 15) for i in range(3)]
    np.testing.assert_allclose(sum(parts), whole, atol=2e-15)
    cap = cap_region(random_directions(rng, 1)[0], 0.4)
    outside, inside = (integrals(part, 15) for part in (polygon_region(octant) - cap, polygon_region(octant) & cap))
    np.testing.assert_allclose(outside + inside, whole, atol=1e-14)
    rest = integrals(~polygon_region(octant), 15)
    np.testing.assert_allclose(rest + whole, [math.sqrt(4 * math.pi)] + [0.0] * 255, atol=2e-14)


def test_corners_where_boundaries_cross():
    east, north = cap_region([1, 0, 0], math.pi / 3), cap_region([0, 1, 0], math.pi / 3)
    corners = (east | north).arcs.corners
    expected = [[0.5, 0.5, -math.sqrt(0.5)], [0.5, 0.5, math.sqrt(0.5)]]
    for corner in expected:
        assert np.linalg.norm(corners - corner, axis=1).min() < 1e-15
    np.testing.assert_allclose(np.abs(corners), np.abs(np.broadcast_to(expected[1], corners.shape)), atol=1e-15)
    octant = polygon_region(np.eye(3))
    crossing = (octant - cap_region([0, 0, 1], math.pi / 6)).arcs.corners
    for corner in ([0.5, 0, math.sqrt(0.75)], [0, 0.5, math.sqrt(0.75)]):
        assert np.linalg.norm(crossing - corner, axis=1).min() < 1e-15


def test_a_small_polygon_sees_a_harmonic_as_constant(rng):
    size, center = 1e-7, random_directions(rng, 1)[0]
    plane = size * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    region = polygon_region(np.column_stack([plane, np.ones(4)]) @ rotation_to(center).T)
    # Its mean over the square differs from the value at the centre by l (l + 1) size² / 6, the area by size².
    right = 4 * size**2 * real_sh(6, center[None])[0]
    np.testing.assert_allclose(integrals(region, 6), right, rtol=0, atol=4 * size**2 * 1e-7)


def test_masks_and_polygons_of_the_same_cell():
    # The cells between the meridians 0 and 90 degrees of the northern half are the octant.
    mask = np.zeros((6, 8))
    mask[:3, :2] = 1
    np.testing.assert_allclose(integrals(mask_region(mask), 12), integrals(polygon_region(np.eye(3)), 12), atol=2e-15)


@pytest.mark.parametrize("width", [1e-9, 1e-3, 0.4, 3.0, 6.28, 2 * math.pi])
def test_stretches_integrate_trigonometric_polynomials(width):
    degree = 30
    strip = Strip(np.array([1.0]), np.array([1.0]), np.array([[0.3]]), np.array([[width]]))
    _, azimuths, weights = spread_nodes([strip], degree)
    assert weights.sum() == pytest.approx(width, rel=1e-14)
    for m in (1, 7, degree):
        exact = 2 / m * math.sin(m * width / 2) * math.cos(m * (0.3 + width / 2))
        assert weights @ np.cos(m * azimuths) == pytest.approx(exact, rel=1e-13, abs=3e-15 * width)
    assert width > 1e-3 or azimuths.size <= 4
