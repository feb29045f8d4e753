"""Which vertices are hidden behind what an edge of theirs goes through, and what fills them."""

import numpy as np
import pytest
import trimesh

from slepian_prt.scene.loading import open_scene
from slepian_prt.scene.mesh import make_mesh
from slepian_prt.transport.transfer import precompute
from tests.conftest import bumpy, sphere
from tests.hard.test_geometry import ambient, grid, joined
from tests.numerics import assert_exact


def post(depth: float, *, hard: bool = False, cuts: int = 2) -> tuple[np.ndarray, np.ndarray]:
    """A closed post of 0.4 x 0.4 x 2, so deep in the floor z = 0; hard: no two faces share a vertex."""
    box = trimesh.creation.box((0.4, 0.4, 2.0))
    for _ in range(cuts):
        box = box.subdivide()
    if hard:
        box.unmerge_vertices()
    return box.vertices + [0.11, 0.07, 1.0 - depth], box.faces


def hidden(mesh) -> np.ndarray:
    with open_scene(mesh) as scene:
        return scene.is_hidden


@pytest.mark.parametrize("hard", [False, True])
@pytest.mark.parametrize("cuts", [0, 2])
@pytest.mark.parametrize("turned", [False, True])
def test_a_foot_sunk_into_a_sheet_takes_what_its_neighbours_above_receive(hard, cuts, turned, rng):
    """The lowest row would see the sky from below; its mean over neighbours is taken as by hand from the mesh."""
    p, f = joined(post(0.1, hard=hard, cuts=cuts), grid(12, 20.0))
    count = len(p) - 13 * 13
    if turned:
        q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        p = p @ (q * np.linalg.det(q)).T + [30.0, -20.0, 10.0]
    mesh = make_mesh(p, f)
    heights = joined(post(0.1, hard=hard, cuts=cuts), grid(12, 20.0))[0][:, 2]
    low = np.flatnonzero(heights[:count] < 0.0)
    above = np.zeros(len(p), dtype=bool)
    above[:count] = heights[:count] > 0.0
    vectors = precompute(mesh, 2, 256, effects="direct").vectors
    links = np.concatenate([mesh.receivers.neighbours, mesh.receivers.neighbours[:, ::-1]])
    filled = 0
    for vertex in low:
        across = links[(links[:, 0] == vertex) & above[links[:, 1]], 1]
        if across.size:
            np.testing.assert_allclose(vectors[vertex], vectors[across].mean(axis=0), atol=1e-6)
            filled += 1
    assert filled >= 4
    assert_exact(
        hidden(mesh)[:count], np.isin(np.arange(count), links[above[links[:, 1]], 0]) & (heights[:count] < 0), ""
    )


def test_a_floor_whose_winding_is_against_its_normals():
    """The normals tell which side is its back."""
    ground, faces = grid(12, 20.0)
    foot = post(0.1)
    up = hidden(make_mesh(*joined(foot, (ground, faces))))
    p, f = joined(foot, (ground, faces[:, ::-1]))
    normals = np.concatenate([make_mesh(*foot).normals, np.tile([0.0, 0.0, 1.0], (len(ground), 1))])
    assert_exact(hidden(make_mesh(p, f, normals=normals)), up, "the same rows")
    assert up.any()


def test_a_floor_with_its_normals_down_does_not_hide_what_stands_on_it():
    ground, faces = grid(12, 20.0)
    p, f = joined(post(0.1), (ground, faces[:, ::-1]))
    assert not hidden(make_mesh(p, f))[p[:, 2] > 0.0].any()


@pytest.mark.parametrize("cells", [7, 8])
@pytest.mark.parametrize("at", [0.0, 0.17])
def test_crossing_cards_hide_nothing(cells, at):
    """Both sides of both are seen, and each point off the line sees past the other card: brute force says so below."""
    square, faces = grid(cells)
    p, f = joined((square[:, [0, 2, 1]], faces), (square[:, [2, 0, 1]] + [at, 0.0, 0.0], faces))
    assert not hidden(make_mesh(p, f)).any()


def test_a_house_with_an_awning_hides_nothing():
    """A single sheet that is fixed to a wall, whichever way it faces: the wall goes on around it."""
    house = trimesh.creation.box((4.0, 4.0, 4.0)).subdivide().subdivide().subdivide()
    awning, flaps = grid(3, 1.5)
    p, f = joined((house.vertices, house.faces), (awning + [0.1, -2.7, 0.13], flaps))
    for faces in (f, np.concatenate([f[: len(house.faces)], f[len(house.faces) :, ::-1]])):
        mesh = make_mesh(p, faces)
        assert not hidden(mesh)[: len(house.vertices)].any()


def test_a_ball_that_touches_a_floor_in_a_vertex():
    """Its lowest vertex looks down at the point it stands on, but its rays start below the floor."""
    ball = trimesh.creation.icosphere(2)
    turn = trimesh.geometry.align_vectors(ball.vertices[0], [0, 0, -1])[:3, :3]
    v = ball.vertices @ turn.T
    p, f = joined((v - [0.0, 0.0, v[:, 2].min()], ball.faces), (grid(8, 20.0)[0] + [0.3, 0.2, 0.0], grid(8, 20.0)[1]))
    light = ambient(make_mesh(p, f), 256, effects="direct")
    assert light[int(np.argmin(v[:, 2]))] < 0.05  # from below, 1; its neighbours see a strip of the horizon, 0.02


@pytest.mark.parametrize("shape", ["sphere", "bumpy", "box on a floor", "sheet", "box in the air"])
def test_simple_scenes_hide_nothing(shape):
    mesh = {
        "sphere": lambda: sphere(2),
        "bumpy": lambda: bumpy(3),
        "box on a floor": lambda: make_mesh(*joined(post(0.0), grid(8, 20.0))),
        "sheet": lambda: make_mesh(*grid(4)),
        "box in the air": lambda: make_mesh(*joined(post(-0.3), grid(8, 20.0))),
    }[shape]()
    with open_scene(mesh) as scene:
        assert scene.pierced.shape == (0, 2)


def test_looking_for_what_is_pierced_counts_no_rays():
    """``rays_traced`` are those of transport: a convex scene has none."""
    assert precompute(make_mesh(*grid(4)), 2, 64).rays_traced == 0
