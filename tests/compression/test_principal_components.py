import math

import numpy as np
import pytest

from slepian_prt.compression.baselines import cube_texels, haar_faces, haar_transfer
from slepian_prt.compression.clustering import cluster_axes
from slepian_prt.compression.principal_components import iterate_clusters, pca_candidates
from slepian_prt.compression.stream import compress
from slepian_prt.sphere.harmonics import real_sh
from slepian_prt.transport.transfer import precompute
from tests.conftest import bumpy
from tests.numerics import assert_exact


@pytest.fixture(scope="module")
def shadowed():
    return precompute(bumpy(4), bandlimit=6, samples=256)


def error(vectors, reference) -> float:
    return float(np.linalg.norm(vectors - reference) / np.linalg.norm(reference))


def test_pca_is_the_best_basis_of_each_cap(shadowed):
    """Against numpy's SVD of each cluster by itself."""
    clusters = cluster_axes(shadowed.normals, 6)
    packed = compress(shadowed, "pca", terms=5, clusters=clusters)
    vectors = packed.reconstruct()
    for members in clusters.members:
        own = shadowed.vectors[members, 0].astype(np.float64)
        centred = own - own.mean(axis=0)
        tail = np.linalg.svd(centred, compute_uv=False)[4:]
        lost = np.linalg.norm(vectors[members] - own)
        assert lost == pytest.approx(np.sqrt((tail**2).sum()), rel=1e-3)


def test_iterated_clusters_lower_the_error(shadowed):
    clusters = cluster_axes(shadowed.normals, 24)
    reference = shadowed.vectors[:, 0]
    plain = error(compress(shadowed, "pca", terms=6, clusters=clusters).reconstruct(), reference)
    iterated = compress(shadowed, "cpca", terms=6, clusters=clusters)
    assert error(iterated.reconstruct(), reference) < 0.9 * plain
    assert iterated.predicted_error == pytest.approx(error(iterated.reconstruct(), reference), rel=1e-3)
    again = iterate_clusters(clusters, shadowed.normals, shadowed.vectors, 6)
    assert_exact(again.index, iterated.clusters.index, because="indices, by the same calls")


def test_second_stage_comes_close_to_pca(shadowed):
    reference = shadowed.vectors[:, 0]
    for terms in (4, 9, 16):
        ours, pca = (
            compress(shadowed, basis, terms=terms, clusters=12, refine=refine)
            for basis, refine in (("adapted", True), ("pca", None))
        )
        errors = [error(p.reconstruct(), reference) for p in (ours, pca)]
        assert errors[0] <= 1.05 * errors[1]
        assert errors[0] >= 0.999 * errors[1]  # nothing linear is better
        assert ours.predicted_error == pytest.approx(errors[0], rel=0.05)


def test_lost_by_degree_adds_up(shadowed):
    clusters = cluster_axes(shadowed.normals, 4)
    for candidate in pca_candidates(6, clusters, shadowed.vectors):
        assert candidate.lost(0).sum() == pytest.approx(candidate.total, rel=1e-9)
        for k in (1, 5, 20):
            assert candidate.lost(k).sum() == pytest.approx(candidate.total - candidate.energies[:k].sum(), rel=1e-6)


# --- Wavelets --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("side", [2, 8, 16])
def test_texels_cover_the_sphere(side):
    directions, solid_angles = cube_texels(side)
    assert solid_angles.sum() == pytest.approx(4.0 * math.pi, rel=1e-12)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0)
    np.testing.assert_allclose(solid_angles @ directions, 0.0, atol=1e-12)
    assert len(np.unique(directions.round(9), axis=0)) == 6 * side * side


def test_texels_integrate(rng):
    directions, solid_angles = cube_texels(64)
    y = real_sh(3, directions)
    np.testing.assert_allclose(y.T @ (solid_angles[:, None] * y), np.eye(16), atol=2e-3)


def test_haar_is_orthonormal():
    basis = haar_faces(np.eye(6 * 16).reshape(6, 4, 4, 96)).reshape(96, 96)
    np.testing.assert_allclose(basis @ basis.T, np.eye(96), atol=1e-14)
    constant = haar_faces(np.ones((6, 8, 8)))
    assert np.count_nonzero(np.abs(constant) > 1e-12) == 6


def test_all_wavelets_give_all(shadowed):
    reference = shadowed.vectors[:, 0]
    whole = haar_transfer(shadowed.vectors, 6 * 64, shadowed.mesh.albedo)
    assert error(whole.reconstruct(), reference) < 0.02  # 8 bits each
    errors = [
        error(haar_transfer(shadowed.vectors, k, shadowed.mesh.albedo).reconstruct(), reference) for k in (4, 16, 64)
    ]
    assert errors[0] > errors[1] > errors[2]
    # Values of 8 bits, places of 9 (384 wavelets), and one scale.
    assert haar_transfer(shadowed.vectors, 16, shadowed.mesh.albedo).bytes_per_vertex == (16 * 17 + 16) / 8


def test_wavelets_relight(shadowed, rng):
    packed = haar_transfer(shadowed.vectors, 20, shadowed.mesh.albedo)
    light = rng.normal(size=(3, 49))
    expected = packed.reconstruct() @ light.T.astype(np.float32)
    np.testing.assert_allclose(packed.radiance(light), expected, atol=1e-5 * np.abs(expected).max())
