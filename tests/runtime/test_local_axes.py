import numpy as np
import pytest

from slepian_prt.runtime.local_axes import LocalAxes, cluster_counts, split_by_axes, variance_left


def planes(rng, count: int, dimensions: int, size: int = 200, space: int = 20):
    """Vectors on planes of some dimensions that lie apart, and the plane of each."""
    vectors, labels = [], []
    for number in range(count):
        axes = np.linalg.qr(rng.normal(size=(space, dimensions)))[0]
        vectors.append(4.0 * rng.normal(size=space) + rng.normal(size=(size, dimensions)) @ axes.T)
        labels += [number] * size
    return np.concatenate(vectors).astype(np.float32), np.array(labels)


def test_axes_are_those_of_the_singular_values(rng):
    vectors = (rng.normal(size=(300, 12)) * np.arange(12, 0, -1)).astype(np.float32)
    plane = LocalAxes.of(vectors, 5)
    centered = vectors.astype(float) - vectors.mean(axis=0, dtype=float)
    singular = np.linalg.svd(centered, compute_uv=False)
    np.testing.assert_allclose(plane.axes.T @ plane.axes, np.eye(5), atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(centered @ plane.axes, axis=0), singular[:5], rtol=1e-4)
    left = np.sum(singular[5:] ** 2)
    np.testing.assert_allclose(plane.residuals(vectors).sum(), left, rtol=1e-4)
    np.testing.assert_allclose(variance_left(vectors, 5), left, rtol=1e-4)


def test_what_lies_on_planes_is_split_by_them(rng):
    vectors, labels = planes(rng, 3, 4)
    found = split_by_axes(vectors, 3, 4, np.random.default_rng(1))
    for number in range(3):
        assert len(set(found[labels == number])) == 1
    assert len(set(found)) == 3
    left = sum(variance_left(vectors[found == number], 4) for number in range(3))
    assert left < 1e-6 * variance_left(vectors, 4)


def test_few_vectors_stay_together(rng):
    assert set(split_by_axes(rng.normal(size=(3, 4)).astype(np.float32), 5, 2, rng)) == {0}
    assert variance_left(np.ones((1, 4), dtype=np.float32), 2) == 0.0


def test_clusters_go_where_they_gain_most():
    counts = cluster_counts(np.array([8.0, 1.0, 0.0]), np.array([1000, 1000, 1000]), 8, 10)
    # Left is 8/c and 1/c: a third cluster of the first gains 1.33, the second of the second .5, …
    assert counts.tolist() == [5, 2, 1]
    # Those of few vectors are not split further.
    assert cluster_counts(np.array([8.0, 1.0]), np.array([25, 1000]), 8, 10).tolist() == [2, 6]


@pytest.mark.parametrize("count", [1, 3])
def test_a_plane_has_no_more_axes_than_vectors_tell(rng, count):
    plane = LocalAxes.of(rng.normal(size=(count, 9)).astype(np.float32), 5)
    assert plane.axes.shape == (9, count - 1)
