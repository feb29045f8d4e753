"""Errors at every bandlimit, against closed forms and brute force."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from slepian_prt.evaluation.reference import ReferenceVertices
from slepian_prt.evaluation.vertex_error import MapMetric, SpectrumMetric
from slepian_prt.lighting.environment import make_environment
from slepian_prt.lighting.projection import project_environment
from slepian_prt.lighting.spectrum import LightPrior, falling_prior
from slepian_prt.sphere.harmonics import degrees, real_sh
from slepian_prt.sphere.rotation import rotate_sh
from slepian_prt.transport.direct import unoccluded_transfer
from slepian_prt.transport.planned import plan_scene
from slepian_prt.transport.settings import TransportSettings
from tests.conftest import bumpy, random_directions, sphere
from tests.lighting.test_environment import grid_directions

L = 8


def banded(rng, bandlimit=L, height=64):
    """A map of the given degrees, whose radiance at vertices is known: (3, (L+1)²) coefficients and the map."""
    light = rng.normal(size=(3, (bandlimit + 1) ** 2)) * 0.1
    light[:, 0] = 8.0  # positive everywhere
    d = grid_directions(height)
    texels = np.einsum("hwm,cm->hwc", real_sh(bandlimit, d.reshape(-1, 3)).reshape(*d.shape[:2], -1), light)
    assert texels.min() > 0.0
    return light, make_environment(texels.astype(np.float32), name="banded")


def by_hand(environment, radiance, noise=0.0) -> MapMetric:
    reference = ReferenceVertices(radiance.astype(np.float32), noise, 1, 0.0)
    n = len(radiance)
    lighting = project_environment(environment, L)
    return MapMetric(("banded",), (lighting,), np.arange(n), (reference,), np.ones((n, 3)))


def test_what_a_bandlimit_leaves_out(rng):
    """Of unshadowed transfer under light of known coefficients: the degrees above, in closed form."""
    _, environment = banded(rng)
    light = project_environment(environment, L)
    vectors = unoccluded_transfer(L, random_directions(rng, 400))
    exact = vectors @ light.T
    found = by_hand(environment, exact).errors(vectors[:, None, :]).squared[:, 0]
    for l in range(L + 1):
        rest = vectors[:, (l + 1) ** 2 :] @ light[:, (l + 1) ** 2 :].T
        assert found[l] == pytest.approx(np.sum(rest**2) / np.sum(exact**2), rel=1e-4, abs=1e-9)  # float32


def test_noise_of_the_reference_is_taken_off(rng):
    """With noise added to the reference, the error stays what it was, within what so many vertices can tell."""
    light, environment = banded(rng)
    vectors = unoccluded_transfer(L, random_directions(rng, 4000))
    exact = vectors @ light.T
    scale = np.sqrt(np.mean(np.sum(exact**2, axis=1)))
    noise = 0.02
    noisy = exact + rng.normal(size=exact.shape) * noise * scale / np.sqrt(3.0)
    clean = by_hand(environment, exact).errors(vectors[:, None, :])
    found = by_hand(environment, noisy, noise).errors(vectors[:, None, :])
    # Squared noise over n vertices and three channels is off by noise² √(2 / 3n); times what it is crossed with.
    for l in range(L + 1):
        off = 4.0 * (noise**2 * np.sqrt(2.0 / 12000) + 2.0 * noise * np.sqrt(clean.squared[l, 0] / 12000))
        assert found.squared[l, 0] == pytest.approx(clean.squared[l, 0], abs=off)
    assert found.squared[L, 0] < 0.1 * noise**2


@pytest.mark.slow
def test_standard_errors_hold(rng):
    """Errors at many small samples of the vertices scatter as each of them says."""
    light, environment = banded(rng)
    vectors = unoccluded_transfer(L, random_directions(rng, 20_000))
    exact = vectors @ light.T
    roots, said = [], []
    for part in np.split(np.arange(20_000), 100):
        found = by_hand(environment, exact[part]).errors(vectors[part][:, None, :])
        roots.append(np.sqrt(found.squared[2, 0]))
        said.append(found.standard_error[2, 0])
    assert np.std(roots) / np.mean(roots) == pytest.approx(np.mean(said), rel=0.25)  # √(1/200) of it, three times


def test_products_and_differences_under_a_map(rng):
    """White noise on the coefficients makes the error that its spectrum lets expect, at every bandlimit."""
    _, environment = banded(rng)
    light = project_environment(environment, L)
    vectors = unoccluded_transfer(L, random_directions(rng, 4000))
    yardstick = by_hand(environment, vectors @ light.T)
    scale = np.mean(np.sum((vectors @ light.T) ** 2, axis=1))
    sizes = np.linspace(0.01, 0.03, L + 1)[degrees(L)]
    noise = (rng.normal(size=vectors.shape) * sizes)[:, None, :]
    power = np.sum(light**2, axis=0)
    # Off by about √(2 / 4000), four times.
    for l in range(L + 1):
        size = (l + 1) ** 2
        expected = float(power[:size] @ sizes[:size] ** 2) / scale
        apart = yardstick.squared_difference(vectors[:, None, :] + noise, vectors[:, None, :])[l, 0]
        assert apart == pytest.approx(expected, rel=0.09)
    assert yardstick.inner_product(noise, noise)[0] == pytest.approx(apart, rel=1e-6)
    assert yardstick.inner_product(noise, -2.0 * noise)[0] == pytest.approx(-2.0 * apart, rel=1e-6)
    other = rng.permutation(noise)
    assert abs(yardstick.inner_product(noise, other)[0]) < 4.0 * apart / np.sqrt(4000)


def spectral(rng, vectors, weights, noise=0.0) -> SpectrumMetric:
    """With halves that differ by noise of each coefficient."""
    halves = tuple((vectors + noise * rng.normal(size=vectors.shape)).astype(np.float32)[:, None, :] for _ in (0, 1))
    return SpectrumMetric("made up", np.arange(len(vectors)), weights**2, halves, 0.0)


def test_spectrum_is_the_mean_over_rotations(rng):
    """Against light of that spectrum, turned many times."""
    weights = 1.0 / (1.0 + np.arange(L + 1.0)) ** 0.5
    vectors = unoccluded_transfer(L, random_directions(rng, 60))
    wrong = vectors + 0.02 * rng.normal(size=vectors.shape)
    found = spectral(rng, vectors, weights).errors(wrong[:, None, :]).squared[:, 0]
    light = rng.normal(size=(L + 1) ** 2)
    for l in range(L + 1):  # as much in each degree as the spectrum says
        degree = slice(l * l, (l + 1) ** 2)
        light[degree] *= weights[l] * np.sqrt(2 * l + 1) / np.linalg.norm(light[degree])
    turned = rotate_sh(np.broadcast_to(light, (3000, light.size)), Rotation.random(3000, random_state=1).as_matrix())
    for l in (1, 4, L):
        size = (l + 1) ** 2
        off = turned @ vectors.T - turned[:, :size] @ wrong[:, :size].T
        brute = np.sum(off**2) / np.sum((turned @ vectors.T) ** 2)
        assert found[l] == pytest.approx(brute, rel=0.03)


def test_spectrum_takes_off_the_noise_of_its_reference(rng):
    vectors = unoccluded_transfer(L, random_directions(rng, 3000))
    clean, noisy = (spectral(rng, vectors, np.ones(L + 1), noise) for noise in (0.0, 0.02))
    assert noisy.noise[0] == pytest.approx(
        0.02 * np.sqrt(81 / 2) / np.sqrt(np.mean(np.sum(vectors**2, axis=1))), rel=0.05
    )
    of_each = noisy.noise[0] / 9.0
    for l in (2, 5):
        expected = clean.errors(vectors[:, None, :]).squared[l, 0]
        # Twice the product of both errors, whose mean over the vertices is off by their sizes over √n; four times.
        off = 4.0 * 2.0 * np.sqrt(expected) * of_each / np.sqrt(3000) + 0.02 * noisy.noise[0] ** 2
        assert noisy.errors(vectors[:, None, :]).squared[l, 0] == pytest.approx(expected, abs=off)
    assert noisy.errors(vectors[:, None, :]).squared[L, 0] < 0.05 * noisy.noise[0] ** 2


def test_what_lies_beyond_the_reference_is_known_from_degree_one():
    """The energy of the clamped cosine in all degrees, 2/(3π), from transfer of degree two."""
    normals = sphere(2).normals
    vectors = unoccluded_transfer(2, normals)
    prior = LightPrior("white", np.ones(3))
    found = SpectrumMetric.of(prior, np.arange(len(normals)), (vectors, vectors), normals)
    kept = np.mean(np.sum(vectors.astype(np.float64) ** 2, axis=1))
    assert found.beyond == pytest.approx(2.0 / (3.0 * np.pi) - kept, rel=1e-5)
    assert found.errors(vectors[:, None, :]).squared[2, 0] == pytest.approx(
        found.beyond / (2.0 / (3.0 * np.pi)), rel=1e-5
    )


@pytest.mark.slow
def test_a_map_against_a_scene():
    """Full SH at a high bandlimit with many rays is within noise of the reference, a low one is not."""
    with plan_scene(bumpy(3), TransportSettings(12, 4096)) as planned:
        vertices = np.flatnonzero(planned.scene.mesh.receivers.active)
        vectors = planned.estimator().estimate(vertices).vectors[:, 0]
        texels = np.full((32, 64, 3), 0.5, dtype=np.float32)
        texels[:16] = 2.0
        yardstick = MapMetric.of(planned, [make_environment(texels, name="half")], vertices, 0.003)
    found = np.sqrt(yardstick.errors(vectors[:, None, :]).squared[:, 0])
    assert yardstick.noise[0] <= 0.0045
    assert found[12] < 0.01
    assert found[0] > 0.1
    half = yardstick.subset(slice(0, 100))
    assert half.vertices.size == 100
    assert np.sqrt(half.errors(vectors[:100, None, :]).squared[12, 0]) < 0.015


def test_falling_prior_is_one_over_degree():
    np.testing.assert_allclose(falling_prior(3).weights, [1.0, 1 / 2, 1 / 3, 1 / 4])
