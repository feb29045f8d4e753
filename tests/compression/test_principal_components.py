import numpy as np
import pytest

from slepian_prt.compression.clustering import cluster_axes
from slepian_prt.compression.principal_components import iterate_clusters, pca_candidates
from slepian_prt.compression.stream import compress
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
    vectors = packed.reconstruct()[:, 0]
    for members in clusters.members:
        own = shadowed.vectors[members, 0].astype(np.float64)
        centred = own - own.mean(axis=0)
        tail = np.linalg.svd(centred, compute_uv=False)[4:]
        lost = np.linalg.norm(vectors[members] - own)
        assert lost == pytest.approx(np.sqrt((tail**2).sum()), rel=1e-3)


def test_iterated_clusters_lower_the_error(shadowed):
    clusters = cluster_axes(shadowed.normals, 24)
    reference = shadowed.vectors[:, 0]
    plain = error(compress(shadowed, "pca", terms=6, clusters=clusters).reconstruct()[:, 0], reference)
    iterated = compress(shadowed, "cpca", terms=6, clusters=clusters)
    assert error(iterated.reconstruct()[:, 0], reference) < 0.9 * plain
    assert iterated.predicted_error == pytest.approx(error(iterated.reconstruct()[:, 0], reference), rel=1e-3)
    again = iterate_clusters(clusters, shadowed.normals, shadowed.vectors, 6)
    assert_exact(again.index, iterated.clusters.index, because="indices, by the same calls")


def test_second_stage_comes_close_to_pca(shadowed):
    reference = shadowed.vectors[:, 0]
    for terms in (4, 9, 16):
        ours, pca = (
            compress(shadowed, basis, terms=terms, clusters=12, refine=refine)
            for basis, refine in (("adapted", True), ("pca", None))
        )
        errors = [error(p.reconstruct()[:, 0], reference) for p in (ours, pca)]
        assert errors[0] <= 1.05 * errors[1]
        assert errors[0] >= 0.999 * errors[1]  # nothing linear is better
        assert ours.predicted_error == pytest.approx(errors[0], rel=0.05)


def test_lost_by_degree_adds_up(shadowed):
    clusters = cluster_axes(shadowed.normals, 4)
    for candidate in pca_candidates(6, clusters, shadowed.vectors):
        assert candidate.lost(0).sum() == pytest.approx(candidate.total, rel=1e-9)
        for k in (1, 5, 20):
            assert candidate.lost(k).sum() == pytest.approx(candidate.total - candidate.energies[:k].sum(), rel=1e-6)
