"""Smoothing of vectors with known truth and noise: what stays, what goes, and that it is never for the worse."""

import tracemalloc
from itertools import pairwise

import numpy as np
import pytest

from slepian_prt.errors import UserError
from slepian_prt.sphere.harmonics import real_sh
from slepian_prt.transport import smoothing
from slepian_prt.transport.smoothing import (
    BANDS,
    across_seams,
    calibrate_variance,
    mean_over_neighbours,
    relative_noise,
    smooth,
    surface_guides,
    variance_of_halves,
    variance_of_paths,
)
from tests.numerics import assert_exact, assert_rounded

SIDE = 48
RINGS = sum(times for _, times in BANDS)


def torus(side: int = SIDE) -> np.ndarray:
    """Pairs of a square grid whose borders meet."""
    index = np.arange(side * side).reshape(side, side)
    right, below = np.roll(index, -1, axis=1), np.roll(index, -1, axis=0)
    return np.concatenate([np.stack([index.ravel(), other.ravel()], axis=1) for other in (right, below)])


def strip(count: int) -> np.ndarray:
    """Pairs of receivers in a row."""
    return np.stack([np.arange(count - 1), np.arange(1, count)], axis=1)


def noisy(truth: np.ndarray, deviation: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Vectors (V, 1, M) with white noise, and its variance (V, 1, L+1)."""
    noise = np.random.default_rng(seed).normal(0.0, deviation, truth.shape)
    return (truth + noise).astype(np.float32), np.full((*truth.shape[:2], round(truth.shape[2] ** 0.5)), deviation**2)


def mean_square(values: np.ndarray) -> float:
    return float(np.mean(np.square(values, dtype=np.float64)))


def eigenvalues(side: int = SIDE) -> np.ndarray:
    """Of the mean over a receiver and its four neighbours on the torus, one for each frequency."""
    cosine = np.cos(2.0 * np.pi * np.arange(side) / side)
    return (1.0 + 2.0 * cosine[:, None] + 2.0 * cosine[None, :]) / 5.0


def band_operators(eigenvalue: np.ndarray) -> list[np.ndarray]:
    """Transfer functions of the bands, and of what no band takes."""
    ends = np.cumsum([0] + [times for _, times in BANDS])
    between = [eigenvalue**a - eigenvalue**b for a, b in pairwise(ends)]
    return [*between, eigenvalue**RINGS]


def smooth_field(spectrum: np.ndarray, orders: int, seed: int) -> np.ndarray:
    """(V, 1, orders) Gaussian random fields on the torus with that power in each frequency."""
    white = np.random.default_rng(seed).normal(size=(orders, *spectrum.shape))
    fields = np.fft.ifft2(np.fft.fft2(white) * np.sqrt(spectrum)).real
    return fields.reshape(orders, -1).T[:, None, :]


# --- The mean --------------------------------------------------------------------------------------------------------


def test_weights_are_those_of_metropolis_and_hastings():
    pairs = np.array([[0, 1], [1, 2], [1, 3], [3, 4]])
    guides = np.array([[0.0], [0.5], [3.0], [0.5], [1.0]])
    weight = {tuple(pair): np.exp(-0.5 * (guides[pair[0], 0] - guides[pair[1], 0]) ** 2) for pair in pairs.tolist()}
    around = [sum(w for pair, w in weight.items() if i in pair) for i in range(5)]
    expected = np.zeros((5, 5))
    for (i, j), w in weight.items():
        expected[i, j] = expected[j, i] = w / (1.0 + max(around[i], around[j]))
    expected += np.diag(1.0 - expected.sum(axis=1))
    assert_rounded(mean_over_neighbours(pairs, 5, guides).toarray(), expected.astype(np.float32), terms=4)


def test_what_bands_let_through_of_noise_is_known():
    filters = smoothing._Filters.along(torus(), SIDE**2, None)
    operators = band_operators(eigenvalues())
    for i, one in enumerate(operators):
        # Each probe is off by √2 of a sum of squares; the mean over all receivers of a torus has little of that left.
        assert filters.own[i].mean() == pytest.approx(one.mean(), abs=0.01)
        for j, other in enumerate(operators):
            assert filters.products[i, j].mean() == pytest.approx((one * other).mean(), abs=0.01)


def test_receivers_on_both_sides_of_a_seam_are_neighbours():
    """A band closed at one place by doubled vertices; a third vertex there is of another surface."""
    angle = np.linspace(0.0, 2.0 * np.pi, 13)
    positions = np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    normals = np.concatenate([positions[:1], [[0.0, 0.0, 1.0]], positions[1:]])
    positions = np.concatenate([positions[:1], positions[:1], positions[1:]])
    found = across_seams(strip(14)[2:], positions, normals)
    assert_exact(found[:11], strip(14)[2:], "those stay")
    assert sorted(found[11:].ravel().tolist()) == [0, 13]


# --- Limits ----------------------------------------------------------------------------------------------------------


def test_vectors_without_variance_keep_their_bits():
    vectors = np.random.default_rng(0).normal(size=(SIDE**2, 3, 9)).astype(np.float32)
    found = smooth(vectors, np.zeros((SIDE**2, 3, 3)), torus())
    assert_exact(found.vectors, vectors, "nothing is taken out")
    assert found.removed == 0.0
    assert not found.variance.any()
    assert np.all(found.gains == 1.0)


def test_no_receivers_are_no_mistake():
    found = smooth(np.zeros((0, 3, 9)), np.zeros((0, 3, 3)), np.zeros((0, 2), dtype=np.int64), np.zeros((0, 2)))
    assert found.vectors.shape == (0, 3, 9)
    assert found.removed == 0.0


def test_receivers_without_neighbours_keep_their_bits():
    vectors, variance = noisy(np.zeros((20, 1, 4)), 1.0)
    found = smooth(vectors, variance, np.zeros((0, 2), dtype=np.int64))
    assert_exact(found.vectors, vectors, "there is nothing to average")
    assert_rounded(found.variance, variance.astype(np.float32), terms=100)


def test_vectors_that_are_all_noise_become_the_mean_of_the_rings_around():
    pairs = strip(60)
    vectors, _ = noisy(np.zeros((60, 2, 4)), 1.0)
    found = smooth(vectors, np.full((60, 2, 2), 1e6), pairs)
    power = np.linalg.matrix_power(mean_over_neighbours(pairs, 60).toarray().astype(np.float64), RINGS)
    expected = np.einsum("vw,wcm->vcm", power, vectors.astype(np.float64))
    np.testing.assert_allclose(found.vectors, expected, rtol=0.0, atol=40 * np.finfo(np.float32).eps)
    assert found.vectors.sum(axis=0) == pytest.approx(vectors.sum(axis=0), abs=1e-4)  # nothing is lost to the borders


def test_constants_stay():
    vectors = np.full((SIDE**2, 1, 9), 0.7, dtype=np.float32)
    found = smooth(vectors, np.full((SIDE**2, 1, 3), 0.1), torus())
    assert_rounded(found.vectors, vectors, terms=2 * 5 * RINGS)


# --- How good it is --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("deviation", [0.1, 0.5, 2.0])
def test_error_falls_to_that_of_wieners_gain_in_each_band(deviation):
    """The error of the same bands and the gains of the true spectrum, by Fourier series."""
    eigenvalue = eigenvalues()
    spectrum = eigenvalue**30
    spectrum /= spectrum.mean()
    bands = band_operators(eigenvalue)
    energies = [((band**2 * spectrum).mean(), (band**2).mean() * deviation**2) for band in bands[:-1]]
    whole = bands[-1] + sum(s / (s + n) * band for (s, n), band in zip(energies, bands, strict=False))
    ideal = float((whole**2 * deviation**2 + (1.0 - whole) ** 2 * spectrum).mean())
    truth = smooth_field(spectrum, 25, seed=1)
    vectors, variance = noisy(truth, deviation)
    found = smooth(vectors, variance, torus())
    error = mean_square(found.vectors[:, :, 16:] - truth[:, :, 16:])
    # Gains are known from some forty receivers only, times nine orders: they add a little.
    assert 0.9 * ideal < error < 1.15 * ideal
    assert error < 0.5 * deviation**2
    assert float(found.variance[:, :, 4].mean()) == pytest.approx(error, rel=0.25)


@pytest.mark.parametrize("power", [0, 1, 4, 30])
@pytest.mark.parametrize("deviation", [0.03, 0.3, 1.0, 3.0])
def test_errors_never_grow(power, deviation):
    """Whatever the signal: white (power 0), rough, smooth."""
    spectrum = np.abs(eigenvalues()) ** power
    truth = smooth_field(spectrum / spectrum.mean(), 16, seed=2)
    vectors, variance = noisy(truth, deviation)
    found = smooth(vectors, variance, torus())
    for degree in range(4):
        part = slice(degree**2, (degree + 1) ** 2)
        # The raw error is a mean of 2304 squares or more, and is known to 3 % of itself.
        assert mean_square(found.vectors[:, :, part] - truth[:, :, part]) < 1.03 * deviation**2


def test_borders_that_guides_tell_are_as_smooth_as_the_rest():
    count = 400
    side = np.arange(count) >= count // 2
    truth = np.repeat(np.where(side, 1.0, 0.0), 25).reshape(count, 1, 25)
    vectors, variance = noisy(truth, 0.5)
    error = smooth(vectors, variance, strip(count), guides=20.0 * side[:, None]).vectors - truth
    border = np.abs(np.arange(count) - count / 2) < 4
    assert mean_square(error[border]) < 0.3 * 0.25
    assert mean_square(error) < 0.2 * 0.25


def test_a_tube_is_smoothed_along_rather_than_around():
    """What changes around a coarse tube stays, though each receiver's neighbours around it differ as much as noise."""
    around, along = 12, 150
    angle = 2.0 * np.pi * np.arange(around) / around
    normals = np.repeat(np.stack([np.cos(angle), np.sin(angle), np.zeros(around)], axis=1), along, axis=0)
    index = np.arange(around * along).reshape(around, along)
    right, next_ring = np.roll(index, -1, axis=1), np.roll(index, -1, axis=0)
    pairs = np.concatenate([np.stack([index.ravel(), other.ravel()], axis=1) for other in (right, next_ring)])
    truth = np.repeat((normals @ [1.0, 0.0, 0.0])[:, None, None], 16, axis=2)
    vectors, variance = noisy(truth, 0.3)
    plain = mean_square(smooth(vectors, variance, pairs).vectors - truth)
    guided = mean_square(smooth(vectors, variance, pairs, surface_guides(normals)).vectors - truth)
    assert guided < 0.2 * 0.3**2
    assert guided < 0.8 * plain


def test_borders_that_only_the_vectors_tell_stay():
    truth = np.repeat(np.where(np.arange(SIDE**2) % SIDE < SIDE // 2, 0.0, 1.0), 16).reshape(-1, 1, 16)
    vectors, variance = noisy(truth, 0.05)
    error = smooth(vectors, variance, torus()).vectors - truth
    assert mean_square(error) < 0.5 * 0.05**2
    assert mean_square(error[np.isin(np.arange(SIDE**2) % SIDE, (0, SIDE // 2, SIDE - 1))]) < 1.1 * 0.05**2


def test_a_bright_point_stays_bright():
    truth = np.zeros((SIDE**2, 1, 9))
    truth[SIDE * SIDE // 2 + SIDE // 2] = 10.0
    vectors, variance = noisy(truth, 0.1)
    found = smooth(vectors, variance, torus())
    assert found.vectors[truth > 0.0] == pytest.approx(10.0, rel=0.05)
    assert mean_square(found.vectors - truth) < 0.01


def test_a_firefly_is_spread_out():
    """A rare bright path: its receiver's variance is as large."""
    truth = np.full((SIDE**2, 1, 9), 0.1)
    vectors, variance = noisy(truth, 0.01)
    there = SIDE * SIDE // 2 + SIDE // 2
    vectors[there] += 1.0
    variance[there] = 1.0
    found = smooth(vectors, variance, torus())
    assert np.all(found.vectors[there] < 0.2)


def test_clean_degrees_are_left_while_noisy_ones_are_smoothed():
    spectrum = eigenvalues() ** 4
    truth = smooth_field(spectrum / spectrum.mean(), 9, seed=3)
    vectors, variance = noisy(truth, 1.0)
    vectors[:, :, :4] = truth[:, :, :4]
    variance[:, :, :2] = 0.0
    found = smooth(vectors, variance, torus())
    assert_exact(found.vectors[:, :, :4], vectors[:, :, :4], "these have no noise")
    assert mean_square(found.vectors[:, :, 4:] - truth[:, :, 4:]) < 0.5


def test_what_all_get_between_them_is_kept():
    """Also where gains differ from place to place: light is neither lost nor made at borders."""
    rng = np.random.default_rng(0)
    truth = np.repeat(np.where(np.arange(SIDE**2) % SIDE < 7, 0.0, 3.0), 3 * 16).reshape(-1, 3, 16)
    deviation = np.repeat(0.1 + (np.arange(SIDE**2) // SIDE < 20), 3 * 16).reshape(-1, 3, 16)
    vectors = (truth + deviation * rng.normal(size=truth.shape)).astype(np.float32)
    found = smooth(vectors, deviation[:, :, :4] ** 2, torus())
    assert found.removed > 0.1
    # Of some thousand numbers below 10, whose differences are summed.
    np.testing.assert_allclose(
        found.vectors.sum(axis=0, dtype=np.float64), vectors.sum(axis=0, dtype=np.float64), rtol=0.0, atol=1e-2
    )


def test_the_number_of_threads_changes_no_bit_and_memory_is_that_of_degrees(monkeypatch):
    vectors, variance = noisy(np.zeros((SIDE**2, 3, 400)), 1.0)
    pairs, guides = torus(), np.random.default_rng(1).normal(size=(SIDE**2, 3))
    at_once = smooth(vectors, variance, pairs, guides)
    monkeypatch.setattr(smoothing, "_WORKERS", 1)
    tracemalloc.start()
    found = smooth(vectors, variance, pairs, guides)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert_exact(found.vectors, at_once.vectors, "degrees know nothing of each other")
    degree = SIDE**2 * 3 * 39 * 4
    assert peak < found.vectors.nbytes + 2 * found.variance.nbytes + 8 * degree + 2 * vectors.nbytes


# --- Variance --------------------------------------------------------------------------------------------------------


def draw_paths(receivers: int, paths: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Means over paths of throughput times harmonics (V, 1, 9), and mean squares of the throughput (V, 1)."""
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(receivers * paths, 3)) + [0.0, 0.5, 1.0]
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    throughput = rng.exponential(size=receivers * paths) * (rng.random(receivers * paths) < 0.5)
    sums = (throughput[:, None] * real_sh(2, directions)).reshape(receivers, paths, 9)
    return sums.mean(axis=1)[:, None], (throughput**2).reshape(receivers, paths).mean(axis=1)[:, None]


def test_variance_of_paths_and_of_halves_is_that_between_runs():
    receivers, paths = 4000, 32
    vectors, second = draw_paths(receivers, paths, seed=1)
    between = np.array([vectors[:, 0, l**2 : (l + 1) ** 2].var(axis=0, ddof=1).mean() for l in range(3)])
    of_paths = variance_of_paths(second, vectors, paths).mean(axis=(0, 1))
    # A variance from 4000 receivers is known to √(2/4000) = 2 %, a little more as these are no Gaussians.
    np.testing.assert_allclose(of_paths, between, rtol=0.08)
    halves = [draw_paths(receivers, paths // 2, seed)[0] for seed in (2, 3)]
    of_halves = variance_of_halves((halves[0] - halves[1]) / 2.0, strip(receivers)).mean(axis=(0, 1))
    np.testing.assert_allclose(of_halves, between, rtol=0.08)


def test_variance_is_made_the_size_that_halves_show():
    """Paths that are stratified vary less than their second moments let expect, here 0.3 times as much."""
    rng = np.random.default_rng(0)
    count = 2000
    independent = np.repeat(np.linspace(1.0, 2.0, count), 3).reshape(count, 1, 3)
    deviation = np.sqrt(0.3 * np.repeat(independent, (1, 3, 5), axis=2))
    found = calibrate_variance(independent, rng.normal(size=(count, 1, 9)) * deviation, strip(count))
    # Each is a mean over some 15 receivers and 2l+1 orders.
    np.testing.assert_allclose(found.mean(axis=0), 0.3 * independent.mean(axis=0), rtol=0.1)
    assert np.corrcoef(found[:, 0, 2], independent[:, 0, 2])[0, 1] > 0.5


def test_relative_noise_is_that_of_radiance_under_rotated_light():
    truth = np.random.default_rng(5).normal(size=(3000, 1, 9))
    vectors, variance = noisy(truth, 0.2)
    variance[:, :, 2] *= 4.0
    vectors[:, :, 4:] += vectors[:, :, 4:] - truth[:, :, 4:]
    power = np.array([1.0, 0.5, 0.1])
    of_orders = power[[0, 1, 1, 1, 2, 2, 2, 2, 2]]
    expected = np.sqrt(np.sum(of_orders * (vectors - truth) ** 2) / np.sum(of_orders * vectors**2))
    assert relative_noise(variance, vectors, power) == pytest.approx(expected, rel=0.02)
    assert relative_noise(variance[:0], vectors[:0]) == 0.0


# --- Bad input -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"vectors": np.zeros((5, 4))}, "vectors must be"),
        ({"vectors": np.zeros((5, 1, 5))}, "does not fit vectors of shape"),
        ({"variance": np.zeros((5, 2, 2))}, "does not fit vectors of shape"),
        ({"variance": np.full((5, 1, 2), -1.0)}, "not negative"),
        ({"vectors": np.full((5, 1, 4), np.nan)}, "must be finite"),
        ({"neighbours": np.zeros((3, 3), dtype=int)}, "pairs"),
        ({"neighbours": np.zeros((3, 2))}, "integers"),
        ({"neighbours": np.array([[0, 5]])}, "numbers of the 5 receivers"),
        ({"guides": np.zeros((4, 2))}, "guides must be"),
        ({"guides": np.full((5, 2), np.inf)}, "guides must be"),
    ],
)
def test_what_does_not_fit_is_told(change, message):
    right = {"vectors": np.zeros((5, 1, 4)), "variance": np.zeros((5, 1, 2)), "neighbours": strip(5), "guides": None}
    with pytest.raises(UserError, match=message):
        smooth(**{**right, **change})
