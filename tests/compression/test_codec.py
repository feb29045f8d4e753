import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import csr_array

from slepian_prt.compression import codec
from slepian_prt.compression.compressed import compress
from slepian_prt.scene.meshes import morton
from slepian_prt.transport.transfer import precompute
from tests.conftest import bumpy, sphere


def grid(n: int) -> csr_array:
    """Who is next to whom along a line of n vertices and five further on, as on a strip of a mesh."""
    i = np.arange(n)
    pairs = [(i[:-s], i[s:]) for s in (1, 5) if n > s]
    a = np.concatenate([np.zeros(0, int), *(p for p, _ in pairs)])
    b = np.concatenate([np.zeros(0, int), *(q for _, q in pairs)])
    return csr_array((np.ones(2 * a.size, np.int32), (np.r_[a, b], np.r_[b, a])), shape=(n, n))


def lossless(quantised: list[np.ndarray], near: list[csr_array]) -> codec.Coded:
    coded = codec.encode(quantised, near)
    for before, after in zip(quantised, codec.decode(coded, near), strict=True):
        np.testing.assert_array_equal(before, after)
    return coded


@given(st.lists(st.tuples(st.integers(1, 70), st.integers(1, 12)), min_size=1, max_size=4), st.integers(0, 2**32 - 1))
@settings(max_examples=60, deadline=None)
def test_any_integers_come_back(shapes, seed):
    rng = np.random.default_rng(seed)
    scale = 10.0 ** rng.uniform(-2, 5)
    quantised = [np.rint(scale * rng.standard_t(2, size=shape)).astype(np.int32) for shape in shapes]
    lossless(quantised, [grid(n) for n, _ in shapes])


@pytest.mark.parametrize("value", [0, 1, -7, 96, 97, -5000, 2**30])
def test_constants_and_escapes(value):
    lossless([np.full((50, 3), value, dtype=np.int32)], [grid(50)])


def test_one_vertex_no_neighbours_and_zeros():
    lossless([np.array([[3, -2, 0]], dtype=np.int32)], [grid(1)])
    lossless([np.arange(40, dtype=np.int32).reshape(20, 2)], [csr_array((20, 20), dtype=np.int32)])
    coded = lossless([np.zeros((30, 4), dtype=np.int32)], [grid(30)])
    assert coded.caps[0].words.size == 0  # what is zero everywhere costs nothing


def test_close_to_the_entropy_where_nothing_can_be_predicted(rng):
    q = np.rint(rng.normal(scale=3.0, size=(20_000, 4))).astype(np.int32)
    coded = lossless([q], [csr_array((20_000, 20_000), dtype=np.int32)])
    counts = np.bincount((q - q.min()).ravel())
    p = counts[counts > 0] / q.size
    entropy = -(p * np.log2(p)).sum() * q.size
    assert coded.caps[0].words.size * 32 <= 1.02 * entropy


def test_prediction_pays_on_smooth_data(rng):
    n = 20_000
    smooth = np.cumsum(rng.normal(size=(n, 2)), axis=0)
    q = np.rint(smooth).astype(np.int32)
    with_neighbours = lossless([q], [grid(n)]).caps[0].words.size
    shuffled = rng.permutation(n)
    without = codec.encode([q[shuffled]], [csr_array((n, n), dtype=np.int32)]).caps[0].words.size
    assert with_neighbours < 0.5 * without


@pytest.mark.parametrize("error", [0.3, 0.05, 1e-3])
def test_step_for_meets_the_energy(error, rng):
    coefficients = [rng.normal(size=(300, 5)) * [3, 1, 0.3, 0.1, 0.01], rng.normal(size=(100, 2))]
    total = sum(float((c**2).sum()) for c in coefficients)
    step = codec.step_for(coefficients, error**2 * total)
    lost = sum(float(((c - step * codec.quantise(c, step)) ** 2).sum()) for c in coefficients)
    assert math.sqrt(lost / total) == pytest.approx(error, rel=0.03)
    assert math.sqrt(lost / total) <= error * 1.01


def test_morton_keeps_neighbours_near(rng):
    points = rng.random((4000, 3))
    order = np.argsort(morton(points))
    along = np.linalg.norm(np.diff(points[order], axis=0), axis=1).mean()
    anyhow = np.linalg.norm(np.diff(points, axis=0), axis=1).mean()
    assert along < 0.25 * anyhow
    assert morton(np.zeros((3, 3))).tolist() == [0, 0, 0]


def test_decoding_needs_only_the_caps_own_words():
    transfer = precompute(bumpy(4), bandlimit=5, samples=64)
    packed = compress(transfer, tolerance=0.1, clusters=5)
    order = codec.surface_order(packed.mesh.positions, packed.clusters.members)
    pattern = codec.adjacency(packed.mesh.faces, len(packed.mesh.positions))
    near = [pattern[m][:, m] for m in order]
    quantised = [
        codec.quantise(c[np.searchsorted(m, along)], packed.step)
        for c, m, along in zip(packed.coefficients, packed.clusters.members, order, strict=True)
    ]
    coded = codec.encode(quantised, near)
    alone = codec.Coded((coded.caps[3],), coded.histograms, coded.shrink)
    np.testing.assert_array_equal(codec.decode(alone, [near[3]])[0], quantised[3])


def test_coded_is_far_smaller_than_float16_at_the_same_error():
    transfer = precompute(bumpy(5), bandlimit=8, samples=256)
    reference = transfer.vectors[:, 0]
    coded = compress(transfer, tolerance=0.05, clusters=24)
    plain = compress(transfer, tolerance=0.05, clusters=24, coding="float16")
    for packed in (coded, plain):
        error = np.linalg.norm(packed.reconstruct() - reference) / np.linalg.norm(reference)
        assert error == pytest.approx(0.05, rel=0.1)
    assert coded.bytes_per_vertex < 0.4 * plain.bytes_per_vertex


def test_convex_mesh_needs_next_to_nothing():
    transfer = precompute(sphere(5), bandlimit=6, samples=16)
    packed = compress(transfer, tolerance=0.05, clusters=24)
    error = np.linalg.norm(packed.reconstruct() - transfer.vectors[:, 0]) / np.linalg.norm(transfer.vectors)
    assert error <= 0.055
    assert packed.bytes_per_vertex < 3.0
