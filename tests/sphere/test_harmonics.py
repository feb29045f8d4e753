import mpmath
import numpy as np
import pytest
from scipy.special import sph_harm_y_all

from slepian_prt.sphere.harmonics import degrees, legendre_polynomials, num_coefficients, orders, real_sh
from slepian_prt.sphere.quadrature import sphere_rule
from tests.conftest import random_directions
from tests.numerics import assert_rounded


def mpmath_real_sh(l: int, m: int, direction: np.ndarray) -> mpmath.mpf:
    """Real SH by the explicit sum for the associated Legendre function, from the exact float64 direction."""
    with mpmath.workdps(60):
        x, y, z = (mpmath.mpf(float(c)) for c in direction)
        norm = mpmath.sqrt(x * x + y * y + z * z)
        x, y, z = x / norm, y / norm, z / norm
        a = abs(m)
        # d^a/dz^a P_l(z), from P_l = 2^-l Σ_k (-1)^k C(l,k) C(2l-2k,l) z^(l-2k)
        total = mpmath.mpf(0)
        for k in range((l - a) // 2 + 1):
            power = l - 2 * k - a
            falling = mpmath.factorial(l - 2 * k) / mpmath.factorial(power)
            total += (-1) ** k * mpmath.binomial(l, k) * mpmath.binomial(2 * l - 2 * k, l) * falling * z**power
        total /= mpmath.mpf(2) ** l
        scale = mpmath.sqrt((2 * l + 1) / (4 * mpmath.pi) * mpmath.factorial(l - a) / mpmath.factorial(l + a))
        azimuthal = mpmath.mpc(x, y) ** a
        part = azimuthal.real if m >= 0 else azimuthal.imag
        return (-1) ** a * (mpmath.sqrt(2) if m else 1) * scale * total * part


@pytest.mark.parametrize("tilt", [0.0, 1e-9, 1e-4, 0.3, 1.5707963, 2.9, 3.141592652589793])
def test_matches_mpmath_at_bandlimit_100(tilt):
    direction = np.array([np.sin(tilt) * np.cos(0.7), np.sin(tilt) * np.sin(0.7), np.cos(tilt)])
    values = real_sh(100, direction)[0]
    largest = np.sqrt(201 / (4 * np.pi))
    chosen = [
        (l, m) for l in (0, 1, 2, 7, 50, 99, 100) for m in sorted({-l, -l // 2, -1, 0, 1, l // 3, l}) if abs(m) <= l
    ]
    errors = [abs(float(mpmath_real_sh(l, m, direction) - mpmath.mpf(float(values[l * l + l + m])))) for l, m in chosen]
    assert max(errors) <= 2e-12 * largest


def test_matches_scipy(rng):
    d = random_directions(rng, 300)
    l, m = degrees(20), orders(20)
    reference = sph_harm_y_all(20, 20, np.arccos(d[:, 2]), np.arctan2(d[:, 1], d[:, 0]))
    parts = np.where(m == 0, 1.0, np.sqrt(2.0)) * np.where(
        m >= 0, reference[l, np.abs(m)].T.real, reference[l, np.abs(m)].T.imag
    )
    # scipy's own argument arccos(z) costs it 1e-13 away from the poles.
    np.testing.assert_allclose(real_sh(20, d), parts, atol=5e-12, rtol=0)


def test_matches_drjit(rng):
    from slepian_prt.renderer.variants import mitsuba

    d = random_directions(rng, 50).astype(np.float32)
    with mitsuba() as mi:
        import drjit as dr

        values = dr.sh_eval(mi.Vector3f(d.T), 9)
        reference = np.stack([np.broadcast_to(np.array(value), 50) for value in values], axis=1)
    np.testing.assert_allclose(real_sh(9, d), reference, atol=5e-6, rtol=0)  # drjit evaluates in float32


@pytest.mark.parametrize("bandlimit", [0, 1, 5, 40])
def test_orthonormal(bandlimit):
    directions, weights = sphere_rule(2 * bandlimit)
    y = real_sh(bandlimit, directions)
    np.testing.assert_allclose((y * weights[:, None]).T @ y, np.eye(num_coefficients(bandlimit)), atol=1e-13)


def test_large_bandlimit_near_the_pole_is_finite():
    directions = [[1e-9, 0, 1], [0, -1e-300, -1], [0, 0, 1], [1e-160, 1e-160, -1]]
    values = real_sh(1000, directions)
    assert np.isfinite(values).all()
    # Σ_m y_lm² = (2l+1)/4π in every direction (addition theorem).
    np.testing.assert_allclose((values**2).sum(axis=1), 1001**2 / (4 * np.pi), rtol=1e-11)


def test_length_of_the_direction_does_not_matter():
    np.testing.assert_allclose(real_sh(6, [[3e200, -4e200, 1e199]]), real_sh(6, [[3.0, -4.0, 0.1]]), atol=1e-14)
    np.testing.assert_allclose(real_sh(6, [[3e-200, -4e-200, 1e-201]]), real_sh(6, [[3.0, -4.0, 0.1]]), atol=1e-14)


def test_chunks_agree(rng):
    d = random_directions(rng, 1300)
    assert_rounded(real_sh(7, d)[600:700], real_sh(7, d[600:700]), terms=3 * 8)  # three products in each step up


def test_low_part_of_the_cosine_counts():
    # 1e-9 is large enough to be added to the cosine itself, which must give the same.
    z, low = np.array([0.5]), np.array([1e-9])
    exact = legendre_polynomials(30, 2, z + low)
    np.testing.assert_allclose(legendre_polynomials(30, 2, z, low), exact, rtol=1e-13)
    assert np.abs(legendre_polynomials(30, 2, z) / exact - 1.0).max() > 1e-9


@pytest.mark.parametrize("bandlimit", [-1, 1.5, "3", None, True, 1001])
def test_bad_bandlimit(bandlimit):
    with pytest.raises(ValueError, match=r"bandlimit must be an integer in \[0, 1000\]"):
        real_sh(bandlimit, [0, 0, 1])


@pytest.mark.parametrize("direction", [[0, 0, 0], [np.nan, 0, 1], [np.inf, 0, 0]])
def test_bad_direction(direction):
    with pytest.raises(ValueError, match=r"directions\[1\] must be finite and not zero"):
        real_sh(3, [[0, 0, 1], direction])


def test_bad_shape():
    with pytest.raises(ValueError, match=r"directions must have shape \(n, 3\), not \(2, 4\)"):
        real_sh(3, np.ones((2, 4)))
