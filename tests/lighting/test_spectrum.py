import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from slepian_prt.compression.prediction import Expectation, by_degree
from slepian_prt.compression.stream import compress
from slepian_prt.errors import UserError
from slepian_prt.lighting.spectrum import falling_prior, light_power, measured_prior
from slepian_prt.relighting.operator import transfer_operator
from slepian_prt.sphere.harmonics import degrees
from slepian_prt.sphere.rotation import rotate_sh
from slepian_prt.transport.transfer import precompute
from tests.conftest import bumpy


@pytest.fixture(scope="module")
def shadowed():
    return precompute(bumpy(4), bandlimit=6, samples=256)


def light_of(decay: float, seed: int = 0) -> np.ndarray:
    """A random environment whose harmonics fall as (l+1)^-decay."""
    rng = np.random.default_rng(seed)
    return rng.normal(size=(3, 49)) * (degrees(6) + 1.0) ** -decay


def relit_error(vectors, reference, light) -> float:
    """Relative error over all rotations of the light: 64 of them, the mean square over lights and vertices."""
    turns = Rotation.random(64, random_state=3).as_matrix()
    lost = whole = 0.0
    for turn in turns:
        turned = rotate_sh(light, turn).T
        lost += np.sum(((vectors - reference) @ turned) ** 2)
        whole += np.sum((reference @ turned) ** 2)
    return float(np.sqrt(lost / whole))


def test_power_is_what_rotations_keep():
    light = light_of(0.0)
    power = light_power(light)
    np.testing.assert_allclose(power[0], (light[:, 0] ** 2).sum())
    np.testing.assert_allclose(power[3], (light[:, 9:16] ** 2).sum() / 7)
    turned = rotate_sh(light, Rotation.random(random_state=1).as_matrix())
    np.testing.assert_allclose(light_power(turned), power, rtol=1e-12)


def test_mean_square_over_rotations_is_power_times_squares():
    """E |δ·e|² = Σ p_l |δ_l|² over rotations of e (Schur): against 4000 random rotations, error about 1/√4000."""
    light, delta = light_of(0.5), np.random.default_rng(4).normal(size=49)
    turned = rotate_sh(light[None], Rotation.random(4000, random_state=5).as_matrix()[:, None])
    measured = np.mean(np.sum((turned @ delta) ** 2, axis=1))
    foreseen = light_power(light) @ by_degree(delta**2)
    assert measured == pytest.approx(foreseen, rel=5 * np.sqrt(2.0 / 4000))


def test_measured_prior_leaves_brightness_out():
    lights = [light_of(1.0, 1), 1e4 * light_of(1.0, 2)]
    prior = measured_prior(lights, 6, "two")
    other = measured_prior([lights[0], lights[1] / 1e4], 6, "two")
    np.testing.assert_allclose(prior.weights, other.weights)
    assert prior.weights.max() <= 1.0
    assert prior.weights.min() >= 0.01


def test_constant_light_still_counts_other_degrees():
    light = np.zeros((3, 49))
    light[:, 0] = 1.0
    np.testing.assert_allclose(measured_prior([light], 6, "constant").weights, [1.0] + [0.01] * 6)


def test_lights_of_other_bandlimits_are_cut_or_dark_where_they_have_nothing(rng):
    long, short = rng.normal(size=(3, 64)), rng.normal(size=(3, 9))
    filled = np.concatenate([short, np.zeros((3, 40))], axis=1)
    expected = measured_prior([long[:, :49], filled], 6, "two")
    np.testing.assert_allclose(measured_prior([long, short], 6, "two").weights, expected.weights, rtol=1e-15)


@pytest.mark.parametrize("lighting", [[], [np.zeros((3, 49))], [np.ones((3, 35))]])
def test_bad_lights(lighting):
    with pytest.raises(UserError):
        measured_prior(lighting, 6, "bad")


@pytest.mark.parametrize("decay", [0.5, 1.5])
@pytest.mark.parametrize("terms", [1, 4, 9, 16])
def test_prior_of_the_light_itself_lowers_its_error(terms, decay, shadowed):
    reference, light = shadowed.vectors[:, 0], light_of(decay)
    prior = measured_prior([light], 6, "itself")
    errors = [
        relit_error(compress(shadowed, terms=terms, clusters=16, light_prior=p).reconstruct()[:, 0], reference, light)
        for p in (prior, None)
    ]
    # Equal where both find the same functions; the pilot's noise moves that by a little.
    assert errors[0] <= 1.005 * errors[1]
    if decay > 1.0 and terms >= 9:
        assert errors[0] < 0.95 * errors[1]


@pytest.mark.parametrize("basis", ["adapted", "transport", "slepian", "incident", "sh", "direct"])
@pytest.mark.parametrize("prior", [None, "1/(l+1)"])
@pytest.mark.parametrize("terms", [4, 16])
def test_relit_error_is_foreseen(basis, prior, terms, shadowed):
    reference, light = shadowed.vectors[:, 0], light_of(0.7)
    given = falling_prior(6) if prior else None
    packed = compress(shadowed, basis, terms=terms, clusters=16, light_prior=given)
    measured = relit_error(packed.reconstruct()[:, 0], reference, light)
    assert packed.predicted_relit_error(light) == pytest.approx(measured, rel=0.1)
    error = np.linalg.norm(packed.reconstruct()[:, 0] - reference) / np.linalg.norm(reference)
    assert packed.predicted_error == pytest.approx(error, rel=0.1)


@pytest.mark.parametrize("tolerance", [0.03, 0.01])
def test_tolerance_is_met_under_the_prior(tolerance, shadowed):
    reference = shadowed.vectors[:, 0]
    prior = falling_prior(6)
    packed = compress(shadowed, tolerance=tolerance, clusters=16, light_prior=prior)
    scale = prior.weights[degrees(6)]
    error = np.linalg.norm((packed.reconstruct()[:, 0] - reference) * scale) / np.linalg.norm(reference * scale)
    assert 0.9 * tolerance < error <= tolerance * (1 + 1e-3)
    assert packed.expected.relative(prior.weights**2) == pytest.approx(error, rel=1e-2)
    plain = compress(shadowed, tolerance=tolerance, clusters=16)
    assert packed.bytes_per_vertex < plain.bytes_per_vertex


@pytest.mark.parametrize("coding", ["coded", "float32"])
def test_relighting_with_a_prior_is_reconstruction_times_light(coding, shadowed, rng):
    prior = falling_prior(6)
    packed = compress(shadowed, tolerance=0.05, clusters=16, light_prior=prior, coding=coding)
    lights = rng.normal(size=(20, 3, 49)) * prior.weights[degrees(6)]
    expected = np.einsum("vm,bcm->bvc", packed.reconstruct()[:, 0], lights)
    # What is left out when relighting is at most a hundredth of the error under lights of the prior.
    allowed = 1e-6 if coding == "float32" else 1.2 * 0.01 * 0.05
    difference = transfer_operator(packed).apply(lights) - expected
    assert np.linalg.norm(difference) <= allowed * np.linalg.norm(expected)


def test_expectation_of_nothing():
    assert Expectation(np.zeros(3), np.zeros(3)).relative() == 0.0
