"""Creases: which corners share a vertex, against what one counts on paper."""

import itertools
import math

import numpy as np
import pytest
import trimesh

from slepian_prt.scene.mesh import MeshDetails, complete_mesh, make_mesh
from slepian_prt.scene.normals import angle_weighted_normals, face_normals, leaning_normals, split_at_creases
from tests.numerics import assert_exact, assert_rounded

CUBE = np.array(list(itertools.product((0.0, 1.0), repeat=3)))
QUADS = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
CUBE_FACES = np.array([t for a, b, c, d in QUADS for t in ((a, b, c), (a, c, d))])


def split(positions, faces, degrees, groups=None, whole=None):
    faces = np.asarray(faces)
    groups = np.arange(len(positions)) if groups is None else groups
    result = split_at_creases(positions, faces, groups, degrees, whole)
    assert_exact(result.vertices[result.faces], faces, "each new corner is a copy of the old one")
    assert (np.diff(result.vertices) >= 0).all()  # the order of the file
    return result


def creased(positions, faces, degrees, normals=None, groups=None):
    return complete_mesh(positions, faces, normals, 1.0, MeshDetails("m", "m", groups, crease_angle=degrees))


def cylinder(sections: int) -> tuple[np.ndarray, np.ndarray]:
    """Closed, welded, with fans for caps whose middles are the last two vertices."""
    phi = 2.0 * np.pi * np.arange(sections) / sections
    ring = np.column_stack([np.cos(phi), np.sin(phi)])
    p = np.concatenate([np.column_stack([ring, np.full(sections, z)]) for z in (0.0, 1.0)] + [[[0, 0, 0], [0, 0, 1]]])
    a, b = np.arange(sections), np.roll(np.arange(sections), -1)
    n = sections
    side = [np.column_stack([a, b, b + n]), np.column_stack([a, b + n, a + n])]
    caps = [np.column_stack([b, a, 0 * a + 2 * n]), np.column_stack([a + n, b + n, 0 * a + 2 * n + 1])]
    return p, np.concatenate(side + caps)


@pytest.mark.parametrize(("degrees", "vertices"), [(0.0, 24), (30.0, 24), (89.999, 24), (90.001, 8), (180.0, 8)])
def test_a_cube(degrees, vertices):
    assert len(split(CUBE, CUBE_FACES, degrees).vertices) == vertices
    mesh = creased(CUBE, CUBE_FACES, degrees)
    assert len(mesh.positions) == vertices
    flat = np.repeat(face_normals(CUBE, CUBE_FACES), 3, axis=0).reshape(-1, 3, 3)
    rounded = np.sign(CUBE - 0.5)[CUBE_FACES] / math.sqrt(3.0)
    np.testing.assert_allclose(mesh.normals[mesh.faces], flat if vertices == 24 else rounded, atol=1e-15)


@pytest.mark.parametrize("sections", [13, 24, 60])
def test_a_cylinder_has_hard_caps_and_a_smooth_side(sections):
    p, f = cylinder(sections)
    step = 360.0 / sections
    smooth = creased(p, f, step + 0.01)
    assert len(smooth.positions) == 4 * sections + 2
    side = smooth.faces[: 2 * sections]
    radial = smooth.positions[side] * [1.0, 1.0, 0.0]
    np.testing.assert_allclose(smooth.normals[side], radial, atol=math.radians(step) ** 2)  # angles differ by corner
    np.testing.assert_allclose(np.abs(smooth.normals[smooth.faces[2 * sections :]][..., 2]), 1.0, atol=1e-15)
    # Below the step each strip is apart from the next.
    assert len(split(p, f, step - 0.01).vertices) == 4 * sections + 2 * sections + 2


def fan(angles: list[float]) -> tuple[np.ndarray, np.ndarray]:
    """Pages of a book: faces at one spine, each in the direction of its angle in degrees, wound from spine to edge."""
    edge = [[math.cos(math.radians(a)), math.sin(math.radians(a)), 0.5] for a in angles]
    return np.array([[0, 0, 0.0], [0, 0, 1.0], *edge]), np.array([[0, 1, 2 + k] for k in range(len(angles))])


def test_an_edge_of_three_faces_joins_those_that_are_smooth_in_any_order():
    """A wall on a floor of two halves: the floor goes on beneath it, whichever face the file has first."""
    p = np.array([[0, 0, 0], [0, 1, 0], [-1, 0, 0], [1, 0, 0], [0, 0, 1.0]])
    floor_left, floor_right, wall = [0, 1, 2], [1, 0, 3], [0, 1, 4]
    for faces in itertools.permutations([floor_left, floor_right, wall]):
        result = split(p, faces, 30.0)
        assert len(result.vertices) == 7  # the ends of the edge for the wall and for the floor
        left, right = (result.faces[list(faces).index(face)] for face in (floor_left, floor_right))
        assert set(left[:2]) == set(right[:2])
    assert len(split(*fan([0, 20, 90, 110]), 25.0).vertices) == 4 + 4
    assert len(split(*fan([0, 90, 20, 110]), 25.0).vertices) == 4 + 4


def test_an_edge_of_very_many_faces_ends():
    angles = list(np.linspace(0.0, 20.0, 3000))
    assert len(split(*fan(angles), 30.0).vertices) == 3002


def test_a_bow_tie_is_two_vertices():
    """Faces that share a point but no edge do not share a vertex."""
    p = np.array([[0, 0, 0], [1, 1, 0], [1, -1, 0], [-1, 1, 0], [-1, -1, 0.0]])
    result = split(p, [[0, 2, 1], [0, 3, 4]], 30.0)
    assert_exact(result.vertices, [0, 0, 1, 2, 3, 4], "in the order of the file")


