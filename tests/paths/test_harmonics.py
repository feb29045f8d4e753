"""Spherical harmonics and sums over paths on Mitsuba's arrays, against NumPy."""

from types import SimpleNamespace

import numpy as np
import pytest

from slepian_prt.paths import harmonics
from slepian_prt.paths.harmonics import sh_values, sum_paths
from slepian_prt.renderer.variants import imported_mitsuba
from slepian_prt.sphere.harmonics import degrees, real_sh
from tests.numerics import assert_rounded
from tests.variants import VARIANT


@pytest.fixture(scope="module")
def mi():
    module = imported_mitsuba()
    module.set_variant(VARIANT)
    return module


def directions(count):
    """Unit vectors in float32, poles and axes among them."""
    vectors = np.random.default_rng(1).normal(size=(count, 3))
    vectors[:6] = [[0, 0, 1], [0, 0, -1], [1, 0, 0], [0, -1, 0], [1e-4, 0, 1], [0, 1e-6, -1]]
    return (vectors / np.linalg.norm(vectors, axis=1, keepdims=True)).astype(np.float32)


@pytest.mark.parametrize("bandlimit", [0, 1, 10, 50])
def test_values_are_those_of_the_sphere(bandlimit, mi):
    vectors = directions(500)
    ours = np.array([np.array(values) for values in sh_values(mi, bandlimit, mi.Vector3f(vectors.T))]).T
    wanted = real_sh(bandlimit, vectors.astype(np.float64))
    # A vector of float32 is off unit length by ε, and y_lm of degree l by l times as much; the recurrence adds up the
    # rounding of its l steps, each at most √(l+1)/2 times the value.
    steps = (degrees(bandlimit) + 1.0) * (degrees(bandlimit) + 2.0)
    assert np.all(np.abs(ours - wanted) <= np.finfo(np.float32).eps * steps * np.sqrt((2 * degrees(bandlimit) + 1) / 2))


@pytest.mark.parametrize("per_receiver", [1, 7, 64])
def test_sums_are_those_of_numpy(per_receiver, mi):
    rng, bandlimit, count = np.random.default_rng(2), 4, 5
    vectors, escaped = directions(count * per_receiver + 6)[6:], rng.random(count * per_receiver) < 0.7
    throughput = rng.random((count * per_receiver, 3)).astype(np.float32)
    ends = SimpleNamespace(
        escaped=mi.Bool(escaped), throughput=mi.Color3f(throughput.T), ray=SimpleNamespace(d=mi.Vector3f(vectors.T))
    )
    sums = sum_paths(mi, bandlimit, ends, per_receiver)
    counted = np.where(escaped[:, None], throughput, 0.0).reshape(count, per_receiver, 3).astype(np.float64)
    values = real_sh(bandlimit, vectors.astype(np.float64)).reshape(count, per_receiver, -1)
    terms = per_receiver + 2 * (bandlimit + 1) * (bandlimit + 2)
    largest = float((np.abs(counted[..., None]) * np.abs(values[:, :, None])).sum(axis=1).max())
    assert_rounded(sums.vectors, np.einsum("npc,npm->ncm", counted, values).astype(np.float32), terms, largest)
    assert_rounded(sums.squares, np.square(counted).sum(axis=1).astype(np.float32), terms)


@pytest.mark.parametrize("numbers", [1, 1 << 26])
@pytest.mark.parametrize("bandlimit", [0, 4])
def test_products_and_loops_are_the_same_sums(bandlimit, numbers, mi, monkeypatch):
    """One receiver at a time, or all of them."""
    monkeypatch.setattr(harmonics, "_NUMBERS", numbers)
    rng, count, per_receiver = np.random.default_rng(3), 5, 12
    carried = mi.Color3f(rng.random((3, count * per_receiver)).astype(np.float32))
    direction = mi.Vector3f(directions(count * per_receiver).T)
    wanted, found = (
        by(mi, bandlimit, carried, direction, per_receiver)
        for by in (harmonics.sum_by_loops, harmonics.sum_by_products)
    )
    for one, other in zip(found, wanted, strict=True):
        assert one.shape == other.shape
        assert_rounded(one, other, per_receiver, size=float(per_receiver) * (bandlimit + 1))
