import math

import mpmath
import numpy as np
import pytest

from slepian_prt.errors import UserError
from slepian_prt.sphere.harmonics import num_coefficients, orders, real_sh
from slepian_prt.sphere.hemispherical import h_basis, h_basis_in_sh, hemispherical_sh, sh_over_hemisphere
from slepian_prt.sphere.quadrature import cap_rule, gauss_legendre, sphere_rule
from tests.numerics import assert_rounded

HALF = math.pi / 2.0
EPSILON = float(np.finfo(np.float64).eps)


def mpmath_hsh(l: int, m: int, direction: np.ndarray) -> mpmath.mpf:
    """Gautron et al. 2004: √2 K cos(mφ) P_l^m(2 cos θ - 1) and the like, by the derivatives of P_l, in 60 digits."""
    with mpmath.workdps(60):
        x, y, z = (mpmath.mpf(float(c)) for c in direction)
        norm = mpmath.sqrt(x * x + y * y + z * z)
        x, y, z = x / norm, y / norm, z / norm
        a, t = abs(m), 2 * z - 1
        derivative = mpmath.mpf(0)
        for k in range((l - a) // 2 + 1):
            power = l - 2 * k - a
            falling = mpmath.factorial(l - 2 * k) / mpmath.factorial(power)
            derivative += (-1) ** k * mpmath.binomial(l, k) * mpmath.binomial(2 * l - 2 * k, l) * falling * t**power
        legendre = (-1) ** a * mpmath.sqrt(4 * z * (1 - z)) ** a * derivative / mpmath.mpf(2) ** l
        scale = mpmath.sqrt((2 * l + 1) / (2 * mpmath.pi) * mpmath.factorial(l - a) / mpmath.factorial(l + a))
        phi = mpmath.atan2(y, x)
        azimuthal = (
            mpmath.mpf(1) if m == 0 else mpmath.sqrt(2) * (mpmath.cos(m * phi) if m > 0 else mpmath.sin(a * phi))
        )
        return scale * legendre * azimuthal


@pytest.mark.parametrize("elevation", [1e-12, 1e-6, 1e-3, 0.4, 1.2, HALF - 1e-6, HALF - 1e-12])
def test_matches_mpmath_next_to_pole_and_horizon(elevation):
    direction = np.array(
        [math.cos(elevation) * math.cos(0.7), math.cos(elevation) * math.sin(0.7), math.sin(elevation)]
    )
    values = hemispherical_sh(60, direction)[0]
    largest = math.sqrt(121 / (2 * math.pi))
    chosen = [(l, m) for l in (0, 1, 2, 7, 33, 60) for m in sorted({-l, -(l // 2), -1, 0, 1, l // 3, l}) if abs(m) <= l]
    errors = [abs(float(mpmath_hsh(l, m, direction) - mpmath.mpf(float(values[l * l + l + m])))) for l, m in chosen]
    # A rounding of 2 cos θ - 1 next to an end changes P_l by up to l²/2 of it, and the recurrence adds as much.
    assert max(errors) <= 60**2 * EPSILON * largest


def hemisphere_rule(nodes: int, azimuths: int) -> tuple[np.ndarray, np.ndarray]:
    """Gauss's rule in √(cos θ), in which products of hemispherical and other functions are smooth."""
    rule = gauss_legendre(nodes)
    root, weights = 0.5 * (1.0 + rule.nodes), 0.5 * rule.weights
    z, phi = root**2, 2.0 * np.pi * np.arange(azimuths) / azimuths
    sine = np.sqrt((1.0 - z) * (1.0 + z))
    directions = np.stack(
        np.broadcast_arrays(np.outer(sine, np.cos(phi)), np.outer(sine, np.sin(phi)), z[:, None]), axis=-1
    )
    return directions.reshape(-1, 3), np.repeat(2.0 * root * weights * (2.0 * np.pi / azimuths), azimuths)


@pytest.mark.parametrize("bandlimit", [0, 3, 20])
def test_orthonormal_over_the_hemisphere(bandlimit):
    directions, weights = hemisphere_rule(2 * bandlimit + 2, 2 * bandlimit + 1)
    values = hemispherical_sh(bandlimit, directions)
    gram = (values * weights[:, None]).T @ values
    np.testing.assert_allclose(gram, np.eye(num_coefficients(bandlimit)), atol=1e-12)


def test_first_functions_in_closed_form(rng):
    directions = rng.normal(size=(50, 3))
    directions[:, 2] = np.abs(directions[:, 2])
    x, y, z = (directions / np.linalg.norm(directions, axis=1, keepdims=True)).T
    cos_phi, sin_phi = x / np.hypot(x, y), y / np.hypot(x, y)
    bent = 2.0 * np.sqrt(z * (1.0 - z)) * math.sqrt(1.5 / np.pi)
    expected = [np.full(50, 1.0 / math.sqrt(2.0 * np.pi)), -bent * sin_phi, math.sqrt(1.5 / np.pi) * (2 * z - 1)]
    expected = np.stack([*expected, -bent * cos_phi], axis=1)
    np.testing.assert_allclose(hemispherical_sh(1, directions), expected, atol=20 * EPSILON)


def test_high_degrees_are_finite_and_bounded():
    """By the addition theorem Σ_m h_lm² = (2l+1)/2π everywhere."""
    elevations = np.array([0.0, 1e-300, 1e-12, 0.3, HALF])
    directions = np.column_stack([np.cos(elevations), np.zeros(5), np.sin(elevations)])
    values = hemispherical_sh(500, directions)
    last = values[:, 500**2 :]
    np.testing.assert_allclose(np.sum(last**2, axis=1), 1001 / (2 * np.pi), rtol=500**2 * EPSILON)


def test_on_the_horizon_only_order_zero_is_left():
    values = hemispherical_sh(12, [[1, 0, 0], [0.3, -0.4, 0.0]])
    assert_rounded(values[:, orders(12) != 0], np.zeros((2, 156)), 12, size=1.0)
    assert np.all(np.abs(values[:, orders(12) == 0]) > 0.3)


@pytest.mark.parametrize("evaluate", [lambda d: hemispherical_sh(3, d), lambda d: h_basis(9, d)])
def test_the_horizon_is_as_wide_as_the_directions_are_rounded(evaluate):
    sides = np.array([[1.0, 0.0, -3e-8], [0.6, 0.8, 0.0]])
    on = evaluate(np.array([[1.0, 0.0, 0.0]]))
    assert_rounded(evaluate(sides[:1].astype(np.float32)), on, 9, size=2.0)
    with pytest.raises(UserError, match=r"directions\[0\] is below the horizon"):
        evaluate(sides)
    with pytest.raises(UserError, match=r"directions\[0\] is below the horizon"):
        evaluate(np.array([1.0, 0.0, -1.1e-6], dtype=np.float32))


def test_a_direction_turned_onto_the_horizon_counts():
    assert_rounded(hemispherical_sh(3, [1, 0, -2e-16]), hemispherical_sh(3, [1, 0, 0]), 4, size=1.0)


@pytest.mark.parametrize("count", [4, 6, 9])
def test_h_basis_is_orthonormal_over_the_hemisphere(count):
    directions, weights = cap_rule(4, HALF)
    values = h_basis(count, directions)
    assert_rounded((values * weights[:, None]).T @ values, np.eye(count), 45, size=4.0)


def test_h_basis_is_the_published_one():
    """Habel & Wimmer, Sec. 4.1: what takes coefficients of SH to the six functions; here with the phase of both."""
    directions, weights = cap_rule(4, HALF)
    matrix = (h_basis(6, directions) * weights[:, None]).T @ real_sh(2, directions)
    published = np.zeros((6, 9))
    published[[0, 1, 3, 4, 5], [0, 1, 3, 4, 8]] = math.sqrt(0.5)
    published[0, 2] = 0.5 * math.sqrt(1.5)
    published[2, 2], published[2, 6] = 0.5 * math.sqrt(0.5), 0.25 * math.sqrt(7.5)
    published[1, 5] = published[3, 7] = 0.375 * math.sqrt(2.5)
    assert_rounded(matrix, published, 45, size=2.0)


def test_h_basis_in_closed_form(rng):
    directions = rng.normal(size=(50, 3))
    directions[:, 2] = np.abs(directions[:, 2])
    x, y, z = (directions / np.linalg.norm(directions, axis=1, keepdims=True)).T
    s = math.sqrt(1.5 / np.pi)
    expected = [np.full(50, math.sqrt(0.5 / np.pi)), -s * y, s * (2 * z - 1), -s * x]
    expected += [math.sqrt(7.5 / np.pi) * x * y, 0.5 * math.sqrt(7.5 / np.pi) * (x * x - y * y)]
    np.testing.assert_allclose(h_basis(6, directions), np.stack(expected, axis=1), atol=40 * EPSILON)
    np.testing.assert_allclose(h_basis(4, directions), np.stack(expected[:4], axis=1), atol=40 * EPSILON)
    quadratic = math.sqrt(2.5 / np.pi) * (6 * z * z - 6 * z + 1)
    np.testing.assert_allclose(h_basis(9, directions)[:, 6], quadratic, atol=40 * EPSILON)


def test_nine_functions_are_all_polynomials_of_degree_two():
    """But not orthogonal over the sphere."""
    coefficients = h_basis_in_sh(9)
    assert np.linalg.cond(coefficients) < 30
    directions, weights = sphere_rule(4)
    values = real_sh(2, directions) @ coefficients.T
    gram = (values * weights[:, None]).T @ values
    assert_rounded(gram, coefficients @ coefficients.T, 45, size=300.0)
    assert np.abs(gram - np.diag(np.diag(gram))).max() > 1.0


@pytest.mark.parametrize("evaluate", [lambda d: hemispherical_sh(3, d), lambda d: h_basis(4, d)])
def test_below_the_horizon_is_told(evaluate):
    with pytest.raises(UserError, match=r"directions\[1\] is below the horizon, z = -0.6; give"):
        evaluate([[0, 0, 1], [0.8, 0, -0.6]])
    with pytest.raises(UserError, match=r"directions\[0\] must be finite and not zero"):
        evaluate([0, 0, 0])


@pytest.mark.parametrize("count", [0, 5, 16, True, "six", 4.5])
def test_other_counts_are_told(count):
    with pytest.raises(UserError, match="count must be 4, 6 or 9, not"):
        h_basis(count, [0, 0, 1])


@pytest.mark.parametrize(("bandlimit", "hemispherical"), [(0, 0), (10, 4), (3, 12), (20, 20)])
def test_integrals_of_both_kinds(bandlimit, hemispherical):
    directions, weights = hemisphere_rule(2 * (bandlimit + hemispherical) + 40, bandlimit + hemispherical + 2)
    expected = (real_sh(bandlimit, directions) * weights[:, None]).T @ hemispherical_sh(hemispherical, directions)
    np.testing.assert_allclose(sh_over_hemisphere(bandlimit, hemispherical), expected, atol=1e-13)


def test_integrals_of_the_first_functions():
    """∫ y_00 h_00 = √2/2, and y_10 = √(3/4π) z meets h_00 in √(3/4π) π/√(2π)."""
    integrals = sh_over_hemisphere(1, 1)
    assert integrals[0, 0] == pytest.approx(math.sqrt(0.5), rel=8 * EPSILON)
    assert integrals[2, 0] == pytest.approx(math.sqrt(0.75 / np.pi) * np.pi / math.sqrt(2.0 * np.pi), rel=8 * EPSILON)
