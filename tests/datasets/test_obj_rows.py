"""Faces of OBJ files as the loaders of PIFu and ICON number them, against a reader that does as they do."""

import numpy as np
import pytest

from slepian_prt.datasets.obj_rows import read_rows
from slepian_prt.errors import UserError
from slepian_prt.scene.mesh_files import read_mesh
from tests.datasets.obj_as_theirs import read_triangles
from tests.datasets.scans import bent_ball, write_obj
from tests.numerics import assert_exact

BALL = bent_ball()
SQUARES = np.array([[x, y, 0.1 * x * y] for y in range(4) for x in range(4)], dtype=float)
QUADS = [[4 * y + x + 1, 4 * y + x + 2, 4 * y + x + 6, 4 * y + x + 5] for y in range(3) for x in range(3)]


def assert_paired(path, rows):
    """Each corner of each triangle that they read has its row, and lies where it lies."""
    positions, triangles = read_triangles(path)
    assert rows.faces.shape == triangles.shape
    assert rows.faces.dtype == np.int64
    assert_exact(rows.mesh.positions[rows.faces], positions[triangles], "the same decimals")


def test_triangles(tmp_path):
    """Rows are the positions of the file, and its faces themselves."""
    path = write_obj(tmp_path / "a.obj", BALL.vertices, (BALL.faces + 1).tolist())
    rows = read_rows(path)
    assert_paired(path, rows)
    assert_exact(rows.faces, BALL.faces, "read as they were written")


def test_faces_without_area_stay_where_they_are(tmp_path):
    faces = (BALL.faces + 1).tolist()
    flat = [[faces[3][0], faces[3][0], faces[3][1]], [7, 7, 7]]
    for place in (0, 3, len(faces)):
        path = write_obj(tmp_path / f"{place}.obj", BALL.vertices, [*faces[:place], *flat, *faces[place:]])
        rows = read_rows(path)
        assert_paired(path, rows)
        assert len(rows.faces) == len(faces) + 2
        assert len(rows.mesh.faces) == len(faces)


def test_quadrilaterals_are_cut_as_they_cut_them(tmp_path):
    """Along the first diagonal, side by side, among triangles; also where a corner is repeated."""
    mixed = [QUADS[0], [1, 2, 6], *QUADS[1:4], [1, 2, 6, 6], [1, 2, 6], *QUADS[4:]]
    path = write_obj(tmp_path / "quads.obj", SQUARES, mixed)
    rows = read_rows(path)
    assert_paired(path, rows)
    assert len(rows.faces) == 2 * (len(QUADS) + 1) + 2


@pytest.mark.parametrize("faces", [[[1, 2, 6], [1, 2, 3, 7, 6]], [[1, 2, 6], [3, 4]]])
def test_polygons_that_they_misread_are_refused(faces, tmp_path):
    path = write_obj(tmp_path / "polygon.obj", SQUARES, faces, "# a comment\n")
    line = path.read_text().splitlines().index("f " + " ".join(map(str, faces[1]))) + 1
    wanted = (
        rf"polygon.obj: line {line}: a face of {len(faces[1])} corners, and the loaders of PIFu and ICON read three"
    )
    with pytest.raises(UserError, match=wanted):
        read_rows(path)


def test_normals_of_the_file_split_vertices(tmp_path):
    """A position with two normals has two rows, each with its own."""
    normals = "vn 0 0 1\nvn 1 0 0\n"
    faces = [[f"{a}//{1 if number < 9 else 2}" for a in quad] for number, quad in enumerate(QUADS + QUADS[:2])]
    path = write_obj(tmp_path / "normals.obj", SQUARES, faces, normals)
    rows = read_rows(path)
    assert_paired(path, rows)
    given = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    wanted = np.repeat([0] * 9 + [1] * 2, 2)
    assert_exact(rows.mesh.normals[rows.faces], given[np.repeat(wanted[:, None], 3, axis=1)], "as given")
    assert len(rows.mesh.positions) == 16 + 6


def test_seams_of_a_texture_split_nothing(tmp_path):
    """Nor do normals differ there that are not in the file: positions that are equal have one."""
    doubled = np.concatenate([BALL.vertices, BALL.vertices])
    half = len(BALL.faces) // 2
    faces = [[f"{a}/{1 + number % 3}" for a in face] for number, face in enumerate((BALL.faces[:half] + 1).tolist())]
    faces += [[f"{a}/2" for a in face] for face in (BALL.faces[half:] + 1 + len(BALL.vertices)).tolist()]
    path = write_obj(tmp_path / "seams.obj", doubled, faces, "vt 0 0\nvt 1 0\nvt 0 1")
    rows = read_rows(path)
    assert_paired(path, rows)
    assert len(rows.mesh.positions) == len(doubled)
    whole = read_mesh(write_obj(tmp_path / "whole.obj", BALL.vertices, (BALL.faces + 1).tolist()))
    np.testing.assert_allclose(rows.mesh.normals[rows.faces], whole.normals[BALL.faces], rtol=0.0, atol=1e-12)


def test_corners_counted_from_the_end(tmp_path):
    count = len(BALL.vertices)
    path = write_obj(tmp_path / "relative.obj", BALL.vertices, (BALL.faces - count).tolist())
    assert_exact(read_rows(path).faces, BALL.faces, "the same corners")


def test_hard_edges(tmp_path):
    """Copies of vertices at creases; faces without area, which have no side of a crease, keep their places."""
    cube = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)], dtype=float)
    sides = [[1, 3, 4, 2], [5, 6, 8, 7], [1, 2, 6, 5], [3, 7, 8, 4], [1, 5, 7, 3], [2, 4, 8, 6]]
    path = write_obj(tmp_path / "cube.obj", cube, [*sides[:2], [1, 1, 2], *sides[2:]])
    rows = read_rows(path, 30.0)
    assert_paired(path, rows)
    assert len(rows.mesh.positions) == 24
    there = np.arange(len(rows.faces)) != 4
    flat = np.cross(*np.moveaxis(np.diff(rows.mesh.positions[rows.faces[there]], axis=1), 1, 0))
    np.testing.assert_allclose(
        rows.mesh.normals[rows.faces[there]], np.repeat(flat[:, None], 3, axis=1), rtol=0.0, atol=1e-12
    )


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("scan.ply", "ply\n", "scan.ply: PIFu and ICON read OBJ files only"),
        ("scan.obj", "", "is empty"),
        ("scan.obj", "v 0 0 0\nv 1 0 0\n", "has no faces"),
        ("scan.obj", "o nothing\n", "has no faces"),
        ("scan.obj", "v 0 0 0\nv 1 0 0\nf 1 2 1\n", "every face has zero area"),
        ("scan.obj", "v 0 0 0\nv 1 0 nan\nv 0 1 0\nf 1 2 3\n", "NaN"),
        ("scan.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n", "line 4: a face names vertex 4"),
    ],
)
def test_mistakes(name, content, message, tmp_path):
    (tmp_path / name).write_text(content)
    with pytest.raises(UserError, match=message):
        read_rows(tmp_path / name)
