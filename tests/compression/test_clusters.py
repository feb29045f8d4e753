import numpy as np
import pytest

from slepian_prt.compression.clusters import cluster_axes
from slepian_prt.sphere.caps import angular_distance
from tests.conftest import random_directions


@pytest.mark.parametrize("count", [1, 2, 24, 96])
def test_caps_hold_their_normals(count, rng):
    normals = random_directions(rng, 3000)
    clusters = cluster_axes(normals, count)
    assert len(clusters.caps) == count
    for cap, members in zip(clusters.caps, clusters.members, strict=True):
        assert members.size > 0
        assert angular_distance(normals[members], cap.center).max() <= cap.half_angle + 1e-7  # they count in float32
    if count == 96:
        # 96 equal caps of the sphere have about 12°; the cells of k-means are up to twice as wide.
        assert max(cap.half_angle for cap in clusters.caps) < np.radians(24)
    np.testing.assert_array_equal(np.sort(np.concatenate(clusters.members)), np.arange(3000))


def test_deterministic(rng):
    normals = random_directions(rng, 500)
    np.testing.assert_array_equal(cluster_axes(normals, 12).index, cluster_axes(normals, 12).index)


def test_plane_is_one_cap_of_no_size():
    clusters = cluster_axes(np.tile([0.0, 0.6, 0.8], (50, 1)), 8)
    assert len(clusters.caps) == 1
    assert clusters.caps[0].half_angle <= 1e-15


def test_more_clusters_than_normals():
    normals = np.repeat(np.eye(3), 4, axis=0)
    clusters = cluster_axes(normals, 24)
    assert len(clusters.caps) == 3


def test_vertices_without_a_normal_do_not_widen_caps(rng):
    normals = random_directions(rng, 100)
    normals[::10] = 0.0
    clusters = cluster_axes(normals, 6)
    lit = normals.any(axis=1)
    assert (clusters.index[~lit] == 0).all()
    np.testing.assert_array_equal(clusters.index[lit], cluster_axes(normals[lit], 6).index)


@pytest.mark.parametrize("count", [0, -1, 2.5])
def test_bad_count(count):
    with pytest.raises(ValueError, match="clusters must be a positive integer"):
        cluster_axes(np.eye(3), count)


def test_no_normal():
    with pytest.raises(ValueError, match="at least one"):
        cluster_axes(np.zeros((4, 3)), 2)
