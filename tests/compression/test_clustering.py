import numpy as np
import pytest

from slepian_prt.compression.clustering import (
    Clusters,
    cluster_axes,
    cluster_by_occlusion,
    cluster_surface,
    clusters_of_sites,
    typical_half_angle,
)
from slepian_prt.scene.mesh import make_mesh
from slepian_prt.sphere.caps import Cap, angular_distance
from tests.conftest import bumpy, random_directions, sphere
from tests.numerics import assert_exact


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
    assert_exact(np.sort(np.concatenate(clusters.members)), np.arange(3000), because="integers")


def test_deterministic(rng):
    normals = random_directions(rng, 500)
    assert_exact(cluster_axes(normals, 12).index, cluster_axes(normals, 12).index, because="integers")


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
    assert_exact(clusters.index[lit], cluster_axes(normals[lit], 6).index, because="integers")


@pytest.mark.parametrize("count", [0, -1, 2.5])
def test_bad_count(count):
    with pytest.raises(ValueError, match="clusters must be a positive integer"):
        cluster_axes(np.eye(3), count)


def test_no_normal():
    with pytest.raises(ValueError, match="at least one"):
        cluster_axes(np.zeros((4, 3)), 2)


def test_the_index_is_told_from_normals_in_float32_alone(rng):
    """Also for normals half-way between sites: whole numbers do not depend on who adds them up."""
    normals = random_directions(rng, 5000)
    clusters = cluster_axes(normals, 48)
    again = clusters_of_sites(clusters.sites, normals.astype(np.float32).astype(np.float64))
    assert_exact(again.index, clusters.index, because="integers")
    sites = np.array([[1 << 14, 0, 0], [0, 1 << 14, 0]], dtype=np.int16)
    half_way = np.array([[1.0, 1.0, 0.3]]) / np.sqrt(2.09)
    assert clusters_of_sites(sites, half_way).index.tolist() == [0]


def test_a_typical_cap_is_one_that_receives_light():
    """Half-angles 0.1, 0.2, 0.9 and 0.3, the third of vertices without light, and a fourth of none at all."""
    caps = tuple(Cap(np.array([0.0, 0.0, 1.0]), half_angle) for half_angle in (0.1, 0.2, 0.9, 0.3))
    clusters = Clusters.of_one_class(np.array([0, 0, 1, 2, 1], dtype=np.int32), caps)
    active = np.array([True, True, True, False, False])
    assert typical_half_angle(clusters, active) == pytest.approx(0.15, rel=1e-15)
    assert typical_half_angle(clusters, ~active) == pytest.approx(0.55, rel=1e-15)
    assert typical_half_angle(clusters, np.zeros(5, dtype=bool)) == 0.0


def test_surface_patches_are_connected_and_even(rng):
    mesh = bumpy(4)
    clusters = cluster_surface(mesh.receivers, mesh.normals, 24)
    assert len(clusters.caps) == 24
    assert clusters.sizes.max() < 3 * clusters.sizes.mean()
    for cap, members in zip(clusters.caps, clusters.members, strict=True):
        inside = np.isin(mesh.faces, members).all(axis=1)
        reached, grew = {int(members[0])}, True
        while grew:
            faces = mesh.faces[inside & np.isin(mesh.faces, list(reached)).any(axis=1)]
            grew = not set(faces.ravel().tolist()) <= reached
            reached |= set(faces.ravel().tolist())
        # Cells are connected along edges; a vertex may hang on by an edge whose faces belong to others too.
        assert len(reached) > 0.9 * members.size
        assert angular_distance(mesh.normals[members], cap.center).max() <= cap.half_angle + 1e-7


def test_surface_patches_of_pieces_and_unused_vertices():
    ball = sphere(1)
    positions = np.concatenate([ball.positions, ball.positions + 9.0, [[50.0, 0, 0]]])
    mesh = make_mesh(positions, np.concatenate([ball.faces, ball.faces + len(ball.positions)]))
    clusters = cluster_surface(mesh.receivers, mesh.normals, 1)
    assert_exact(clusters.index, 0, because="integers")
    many = cluster_surface(mesh.receivers, mesh.normals, 500)
    assert len(many.caps) <= 84
    assert many.index.min() == 0


def test_occlusion_classes_are_even_and_ordered(rng):
    normals, openness = random_directions(rng, 4000), rng.random(4000)
    clusters = cluster_by_occlusion(normals, openness, 4, 6)
    kinds = clusters.occlusion_classes[clusters.index]
    assert np.bincount(kinds).tolist() == [1000] * 4
    assert all(openness[kinds == k].max() <= openness[kinds == k + 1].min() for k in range(3))
    assert np.bincount(clusters.occlusion_classes).tolist() == [6] * 4
    same = cluster_by_occlusion(normals, np.ones(4000), 4, 6)
    assert set(same.occlusion_classes) == {0}


def test_bent_normals_point_to_the_light():
    """Unshadowed, they are the normals; half of the sky blocked, they turn away from that half."""
    from slepian_prt.compression.grouping import bent_normals
    from slepian_prt.transport.direct import unoccluded_transfer

    normals = np.array([[0.0, 0.0, 1.0], [0.6, 0.0, 0.8], [0.0, -1.0, 0.0]])
    np.testing.assert_allclose(bent_normals(unoccluded_transfer(2, normals), normals), normals, atol=1e-6)
    dark = np.zeros((3, 9), dtype=np.float32)
    assert_exact(bent_normals(dark, normals), normals, because="a copy")
