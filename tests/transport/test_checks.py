"""Vectors that came from elsewhere, at each function that takes them."""

import math
from dataclasses import replace

import numpy as np
import pytest

import slepian_prt as sp
from slepian_prt.lighting.spectrum import LightPrior
from slepian_prt.transport.checks import LARGEST, SMALLEST
from tests.conftest import bumpy

LIGHT = np.zeros((3, 9))
LIGHT[:, 0] = 1.0

TAKES_VECTORS = {
    "compress": lambda transfer: sp.compress(transfer, tolerance=0.1),
    "compress by number": lambda transfer: sp.compress(transfer, "pca", terms=2),
    "gpu_transfer": sp.gpu_transfer,
    "effective_dimension": sp.effective_dimension,
    "relight": lambda transfer: sp.relight(transfer, LIGHT),
}


@pytest.fixture(scope="module")
def transfer() -> sp.Transfer:
    return sp.precompute(bumpy(2), bandlimit=2, samples=16)


def changed(transfer: sp.Transfer, value: float) -> sp.Transfer:
    vectors = transfer.vectors.copy()
    vectors[3, 0, 1] = value
    return replace(transfer, vectors=vectors)


@pytest.mark.parametrize("function", TAKES_VECTORS)
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_vectors_that_are_not_finite(transfer, function, value):
    with pytest.raises(sp.UserError, match=r"^the transfer vectors of 1 of \d+ vertices are not finite.* vertex 3;"):
        TAKES_VECTORS[function](changed(transfer, value))


@pytest.mark.parametrize("value", [1e30, -1e30, 3.4e38])
def test_vectors_that_no_light_makes(transfer, value):
    with pytest.raises(sp.UserError, match=r"largest coefficient of the transfer vectors must lie within"):
        sp.compress(changed(transfer, value))


def test_vectors_that_vanish_in_float32(transfer):
    with pytest.raises(sp.UserError, match=r"must lie within 1e-12 and 1e\+12, not be 1e-30"):
        sp.compress(replace(transfer, vectors=np.full_like(transfer.vectors, 1e-30)))


@pytest.mark.parametrize("basis", ["adapted", "pca", "cpca"])
@pytest.mark.parametrize("size", [3 * SMALLEST, 1e-6, 1.0, 1e6, LARGEST])
def test_the_wanted_error_holds_however_large_vectors_are(transfer, basis, size, tmp_path):
    """Scaled by a power of two, vectors are the same numbers: so must the error be, but for means kept in float16."""
    scale = 2.0 ** math.floor(math.log2(size / np.abs(transfer.vectors).max()))
    scaled = replace(transfer, vectors=transfer.vectors * np.float32(scale))
    sp.compress(scaled, basis, tolerance=0.02).save(tmp_path / "scaled.prt", keep_order=True)
    packed = sp.load(tmp_path / "scaled.prt")
    difference = np.linalg.norm(packed.reconstruct() - scaled.vectors) / np.linalg.norm(scaled.vectors)
    assert difference == pytest.approx(packed.predicted_error, rel=0.05)
    assert difference < 0.021


@pytest.mark.parametrize("scale", [1e6, 1e-10])
def test_float16_that_does_not_hold_the_coefficients(transfer, scale):
    scaled = replace(transfer, vectors=transfer.vectors * np.float32(scale))
    with pytest.raises(sp.UserError, match=r"do not fit `coding=float16`; choose `coding=float32`"):
        sp.compress(scaled, terms=4, coding="float16")
    for refine in (False, True):
        packed = sp.compress(scaled, terms=9, coding="float32", refine=refine)
        np.testing.assert_allclose(packed.reconstruct(), scaled.vectors, rtol=0, atol=1e-5 * scale)


def test_radiance_beyond_float32(transfer):
    bright = replace(transfer, vectors=transfer.vectors * np.float32(1e12))
    with pytest.raises(sp.UserError, match="radiance is beyond what float32 holds"):
        sp.relight(bright, LIGHT * 1e30)


@pytest.mark.parametrize(
    "vectors",
    [np.zeros((5, 1, 9), np.float32), np.zeros((1, 9)), np.zeros((5, 9)), np.zeros(3), [[1.0]], "vectors", None],
    ids=str,
)
def test_vectors_of_another_shape_or_type(transfer, vectors):
    with pytest.raises(sp.UserError, match=r"^transfer vectors must "):
        sp.compress(replace(transfer, vectors=vectors))


def test_integers_are_no_vectors(transfer):
    with pytest.raises(sp.UserError, match="floating-point numbers, not int64"):
        sp.compress(replace(transfer, vectors=np.zeros(transfer.vectors.shape, dtype=np.int64)))


@pytest.mark.parametrize(
    "axes", [np.zeros((4, 3)), np.full((162, 3), math.nan), None, "axes"], ids=lambda x: str(x)[:9]
)
def test_axes_of_another_shape(transfer, axes):
    with pytest.raises(sp.UserError, match=r"^axes of the transfer must be"):
        sp.compress(replace(transfer, axes=axes))


@pytest.mark.parametrize("weight", [math.nan, math.inf, 0.0, -1.0, 2.0, 1e300])
def test_weights_of_a_prior_that_are_none(transfer, weight):
    with pytest.raises(sp.UserError, match=r"^weights of `light_prior` must lie in \(0, 1\]"):
        sp.compress(transfer, light_prior=LightPrior("own", np.array([1.0, 1.0, weight])))


@pytest.mark.parametrize("bandlimit", [-1, 3, 1.5, "2", None])
def test_a_bandlimit_that_the_transfer_does_not_reach(transfer, bandlimit):
    with pytest.raises(sp.UserError, match=r"^bandlimit must be an integer in \[0, 2\]"):
        transfer.at_bandlimit(bandlimit)


@pytest.mark.parametrize("lighting", [math.nan, 1.0, [1.0, math.nan, 1.0, 1.0], [1j] * 4, np.ones(5), "sky", []])
def test_errors_under_no_light(transfer, lighting):
    with pytest.raises(sp.UserError, match=r"^lighting must "):
        sp.measured_prior([lighting], 2, "own")
    packed = sp.compress(transfer, terms=2, clusters=2)
    with pytest.raises(sp.UserError, match=r"^lighting must "):
        packed.predicted_relit_error(lighting)


@pytest.mark.parametrize(
    "vertices", [[162], [-1], [0.5], "all", [[1]], np.ones(162, dtype=bool)], ids=lambda x: str(x)[:9]
)
def test_vertices_that_are_not_there(transfer, vertices):
    with pytest.raises(sp.UserError, match=r"^vertices must be "):
        sp.compress(transfer, terms=2, clusters=2).reconstruct(vertices)
