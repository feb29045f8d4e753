"""From which error on a dimension is that of transport: sums of squares, by hand."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import slepian_prt as sp
from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.compression.prediction import Expectation
from slepian_prt.evaluation.dimension.limits import error_of_vectors, remark_on_error
from slepian_prt.scene.film import FilmOutline
from tests.conftest import sphere


@pytest.fixture(scope="module")
def transfer() -> sp.Transfer:
    return sp.precompute(sphere(1), bandlimit=1, samples=16)


@pytest.fixture(scope="module")
def packed(transfer) -> CompressedTransfer:
    """Of whose energy, 100, the part 0.09 is lost: 3 %."""
    expected = Expectation(np.array([0.05, 0.04]), np.array([60.0, 40.0]))
    return replace(sp.compress(transfer, tolerance=0.1, clusters=2), expected=expected)


def test_errors_add_as_squares(transfer, packed):
    assert error_of_vectors(transfer) == 0.0
    assert error_of_vectors(replace(transfer, noise=0.2)) == 0.2
    assert error_of_vectors(packed) == pytest.approx(0.03, rel=1e-12)
    assert error_of_vectors(replace(packed, path_noise=0.04)) == pytest.approx(0.05, rel=1e-12)


def test_noise_of_a_film_counts(packed):
    """In degrees 0 and 1 the noise 9 and 11 of 100: 20 of the 80 that are left."""
    film = FilmOutline("front", 2, 2, np.array([9.0, 11.0]))
    pixels = SimpleNamespace(
        channels=1, bandlimit=1, predicted_error=0.0, path_noise=None, film_outline=film, expected=packed.expected
    )
    assert error_of_vectors(pixels) == pytest.approx(math.sqrt(20.0 / 80.0), rel=1e-12)
    assert remark_on_error(pixels, 0.6) == (
        "transfer vectors have an error of 0.5 themselves, which counts as dimension at an `error` of 0.6: give "
        "transfer of a smaller `tolerance` and more `samples`"
    )


def test_twice_the_error_of_the_vectors_is_enough(packed):
    assert remark_on_error(packed, 0.0601) is None
    assert remark_on_error(packed, 0.0599) == (
        "transfer vectors have an error of 0.03 themselves, which counts as dimension at an `error` of 0.0599: give an "
        "`error` of 0.06 or more, or transfer of a smaller `tolerance` and more `samples`"
    )
