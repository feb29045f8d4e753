import math

import numpy as np
import pytest

from slepian_prt.slepian.concentration import cap_basis
from slepian_prt.slepian.shannon import (
    _curvature_term,
    concentration_count,
    generalized_shannon_number,
    refined_shannon_number,
    shannon_number,
)

GRID = [(l, t) for l in (2, 5, 10, 20, 50, 100) for t in (5, 10, 20, 30, 60, 90)]
EPSILONS = (0.5, 0.1, 0.01, 0.001)


@pytest.fixture(scope="module")
def errors():
    """Relative errors of the estimates on the grid of the design, with N of each case."""
    rows = []
    for bandlimit, degrees in GRID:
        half_angle = math.radians(degrees)
        values = cap_basis(bandlimit, half_angle).eigenvalues
        for epsilon in EPSILONS:
            exact = int((values > epsilon).sum())
            if exact == 0:
                continue
            n = shannon_number(bandlimit, half_angle)
            n_g = generalized_shannon_number(bandlimit, half_angle, epsilon)
            natural = generalized_shannon_number(bandlimit, half_angle, epsilon, log_base=math.e)
            n_ref = refined_shannon_number(bandlimit, half_angle, epsilon)
            rows.append([n, *(abs(x / exact - 1) for x in (n, n_g, natural, n_ref))])
    return np.array(rows)


def test_refined_number_is_within_five_percent(errors):
    assert errors[errors[:, 0] >= 10, 4].mean() <= 0.05


def test_base_ten_is_the_reading_of_the_paper_that_fits(errors):
    large = errors[:, 0] >= 10
    assert errors[large, 2].mean() <= 0.5 * errors[large, 1].mean()  # better than N alone
    assert errors[large, 2].mean() <= 0.2 * errors[large, 3].mean()  # than natural logarithms


@pytest.mark.parametrize(
    ("bandlimit", "degrees", "epsilon", "count"),
    [(5, 20, 0.01, 5), (10, 30, 0.01, 19), (20, 60, 0.001, 171), (50, 20, 0.1, 98), (100, 60, 0.01, 2807)],
)
def test_exact_counts_of_the_design(bandlimit, degrees, epsilon, count):
    assert concentration_count(bandlimit, math.radians(degrees), epsilon) == count


def test_radially_symmetric_number():
    # C/4π = (L+1)Θ/π counts the functions of order 0 (Wieczorek & Simons 2005).
    for bandlimit, half_angle in ((40, 0.5), (100, 1.0)):
        count = concentration_count(bandlimit, half_angle, 0.5, radially_symmetric=True)
        number = generalized_shannon_number(bandlimit, half_angle, 0.5, radially_symmetric=True)
        assert abs(number - count) <= 1


def test_limits():
    for epsilon in EPSILONS:
        assert generalized_shannon_number(10, 0.0, epsilon) == 0.0
        assert refined_shannon_number(10, 0.0, epsilon) == 0.0
        assert concentration_count(10, 0.0, epsilon) == 0
        assert generalized_shannon_number(10, math.pi, epsilon) == 121.0
        assert refined_shannon_number(10, math.pi, epsilon) == 121.0
        assert concentration_count(10, math.pi, epsilon) == 121
    assert shannon_number(10, math.pi) == 121.0


def test_numbers_stay_within_the_dimension():
    for half_angle in np.linspace(0, math.pi, 41):
        for epsilon in (1e-12, 0.01, 0.5, 0.99):
            for bandlimit in (0, 1, 8):
                for number in (generalized_shannon_number, refined_shannon_number):
                    assert 0.0 <= number(bandlimit, half_angle, epsilon) <= (bandlimit + 1) ** 2


def test_curvature_term_is_continuous_where_its_logarithms_diverge():
    assert _curvature_term(math.pi / 2) == pytest.approx(1 - math.log(2), abs=1e-12)
    assert _curvature_term(math.pi / 2 - 1e-6) == pytest.approx(1 - math.log(2), abs=1e-5)
    direct = 1 - math.log(math.cos(1.1)) - math.atanh(math.sin(1.1)) / math.sin(1.1)
    assert _curvature_term(1.1) == pytest.approx(direct, rel=1e-12)
    assert _curvature_term(1e-4 * 1.0001) == pytest.approx(_curvature_term(1e-4 * 0.9999), rel=1e-3)


@pytest.mark.parametrize("epsilon", [0.0, 1.0, -0.1, float("nan"), "x"])
def test_bad_epsilon(epsilon):
    for number in (generalized_shannon_number, refined_shannon_number, concentration_count):
        with pytest.raises(ValueError, match=r"epsilon must be a number in \(0, 1\)"):
            number(5, 0.3, epsilon)
