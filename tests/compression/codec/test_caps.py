import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slepian_prt.compression.clustering import cluster_axes
from slepian_prt.compression.codec import caps as codec
from slepian_prt.compression.codec import entropy
from slepian_prt.compression.codec.prediction import octave_parts
from slepian_prt.compression.codec.surface import Surface
from slepian_prt.compression.codec.tuning import tune
from slepian_prt.compression.decoder import decode
from slepian_prt.compression.stream import compress
from slepian_prt.scene.mesh import Mesh, make_mesh
from slepian_prt.scene.receivers import morton
from slepian_prt.transport.transfer import precompute
from tests.conftest import bumpy, sphere
from tests.numerics import assert_exact


def cloud(n: int) -> Mesh:
    """Vertices without any face, so that nothing but the curve tells of neighbours."""
    rng = np.random.default_rng(n)
    positions = rng.random((n, 3))
    return Mesh("cloud", positions, np.zeros((n, 3)), np.zeros((0, 3), np.int32), np.ones((n, 3), np.float32))


def along(mesh: Mesh):
    return Surface(mesh.receivers).cap(np.arange(len(mesh.positions)))


def assert_comes_back(x: np.ndarray, surface, step: float, *, axes: bool | None = False) -> codec.EncodedCap:
    """Encode and decode; the decoder must have just what the encoder thought."""
    tuning = tune([(x, surface)], step**2 / 12.0 * x.size)
    tuning = replace(tuning, step=step)
    coded = codec.encode_cap(x, surface, tuning, principal_axes=axes, keep=True)
    decoded = codec.decode_cap(coded.words, x.shape[1], surface, tuning)
    assert_exact(decoded.multiples, coded.decoded.multiples, because="integers")
    values = decoded.coefficients(step)
    assert float(np.sum((values - x) ** 2)) == pytest.approx(coded.distortion, rel=1e-9, abs=1e-12 * step**2)
    if not coded.principal_axes:
        # Every value is within half a step, or within the dead zone, of the truth.
        assert np.abs(values - x).max(initial=0.0) <= entropy.DEAD_ZONE * step * (1 + 1e-9)
    return coded


@given(st.integers(1, 300), st.integers(1, 12), st.sampled_from([False, True, None]), st.integers(0, 2**32 - 1))
@settings(max_examples=60, deadline=None)
def test_any_coefficients_come_back(count, width, axes, seed):
    rng = np.random.default_rng(seed)
    x = rng.standard_t(2, size=(count, width)) * 10.0 ** rng.uniform(-3, 3, size=width)
    assert_comes_back(x, along(cloud(count)), 10.0 ** rng.uniform(-3, 1), axes=axes)


@pytest.mark.parametrize("value", [0.0, 1.0, -7.0, 96.0, 97.0, -5000.0, 2.0**24, -(2.0**24)])
def test_constants_and_escapes(value):
    assert_comes_back(np.full((50, 3), value), along(cloud(50)), 1.0)


def test_nothing_costs_next_to_nothing():
    coded = assert_comes_back(np.zeros((3000, 40)), along(cloud(3000)), 1.0)
    assert coded.words.size <= 1
    assert coded.used == 0


def test_close_to_the_entropy_where_nothing_can_be_predicted(rng):
    """Independent numbers: within 6 % of the entropy of rounding them by themselves (models are fixed, not fitted)."""
    x = rng.laplace(scale=3.0, size=(20_000, 4))
    coded = assert_comes_back(x, along(cloud(20_000)), 1.0)
    counts = np.bincount(np.rint(x).astype(int).ravel() + 200)
    p = counts[counts > 0] / x.size
    assert coded.words.size * 32 <= 1.06 * -(p * np.log2(p)).sum() * x.size


def test_prediction_pays_on_smooth_data():
    mesh = bumpy(5)
    smooth = np.sin(mesh.positions @ np.random.default_rng(0).normal(size=(3, 4)))
    apart = Mesh(mesh.name, mesh.positions[::-1], mesh.normals, np.zeros((0, 3), np.int32), mesh.albedo)
    with_neighbours, without = along(mesh), along(apart)
    shuffled = np.random.default_rng(1).permutation(len(smooth))
    known = assert_comes_back(smooth[with_neighbours.order], with_neighbours, 0.01).words.size
    unknown = assert_comes_back(smooth[shuffled], without, 0.01).words.size
    assert known < 0.3 * unknown


def test_axes_pay_where_coefficients_go_together(rng):
    """Ten coefficients that are one number in truth."""
    mesh = bumpy(4)
    surface = along(mesh)
    x = rng.normal(size=(len(mesh.positions), 1)) * rng.normal(size=10)
    along_axes, plain = (assert_comes_back(x, surface, 0.05, axes=axes) for axes in (None, False))
    assert along_axes.principal_axes
    assert along_axes.words.size < 0.3 * plain.words.size
    assert along_axes.distortion < 1.1 * plain.distortion


@pytest.mark.parametrize("error", [0.5, 0.1, 0.01])
def test_tuning_meets_the_distortion(error, rng):
    mesh = bumpy(4)
    surface = along(mesh)
    x = rng.normal(size=(len(mesh.positions), 5)) * [3, 1, 0.3, 0.1, 0.01]
    wanted = error**2 * float((x**2).sum())
    tuning = tune([(x, surface)], wanted)
    got = codec.encode_cap(x, surface, tuning, principal_axes=False).distortion
    # Bisection of an interval of an octave, six times: the step is within 1.1 %.
    assert 0.96 * wanted <= got <= wanted


