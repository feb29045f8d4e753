"""Mesh files of several parts: what is joined, and what of materials and creases arrives in the mesh."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from slepian_prt.errors import UserError
from slepian_prt.scene.formats.parts import Material, MeshFile, MeshPart
from slepian_prt.scene.loading import open_scene
from slepian_prt.scene.mesh_files import _join, read_mesh
from tests.numerics import assert_exact
from tests.scene.test_normals import CUBE, CUBE_FACES, QUADS

TRIANGLE = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
FACE = np.array([[0, 1, 2]])


def joined(*parts: MeshPart, crease_angle: float = 180.0):
    return _join(MeshFile(parts), Path("model.x"), crease_angle)


def cube_obj(tmp_path, *, normals: bool = False):
    text = "".join(f"v {x:g} {y:g} {z:g}\n" for x, y, z in CUBE)
    if normals:
        text += "".join("vn {:g} {:g} {:g}\n".format(*(corner - 0.5)) for corner in CUBE)
    for quad in QUADS:
        text += "f " + " ".join(f"{i + 1}//{i + 1}" if normals else f"{i + 1}" for i in quad) + "\n"
    path = tmp_path / "cube.obj"
    path.write_text(text)
    return path


@pytest.mark.parametrize(("degrees", "vertices"), [(None, 8), (180.0, 8), (30.0, 24), (0.0, 24)])
def test_crease_angle_of_a_file(degrees, vertices, tmp_path):
    path = cube_obj(tmp_path)
    mesh = read_mesh(path) if degrees is None else read_mesh(path, crease_angle=degrees)
    assert len(mesh.positions) == vertices
    assert len(mesh.faces) == 12
    assert len(read_mesh(cube_obj(tmp_path, normals=True), crease_angle=0.0).positions) == 8  # the file's are kept


@pytest.mark.parametrize("degrees", [-1.0, 180.5, float("nan")])
def test_crease_angles_out_of_range(degrees, tmp_path):
    with pytest.raises(UserError, match=r"crease_angle must be a number of degrees in \[0, 180\], not"):
        read_mesh(cube_obj(tmp_path), crease_angle=degrees)


def test_creases_where_one_part_has_normals_and_another_none():
    """The part without them gets hard edges, the other one stays as it is."""
    bare = MeshPart("bare", CUBE, CUBE_FACES)
    given = MeshPart("given", CUBE + [3.0, 0.0, 0.0], CUBE_FACES, normals=CUBE - 0.5)
    mesh = joined(bare, given, crease_angle=30.0)
    assert len(mesh.positions) == 24 + 8
    rounded = mesh.normals[mesh.positions[:, 0] > 2.0]
    np.testing.assert_allclose(np.abs(rounded), 1.0 / np.sqrt(3.0), atol=1e-15)
    np.testing.assert_allclose(np.abs(mesh.normals[mesh.positions[:, 0] < 2.0]).max(axis=1), 1.0, atol=1e-15)


def test_albedo_and_points_follow_the_vertices_through_creases():
    """Two materials on one cube, whose corners are points of both: colours stay with their parts."""
    upper = CUBE_FACES[2:4]
    lower = np.delete(CUBE_FACES, [2, 3], axis=0)
    parts = []
    for name, faces, color in (("red", upper, (1.0, 0.0, 0.0)), ("blue", lower, (0.0, 0.0, 1.0))):
        used, renumbered = np.unique(faces, return_inverse=True)
        parts.append(MeshPart(name, CUBE[used], renumbered.reshape(-1, 3), points=used, material=Material(name, color)))
    for degrees, vertices in ((180.0, 4 + 8), (30.0, 24)):
        mesh = joined(*parts, crease_angle=degrees)
        assert len(mesh.positions) == vertices
        red = np.zeros(len(mesh.positions), dtype=bool)
        red[mesh.faces[:2]] = True
        assert_exact(mesh.albedo, np.where(red[:, None], [1.0, 0, 0], [0, 0, 1.0]), "copies of whole numbers")
    np.testing.assert_allclose(
        joined(*parts).normals, np.sign(joined(*parts).positions - 0.5) / np.sqrt(3.0), atol=1e-15
    )


def test_whether_the_albedo_is_known():
    white = Material("white")
    colors = np.ones((3, 3), dtype=np.float32)
    for parts, known in (
        ([MeshPart("a", TRIANGLE, FACE)], False),
        ([MeshPart("a", TRIANGLE, FACE, material=white)], True),
        ([MeshPart("a", TRIANGLE, FACE, colors=colors)], True),
        ([MeshPart("a", TRIANGLE, FACE), MeshPart("b", TRIANGLE + 1.0, FACE, material=white)], True),
    ):
        mesh = joined(*parts)
        assert mesh.known_albedo is known
        assert_exact(mesh.albedo, np.ones_like(mesh.albedo), "white is white")


def test_what_is_not_simulated_is_told_until_an_albedo_is_given():
    mesh = joined(MeshPart("a", TRIANGLE, FACE, material=Material("gold", metallic=1.0, not_simulated=("normal map",))))
    assert mesh.not_simulated[0][:2] == ("metallic reflection of material 'gold'", 1.0)
    assert mesh.not_simulated[1][:2] == ("normal map of material 'gold'", 1.0)
    assert mesh.albedo.max() == 0.0
    with open_scene(mesh, albedo=0.5) as scene:
        assert scene.not_simulated == ()
        assert scene.mesh.albedo.min() == 0.5


def test_points_are_numbered_over_all_parts():
    """Parts that say which point their vertices are share those; vertices of other parts are their own."""
    up, down = TRIANGLE, TRIANGLE * [1.0, -1.0, 1.0] + [0.0, 0.0, 0.0]
    folded = np.array([[0.0, 0, 0], [1, 0, 0], [0, 0, 1]])
    one = MeshPart("one", up, FACE, points=np.array([4, 5, 6]))
    two = MeshPart("two", folded, FACE[:, ::-1], points=np.array([4, 5, 9]))
    alone = MeshPart("alone", down, FACE[:, ::-1])
    mesh = joined(one, alone, two)
    np.testing.assert_allclose(mesh.normals[0], mesh.normals[6], atol=1e-15)
    np.testing.assert_allclose(mesh.normals[0], np.array([0.0, 1.0, 1.0]) / np.sqrt(2.0), atol=1e-15)
    np.testing.assert_allclose(mesh.normals[3:6], [[0.0, 0.0, 1.0]] * 3, atol=1e-15)


def test_faces_are_checked_part_by_part():
    """A vertex that only exists once all parts are joined is another part's."""
    good, bad = MeshPart("a", TRIANGLE, FACE), MeshPart("b", TRIANGLE, FACE + 1)
    with pytest.raises(UserError, match=r"1 faces name vertices that do not exist \(face 0 has \[1, 2, 3\], the mesh"):
        joined(bad, good)


