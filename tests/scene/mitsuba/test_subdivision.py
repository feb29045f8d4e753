"""Large faces cut finer: what must stay as it was, and what is linear on the faces."""

import math

import numpy as np
import pytest

from slepian_prt.scene.loading import open_scene
from slepian_prt.scene.mitsuba import sorting
from slepian_prt.scene.mitsuba.edge_lengths import EdgeLengths, Things
from slepian_prt.scene.mitsuba.subdivision import cut_long_edges, side_lengths
from slepian_prt.scene.mitsuba.triangles import Triangles
from slepian_prt.scene.normals import face_areas, face_normals
from slepian_prt.transport.survey import Survey
from slepian_prt.transport.transfer import precompute
from tests.numerics import assert_exact, assert_rounded

# A box whose sides have vertices of their own, as hard edges have: 6 x 4 vertices, two triangles a side.
CORNERS = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 2.0) for z in (0.0, 3.0)])
SIDES = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
SQUARE = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
TWO = np.array([[0, 1, 2], [0, 2, 3]])
SLOPE, SHIFT = np.array([[1.0, -2.0], [0.5, 3.0], [2.0, 0.25]]), np.array([0.125, -1.0])


def box() -> Triangles:
    positions = CORNERS[np.ravel(SIDES)]
    faces = np.concatenate([TWO + 4 * side for side in range(6)])
    normals = np.repeat(face_normals(positions, faces)[::2], 4, axis=0)
    attributes = {
        "vertex_color": np.column_stack([positions @ SLOPE, positions[:, 0]]),
        "face_number": np.arange(len(faces), dtype=np.float64)[:, None],
    }
    return Triangles(positions, normals, faces, positions @ SLOPE + SHIFT, attributes, are_own=True)


def cut(piece: Triangles, wanted: float, most: int = 10**6) -> Triangles:
    return cut_long_edges([piece], [EdgeLengths(wanted)], [1], most).pieces[0]


def test_the_shape_stays_the_same():
    before, after = box(), cut(box(), 0.3)
    assert side_lengths(after.positions, after.faces).max() <= 0.3 * (1 + 1e-6)
    areas = face_areas(after.positions, after.faces)
    assert_rounded(areas.sum(), face_areas(before.positions, before.faces).sum(), len(areas))
    # Each face lies in the one that it is cut from, on the same side of it.
    parent = after.attributes["face_number"][:, 0].astype(int)
    upward = face_normals(before.positions, before.faces)[parent]
    assert_rounded(np.einsum("ij,ij->i", face_normals(after.positions, after.faces), upward), np.ones(len(parent)), 64)
    assert_rounded(np.bincount(parent, areas), face_areas(before.positions, before.faces), len(areas))
    assert_rounded(after.normals[after.faces].reshape(-1, 3), np.repeat(upward, 3, axis=0), 64)
    assert not after.are_own


def test_no_gap_opens():
    """Also where sides meet that have vertices of their own: joined by place, all edges have two faces."""
    after = cut(box(), 0.3)
    place = np.unique(after.positions, axis=0, return_inverse=True)[1].ravel()
    ends = np.concatenate([place[after.faces[:, [k, (k + 1) % 3]]] for k in range(3)])
    forward, times = np.unique(ends, axis=0, return_counts=True)
    assert_exact(times, np.ones(len(forward)), "counts")
    assert_exact(forward, np.unique(ends[:, ::-1], axis=0), "indices")
    assert len(after.positions) > len(np.unique(place))  # and the hard edges stay hard


def test_what_is_linear_stays_linear():
    after = cut(box(), 0.3)
    assert_rounded(after.uv, after.positions @ SLOPE + SHIFT, 32, 16.0)
    expected = np.column_stack([after.positions @ SLOPE, after.positions[:, 0]])
    assert_rounded(after.attributes["vertex_color"], expected, 32, 16.0)


def test_normals_between_vertices_are_unit_vectors():
    leaning = np.array([[-0.6, 0.0, 0.8], [0.6, 0.0, 0.8], [0.6, 0.0, 0.8], [-0.6, 0.0, 0.8]])
    after = cut(Triangles(SQUARE, leaning, TWO, None, {}, are_own=True), 0.1)
    direction = np.column_stack(
        [1.2 * after.positions[:, 0] - 0.6, 0 * after.positions[:, 0], np.full(len(after.positions), 0.8)]
    )
    assert_rounded(after.normals, direction / np.linalg.norm(direction, axis=1, keepdims=True), 64)