def test_models_are_distributions_and_ordered():
    table = entropy.probabilities()
    np.testing.assert_allclose(table.sum(axis=1), 1.0, rtol=1e-14)
    assert (table > 2.0**-24).all()
    sizes = np.abs(np.arange(table.shape[1]) - entropy.LARGEST)
    assert (np.diff(table @ sizes) > 0).all()
    np.testing.assert_allclose(table[:, : entropy.LARGEST], table[:, 2 * entropy.LARGEST : entropy.LARGEST : -1])


def test_roots_of_two_are_right():
    np.testing.assert_allclose(octave_parts(-8, 17, 4), 2.0 ** (np.arange(-8, 9) / 4), rtol=3e-16)
    np.testing.assert_allclose(octave_parts(-19, 40, 2), 2.0 ** (np.arange(-19, 21) / 2), rtol=3e-16)


def test_morton_keeps_neighbours_near(rng):
    points = rng.random((4000, 3))
    order = np.argsort(morton(points))
    near = np.linalg.norm(np.diff(points[order], axis=0), axis=1).mean()
    anyhow = np.linalg.norm(np.diff(points, axis=0), axis=1).mean()
    assert near < 0.25 * anyhow
    assert morton(np.zeros((3, 3))).tolist() == [0, 0, 0]


@pytest.mark.parametrize("mesh", [bumpy(3), sphere(2), make_mesh(np.eye(3), [[0, 1, 2]]), cloud(1), cloud(2)])
def test_every_vertex_is_told_from_earlier_ones(mesh):
    surface = along(mesh)
    assert_exact(np.sort(surface.order), np.arange(len(mesh.positions)), because="integers")
    known = {0}
    for level in surface.levels:
        assert set(level.sources.nonzero()[1].tolist()) <= known
        assert (level.totals > 0).all()
        assert_exact(level.totals, level.sources.toarray().sum(axis=1), because="integers")
        known |= set(level.rows.tolist())
    assert known == set(range(len(mesh.positions)))


def test_a_fan_of_very_many_triangles_takes_little_memory():
    n = 20_000
    angle = np.linspace(0.0, 2.0 * math.pi, n, endpoint=False)
    ring = np.stack([np.cos(angle), np.sin(angle), np.zeros(n)], axis=1)
    i = np.arange(n)
    faces = np.stack([np.full(n, n), i, (i + 1) % n], axis=1)
    surface = along(make_mesh(np.concatenate([ring, np.zeros((1, 3))]), faces))
    assert sum(level.sources.nnz for level in surface.levels) <= 8 * n


def test_decoding_needs_only_the_caps_own_words():
    transfer = precompute(bumpy(4), bandlimit=5, samples=64)
    packed = compress(transfer, tolerance=0.1, clusters=5)
    third = decode(packed, 3)
    words = [np.zeros(0, np.uint32)] * 5
    words[3] = packed.coded.words[3]
    alone = replace(packed, coded=replace(packed.coded, words=tuple(words)))
    assert_exact(decode(alone, 3).values, third.values, because="whole multiples of the step")


def test_words_of_another_cap_are_refused_or_differ():
    """Streams hold no room for what does not belong: cut or changed words end in an error, not in a crash."""
    transfer = precompute(bumpy(3), bandlimit=4, samples=64)
    packed = compress(transfer, tolerance=0.005, clusters=3)
    surface = Surface(packed.mesh.receivers).cap(packed.clusters.members[0])
    words = packed.coded.words[0]
    rng = np.random.default_rng(1)
    for _ in range(50):
        spoiled = words.copy()[: int(rng.integers(1, words.size + 1))]
        spoiled[rng.integers(spoiled.size)] ^= np.uint32(1 << rng.integers(32))
        try:
            decoded = codec.decode_cap(spoiled, packed.bases[0].count, surface, packed.coded.tuning)
        except (ValueError, AssertionError):
            continue
        assert decoded.multiples.shape[0] == len(surface.order)


@pytest.mark.slow
def test_coded_is_far_smaller_than_float16_at_the_same_error():
    transfer = precompute(bumpy(5), bandlimit=8, samples=256)
    reference = transfer.vectors[:, 0]
    coded = compress(transfer, tolerance=0.05, clusters=24)
    plain = compress(transfer, tolerance=0.05, clusters=24, coding="float16")
    for packed in (coded, plain):
        error = np.linalg.norm(packed.reconstruct() - reference) / np.linalg.norm(reference)
        assert error == pytest.approx(0.05, rel=0.1)
    assert coded.bytes_per_vertex < 0.1 * plain.bytes_per_vertex


def test_convex_mesh_needs_next_to_nothing():
    """What the normal tells is all there is."""
    transfer = precompute(sphere(5), bandlimit=6, samples=16)
    packed = compress(transfer, tolerance=0.01, clusters=24)
    error = np.linalg.norm(packed.reconstruct() - transfer.vectors[:, 0]) / np.linalg.norm(transfer.vectors)
    assert error <= 1e-3
    assert packed.bytes_per_vertex * len(packed.mesh.positions) < 3000  # frames and functions, no coefficients


def test_order_of_caps_does_not_matter_for_the_same_mesh():
    mesh = bumpy(4)
    clusters = cluster_axes(mesh.normals, 6)
    whole = Surface(mesh.receivers)
    again = [whole.cap(clusters.members[c]) for c in (5, 0)]
    for c, surface in zip((5, 0), again, strict=True):
        fresh = Surface(mesh.receivers).cap(clusters.members[c])
        assert_exact(fresh.order, surface.order, because="integers")
        for a, b in zip(fresh.levels, surface.levels, strict=True):
            assert_exact(a.sources.toarray(), b.sources.toarray(), because="integers")
