"""Neighbourhoods on a surface against caps and disks in closed form, and what hangs together."""

import math
from itertools import permutations

import numpy as np
import pytest
from scipy.spatial import Delaunay

from slepian_prt.evaluation.dimension.cells import Cells
from slepian_prt.evaluation.dimension.neighbourhoods import Surface, copies_at_one_place, vertex_areas
from slepian_prt.scene.mesh import Mesh, make_mesh
from tests.conftest import sphere
from tests.numerics import assert_exact


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
    assert distances.max() < 0.5 + 0.5 * math.hypot(0.2, 0.2)  # cells reach to the middles of edges
    folded = sphere(4)
    flat = make_mesh(folded.positions * [1.0, 1.0, 0.05], folded.faces)
    top = int(np.argmax(flat.positions[:, 2]))
    assert np.all(flat.positions[Surface(flat, 0.5).about(top).members, 2] > 0.0)
    rim = int(np.argmax(flat.positions[:, 0]))
    assert np.ptp(np.sign(flat.positions[Surface(flat, 0.5).about(rim).members, 2])) == 2


def test_one_large_face_far_away_joins_nothing():
    """Two sides of a flat sphere hang together outside of the radius, wherever the mesh has faces of other sizes."""
    ball = sphere(4)
    positions = ball.positions * [1.0, 1.0, 0.02]
    triangle = np.array([[5.0, 0.0, 0.0], [9.0, 0.0, 0.0], [5.0, 4.0, 0.0]]), np.array([[0, 1, 2]])
    alone, beside = joined((positions, ball.faces)), joined((positions, ball.faces), triangle)
    away = np.hypot(positions[:, 0], positions[:, 1])
    vertex = int(np.argmin(np.abs(away - 0.5) + (positions[:, 2] < 0.01)))  # 0.1 of the radius from the rim's reach
    found, same = Surface(alone, 0.4).about(vertex), Surface(beside, 0.4).about(vertex)
    assert np.all(positions[found.members, 2] > 0.0)
    a, b = np.argsort(found.members), np.argsort(same.members)  # the tree may give them in another order
    assert_exact(found.members[a], same.members[b], "the same vertices")
    assert_exact(found.areas[a], same.areas[b], "of the same cells")


def test_cells_in_a_disc_have_its_area_however_the_plane_is_cut(rng):
    """π r² in closed form, with points dense at one side and few at the other: triangles far larger than the disc."""
    dense = rng.uniform([-1.0, -1.0], [0.0, 1.0], size=(400, 2))
    few = np.array([[-9.0, -9.0], [9.0, -9.0], [9.0, 9.0], [-9.0, 9.0], [0.8, 0.1]])
    points = np.concatenate([dense, few])
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    mesh = make_mesh(np.pad(points, ((0, 0), (0, 1))) @ turn.T, Delaunay(points).simplices)
    cells, everywhere = Cells(mesh), np.arange(len(points))
    for radius in (0.03, 0.4, 3.0):
        middle = np.array([0.1, 0.2, 0.0]) @ turn.T
        areas = cells.areas_within(everywhere, middle, radius)
        # To rounding of the triangles' size squared, 18².
        assert areas.sum() == pytest.approx(math.pi * radius**2, abs=1e-12)
        raised = cells.areas_within(everywhere, middle + 0.6 * radius * turn[:, 2], radius)
        assert raised.sum() == pytest.approx(math.pi * (0.8 * radius) ** 2, abs=1e-12)
    np.testing.assert_allclose(cells.areas_within(everywhere, np.zeros(3), 99.0), vertex_areas(mesh), rtol=1e-9)
    assert cells.areas_within(everywhere[:0], np.zeros(3), 1.0).shape == (0,)


def test_of_a_face_larger_than_a_neighbourhood_only_what_is_inside_counts():
    """A fine square in a coarse frame: the disc about a point at its side is π r² with both, half of it is of each."""
    fine, faces = grid(40)
    corner = np.array([[1.0, -1.0, 0.0], [21.0, -1.0, 0.0], [21.0, 1.0, 0.0], [1.0, 1.0, 0.0]])
    side = np.flatnonzero(fine[:, 0] == 1.0)
    strip = np.concatenate([fine[side], corner[1:3]])
    fan = [[i, 41, i + 1] for i in range(40)] + [[40, 41, 42]]
    mesh = joined((fine, faces), (strip, np.array(fan)))
    vertex = int(np.argmin(np.linalg.norm(mesh.positions - [1.0, 0.0, 0.0], axis=1)))
    about = Surface(mesh, 0.3).about(vertex)
    assert about.areas.sum() == pytest.approx(math.pi * 0.09, rel=1e-9)
    assert about.areas[about.members >= len(fine)].sum() == pytest.approx(math.pi * 0.045, rel=1e-9)


def test_copies_of_two_sides_are_told_apart_in_any_order():
    """A sheet with two sides and a seam, halves left up, left down, right up, right down: a side holds together."""

    def half(sign: float, tip: float) -> tuple[np.ndarray, np.ndarray]:
        positions, faces = grid(10, tip=(0.0, 0.0, tip))
        faces = faces[np.all(sign * positions[faces][:, :, 0] >= -1e-12, axis=1)]
        used, numbers = np.unique(faces, return_inverse=True)
        return positions[used], numbers.reshape(faces.shape)

    halves = {(sign, tip): half(sign, tip) for sign in (-1.0, 1.0) for tip in (1.0, -1.0)}
    for order in permutations(halves):
        sheet = joined(*(halves[key] for key in order))
        pairs = copies_at_one_place(sheet.receivers)
        assert len(pairs) == 22
        np.testing.assert_allclose(sheet.normals[pairs[:, 0]], sheet.normals[pairs[:, 1]], rtol=0.0, atol=0.0)
    vertex = int(np.argmin(np.linalg.norm(sheet.positions - [-0.2, 0.0, 0.0], axis=1)))
    assert Surface(sheet, 0.5).about(vertex).areas.sum() == pytest.approx(math.pi * 0.25, rel=1e-9)


def test_unused_copies_do_not_come_between_those_that_are_used():
    positions, faces = grid(2)
    shared = positions[positions[:, 0] == 1.0]
    other = positions + [2.0, 0.0, 0.0]
    mesh = joined((positions, faces), (shared, np.zeros((0, 3), dtype=int)), (other, faces))
    pairs = copies_at_one_place(mesh.receivers)
    assert {tuple(pair) for pair in pairs.tolist()} == {(2, 12), (5, 15), (8, 18)}


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


def test_faces_without_area_count_for_nothing():
    """Two squares with a face of no area between them: of a disc between two lines the part is in closed form."""
    positions = np.array([[x, y, 0.0] for y in (0.0, 1.0) for x in (0.0, 1.0, 2.0)] + [[1.0, 0.5, 0.0]])
    faces = np.array([[0, 1, 4], [0, 4, 3], [1, 6, 4], [1, 2, 5], [1, 5, 4]])
    cells, middle = Cells(make_mesh(positions, faces)), np.array([1.0, 0.5, 0.0])
    areas = cells.areas_within(np.arange(7), middle, 1.0)
    assert areas.sum() == pytest.approx(2.0 * (0.5 * math.sqrt(0.75) + math.asin(0.5)), rel=1e-12)
    assert areas[6] == 0.0
    assert np.isfinite(Surface(make_mesh(positions, faces), 0.6).about(1).areas).all()
