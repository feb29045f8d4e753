import dataclasses

import numpy as np
import pytest

from slepian_prt.compression.stream import compress
from slepian_prt.lighting.spectrum import falling_prior
from slepian_prt.relighting.factors import Factors, Joint, all_factors, drop_least
from slepian_prt.sphere.harmonics import num_coefficients
from slepian_prt.transport.transfer import precompute
from tests.conftest import bumpy


def orthonormal(rng, count: int, channels: int, size: int = 25):
    return np.linalg.qr(rng.normal(size=(channels * size, count)))[0].T.reshape(count, channels, size)


def made_up(rng, channels: int = 1, caps: int = 5):
    """Caps of many sizes, the first of them empty, with orthonormal functions."""
    sizes = [0, *rng.integers(1, 40, caps - 1).tolist()]
    ranks = rng.integers(1, 12, caps).tolist()
    return [
        Factors(rng.normal(size=(n, r)).astype(np.float32), orthonormal(rng, r, channels).astype(np.float32))
        for n, r in zip(sizes, ranks, strict=True)
    ]


def whole(part: Factors):
    return np.tensordot(part.coefficients.astype(np.float64), part.functions.astype(np.float64), 1)


@pytest.mark.parametrize("channels", [1, 3])
def test_leaving_out_keeps_to_the_energy_allowed_and_no_function_too_many(channels, rng):
    parts = made_up(rng, channels)
    fewer = drop_least(parts, 0.3)
    lost = sum(np.sum((whole(part) - whole(less)) ** 2) for part, less in zip(parts, fewer, strict=True))
    total = sum(np.sum(whole(part) ** 2) for part in parts)
    assert 0.15 < np.sqrt(lost / total) <= 0.3
    assert sum(less.coefficients.size for less in fewer) < sum(part.coefficients.size for part in parts)


def test_leaving_out_nothing_leaves_out_what_is_zero(rng):
    (part,) = made_up(rng, caps=2)[1:]
    coefficients = np.concatenate([part.coefficients, 0.0 * part.coefficients], axis=1)
    doubled = Factors(coefficients, np.concatenate([part.functions, part.functions]))
    (same,) = drop_least([doubled], 0.0)
    assert same.coefficients.shape == part.coefficients.shape
    np.testing.assert_allclose(whole(same), whole(part), rtol=0.0, atol=1e-7)


@pytest.mark.parametrize("channels", [1, 3])
def test_functions_that_are_joined_add_up_and_stay_orthonormal(channels, rng):
    functions = orthonormal(rng, 6, channels)
    # One among them, one that is partly so, two that are the same.
    more = rng.normal(size=(4, channels, 25))
    more[0], more[3] = functions[2], more[1]
    mine, added = (rng.normal(size=(30, k)).astype(np.float32) for k in (6, 4))
    both = Factors(mine, functions.astype(np.float32)).and_also(added, Joint.of(functions, more))
    assert both.coefficients.shape == (30, 6 + 2)
    rows = both.functions.reshape(8, -1).astype(np.float64)
    np.testing.assert_allclose(rows @ rows.T, np.eye(8), rtol=0.0, atol=1e-6)
    expected = np.tensordot(mine, functions, 1) + np.tensordot(added, more, 1)
    np.testing.assert_allclose(whole(both), expected, rtol=0.0, atol=1e-6 * np.abs(expected).max())
    # What came in is along principal axes: uncorrelated.
    extra = both.coefficients[:, 6:].astype(np.float64)
    product = extra.T @ extra
    assert abs(product[0, 1]) <= 1e-5 * np.trace(product)


@pytest.mark.parametrize("group_by", ["normal", "bent", "surface"])
@pytest.mark.parametrize("prior", [None, "falling"])
def test_factors_are_what_the_file_holds(prior, group_by):
    """As `reconstruct` has it, which evaluates the mean transfer at every normal; nothing where nothing is received."""
    transfer = precompute(bumpy(4), bandlimit=6, samples=64)
    packed = compress(transfer, tolerance=0.02, clusters=12, group_by=group_by, light_prior=prior and falling_prior(6))
    expected = packed.reconstruct()[:, 0].astype(np.float64)
    found = np.zeros((len(expected), 1, num_coefficients(6)))
    for part, members in zip(all_factors(packed), packed.clusters.members, strict=True):
        found[members] = whole(part)
    weights = 1.0 if packed.bases[0].weights is None else packed.bases[0].weights
    by_degree = np.repeat(weights * np.ones(7), 2 * np.arange(7) + 1)
    error = packed.predicted_error_under_prior or packed.predicted_error
    missed = (found[:, 0] - expected) * by_degree
    # A hundredth of the error, which is of the transfer with what coding lost.
    assert np.linalg.norm(missed) <= 1.1 * 0.01 * error * np.linalg.norm(expected * by_degree)


def test_factors_of_three_channels_and_two_classes_are_what_the_file_holds(rng):
    """Tints that differ from vertex to vertex; means of two classes, functions shared by caps of both."""
    transfer = precompute(bumpy(4), bandlimit=4, samples=64)
    tints = rng.uniform(0.5, 1.0, (len(transfer.vectors), 3, 1)).astype(np.float32)
    coloured = dataclasses.replace(transfer, vectors=transfer.vectors[:, :1] * tints)
    packed = compress(coloured, tolerance=0.05, clusters=6, occlusion_classes=2)
    expected = packed.reconstruct().astype(np.float64)
    assert expected.shape == (len(tints), 3, 25)
    found = np.zeros_like(expected)
    for part, members in zip(all_factors(packed), packed.clusters.members, strict=True):
        found[members] = whole(part)
    assert np.linalg.norm(found - expected) <= 1.1 * 0.01 * packed.predicted_error * np.linalg.norm(expected)
