"""The paper's error identity: both sides agree, and each with an independent sum."""

import math
import re

import numpy as np
import pytest

from slepian_prt.errors import UserError
from slepian_prt.evaluation.error_identity import IdentityRow, measure_identity
from slepian_prt.slepian.kernels import cosine_lobe

ANGLE = math.radians(40)


@pytest.mark.parametrize("kernel", [None, cosine_lobe(8), cosine_lobe(8, 64.0)], ids=["slepian", "diffuse", "phong"])
@pytest.mark.parametrize("radial", [False, True])
@pytest.mark.parametrize("half_angle", [0.2, ANGLE, 2.2])
def test_both_sides_agree(kernel, radial, half_angle):
    terms = [0, 1, 2] if radial else [0, 1, 4, 9]
    rows = measure_identity(8, half_angle, terms, kernel=kernel, radially_symmetric=radial)
    assert [row.terms for row in rows] == terms
    errors = [row.quadrature for row in rows]
    assert errors == sorted(errors, reverse=True)
    for row in rows:
        # B and B̃ are rounded to some ε of the signal: what is left of a difference keeps that of the first row.
        rounding = 100 * np.finfo(float).eps * math.sqrt(rows[0].identity * row.identity) + 1e-28 * rows[0].identity
        assert row.quadrature == pytest.approx(row.identity, rel=1e-12, abs=rounding)


@pytest.mark.parametrize("radial", [False, True])
@pytest.mark.parametrize(("bandlimit", "degrees"), [(5, 1e-5), (5, 1e-3), (10, 0.1), (20, 1.0)])
def test_how_far_small_caps_differ(bandlimit, degrees, radial):
    # The docstring's bound, which the guide repeats.
    first, *others = measure_identity(bandlimit, math.radians(degrees), [0, 1, 2], radially_symmetric=radial)
    assert first.difference < 5e-13
    for row in others:
        assert row.difference < 5e-13 * math.sqrt(first.identity / row.identity)


def test_error_of_nothing_is_the_signals_energy():
    # K = 0 over nearly the whole sphere: Σ b², which is a sum of M squared normal numbers.
    (row,) = measure_identity(8, math.pi, [0])
    assert row.identity == pytest.approx(np.sum(np.random.default_rng(0).standard_normal(81) ** 2), rel=1e-12)
    assert row.quadrature == pytest.approx(row.identity, rel=1e-12)


def test_error_of_transport_by_random_light():
    # Averaged over lights, |U| Σ λ_i is ∫_U Σ t² dn = |U| Σ (2l+1) t_l²/4π: the energy of a transfer vector.
    kernel = cosine_lobe(5)
    energy = float(np.sum((2 * np.arange(6) + 1) * kernel**2)) / (4 * math.pi) * 2 * math.pi * (1 - math.cos(ANGLE))
    errors = [measure_identity(5, ANGLE, [0], kernel=kernel, seed=seed)[0].quadrature for seed in range(200)]
    assert np.mean(errors) == pytest.approx(energy, abs=4 * np.std(errors) / math.sqrt(200))


def test_signals_differ_by_their_seed():
    first, again, other = (measure_identity(4, ANGLE, [2], seed=seed)[0] for seed in (1, 1, 2))
    assert first == again
    assert first != other


def test_difference_without_an_error():
    assert IdentityRow(3, 0.0, 0.0).difference == 0.0
    assert IdentityRow(3, 1.1, 1.0).difference == pytest.approx(0.1)
    assert IdentityRow(3, 1e-30, 0.0).difference == math.inf  # relative to nothing


def test_what_cannot_be_checked():
    with pytest.raises(UserError, match="half_angle must be above 0 for the error to be checked"):
        measure_identity(4, 0.0, [0])
    with pytest.raises(UserError, match=r"bandlimit must be at most 50 for the error to be checked, .*, not 51"):
        measure_identity(51, 0.5, [0])
    for terms in ([], 3, 1.5, "12", None, np.zeros(0), np.array(3)):
        with pytest.raises(UserError, match="terms must be a list of numbers of functions"):
            measure_identity(4, 0.5, terms)
    for bad in (-1, 26, 1.5, True, "1", [1]):
        with pytest.raises(UserError, match=rf"terms\[1\] must be an integer in \[0, 25\], not {re.escape(repr(bad))}"):
            measure_identity(4, 0.5, [0, bad])
    with pytest.raises(UserError, match=r"terms\[0\] must be an integer in \[0, 5\], not 6"):
        measure_identity(4, 0.5, np.array([6]), radially_symmetric=True)
    for seed in (-1, 0.5, None):
        with pytest.raises(UserError, match="seed must be a non-negative integer"):
            measure_identity(4, 0.5, [0], seed=seed)
    with pytest.raises(UserError, match="kernel must hold 5"):
        measure_identity(4, 0.5, [0], kernel=cosine_lobe(3))