@pytest.mark.parametrize(
    ("value", "message"), [(np.nan, "NaN or infinite"), (np.inf, "NaN"), (1e200, "above 1e"), (-1e99, "above 1e")]
)
def test_coordinates_are_checked_before_anything_is_computed(value, message):
    positions = TRIANGLE.copy()
    positions[1, 2] = value
    part = MeshPart("a", positions, FACE, colors=np.ones((3, 3), dtype=np.float32))
    with np.errstate(all="raise"), pytest.raises(UserError, match=rf"1 vertices have .*{message}.*vertex 1\)"):
        joined(part, crease_angle=30.0)


@pytest.mark.parametrize("part", [(), (MeshPart("a", np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64)),)])
def test_files_without_anything(part):
    with pytest.raises(UserError, match="the mesh has no vertices"):
        joined(*part)


def test_a_part_without_faces_beside_another():
    points = MeshPart("points", TRIANGLE + 5.0, np.zeros((0, 3), dtype=np.int64), material=Material("m"))
    mesh = joined(points, MeshPart("a", TRIANGLE, FACE, material=Material("n", (0.5, 0.5, 0.5))))
    assert_exact(mesh.receivers.active, [False] * 3 + [True] * 3, "bools")
    assert_exact(mesh.albedo[3:], np.full((3, 3), 0.5), "copies")


def test_a_texture_from_the_file_to_the_mesh(tmp_path):
    """An .obj with its .mtl: v runs up there, and the texture's values arrive where they belong."""
    Image.fromarray(np.array([[[255, 255, 255]], [[0, 0, 0]]], dtype=np.uint8)).save(tmp_path / "half.png")
    (tmp_path / "m.mtl").write_text("newmtl m\nKd 0.5 0.5 0.5\nmap_Kd -clamp on half.png\n")
    text, n = "mtllib m.mtl\nusemtl m\n", 8
    for j in range(n + 1):
        for i in range(n + 1):
            text += f"v {i} {j} 0\nvt {i / n} {j / n}\n"
    for j in range(n):
        for i in range(n):
            a = j * (n + 1) + i + 1
            text += "f " + " ".join(f"{v}/{v}" for v in (a, a + 1, a + n + 2, a + n + 1)) + "\n"
    (tmp_path / "m.obj").write_text(text)
    mesh = read_mesh(tmp_path / "m.obj")
    v = mesh.positions[:, 1] / n
    # Two texels: white in the middle of the upper one and above, between the middles as bilinear lookup has it.
    expected = 0.5 * np.clip(2.0 * v - 0.5, 0.0, 1.0)
    # A hat function of width h rounds a kink of slope 1 by h/6, at the border by up to h/3.
    np.testing.assert_allclose(mesh.albedo[:, 0], expected, atol=1.0 / n / 3.0)
    assert mesh.known_albedo
