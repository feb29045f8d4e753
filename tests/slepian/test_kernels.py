import math

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import eval_legendre

from slepian_prt.errors import UserError
from slepian_prt.slepian.kernels import cosine_lobe, measured_moment, zonal_coefficients, zonal_moment


def test_clamped_cosine():
    np.testing.assert_allclose(cosine_lobe(6), [1, 2 / 3, 1 / 4, 0, -1 / 24, 0, 1 / 64], atol=1e-16)


@pytest.mark.parametrize("exponent", [1.0, 2.5, 16.0, 128.0])
def test_lobe_against_quadrature(exponent):
    lobe = cosine_lobe(20, exponent)
    for l in (0, 1, 2, 5, 12, 20):
        # x = u² smooths the fractional power at 0, which quadrature would otherwise resolve to 1e-11 only.
        exact, _ = quad(
            lambda u, l=l: 2 * u ** (2 * exponent + 1) * eval_legendre(l, u * u), 0, 1, epsabs=1e-13, limit=200
        )
        assert lobe[l] == pytest.approx((exponent + 1) * exact, abs=1e-12)


def test_zonal_coefficients_of_a_given_lobe():
    ours = zonal_coefficients(12, lambda x: np.maximum(x, 0.0) ** 9 * 10 / (2 * math.pi))
    np.testing.assert_allclose(ours, cosine_lobe(12, 9.0), atol=1e-13)


def test_moment_energy(rng):
    vectors = rng.normal(size=(7, 36))
    assert measured_moment(vectors).energy == pytest.approx((vectors**2).sum(axis=1).mean(), rel=1e-13)
    zonal = cosine_lobe(5)
    assert zonal_moment(zonal).energy == pytest.approx((zonal**2 * (2 * np.arange(6) + 1)).sum() / (4 * math.pi))


@pytest.mark.parametrize("exponent", [0.0, -1.0, float("nan"), float("inf"), None, "2", True])
def test_bad_exponent(exponent):
    with pytest.raises(UserError, match=r"exponent must be a number in \(0, inf\), not"):
        cosine_lobe(3, exponent)


@pytest.mark.parametrize("shape", [(0, 9), (3, 8), (9,)])
def test_bad_pilot(shape):
    with pytest.raises(ValueError, match="local_vectors"):
        measured_moment(np.zeros(shape))
