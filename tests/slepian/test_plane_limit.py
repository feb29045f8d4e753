"""Concentrations on the line and the disc against prolate functions, closed forms, and the sphere's small caps."""

import math
from itertools import pairwise

import mpmath
import numpy as np
import pytest
from scipy.special import jv, pro_rad1

from slepian_prt.errors import UserError
from slepian_prt.slepian.concentration import cap_basis
from slepian_prt.slepian.plane_limit import disc_concentrations, line_concentrations, line_number
from tests.numerics import assert_exact


@pytest.mark.parametrize("product", [0.1, 1.0, 4.0, 12.0])
def test_line_against_prolate_functions(product):
    # λ = (2c/π) R₀ₙ(c, 1)², whose radial functions SciPy has for x > 1.
    values = line_concentrations(product)
    radial = [pro_rad1(0, n, product, 1.0 + 1e-12)[0] for n in range(6)]
    # SciPy's x is not 1, and of the singular value 3e-11 of the last function at c = 0.1 eight digits are left.
    np.testing.assert_allclose(values[:6], [2.0 * product / math.pi * r**2 for r in radial], rtol=1e-8)


@pytest.mark.parametrize("product", [0.01, 3.0, 40.0, 100.0])
def test_sum_on_the_line_is_its_shannon_number(product):
    values = line_concentrations(product)
    assert values.sum() == pytest.approx(2.0 * product / math.pi, rel=1e-13)
    assert np.all(np.diff(values) <= 0.0)
    assert values[0] <= 1.0


def test_smallest_concentrations_keep_their_digits():
    # c → 0: λ_n = (2c/π) [(4c)^n (n!)³/((2n)! (2n+1)!)]² (1 + O(c²)) (Slepian & Pollak 1961).
    product = 1e-3
    for n in (0, 1, 2, 3):
        f = math.factorial
        leading = product**n * 4**n * f(n) ** 3 / (f(2 * n) * f(2 * n + 1))
        assert line_concentrations(product)[n] == pytest.approx(2 * product / math.pi * leading**2, rel=1e-5)


@pytest.mark.parametrize("product", [20.0, 100.0, 200.0])
def test_slepians_count_on_the_line(product):
    values = line_concentrations(product)
    for epsilon in (0.5, 0.1, 0.01):
        assert line_number(product, epsilon) == pytest.approx(int((values > epsilon).sum()), abs=1.0)
    # The readings of C̃ that Eq. 5 leaves open are off by many: c, and the whole band times the whole interval.
    count = int((values > 0.5).sum())
    assert abs(line_number(product / 2.0, 0.5) - count) > 5.0
    assert abs(line_number(2.0 * product, 0.5) - count) > 5.0


@pytest.mark.parametrize("product", [0.5, 3.0, 12.0])
def test_traces_on_the_disc(product):
    found = disc_concentrations(product, threshold=1e-14)
    # Area times area of the band over (2π)².
    assert found.eigenvalues.sum() == pytest.approx(product**2 / 4.0, rel=1e-10)
    # Of each order alone: ∫₀¹ c² ∫₀¹ J_m(c r s)² r s dr ds, by another rule.
    x, w = np.polynomial.legendre.leggauss(80)
    r, w = 0.5 * (1 + x), 0.5 * w
    for m in (0, 1, 3):
        kernel = (product * jv(m, product * np.outer(r, r))) ** 2 * np.outer(r * w, r * w)
        for order in {m, -m}:
            assert found.eigenvalues[found.orders == order].sum() == pytest.approx(kernel.sum(), abs=1e-12)


def test_small_disc_has_one_function():
    # c → 0: the first concentration is that of a constant, c²/4 (1 - c²/8 …).
    assert disc_concentrations(0.01).eigenvalues[0] == pytest.approx(0.01**2 / 4.0, rel=2e-5)


def test_orders_of_the_disc():
    found = disc_concentrations(5.0)
    assert_exact(found.orders[:5], [0, 1, -1, 2, -2], because="integers")
    for m in range(1, 4):
        pair = [found.eigenvalues[found.orders == order] for order in (m, -m)]
        assert_exact(pair[0], pair[1], because="the same numbers")


