"""Noise of pixels: its variance from passes and second moments, and less of it in what is smoothed."""

import numpy as np
import pytest

from slepian_prt.scene.film import film_mesh
from slepian_prt.sphere.harmonics import real_sh
from slepian_prt.transport.capturing.capture import capture
from slepian_prt.transport.capturing.denoising import Pixels, calibrated, guide_table, smoothed
from slepian_prt.transport.capturing.guides import Guides
from tests.conftest import random_directions
from tests.transport.capturing.scenes import camera, film, llvm_mitsuba, open_box

WIDTH, HEIGHT, BANDLIMIT, PATHS = 24, 20, 3, 32


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("SLEPIAN_PRT_CACHE", str(tmp_path / "cache"))


def plain_guides(count, shapes=None):
    normals = np.zeros((count, 3), np.float32)
    normals[:, 2] = 1.0
    shapes = np.ones(count, np.uint32) if shapes is None else shapes
    return Guides(normals, np.ones(count, np.float32), np.full((count, 3), 0.5, np.float32), shapes)


def noisy_pixels(rng):
    """Pixels that all see the same light, by independent paths; their variance is known."""
    count = WIDTH * HEIGHT
    values = real_sh(BANDLIMIT, random_directions(rng, count * PATHS)).reshape(count, PATHS, -1)
    passes = values.reshape(count, 2, PATHS // 2, -1).mean(axis=2)
    vectors = np.repeat(values.mean(axis=1)[:, None], 3, axis=1).astype(np.float32)
    squares = np.square(passes[:, 0] - passes[:, 1]) / 4.0
    measured = np.stack([squares[:, l * l : (l + 1) ** 2].mean(axis=1) for l in range(BANDLIMIT + 1)], axis=1)
    variance = np.repeat(measured[:, None], 3, axis=1).astype(np.float32)
    ones = np.ones((count, 3), np.float32)
    return Pixels(vectors, variance, np.zeros_like(ones), ones, count * PATHS)


def test_the_variance_is_as_large_as_measured_and_smoother(rng):
    mesh = film_mesh("eye", WIDTH, HEIGHT, np.zeros((WIDTH * HEIGHT, 3)))
    pixels = noisy_pixels(rng)
    # Second moments that are four times too large, as those of stratified paths are.
    foreseen = np.full_like(pixels.variance, 4.0 / (4.0 * np.pi * PATHS))
    found = calibrated(foreseen, pixels.variance, mesh.receivers.neighbours)
    exact = 1.0 / (4.0 * np.pi * PATHS)
    # Degree 0 has no variance; the others that of paths in all directions.
    np.testing.assert_allclose(found[:, :, 1:].mean(), exact, rtol=0.1)
    assert found[:, :, 1:].std() < 0.25 * pixels.variance[:, :, 1:].std()
    assert np.abs(found[:, :, 0]).max() < 1e-6 * exact


def test_what_all_pixels_see_is_told_from_noise(rng):
    """The truth is degree 0 alone."""
    count = WIDTH * HEIGHT
    mesh = film_mesh("eye", WIDTH, HEIGHT, np.zeros((count, 3)))
    pixels = noisy_pixels(rng)
    dark = np.arange(count) < WIDTH
    pixels.vectors[dark] = 0.0
    shapes = np.where(dark, 0, 1).astype(np.uint32)
    guides = guide_table(plain_guides(count, shapes), pixels.background)
    result = smoothed(pixels, mesh.receivers.neighbours, guides, PATHS)
    before, after = (np.square(vectors[~dark, :, 1:]).mean() for vectors in (pixels.vectors, result.vectors))
    assert after < 0.1 * before
    assert 0.0 < result.removed < 1.0
    np.testing.assert_allclose(result.vectors[~dark, :, 0], 1.0 / np.sqrt(4.0 * np.pi), rtol=1e-5)
    assert not result.vectors[dark].any()
    assert result.variance.mean() < 0.2 * pixels.variance.mean()


def test_guides_tell_surfaces_apart():
    guides = plain_guides(4, np.array([7, 7, 9, 9], np.uint32))
    guides.normals[1] = [0.0, 0.6, 0.8]
    table = guide_table(guides, np.array([0.0, 0.0, 0.0, 1.0])[:, None])
    apart = np.square(table[:, None] - table[None]).sum(axis=2) / 2.0  # what weights fall with, exponentially
    assert apart[0, 0] == 0.0
    assert apart[0, 1] > 5.0  # 37 degrees
    assert np.exp(-apart[0, 2] / 16.0).astype(np.float32) == 0.0  # another shape, in the widest band
    assert apart[2, 3] > 5.0  # not covered


@pytest.mark.slow
def test_smoothed_captures_are_nearer_to_the_truth():
    mi = llvm_mitsuba()
    scene = mi.load_dict(open_box(mi, eye=camera(mi, film_of=film(48))))
    asked = {"bandlimit": 4}
    truth = capture(scene, samples=4096, seed=9, smooth=False, **asked).vectors
    falling = 1.0 / np.repeat(np.arange(5) + 1.0, 2 * np.arange(5) + 1)
    for samples, part in ((16, 0.65), (64, 0.75), (256, 0.95)):
        errors = []
        for smooth in (False, True):
            made = capture(scene, samples=samples, seed=1, smooth=smooth, **asked)
            errors.append(np.linalg.norm((made.vectors - truth) * falling) / np.linalg.norm(truth * falling))
        assert errors[1] < part * errors[0]
        power = 1.0 / (1.0 + np.arange(5)) ** 2
        energy = np.array([np.square(truth[:, :, l * l : (l + 1) ** 2]).sum() for l in range(5)]) / len(truth)
        told = np.sqrt(power @ made.film.noise_power / (power @ energy))
        assert told == pytest.approx(errors[1], rel=0.5)


@pytest.mark.slow
def test_pictures_of_lamps_are_smoothed_too():
    mi = llvm_mitsuba()
    lamp = {"type": "point", "position": [0.5, 1.5, 1.0], "intensity": 1.5}
    scene = mi.load_dict(open_box(mi, eye=camera(mi, film_of=film(48)), lamp=lamp))
    truth = capture(scene, samples=2048, bandlimit=0, seed=9, smooth=False).fixed.direct[0]
    rough, fine = (capture(scene, samples=16, bandlimit=0, seed=1, smooth=smooth).fixed.direct[0] for smooth in (0, 1))
    assert np.linalg.norm(fine - truth) < 0.8 * np.linalg.norm(rough - truth)
