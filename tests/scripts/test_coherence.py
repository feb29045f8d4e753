import numpy as np
import pytest

from scripts.paper.coherence import lasting_part, shared_by_neighbours, smoothed_error


def ring(count):
    a = np.arange(count)
    return np.column_stack([a, (a + 1) % count])


def smooth_vectors(count=4000):
    phase = 2.0 * np.pi * np.arange(count)[:, None] / count
    return np.cos(phase + np.arange(4)) + 2.0


def test_random_errors_of_smooth_vectors_fall_to_the_root_of_a_third(rng):
    """The mean of three has a third of the variance, and nothing of the signal is lost."""
    exact = smooth_vectors()
    noisy = exact + 0.1 * rng.normal(size=exact.shape)
    raw = np.linalg.norm(noisy - exact) / np.linalg.norm(exact)
    assert smoothed_error(noisy, exact, ring(4000), 1) / raw == pytest.approx(3.0**-0.5, abs=0.03)
    assert smoothed_error(noisy, exact, ring(4000), 2) < smoothed_error(noisy, exact, ring(4000), 1)


def test_errors_that_neighbours_share_stay():
    exact = smooth_vectors()
    off = exact + 0.1
    raw = np.linalg.norm(off - exact) / np.linalg.norm(exact)
    assert smoothed_error(off, exact, ring(4000), 1) == pytest.approx(raw, rel=0.01)


def test_smoothing_is_never_worse_than_leaving_it(rng):
    """Alternating signal: a gain of one is the best."""
    exact = np.tile([[1.0, 2.0, 3.0, 4.0], [-1.0, -2.0, -3.0, -4.0]], (50, 1))
    noisy = exact + 0.01 * rng.normal(size=exact.shape)
    raw = np.linalg.norm(noisy - exact) / np.linalg.norm(exact)
    assert smoothed_error(noisy, exact, ring(100), 1) <= raw * (1.0 + 1e-6)


def test_part_of_the_error_that_lasts(rng):
    """b + n of equal energy: a half lasts; n alone: nothing; b alone: all."""
    lasting = rng.normal(size=(3000, 4))
    noise = rng.normal(size=(3, 3000, 4))
    assert lasting_part(list(lasting + noise)) == pytest.approx(0.5, abs=0.05)
    assert lasting_part(list(noise)) == pytest.approx(0.0, abs=0.05)
    assert lasting_part([lasting] * 3) == pytest.approx(1.0, abs=1e-12)


def test_what_neighbours_share(rng):
    noise = rng.normal(size=(4000, 4))
    assert shared_by_neighbours(noise, ring(4000)) == pytest.approx(0.0, abs=0.05)
    assert shared_by_neighbours(smooth_vectors(), ring(4000)) == pytest.approx(1.0, abs=1e-4)
    both = noise + np.roll(noise, 1, axis=0)
    assert shared_by_neighbours(both, ring(4000)) == pytest.approx(0.5, abs=0.05)