def test_a_corner_of_three_hard_edges_between_smooth_ones():
    """A pyramid of five sides: at 60° to each other only every pair of neighbours under the angle is joined."""
    phi = np.radians([0, 20, 40, 180, 200.0])
    p = np.array([[0, 0, 1.0], *np.column_stack([np.cos(phi), np.sin(phi), 0 * phi])])
    faces = np.array([[0, 1 + k, 1 + (k + 1) % 5] for k in range(5)])
    normals = face_normals(p, faces)
    joined = [normals[k] @ normals[(k + 1) % 5] >= math.cos(math.radians(40.0)) for k in range(5)]
    tops = np.unique(split(p, faces, 40.0).faces[:, 0]).size
    assert tops == max(1, joined.count(False)) > 1


def test_a_seam_of_a_texture_in_a_smooth_surface_is_not_seen():
    """Vertices that the file keeps apart stay apart, and share their normal where the edge is smooth."""
    p, f = cylinder(24)
    seam = len(p)
    positions = np.concatenate([p, p[[0, 24]]])  # the last faces of the side end at copies of the first vertices
    faces = f.copy()
    for row in np.flatnonzero((f[:48] == 23).any(axis=1) | (f[:48] == 47).any(axis=1)):
        faces[row] = (
            np.where(f[row] == 0, seam, np.where(f[row] == 24, seam + 1, f[row])) if 22 not in f[row] else f[row]
        )
    groups = np.concatenate([np.arange(len(p)), [0, 24]])
    whole, cut = creased(p, f, 30.0), creased(positions, faces, 30.0, groups=groups)
    assert len(cut.positions) == len(whole.positions) + 2
    np.testing.assert_allclose(cut.normals[cut.faces], whole.normals[whole.faces], atol=1e-15)


def test_normals_of_the_file_are_kept_and_their_vertices_whole():
    given = np.full(CUBE.shape, np.nan)
    given[0] = [0.0, 0.0, -2.0]
    given[1] = 0.0
    mesh = creased(CUBE, CUBE_FACES, 30.0, normals=given)
    assert len(mesh.positions) == 24 - 2
    np.testing.assert_allclose(mesh.normals[0], [0.0, 0.0, -1.0], atol=1e-15)
    assert any("missing or zero" in note for note in mesh.notes)


def test_without_creases_nothing_changes():
    """Vertices that no face uses stay too, so that what belongs to vertices of the file still fits."""
    ball = trimesh.creation.icosphere(2)
    p = np.concatenate([[[5.0, 5.0, 5.0]], ball.vertices])
    plain, mesh = make_mesh(p, ball.faces + 1), creased(p, ball.faces + 1, 45.0)
    assert_exact(mesh.positions, plain.positions, "copies")
    assert_exact(mesh.faces, plain.faces, "integers")
    np.testing.assert_allclose(mesh.normals, plain.normals, atol=1e-15)
    assert mesh.notes == plain.notes == ("1 vertices that no face uses receive no light",)


def test_faces_without_area_are_no_creases():
    """A sliver is left out before anything is split: no vertex is left behind for it."""
    p = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 0, 0]])
    mesh = creased(p, [[0, 1, 2], [0, 2, 3], [0, 4, 1]], 30.0)
    assert len(mesh.positions) == 5
    assert mesh.receivers.active.sum() == 4


def test_normals_of_a_needle_tip():
    """However small the angle of the only face at a vertex, its normal is that of the face."""
    p = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1e-10, 0.0]])
    np.testing.assert_allclose(angle_weighted_normals(p, np.array([[0, 1, 2]])), [[0.0, 0.0, 1.0]] * 3, atol=1e-15)


@pytest.mark.parametrize("size", [1e-30, 1.0, 1e30])
def test_the_size_of_given_normals_does_not_matter(size):
    p = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    mesh = make_mesh(p, [[0, 1, 2]], normals=np.tile([0.0, 0.6 * size, 0.8 * size], (3, 1)))
    expected = [0.0, 0.6, 0.8] if size > 1e-12 else [0.0, 0.0, 1.0]  # zero but for rounding: computed
    np.testing.assert_allclose(mesh.normals, [expected] * 3, atol=1e-15)
    with np.errstate(all="raise"):
        make_mesh(p, [[0, 1, 2]], normals=np.tile([0.0, 6e199, 8e199], (3, 1)))


def test_faces_back_to_back_turn_to_the_side_of_the_surface_around():
    """Scans hold triangles twice, once each way; lying on a surface they face as it does."""
    ball = trimesh.creation.icosphere(4)
    for chosen in (3, 700, 1900):
        patch = 1.001 * ball.vertices[ball.faces[chosen]]
        for order in ([0, 1, 2], [0, 2, 1]):
            pair = len(ball.vertices) + np.array([order, order[::-1]])
            mesh = make_mesh(np.concatenate([ball.vertices, patch]), np.concatenate([ball.faces, pair]))
            radial = np.einsum("ij,ij->i", mesh.normals, mesh.positions)
            assert radial.min() > 0.99


@pytest.mark.parametrize("degrees", [0.0, 30.0, 90.0, 180.0])
def test_normals_that_lean(degrees):
    """Of a cosine-weighted hemisphere (1 - |cos θ|) / 2 is below a plane that its axis leans by θ against."""
    lean = math.radians(degrees)
    square = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
    normals = np.tile([math.sin(lean), 0.0, math.cos(lean)], (4, 1))
    found = leaning_normals(square, np.array([[0, 1, 2], [0, 2, 3], [0, 0, 1]]), normals)
    assert_rounded(found, 0.5 - 0.5 * abs(math.cos(lean)), 16, 1.0)
    assert leaning_normals(np.zeros((3, 3)), np.array([[0, 1, 2]]), normals[:3]) == 0.0
