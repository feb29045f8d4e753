"""How far light between vertices is from what is interpolated."""

import numpy as np
import pytest
import trimesh

from slepian_prt.scene.loading import open_scene
from slepian_prt.scene.mesh import make_mesh
from slepian_prt.transport.interpolation import interpolation_error
from tests.conftest import sphere
from tests.hard.test_geometry import grid, joined

# Transfer at points and at vertices is measured with 128 directions each: their noise, and what is left at this size.
NOISE = 0.05


def error(mesh, seed: int = 0) -> float:
    with open_scene(mesh) as scene:
        return interpolation_error(scene, seed)


def cube_on_floor(cuts: int, cells: int):
    """A hard-edged cube, standing a little above a floor of 6 x 6."""
    box = trimesh.creation.box()
    for _ in range(cuts):
        box = box.subdivide()
    faces = box.faces
    axis = np.argmax(np.abs(np.cross(*(box.vertices[faces[:, k]] - box.vertices[faces[:, 0]] for k in (1, 2)))), axis=1)
    side = 2 * axis + (box.vertices[faces].mean(axis=1)[np.arange(len(faces)), axis] > 0.0)
    keys, corner = np.unique(faces + len(box.vertices) * side[:, None], return_inverse=True)
    cube = box.vertices[keys % len(box.vertices)] + [0.0, 0.0, 0.6], corner.reshape(-1, 3)
    return make_mesh(*joined(cube, grid(cells, 6.0)))


def test_a_plane_has_none():
    assert error(make_mesh(*grid(1))) < 1e-6


@pytest.mark.parametrize("subdivisions", [0, 1, 2])
def test_a_ball_without_shadows(subdivisions):
    """Against a sum over all triangles: between vertices, normals are made unit vectors again, and transfer is not."""
    mesh = sphere(subdivisions)
    found = error(mesh)
    weights = np.random.default_rng(1).dirichlet(np.ones(3), 400)  # evenly over a triangle

    def vectors(d: np.ndarray) -> np.ndarray:
        """Transfer up to degree 2, A_l y_l(d) with A = 1, 2/3, 1/4, as tensors of the same norms but for √4π."""
        trace_free = np.einsum("...i,...j->...ij", d, d) - np.eye(3) / 3.0
        flat = trace_free.reshape(*d.shape[:-1], 9)
        first = np.full((*d.shape[:-1], 1), 1.0)
        return np.concatenate([first, np.sqrt(3.0) * 2 / 3 * d, np.sqrt(5.0) / 4 * np.sqrt(1.5) * flat], axis=-1)

    corner = mesh.normals[mesh.faces]
    between = np.einsum("pk,fkc->fpc", weights, corner)
    between /= np.linalg.norm(between, axis=2, keepdims=True)
    exact = vectors(between)
    interpolated = np.einsum("pk,fkm->fpm", weights, vectors(corner))
    brute = np.sqrt(np.sum((exact - interpolated) ** 2) / np.sum(exact**2))
    # 256 points drawn at random of a quantity that varies over each triangle by about its own size.
    assert found == pytest.approx(brute, rel=0.25)


def test_a_floor_of_two_triangles_under_a_cube_is_told():
    """All of the shadow falls between its vertices, which see the whole sky but for the cube far away."""
    assert error(cube_on_floor(0, 1)) > 0.15


def test_it_falls_with_subdivision_of_everything():
    coarse, medium, fine = (error(cube_on_floor(cuts, cells)) for cuts, cells in ((0, 1), (2, 8), (4, 48)))
    assert fine < 0.5 * medium < 0.35 * coarse
    assert fine < NOISE


def test_it_does_not_depend_on_the_seed_by_much():
    mesh = cube_on_floor(0, 1)
    found = [error(mesh, seed) for seed in range(4)]
    assert np.std(found) < 0.35 * np.mean(found)


def test_points_next_to_vertices_inside_others_do_not_count():
    """A block on a floor: the vertex under it is dark, and is filled before anything is interpolated from it."""
    box = trimesh.creation.box().subdivide().subdivide()
    p, f = joined((box.vertices + [0.0, 0.0, 0.5], box.faces), grid(2, 40.0))
    dark = np.argmin(np.linalg.norm(p[len(box.vertices) :], axis=1)) + len(box.vertices)
    assert np.linalg.norm(p[dark]) == 0.0
    assert error(make_mesh(p, f)) < 0.5  # with it, most of the floor would be half of what it is