def test_a_mesh_that_is_fine_enough_is_left_alone():
    piece = box()
    assert cut(piece, math.sqrt(13.0) / 2.99) is piece  # its longest edge is a diagonal of 2 x 3
    assert cut(piece, math.sqrt(13.0) / 3.01) is not piece


def test_short_sides_stay_whole():
    corner = np.array([[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [0.0, 0.1, 0.0]])
    after = cut(Triangles(corner, None, np.array([[0, 1, 2]]), None, {}, are_own=True), 1.0)
    assert (after.positions[:, 0] == 0.0).sum() == 2
    assert side_lengths(after.positions, after.faces).max() <= 1.0 * (1 + 1e-6)


@pytest.mark.parametrize("most", [0, 5, 100, 1000])
def test_the_longest_edges_first_within_a_budget(most):
    """What is left is told, and nothing is left longer than that; copies count."""
    small = Triangles(0.4 * SQUARE, None, TWO, None, {}, are_own=True)
    large = Triangles(SQUARE, None, TWO, None, {}, are_own=True)
    result = cut_long_edges([small, large], [EdgeLengths(0.01), EdgeLengths(0.01)], [1, 3], most)
    new = [len(piece.positions) - 4 for piece in result.pieces]
    assert new[0] + 3 * new[1] <= most
    longest = [side_lengths(piece.positions, piece.faces).max() for piece in result.pieces]
    assert result.left == pytest.approx(max(longest) / 0.01, rel=1e-5)
    assert most < 1000 or (longest[1] <= 0.4 and new[1] > 0)


def test_fine_only_where_something_small_stands():
    """An edge is no longer than what its middle asks for, and far from the thing faces stay large."""
    thing = np.array([[[40.0, 40.0, 0.0], [41.0, 41.0, 1.0]]])
    ground = Triangles(100.0 * SQUARE, None, TWO, 100.0 * SQUARE[:, :2], {}, are_own=True)
    wanted = Things(thing).lengths(ground.positions, 20.0)
    after = cut_long_edges([ground], [wanted], [1], 10**6).pieces[0]
    sides = side_lengths(after.positions, after.faces)
    middles = 0.5 * (after.positions[after.faces] + after.positions[np.roll(after.faces, -1, axis=1)])
    assert np.all(sides.ravel() <= wanted.at(middles.reshape(-1, 3)) * (1 + 1e-5))
    assert sides[np.abs(middles - [40.5, 40.5, 0.0]).max(axis=2) < 0.5].max() < math.sqrt(3.0) / 12.0 * 1.5
    assert len(after.positions) < 4000  # everywhere as fine it would be half a million
    assert_rounded(face_areas(after.positions, after.faces).sum(), 1e4, len(after.faces))


def test_new_vertices_of_a_ball_are_on_it():
    """As they are put there by their texture coordinates; normals keep their side."""
    u, v = (values.ravel() for values in np.meshgrid(np.linspace(0.1, 0.3, 3), np.linspace(0.4, 0.6, 3)))

    def on_ball(uv):
        angle, polar = 2 * np.pi * uv[:, 0], np.pi * uv[:, 1]
        normal = np.column_stack([np.sin(polar) * np.cos(angle), np.sin(polar) * np.sin(angle), np.cos(polar)])
        return 3.0 * normal, normal

    uv = np.column_stack([u, v])
    positions, normals = on_ball(uv)
    faces = np.array([[a, a + 1, a + 4] for a in (0, 1, 3, 4)] + [[a, a + 4, a + 3] for a in (0, 1, 3, 4)])
    piece = Triangles(positions, -normals, faces, uv, {}, are_own=False)
    after = cut_long_edges([piece], [EdgeLengths(0.1)], [1], 10**6, [on_ball]).pieces[0]
    assert len(after.positions) > 100
    assert_rounded(np.linalg.norm(after.positions, axis=1), np.full(len(after.positions), 3.0), 8)
    assert_rounded(after.normals, -after.positions / 3.0, 16)


GROUNDS = {
    "rectangle": '<shape type="rectangle" id="floor"><transform name="to_world"><scale value="100"/></transform>',
    "mesh": '<shape type="obj" id="floor"><string name="filename" value="floor.obj"/>',
    "planet": '<shape type="sphere" id="floor"><float name="radius" value="1000"/>'
    '<point name="center" x="0" y="0" z="-1000"/>',
}


@pytest.mark.slow
@pytest.mark.parametrize("ground", GROUNDS)
def test_light_on_a_large_ground(ground, tmp_path):
    """Under the middle of a small disk the sky is blocked by R² / (R² + h²) of its light."""
    (tmp_path / "floor.obj").write_text("v -100 -100 0\nv 100 -100 0\nv 100 100 0\nv -100 100 0\nf 1 2 3\nf 1 3 4\n")
    (tmp_path / "scene.xml").write_text(
        f"""<scene version="3.0.0">{GROUNDS[ground]}<bsdf type="diffuse"/></shape><shape type="disk">
        <transform name="to_world"><rotate x="1" angle="180"/><scale value="0.5"/><translate z="0.5"/></transform>
        <bsdf type="conductor"/></shape></scene>"""
    )
    transfer = precompute(tmp_path / "scene.xml", 0, 256, effects="direct")
    light = transfer.vectors[:, 0, 0] * math.sqrt(4.0 * math.pi)
    radius = np.linalg.norm(transfer.positions[:, :2], axis=1) + 100.0 * (transfer.positions[:, 2] < -900.0)
    assert light[np.argmin(radius)] == pytest.approx(0.5, abs=0.06)  # a vertex is within a 12th of a diagonal
    assert (radius < 0.5).sum() > 20
    assert len(transfer.positions) < 40_000


def test_light_on_a_floor_of_two_triangles(tmp_path):
    """Under the middle of a disk the sky is blocked by R² / (R² + h²) of its light."""
    (tmp_path / "floor.obj").write_text("v -2 -2 0\nv 2 -2 0\nv 2 2 0\nv -2 2 0\nf 1 2 3\nf 1 3 4\n")
    (tmp_path / "scene.xml").write_text(
        """<scene version="3.0.0"><shape type="obj" id="floor"><string name="filename" value="floor.obj"/>
        <bsdf type="diffuse"/></shape><shape type="disk"><transform name="to_world"><rotate x="1" angle="180"/>
        <scale value="0.5"/><translate z="0.5"/></transform><bsdf type="conductor"/></shape></scene>"""
    )
    transfer = precompute(tmp_path / "scene.xml", 0, 256, effects="direct")
    light = transfer.vectors[:, 0, 0] * math.sqrt(4.0 * math.pi)
    radius = np.linalg.norm(transfer.positions[:, :2], axis=1)
    assert light[np.argmin(radius)] == pytest.approx(0.5, abs=0.02)
    assert light[radius > 1.9].min() > 0.95
    assert (radius < 0.5).sum() > 50


def test_what_stays_coarse_is_told(tmp_path, monkeypatch):
    (tmp_path / "floor.obj").write_text("v -2 -2 0\nv 2 -2 0\nv 2 2 0\nv -2 2 0\nf 1 2 3\nf 1 3 4\n")
    placed = '<transform name="to_world"><scale value="0.4"/><translate x="1" y="0.7" z="0.5"/></transform>'
    block = f'<shape type="cube">{placed}<bsdf type="diffuse"/></shape>'
    (tmp_path / "scene.xml").write_text(
        f"""<scene version="3.0.0"><shape type="obj"><string name="filename" value="floor.obj"/>
        <bsdf type="diffuse"/></shape>{block}</scene>"""
    )
    for most, times in ((10**6, 0), (5, 1)):
        monkeypatch.setattr(sorting, "_MOST_NEW_VERTICES", most)
        with open_scene(tmp_path / "scene.xml") as scene:
            plan = Survey.of(scene).plan(1, 16)
        rows = [effect.reason for effect in plan.effects if effect.name == "light between vertices"]
        # Halved once, the diagonal of 4√2 is half as long as the floor; 1/48 of the scene's diagonal is wanted.
        expected = f"edges are up to {24 * math.sqrt(32.0 / (32.0 + 0.9**2)):.2g} times as long"
        assert sum(expected in reason for reason in rows) == times
