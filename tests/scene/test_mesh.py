import json
import logging
import struct

import numpy as np
import pytest
import trimesh

from slepian_prt.errors import UserError
from slepian_prt.scene.mesh import make_mesh
from slepian_prt.scene.mesh_files import read_mesh

TRIANGLE = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])


def ply(vertices: str, faces: str) -> bytes:
    n, f = len(vertices.split("\n")), len(faces.split("\n")) if faces else 0
    head = f"ply\nformat ascii 1.0\nelement vertex {n}\nproperty float x\nproperty float y\nproperty float z\n"
    head += f"element face {f}\nproperty list uchar int vertex_indices\nend_header\n"
    return (head + vertices + "\n" + (faces + "\n" if faces else "")).encode()


def draco_glb() -> bytes:
    content = {
        "asset": {"version": "2.0"},
        "extensionsUsed": ["KHR_draco_mesh_compression"],
        "extensionsRequired": ["KHR_draco_mesh_compression"],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
    }
    text = json.dumps(content).encode()
    text += b" " * (-len(text) % 4)
    return b"glTF" + struct.pack("<II", 2, 20 + len(text)) + struct.pack("<I4s", len(text), b"JSON") + text


BAD = {
    "empty.ply": (b"", "the file is empty"),
    "garbage.ply": (b"not a mesh at all", "cannot be read as a mesh"),
    "garbage.obj": (b"hello world\n", "holds no mesh"),
    "garbage.stl": (b"xx", "holds no mesh"),
    "garbage.off": (b"foo", "cannot be read as a mesh"),
    "garbage.glb": (b"foo", "not a binary glTF"),
    "points.ply": (ply("0 0 0\n1 0 0\n0 1 0", ""), "no faces"),
    "nan.obj": (b"v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "1 vertices have NaN or infinite coordinates"),
    "inf.ply": (ply("0 0 inf\n1 0 0\n0 1 0", "3 0 1 2"), "the first is vertex 0"),
    "range.ply": (ply("0 0 0\n1 0 0\n0 1 0", "3 0 1 5"), r"faces name vertices that do not exist \(face 0"),
    "negative.ply": (ply("0 0 0\n1 0 0\n0 1 0", "3 0 1 -1"), "faces name vertices that do not exist"),
    "range.obj": (b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "line 4: a face names vertex 9"),
    "range.off": (b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 7\n", "faces name vertices that do not exist"),
    "flat.ply": (ply("0 0 0\n1 0 0\n2 0 0", "3 0 1 2"), "every face has zero area"),
    "draco.glb": (draco_glb(), "Draco-compressed|malformed"),
    "unknown.fbx": (b"x", "unknown mesh format '.fbx'"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_files_are_named_with_one_line(name, tmp_path):
    content, message = BAD[name]
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(UserError, match=message) as caught:
        read_mesh(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_missing_file_and_folder(tmp_path):
    with pytest.raises(UserError, match="no such file"):
        read_mesh(tmp_path / "nothing.ply")
    with pytest.raises(UserError, match="is a folder"):
        read_mesh(tmp_path)


@pytest.mark.parametrize("cut", [0.2, 0.5, 0.95])
def test_cut_ply(cut, tmp_path):
    whole = trimesh.creation.icosphere(2).export(file_type="ply")
    path = tmp_path / "cut.ply"
    path.write_bytes(whole[: int(cut * len(whole))])
    with pytest.raises(UserError, match="the file ends before them"):
        read_mesh(path)


@pytest.mark.parametrize("suffix", ["ply", "obj", "stl", "off", "glb"])
def test_formats_agree(suffix, tmp_path):
    ball = trimesh.creation.icosphere(2)
    path = tmp_path / f"ball.{suffix}"
    ball.export(path)
    mesh = read_mesh(path)
    assert len(mesh.positions) == 162
    assert len(mesh.faces) == 320
    assert mesh.receivers.active.all()
    # Outward, whatever the order of vertices: STL comes as loose triangles and must be joined.
    radial = mesh.positions / np.linalg.norm(mesh.positions, axis=1, keepdims=True)
    assert np.einsum("ij,ij->i", mesh.normals, radial).min() > 0.99


def test_placed_parts_of_a_glb_are_joined(tmp_path):
    scene = trimesh.Scene()
    ball = trimesh.creation.icosphere(1)
    scene.add_geometry(ball, transform=trimesh.transformations.translation_matrix([5, 0, 0]))
    scene.add_geometry(ball.copy(), transform=trimesh.transformations.scale_matrix(2.0))
    path = tmp_path / "two.glb"
    scene.export(path)
    mesh = read_mesh(path)
    assert len(mesh.positions) == 84
    assert mesh.positions[:, 0].max() == pytest.approx(6.0, abs=0.02)


BOX_OBJ = "".join(f"v {x} {y} {z}\n" for x in (0, 1) for y in (0, 1) for z in (0, 1))
BOX_FACES = (  # corners and the outward axis of each side
    ((1, 2, 4, 3), 1), ((5, 7, 8, 6), 2), ((1, 5, 6, 2), 3), ((3, 4, 8, 7), 4), ((1, 3, 7, 5), 5), ((2, 6, 8, 4), 6),
)  # fmt: skip


def test_hard_edges_of_an_obj_are_kept(tmp_path):
    """One position with three normals is three vertices; trimesh can be asked to collapse them, which is wrong."""
    text = BOX_OBJ + "vn -1 0 0\nvn 1 0 0\nvn 0 -1 0\nvn 0 1 0\nvn 0 0 -1\nvn 0 0 1\n"
    for corners, axis in BOX_FACES:
        text += "f " + " ".join(f"{c}//{axis}" for c in corners) + "\n"
    path = tmp_path / "box.obj"
    path.write_text(text)
    mesh = read_mesh(path)
    assert len(np.unique(np.column_stack([mesh.positions, mesh.normals]).round(6), axis=0)) == 24
    for corner in range(3):
        flat = mesh.positions[mesh.faces]
        face_normal = np.cross(flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0])
        assert np.einsum("ij,ij->i", mesh.normals[mesh.faces[:, corner]], face_normal).min() > 0.99


def test_seams_of_a_texture_are_no_seams_of_the_normals(tmp_path):
    text = BOX_OBJ + "".join(f"vt {i / 7} 0\n" for i in range(8))
    for corners, axis in BOX_FACES:
        text += "f " + " ".join(f"{c}/{(c + axis) % 8 + 1}" for c in corners) + "\n"
    path = tmp_path / "box.obj"
    path.write_text(text)
    mesh = read_mesh(path)
    assert len(mesh.positions) == 8
    np.testing.assert_allclose(mesh.normals, np.sign(mesh.positions - 0.5) / np.sqrt(3), atol=1e-9)


def test_objects_of_an_obj_do_not_repeat_each_others_vertices(tmp_path):
    text = "o one\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\no two\nv 0 0 1\nv 1 0 1\nv 0 1 1\nf 4 5 6\n"
    path = tmp_path / "two.obj"
    path.write_text(text)
    assert len(read_mesh(path).positions) == 6


def test_inconsistent_winding_is_remarked_on():
    ball = trimesh.creation.icosphere(2)
    faces = ball.faces.copy()
    faces[::3] = faces[::3, ::-1]
    assert any("opposite orientation" in note for note in make_mesh(ball.vertices, faces).notes)
    assert not make_mesh(ball.vertices, ball.faces).notes
    assert not make_mesh(ball.vertices, ball.faces[:, ::-1]).notes


def test_given_normals_are_kept_and_bad_ones_replaced(caplog):
    given = np.array([[0, 0, 2.0], [0, 0, 0], [np.nan, 0, 1]])
    with caplog.at_level(logging.INFO):
        mesh = make_mesh(TRIANGLE, [[0, 1, 2]], normals=given)
    np.testing.assert_allclose(mesh.normals, np.tile([0, 0, 1.0], (3, 1)))
    assert "2 missing or zero normals computed" in caplog.text
    tilted = make_mesh(TRIANGLE, [[0, 1, 2]], normals=np.tile([0, 0.6, 0.8], (3, 1)))
    np.testing.assert_allclose(tilted.normals, np.tile([0, 0.6, 0.8], (3, 1)))


def test_degenerate_faces_and_loose_vertices_are_counted():
    positions = np.concatenate([TRIANGLE, [[5, 5, 5], [0.5, 0, 0]]])
    mesh = make_mesh(positions, [[0, 1, 2], [0, 4, 1], [2, 2, 2]])
    assert len(mesh.faces) == 1
    assert mesh.receivers.active.tolist() == [True, True, True, False, False]
    assert any("2 faces of zero area" in note for note in mesh.notes)
    assert any("2 vertices that no face uses" in note for note in mesh.notes)
    assert np.isfinite(mesh.normals).all()


def test_faces_back_to_back_keep_a_normal():
    mesh = make_mesh(TRIANGLE, [[0, 1, 2], [0, 2, 1]])
    np.testing.assert_allclose(np.abs(mesh.normals[:, 2]), 1.0)
    assert any("cancel" in note for note in mesh.notes)


def test_normals_do_not_depend_on_the_triangulation():
    box = trimesh.creation.box()
    mesh = make_mesh(box.vertices, box.faces)
    expected = np.sign(box.vertices) / np.sqrt(3)
    np.testing.assert_allclose(mesh.normals, expected, atol=1e-12)


@pytest.mark.parametrize("scale", [1e-6, 1e8])
def test_scale_and_place_do_not_matter(scale):
    ball = trimesh.creation.icosphere(2)
    mesh = make_mesh(ball.vertices * scale + [0, 3 * scale, 0], ball.faces)
    assert not mesh.notes
    np.testing.assert_allclose(mesh.normals, make_mesh(ball.vertices, ball.faces).normals, atol=1e-9)
