import math

import mpmath
import numpy as np
import pytest

from slepian_prt.sphere.harmonics import num_coefficients, real_sh
from slepian_prt.sphere.quadrature import (
    cap_nodes,
    cap_rule,
    gauss_legendre,
    hemisphere_fibonacci,
    sphere_rule,
    spherical_fibonacci,
)


def exact_node_and_weight(n: int, start: float) -> tuple[mpmath.mpf, mpmath.mpf]:
    """Newton's method at 40 digits with the three-term recurrence."""
    x = mpmath.mpf(start)
    for _ in range(6):
        p0, p1 = mpmath.mpf(1), x
        for k in range(2, n + 1):
            p0, p1 = p1, ((2 * k - 1) * x * p1 - (k - 1) * p0) / k
        slope = n * (x * p1 - p0) / (x * x - 1)
        x -= p1 / slope
    return x, 2 / ((1 - x * x) * slope * slope)


@pytest.mark.parametrize("n", [2, 3, 20, 101, 500])
def test_gauss_legendre_is_good_to_rounding(n):
    rule = gauss_legendre(n)
    with mpmath.workdps(40):
        for i in {0, 1, n // 4, n // 2, n - 2, n - 1} - {-1}:
            x, w = exact_node_and_weight(n, float(rule.nodes[i]))
            assert abs(x - mpmath.mpf(float(rule.nodes[i]))) <= 2.3e-16
            assert abs(w / mpmath.mpf(float(rule.weights[i])) - 1) <= 1e-14
            complement = mpmath.mpf(float(rule.complement[i]))
            assert abs((1 - abs(x)) / complement - 1) <= 1e-14 or i == n // 2


@pytest.mark.parametrize("n", [1, 2, 7, 64, 333])
def test_gauss_legendre_is_exact_for_polynomials(n):
    rule = gauss_legendre(n)
    assert (np.diff(rule.nodes) > 0).all()
    for degree in {0, 2 * (n // 2), 2 * n - 2}:
        assert rule.weights @ rule.nodes**degree == pytest.approx(2 / (degree + 1), rel=1e-13)
    assert abs(rule.weights @ rule.nodes ** (2 * n - 1)) <= 1e-15


@pytest.mark.parametrize("half_angle", [1e-8, 1e-3, 0.7, math.pi / 2, 3.0, math.pi])
def test_cap_weights_do_not_cancel(half_angle):
    area = 2 * math.pi * cap_nodes(9, half_angle).weights.sum()
    exact = mpmath.mpf(4) * mpmath.pi * mpmath.sin(mpmath.mpf(half_angle) / 2) ** 2
    assert abs(area / float(exact) - 1) <= 2e-15
    rest = 2 * math.pi * cap_nodes(9, half_angle, complement=True).weights.sum()
    exact = mpmath.mpf(4) * mpmath.pi * mpmath.cos(mpmath.mpf(half_angle) / 2) ** 2
    assert abs(rest - float(exact)) <= 2e-15 * 4 * math.pi


def test_cap_rule_is_exact_for_products():
    # Σ over a cap and over its complement of y y' must give the identity on the sphere.
    center, half_angle, bandlimit = [0.3, -0.5, 0.2], 0.8, 9
    total = np.zeros((num_coefficients(bandlimit),) * 2)
    for c, angle in ((center, half_angle), ([-x for x in center], math.pi - half_angle)):
        directions, weights = cap_rule(2 * bandlimit, angle, c)
        y = real_sh(bandlimit, directions)
        total += (y * weights[:, None]).T @ y
    np.testing.assert_allclose(total, np.eye(len(total)), atol=1e-13)


def test_sphere_rule_area():
    assert sphere_rule(0)[1].sum() == pytest.approx(4 * math.pi, rel=1e-15)


@pytest.mark.parametrize("n", [1, 2, 100, 4096])
def test_direction_sets_are_unit_and_uniform(n):
    for d in (spherical_fibonacci(n), hemisphere_fibonacci(n)):
        np.testing.assert_allclose(np.linalg.norm(d, axis=1), 1.0, atol=1e-15)
    if n >= 100:
        # Every direction stands for 4π/n: the largest empty cap is not much wider than that of a hexagonal grid.
        nearest = (spherical_fibonacci(n) @ sphere_rule(60)[0].T).max(axis=0)
        assert np.arccos(np.clip(nearest, -1, 1)).max() <= 2.2 * math.sqrt(4 / n)


def test_hemisphere_set_integrates_the_cosine_lobe():
    # (1/π) ∫ (ω_z)₊ ω_z² dω = 1/2, and 0 for the tangential components.
    d = hemisphere_fibonacci(2048)
    assert (d[:, 2] > 0).all()
    assert np.mean(d[:, 2] ** 2) == pytest.approx(0.5, abs=1e-6)
    np.testing.assert_allclose(d[:, :2].mean(axis=0), 0.0, atol=1e-3)


@pytest.mark.parametrize("n", [0, -3, 2.5])
def test_bad_count(n):
    with pytest.raises(ValueError, match="n must be a positive integer"):
        gauss_legendre(n)
