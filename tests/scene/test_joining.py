"""Joined vertices against comparing all pairs."""

import numpy as np
import pytest

from slepian_prt.scene.formats import joining
from slepian_prt.scene.formats.joining import join_equal, join_near
from tests.numerics import assert_exact


@pytest.mark.parametrize("collide", [False, True])
@pytest.mark.parametrize("seed", range(5))
def test_equal_rows_are_one(seed, collide, monkeypatch):
    rng = np.random.default_rng(seed)
    rows = rng.choice([-1.5, -0.0, 0.0, 2.0**-1074, 1e300], size=(200, 3))
    if collide:
        whole = joining.group
        calls = []

        def collided(keys):
            calls.append(0)
            return whole(keys if len(calls) > 1 else keys % 7)

        monkeypatch.setattr(joining, "group", collided)
    first, joined = join_equal(rows[:, :1], rows[:, 1:])
    same = np.all(rows[:, None] == rows[None], axis=2)
    assert_exact(first[joined], np.argmax(same, axis=1), "indices: the first row that is equal")
    assert_exact(first, np.unique(first), "in the order of the rows")


def test_no_rows():
    first, joined = join_equal(np.empty((0, 3)))
    assert len(first) == len(joined) == 0


@pytest.mark.parametrize("seed", range(5))
def test_near_vertices_are_one(seed):
    rng = np.random.default_rng(seed)
    centers = rng.random((30, 3))
    which = rng.integers(30, size=300)
    positions = centers[which] + rng.uniform(-1e-7, 1e-7, (300, 3))
    first, joined = join_near(positions, np.empty((0, 3), dtype=np.int64), 4e-7)
    assert_exact(which[first[joined]], which, "indices: clusters are far apart")
    assert len(first) == len(np.unique(which))


def test_chains_stay_within_the_tolerance():
    positions = np.column_stack([np.arange(200) * 0.5, np.zeros(200), np.zeros(200)])
    first, joined = join_near(positions, np.empty((0, 3), dtype=np.int64), 0.75)
    assert np.abs(positions[first[joined]] - positions).max() <= 0.75
    assert len(first) < 200


def test_corners_of_a_triangle_stay_apart():
    positions = np.array([[0.0, 0, 0], [0, 0, 1e-3], [0, 1e-3, 0], [1e-3, 0, 0], [5, 5, 5], [5, 5, 5.001]])
    _, joined = join_near(positions, np.array([[0, 1, 2]]), 0.1)
    assert len(set(joined[:3].tolist())) == 3
    assert joined[3] in joined[:3]
    assert joined[4] == joined[5]
