"""Neighbourhoods on a surface against caps and disks in closed form, and what hangs together."""

import math

import numpy as np
import pytest

from slepian_prt.evaluation.dimension.neighbourhoods import Surface, copies_at_one_place, vertex_areas
from slepian_prt.scene.mesh import Mesh, make_mesh
from tests.conftest import sphere


def grid(
    n: int, height: float = 0.0, tip: tuple[float, float, float] = (0.0, 0.0, 1.0)
) -> tuple[np.ndarray, np.ndarray]:
    """Positions and faces of a square of side 2 with n x n cells, facing up or down."""
    x, y = np.meshgrid(np.linspace(-1, 1, n + 1), np.linspace(-1, 1, n + 1))
    positions = np.stack([x.ravel(), y.ravel(), np.full(x.size, height)], axis=1)
    a = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    faces = np.concatenate([np.stack([a, a + 1, a + n + 2], 1), np.stack([a, a + n + 2, a + n + 1], 1)])
    return positions, faces if tip[2] > 0 else faces[:, ::-1]


def joined(*parts: tuple[np.ndarray, np.ndarray]) -> Mesh:
    """One mesh of several, whose vertices stay apart."""
    starts = np.cumsum([0, *(len(positions) for positions, _ in parts)])
    faces = [faces + start for (_, faces), start in zip(parts, starts[:-1], strict=True)]
    return make_mesh(np.concatenate([positions for positions, _ in parts]), np.concatenate(faces))


def test_areas_sum_to_that_of_the_faces():
    mesh = joined(grid(5))
    areas = vertex_areas(mesh)
    assert areas.sum() == pytest.approx(4.0, rel=1e-14)
    inner = np.all(np.abs(mesh.positions[:, :2]) < 0.9, axis=1)
    np.testing.assert_allclose(areas[inner], 0.16, rtol=1e-13)  # a cell's area: six faces of half a cell, a third each


@pytest.mark.parametrize("half_angle", [0.2, 0.7, 1.5])
def test_on_a_sphere_it_is_a_cap(half_angle):
    """Its area is 4π sin²(Θ/2) to second order in the spacing h: the rim is cut to a part of a vertex's area."""
    errors = []
    for subdivisions in (3, 4):
        mesh = sphere(subdivisions)
        surface = Surface(mesh, 2.0 * math.sin(half_angle / 2.0))
        area = 4.0 * math.pi * math.sin(half_angle / 2.0) ** 2
        found = [surface.about(vertex).areas.sum() for vertex in range(0, len(mesh.positions), 37)]
        errors.append(float(np.abs(np.array(found) / area - 1.0).max()))
        spacing = math.sqrt(4.0 * math.pi / len(mesh.positions))
        assert errors[-1] < 0.5 * (spacing / half_angle) ** 2 + spacing**2  # of the rim; of the flat faces
    assert errors[1] < errors[0]


def test_the_other_side_of_a_gap_does_not_belong_to_it():
    """Two sheets closer than the radius; but a sheet that hangs together around the rim is one."""
    apart = joined(grid(10), grid(10, 0.05))
    surface = Surface(apart, 0.5)
    middle = 60
    members, distances, _ = surface.about(middle)
    assert members.max() < 121
    assert distances.max() < 0.5 + 0.51 * 0.2
    folded = sphere(4)
    flat = make_mesh(folded.positions * [1.0, 1.0, 0.05], folded.faces)
    top = int(np.argmax(flat.positions[:, 2]))
    assert np.all(flat.positions[Surface(flat, 0.5).about(top).members, 2] > 0.0)
    rim = int(np.argmax(flat.positions[:, 0]))
    assert np.ptp(np.sign(flat.positions[Surface(flat, 0.5).about(rim).members, 2])) == 2


def test_hard_edges_hold_together_and_two_sides_of_a_sheet_do_not():
    """Copies of vertices at one place, as at seams, but with opposite normals only the place is the same."""
    positions, faces = grid(10)
    turned = positions[:, [2, 1, 0]] + [1.0, 0.0, 1.0]  # a second square that stands on the side x = 1 of the first
    corner = joined((positions, faces), (turned, faces))
    pairs = copies_at_one_place(corner.receivers)
    assert len(pairs) == 11
    np.testing.assert_allclose(corner.positions[pairs[:, 0]], corner.positions[pairs[:, 1]], rtol=0.0, atol=0.0)
    members = Surface(corner, 0.5).about(60 + 5).members  # the middle of that side
    assert (members >= 121).any()
    sheet = joined(grid(10), grid(10, tip=(0.0, 0.0, -1.0)))
    assert len(copies_at_one_place(sheet.receivers)) == 0
    assert Surface(sheet, 0.5).about(60).members.max() < 121


def test_every_vertex_comes_once_and_numbers_do_not_matter(rng):
    mesh = sphere(2)
    order = list(Surface(mesh, 0.3).spread_order())
    assert sorted(order) == list(range(len(mesh.positions)))
    shuffle = rng.permutation(len(mesh.positions))
    renumbered = make_mesh(mesh.positions[shuffle], np.argsort(shuffle)[mesh.faces])
    assert [int(shuffle[vertex]) for vertex in Surface(renumbered, 0.3).spread_order()] == order
    away = np.linalg.norm(mesh.positions[:, None] - mesh.positions[order[:32]], axis=2).min(axis=1)
    assert away.max() < 0.75  # of a radius of 1; with 32 at random it is 0.8


def test_what_no_face_uses_is_in_no_neighbourhood():
    positions, faces = grid(4)
    mesh = make_mesh(np.concatenate([positions, [[0.0, 0.0, 0.01]]]), faces)
    surface = Surface(mesh, 1.0)
    assert 25 not in surface.about(12).members
    assert 25 not in list(surface.spread_order())
