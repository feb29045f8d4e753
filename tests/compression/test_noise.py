"""Coding is no finer than the noise of the transfer."""

import logging
from dataclasses import replace

import numpy as np
import pytest

from slepian_prt.compression.files import container
from slepian_prt.compression.files.prt_file import load
from slepian_prt.compression.grouping import group_transfer
from slepian_prt.compression.noise import finest_tolerance
from slepian_prt.compression.settings import CompressionSettings
from slepian_prt.compression.stream import compress
from slepian_prt.compression.tolerance_sweep import ToleranceSweep
from slepian_prt.lighting.spectrum import falling_prior
from slepian_prt.sphere.harmonics import degrees
from slepian_prt.transport.transfer import precompute
from slepian_prt.transport.transfer_file import load_transfer
from tests.conftest import bumpy
from tests.numerics import assert_exact

NOISE = 0.3


@pytest.fixture(scope="module")
def clean():
    return precompute(bumpy(3), bandlimit=4, samples=64)


@pytest.fixture(scope="module")
def noisy(clean):
    """As paths would leave it: noise that is alike in all coefficients."""
    white = np.random.default_rng(0).normal(size=clean.vectors.shape)
    white *= NOISE * np.linalg.norm(clean.vectors) / np.linalg.norm(white)
    return replace(clean, vectors=(clean.vectors + white).astype(np.float32), noise=NOISE)


@pytest.mark.parametrize("prior", [None, falling_prior(4)])
def test_finest_tolerance_is_a_third_of_what_noise_does_to_radiance(clean, noisy, prior):
    weights = np.ones(25) if prior is None else prior.weights[degrees(4)]
    noise = (noisy.vectors - clean.vectors) * weights
    expected = np.linalg.norm(noise) / np.linalg.norm(clean.vectors * weights) / 3.0
    energies = np.bincount(degrees(4), np.square(clean.vectors, dtype=np.float64).sum(axis=(0, 1)))
    # The noise of the lowest degree is a mean over 642 vertices, and known to 3 % of itself.
    assert finest_tolerance(NOISE, energies, prior) == pytest.approx(expected, rel=0.05)


def test_nothing_is_finer_than_what_noise_leaves(noisy, caplog):
    with caplog.at_level(logging.INFO, "slepian_prt"):
        packed = compress(noisy, tolerance=0.01, clusters=8)
    assert "a noise of 0.3 in the transfer, which is coded to a tolerance of 0.1: at 0.01" in caplog.text
    assert packed.predicted_error == pytest.approx(NOISE / 3.0, rel=0.1)
    assert packed.path_noise == NOISE
    error = np.linalg.norm(packed.reconstruct()[:, 0] - noisy.vectors[:, 0]) / np.linalg.norm(noisy.vectors)
    assert error == pytest.approx(NOISE / 3.0, rel=0.1)
    as_fine_as_asked = compress(replace(noisy, noise=None), tolerance=0.01, clusters=8)
    assert packed.bytes_per_vertex < 0.6 * as_fine_as_asked.bytes_per_vertex


def test_a_tolerance_that_is_coarser_stays(noisy, caplog):
    with caplog.at_level(logging.INFO, "slepian_prt"):
        packed = compress(noisy, tolerance=0.2, clusters=8)
    assert not caplog.records
    without = compress(replace(noisy, noise=None), tolerance=0.2, clusters=8)
    assert_exact(packed.reconstruct(), without.reconstruct(), "the same settings")


def test_a_sweep_of_tolerances_is_coded_the_same(noisy):
    settings = CompressionSettings(clusters=8)
    swept = ToleranceSweep(noisy, settings, group_transfer(settings, noisy)).compress(0.01)
    assert swept.predicted_error == pytest.approx(NOISE / 3.0, rel=0.1)


def test_files_tell_the_noise(noisy, clean, tmp_path):
    compress(noisy, tolerance=0.2, clusters=8).save(tmp_path / "noisy.prt")
    manifest = container.Contents(tmp_path / "noisy.prt").manifest
    assert manifest["noise"] == NOISE
    assert load(tmp_path / "noisy.prt").path_noise == NOISE
    compress(clean, tolerance=0.2, clusters=8).save(tmp_path / "clean.prt")
    assert "noise" not in container.Contents(tmp_path / "clean.prt").manifest
    assert load(tmp_path / "clean.prt").path_noise is None
    for transfer in (noisy, clean):
        transfer.save(tmp_path / "transfer.npz")
        assert load_transfer(tmp_path / "transfer.npz").noise == transfer.noise


def test_fewer_degrees_have_less_noise(clean, noisy):
    low = noisy.at_bandlimit(2)
    expected = np.linalg.norm((noisy.vectors - clean.vectors)[:, :, :9]) / np.linalg.norm(low.vectors)
    # The noise is relative to vectors with noise, a part NOISE² / 2 longer; 642 vertices know it to 2 %.
    assert low.noise == pytest.approx(expected, rel=0.06)
