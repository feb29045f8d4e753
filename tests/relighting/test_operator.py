import numpy as np
import pytest

from slepian_prt.compression.stream import compress
from slepian_prt.relighting.factors import Factors
from slepian_prt.relighting.operator import TransferOperator, transfer_operator
from slepian_prt.sphere.harmonics import num_coefficients
from slepian_prt.transport.transfer import precompute
from tests.conftest import bumpy


@pytest.fixture(scope="module")
def shadowed():
    return precompute(bumpy(4), bandlimit=6, samples=256)


def made_up(rng, channels: int = 1, caps: int = 5, bandlimit: int = 4):
    """Caps of many sizes (one of them empty), their vertices, and the whole matrix."""
    sizes = [0, *rng.integers(1, 40, caps - 1)]
    members = np.split(rng.permutation(sum(sizes)), np.cumsum(sizes)[:-1])
    size = num_coefficients(bandlimit)
    parts = []
    whole = np.zeros((sum(sizes), channels, size))
    for vertices in members:
        rank = int(rng.integers(1, 12))
        part = Factors(
            rng.normal(size=(len(vertices), rank)).astype(np.float32), rng.normal(size=(rank, channels, size))
        )
        parts.append(part)
        whole[vertices] = np.einsum("nr,rcm->ncm", part.coefficients, part.functions)
    return parts, members, whole


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("count", [1, 4])
def test_apply_is_the_product_and_adjoint_its_transpose(channels, count, rng):
    parts, members, whole = made_up(rng, channels)
    operator = TransferOperator(parts, members)
    lights = rng.normal(size=(count, 3, 25))
    expected = np.einsum("vcm,bcm->bvc", np.broadcast_to(whole, (len(whole), 3, 25)), lights)
    found = operator.apply(lights)
    assert found.shape == (count, len(whole), 3)
    # Sums of some 100 products in float32.
    np.testing.assert_allclose(found, expected, atol=1e-5 * np.abs(expected).max())
    gradient = rng.normal(size=found.shape)
    back = operator.adjoint(gradient)
    assert back.shape == lights.shape
    np.testing.assert_allclose(np.sum(back * lights), np.sum(gradient * expected), rtol=1e-4)
    expected = np.einsum("bvc,vcm->bcm", gradient, np.broadcast_to(whole, (len(whole), 3, 25)))
    np.testing.assert_allclose(back, expected, atol=1e-5 * np.abs(expected).max())


def test_caps_of_many_tiles_and_functions_of_many_strips(rng):
    sizes, ranks = (0, 1, 127, 128, 129, 700), (3, 0, 64, 65, 130, 5)  # around whole tiles and whole strips
    members = np.split(rng.permutation(sum(sizes)), np.cumsum(sizes)[:-1])
    parts = [
        Factors(rng.normal(size=(n, r)).astype(np.float32), rng.normal(size=(r, 3, 25)).astype(np.float32))
        for n, r in zip(sizes, ranks, strict=True)
    ]
    operator, lights = TransferOperator(parts, members), rng.normal(size=(3, 3, 25))
    expected = np.empty((3, sum(sizes), 3))
    for vertices, part in zip(members, parts, strict=True):
        expected[:, vertices] = np.einsum("nr,rcm,bcm->bnc", part.coefficients, part.functions, lights)
    allowed = 130 * 25 * np.finfo(np.float32).eps * np.abs(expected).max()
    np.testing.assert_allclose(operator.apply(lights), expected, rtol=0, atol=allowed)
    for light, radiance in zip(lights, expected, strict=True):
        np.testing.assert_allclose(operator.apply(light[None])[0], radiance, rtol=0, atol=allowed)
    gradient = rng.normal(size=expected.shape)
    np.testing.assert_allclose(np.sum(operator.adjoint(gradient) * lights), np.sum(gradient * expected), rtol=1e-4)


@pytest.mark.parametrize("coding", ["coded", "float32", "float16"])
@pytest.mark.parametrize("basis", ["adapted", "pca", "sh"])
def test_relit_as_reconstructed(basis, coding, shadowed, rng):
    if basis == "pca" and coding == "coded":
        pytest.skip("not coded")
    packed = compress(shadowed, basis, terms=9 if coding != "coded" else None, clusters=16, coding=coding)
    lights = rng.normal(size=(20, 3, 49))
    expected = np.einsum("vm,bcm->bvc", packed.reconstruct()[:, 0], lights)
    allowed = 1.2 * 0.01 * packed.predicted_error if coding == "coded" else 1e-6
    assert np.linalg.norm(transfer_operator(packed).apply(lights) - expected) <= allowed * np.linalg.norm(expected)
