import numpy as np
import pytest

from slepian_prt.evaluation.metrics import relative_rms, relative_square


def test_relative_square_by_hand():
    np.testing.assert_allclose(relative_square([1.0, 4.0], 16.0), [1 / 16, 1 / 4])
    np.testing.assert_allclose(relative_square([1.0, 4.0], 16.0, noise=0.3), [0.0, 0.25 - 0.09])
    assert relative_square([0.0, 1.0], 0.0).tolist() == [0.0, np.inf]


def test_noise_that_is_independent_of_the_difference_is_taken_off(rng):
    """‖v - r - n‖² has the mean ‖v - r‖² + ‖n‖²; over 3e5 numbers it is off by √(2/3e5) of its parts, four times."""
    reference = 1.0 + rng.random((100_000, 3))
    values = 1.1 * reference
    rms = np.sqrt(np.mean(reference**2))
    noisy = reference + 0.05 * rms * rng.normal(size=reference.shape)
    assert relative_rms(values, reference) == pytest.approx(0.1, rel=1e-12)
    assert relative_rms(values, noisy) == pytest.approx(np.hypot(0.1, 0.05), rel=0.01)
    assert relative_rms(values, noisy, noise=0.05) == pytest.approx(0.1, rel=0.015)
