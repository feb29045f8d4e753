"""Partial occlusion in a hemispherical pit: ray-traced transport against integration over its open disk."""

import math

import numpy as np
import pytest

from scripts.paper.pit import exact_pit_transfer, pit_spectrum, traced_pit_transfer

AMBIENT = math.sqrt(4 * math.pi)


@pytest.mark.slow
@pytest.mark.parametrize("degrees", [10, 40])
def test_traced_transfer_is_exact_transfer(degrees):
    angles = np.linspace(0.0, math.radians(degrees), 21)
    exact = exact_pit_transfer(8, angles)
    # The quadrature converges exponentially, and half of the sky is seen from everywhere.
    np.testing.assert_allclose(exact, exact_pit_transfer(8, angles, 100), atol=1e-13)
    np.testing.assert_allclose(exact[:, 0] * AMBIENT, 0.5, atol=1e-12)
    traced = traced_pit_transfer(8, angles, 2048)
    # The rim has 90 corners, which makes its disk (2π/90)²/6 = 8e-4 smaller; sampling is averaged around the axis.
    assert np.linalg.norm(traced - exact) < 1.5e-3 * np.linalg.norm(exact)
    kept = pit_spectrum(exact, angles) > 1e-6
    np.testing.assert_allclose(pit_spectrum(traced, angles)[kept], pit_spectrum(exact, angles)[kept], rtol=0.02)