@pytest.mark.parametrize("product", [2.0, 6.0])
def test_caps_tend_to_the_disc(product):
    """Simons, Dahlen & Wieczorek 2006: the sphere's problem becomes the plane's as Θ → 0 with (L+1)Θ = c, by Θ²."""
    plane = disc_concentrations(product)
    errors = []
    for bandlimit in (20, 40, 80):
        cap = cap_basis(bandlimit, product / (bandlimit + 1))
        assert_exact(np.abs(cap.orders[:6]), np.abs(plane.orders[:6]), because="integers")
        shown = min(len(cap), plane.eigenvalues.size)
        errors.append(np.abs(cap.eigenvalues[:shown] - plane.eigenvalues[:shown]).max())
    for error, half in pairwise(errors):
        assert half == pytest.approx(error / 4.0, rel=0.1)
    assert errors[-1] < 1e-3


@pytest.mark.parametrize("product", [0.01, 1.0, 5.0, 50.0])
def test_none_of_the_smallest_is_rounding(product):
    # Of one order, or parity, each is far below the one before, where rounding is of one size.
    disc = disc_concentrations(product, threshold=1e-30 * (1 + 2 * product))
    line = line_concentrations(product)
    series = [disc.eigenvalues[disc.orders == m] for m in range(disc.orders.max() + 1)] + [line[::2], line[1::2]]
    for values in series:
        small = values[values < 1e-15]
        assert np.all(small[1:] <= 0.1 * small[:-1])


def test_digits_of_small_concentrations_on_the_line():
    # The errors that the docstring tells, against the same transform in 50 digits.
    with mpmath.workdps(50):
        nodes, weights = zip(*mpmath.calculus.quadrature.GaussLegendre(mpmath.mp).calc_nodes(4, 170), strict=True)
        x, w = [(1 + t) / 2 for t in nodes], [t / 2 for t in weights]
        even = mpmath.matrix(len(x))
        for i in range(len(x)):
            for j in range(len(x)):
                even[i, j] = mpmath.sqrt(2 * w[i] * w[j] / mpmath.pi) * mpmath.cos(x[i] * x[j])
        exact = sorted((float(t**2) for t in mpmath.eigsy(even, eigvals_only=True)), reverse=True)
    found = line_concentrations(1.0)[::2]
    for value, reference in zip(found, exact, strict=False):
        assert value == pytest.approx(reference, rel=4e-16 + 5e-17 / math.sqrt(reference), abs=0.0)


@pytest.mark.parametrize("epsilon", [1e-320, 1e-10, 0.01, 0.5, 0.99])
def test_estimate_on_a_short_line_is_not_negative(epsilon):
    for product in (1e-300, 0.01, 0.3):
        assert line_number(product, epsilon) == pytest.approx(2.0 * product / math.pi, rel=1e-15)
    assert line_number(0.6, 1e-320) > line_number(0.6, 0.5) == pytest.approx(1.2 / math.pi, rel=1e-15)
    assert line_number(5.0, 1.0 - 1e-12) == 0.0


@pytest.mark.parametrize("product", [0.0, -1.0, 501.0, math.nan, "x", None, True, "1"])
@pytest.mark.parametrize("solve", [line_concentrations, disc_concentrations, lambda c: line_number(c, 0.5)])
def test_bad_products(solve, product):
    with pytest.raises(UserError, match=r"product must be a number in \(0, 500\], the bandlimit times the radius, not"):
        solve(product)


def test_bad_thresholds():
    for threshold in (0.0, 1e-33, 1.0, math.nan, "x", True):
        with pytest.raises(UserError, match=r"threshold must be a number in \[1.1e-29, 1\), above rounding, not"):
            disc_concentrations(5.0, threshold=threshold)
    with pytest.raises(UserError, match="epsilon must be a number in"):
        line_number(1.0, 1.0)
