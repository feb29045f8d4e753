"""Which vertex of a mesh is which of the file that it was read from, where readers split, join or leave out some."""

import numpy as np
import pytest
import trimesh

from slepian_prt.scene.mesh_files import read_mesh
from tests.numerics import assert_exact


def positions_of(mesh, path_positions) -> None:
    """Each pair is one place, and each vertex of the mesh is in one."""
    before, now = mesh.source.T
    assert_exact(mesh.positions[now], np.asarray(path_positions)[before], because="a copy")
    assert set(now.tolist()) == set(range(len(mesh.positions)))


@pytest.fixture
def box():
    return trimesh.creation.box()


def test_vertices_that_are_neither_split_nor_joined_need_no_map(tmp_path, box):
    box.export(tmp_path / "box.ply")
    assert read_mesh(tmp_path / "box.ply").source is None


def test_hard_edges_split(tmp_path, box):
    box.export(tmp_path / "box.ply")
    mesh = read_mesh(tmp_path / "box.ply", crease_angle=30.0)
    assert (len(mesh.positions), len(mesh.source)) == (24, 24)
    positions_of(mesh, box.vertices)
    assert np.bincount(mesh.source[:, 0]).tolist() == [3] * 8


def test_normals_of_obj_files_split(tmp_path):
    lines = [
        "v 0 0 0",
        "v 1 0 0",
        "v 0 1 0",
        "v 0 0 1",
        "vn 0 0 1",
        "vn 0 -1 0",
        "f 1//1 2//1 3//1",
        "f 1//2 4//2 2//2",
    ]
    (tmp_path / "a.obj").write_text("\n".join(lines))
    mesh = read_mesh(tmp_path / "a.obj")
    assert len(mesh.positions) == 6
    positions_of(mesh, [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])


def test_equal_positions_of_obj_files_join(tmp_path):
    lines = ["v 0 0 0", "v 1 0 0", "v 0 1 0", "v 1 0 0", "v 0 0 1", "f 1 2 3", "f 1 5 4"]
    (tmp_path / "a.obj").write_text("\n".join(lines))
    mesh = read_mesh(tmp_path / "a.obj")
    assert len(mesh.positions) == 4
    assert sorted(map(tuple, mesh.source.tolist())) == [(0, 0), (1, 1), (2, 2), (3, 1), (4, 3)]


def test_materials_part_and_leave_out(tmp_path):
    (tmp_path / "a.mtl").write_text("newmtl red\nKd 1 0 0\nnewmtl blue\nKd 0 0 1\n")
    places = [[0, 0, 0], [9, 9, 9], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
    vertices = "\n".join("v {} {} {}".format(*place) for place in places)
    (tmp_path / "a.obj").write_text(f"mtllib a.mtl\n{vertices}\nusemtl red\nf 1 3 4\nusemtl blue\nf 1 5 3\n")
    mesh = read_mesh(tmp_path / "a.obj")
    assert len(mesh.positions) == 6
    positions_of(mesh, places)
    assert 1 not in mesh.source[:, 0]
    both = read_mesh(tmp_path / "a.obj", crease_angle=10.0)
    positions_of(both, places)
