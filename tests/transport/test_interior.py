"""Dark vertices inside other geometry, and what fills them."""

import numpy as np
import pytest
import trimesh

from slepian_prt.scene.loading import open_scene
from slepian_prt.scene.mesh import make_mesh
from slepian_prt.transport.interior import InteriorVertices, find_interior
from tests.hard.test_geometry import grid, joined
from tests.numerics import assert_exact

NOTHING = np.zeros(0, dtype=np.int64)


def block_on_floor(cells: int = 10) -> tuple[np.ndarray, np.ndarray]:
    """A block of 3 x 3 on a floor of 10 x 10 with vertices at whole numbers, plus a half."""
    box = trimesh.creation.box((3.0, 3.0, 2.0))
    ground, faces = grid(cells, 10.0)
    return joined((ground, faces), (box.vertices + [0.0, 0.0, 1.0], box.faces))


def test_what_is_under_a_block_takes_the_mean_of_what_is_beside_it():
    """Of 9 vertices under it the 8 at its edge have neighbours outside; the one in the middle stays as it is."""
    p, f = block_on_floor()
    mesh = make_mesh(p, f)
    under = np.flatnonzero((np.abs(p[:121, :2]) < 1.4).all(axis=1))
    assert under.size == 9
    with open_scene(mesh) as scene:
        interior = find_interior(scene, under)
    edge = under[np.linalg.norm(p[under], axis=1) > 0.5]
    assert_exact(interior.vertices, edge, "vertices in their order")
    links = np.concatenate([mesh.receivers.neighbours, mesh.receivers.neighbours[:, ::-1]])
    values = np.random.default_rng(3).random((len(p), 2, 4))
    filled = values.copy()
    interior.fill(filled)
    for vertex in edge:
        around = links[(links[:, 0] == vertex) & ~np.isin(links[:, 1], under), 1]
        np.testing.assert_allclose(filled[vertex], values[around].mean(axis=0), rtol=1e-6)
    others = np.setdiff1d(np.arange(len(p)), edge)
    assert_exact(filled[others], values[others], "not touched")


@pytest.mark.parametrize("inward", [True, False])
def test_a_dark_corner_is_not_inside(inward):
    """Of a closed room half is said to be dark: all that is seen from there are fronts."""
    room = trimesh.creation.box().subdivide()
    with open_scene(make_mesh(room.vertices, room.faces[:, ::-1] if inward else room.faces)) as scene:
        assert find_interior(scene, np.flatnonzero(room.vertices[:, 0] < 0.0)).vertices.size == 0


def test_nothing_is_filled_from_what_is_hidden():
    """Of a post in a slab the row below the top is hidden; those deeper down are not filled from that row."""
    box = trimesh.creation.box((0.4, 0.4, 2.0)).subdivide().subdivide()
    block = trimesh.creation.box((8.0, 8.0, 4.0))
    p, f = joined((box.vertices + [0.1, 0.2, 0.2], box.faces), (block.vertices - [0.0, 0.0, 2.0], block.faces))
    with open_scene(make_mesh(p, f)) as scene:
        below = np.flatnonzero(p[: len(box.vertices), 2] < 0.0)
        found = find_interior(scene, below)
    height = np.round(p[found.vertices, 2], 6)
    assert_exact(np.unique(height), [-0.3], "only those next to the top")
    assert (p[found.weights.indices, 2] > 0.0).all()


def test_only_dark_vertices_are_asked_about():
    p, f = block_on_floor()
    with open_scene(make_mesh(p, f)) as scene:
        assert find_interior(scene, NOTHING).vertices.size == 0


def test_hidden_vertices_are_filled():
    """A foot sunk into a sheet sees the sky from below: only that it is hidden tells."""
    box = trimesh.creation.box((1.0, 1.0, 2.0)).subdivide()
    p, f = joined((box.vertices + [0.2, 0.1, 0.9], box.faces), grid(9, 10.0))
    with open_scene(make_mesh(p, f)) as scene:
        low = np.flatnonzero(p[: len(box.vertices), 2] < 0.0)
        found = find_interior(scene, np.flatnonzero(scene.is_hidden))
        assert set(found.vertices) <= set(low)
        assert found.vertices.size >= 8
        np.testing.assert_allclose(found.weights.sum(axis=1), 1.0, rtol=1e-6)


@pytest.mark.parametrize("shape", [(5,), (5, 3), (5, 2, 3)])
def test_nothing_to_fill(shape):
    values = np.arange(np.prod(shape), dtype=np.float32).reshape(shape)
    with open_scene(make_mesh(*grid(1))) as scene:
        interior = find_interior(scene, NOTHING)
    assert isinstance(interior, InteriorVertices)
    filled = values.copy()
    interior.fill(filled)
    assert_exact(filled, values, "untouched")
