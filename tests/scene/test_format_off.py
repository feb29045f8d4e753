"""OFF by its description."""

import numpy as np
import pytest

from slepian_prt.errors import UserError
from slepian_prt.scene.formats.off import read_off
from tests.numerics import assert_exact

SQUARE = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0.5], [0, 1, 0]])
VERTICES = "0 0 0\n1 0 0\n1 1 .5\n0 1 0\n"


def read(tmp_path, content):
    path = tmp_path / "part.off"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return read_off(path)


@pytest.mark.parametrize(
    "content",
    [
        f"OFF\n4 2 0\n{VERTICES}3 0 1 2\n3 0 2 3\n",
        f"OFF 4 2 5\n{VERTICES}3 0 1 2\n3 0 2 3",
        f"# made here\n\nOFF # 3-D\n# counts\n4 1 0 # of them\n\n{VERTICES}\n# faces\n4 0 1 2 3 # one\n",
        f"OFF\r\n4 2 0\r\n{VERTICES}3 0 1 2 255 0 0\r\n3 0 2 3 0.5 0.5 0.5 1\r\n".replace("\n", "\r\n"),
        f"OFF\n4 3 0\n{VERTICES}3 0 1 2 7\n2 0 1\n3 0 2 3\n",
        f"\ufeffOFF\n4 2 0\n\t{VERTICES}3 0 1 2\n3\t0\t2\t3\n",
        f"  OFF4 2 0\n{VERTICES}3 0 1 2\n3 0 2 3\n",
        f"OFF\n4 2 0\n{VERTICES}3 0\n1\n2\n\n3\n0 2\n3\n",
        f"OFF\n4 2 0\n{VERTICES}3 0 1 2 3 0 2 3\n".replace("0\n1 1", "0 1 1"),
    ],
)
def test_all_ways_to_write_two_triangles(tmp_path, content):
    (part,) = read(tmp_path, content).parts
    assert_exact(part.positions, SQUARE, "short decimals")
    assert_exact(part.faces, [[0, 1, 2], [0, 2, 3]], "indices")
    assert part.normals is None
    assert part.colors is None


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-be"])
def test_text_of_two_bytes_a_letter(tmp_path, encoding):
    mark = "" if encoding == "utf-16" else "\ufeff"
    (part,) = read(tmp_path, (mark + f"OFF\n4 2 0\n{VERTICES}3 0 1 2\n3 0 2 3\n").encode(encoding)).parts
    assert_exact(part.faces, [[0, 1, 2], [0, 2, 3]], "indices")


def test_normals_and_colours_by_the_keyword(tmp_path):
    rows = "0 0 0  0 0 2  255 0 51 255  .1 .2\n1 0 0  0 0 1  0 0 0 255  .1 .2\n1 1 .5  1 0 0  255 255 255 0  .1 .2\n"
    (part,) = read(tmp_path, f"STCNOFF\n3 1 0\n{rows}3 0 1 2\n").parts
    assert_exact(part.normals, [[0, 0, 2], [0, 0, 1], [1, 0, 0]], "copies")
    dark = ((51 / 255 + 0.055) / 1.055) ** 2.4
    np.testing.assert_allclose(part.colors, [[1, 0, dark], [0, 0, 0], [1, 1, 1]], rtol=1e-6)
    (part,) = read(tmp_path, "COFF\n3 1 0\n0 0 0 .5 0 1.0\n1 0 0 0 0 1\n0 1 0 1 1 1\n3 0 1 2\n").parts
    np.testing.assert_allclose(part.colors, [[0.5, 0, 1], [0, 0, 1], [1, 1, 1]], rtol=1e-7)
    (part,) = read(tmp_path, "NOFF\n3 1 0\n0 0 0 .5 0 1.0\n1 0 0 0 0 1\n0 1 0 1 1 1\n3 0 1 2\n").parts
    assert_exact(part.normals, [[0.5, 0, 1], [0, 0, 1], [1, 1, 1]], "copies")


def test_further_columns_and_short_faces_are_noted(tmp_path):
    file = read(tmp_path, "OFF\n3 2 0\n0 0 0 9\n1 0 0 9\n0 1 0 9\n3 0 1 2\n1 0\n")
    assert file.notes == (
        "1 further numbers of each vertex left out",
        "1 faces of fewer than three different corners left out",
    )


def test_a_file_of_points_has_no_faces(tmp_path):
    (part,) = read(tmp_path, f"OFF\n4 0 0\n{VERTICES}").parts
    assert part.faces.shape == (0, 3)


GOOD = f"OFF\n4 2 0\n{VERTICES}3 0 1 2\n3 0 2 3\n"

BAD = {
    "garbage": ("foo", "does not begin with 'OFF'"),
    "another word": ("OFFICE\n1 2 3", "does not begin with 'OFF'"),
    "nothing more": ("OFF\n", "no counts"),
    "no counts": (f"OFF\n{VERTICES}", "declares 0 vertices and 0 faces, and has 3 lines"),
    "counts that are none": ("OFF\n4.5 1 0\n", "line 2: '4.5 1 0' are no counts"),
    "binary": (b"OFF BINARY\n\0\0\0\1", "is a binary OFF file; save it as text"),
    "four dimensions": ("4OFF\n1 0 0\n0 0 0 0\n", "is a 4OFF file"),
    "any dimensions": ("nOFF 2\n1 0 0\n0 0\n", "is a nOFF file"),
    "cut off": (GOOD[:-10], "declares 4 vertices and 2 faces, and has 5 lines"),
    "cut off in a line": (GOOD[:-3], "line 8: begins with 3, which is not how many corners follow"),
    "too many lines": (GOOD + "3 0 1 3\n", "has 7 lines"),
    "rows over lines, cut off": (GOOD.replace("3 0 2 3\n", "3 0\n2"), "declares 4 vertices and 2 faces, and has 7"),
    "a long number over lines": (GOOD.replace("3 0 2 3", f"3 0 2 3\n{'9' * 5000}"), "has 7 lines"),
    "as many as atoms": ("OFF\n1000000000000000000 2 0\n0 0 0\n", "declares 1000000000000000000 vertices"),
    "two coordinates": (GOOD.replace("1 0 0", "1 0"), "line 4: has 2 numbers, and a vertex has 3"),
    "a longer line": (GOOD.replace("1 0 0", "1 0 0 9"), "line 4: has 4 numbers, and a vertex has 3"),
    "a word": (GOOD.replace("1 1 .5", "1 one .5"), "line 5: 'one' is not a number"),
    "a vertex that is not there": (GOOD.replace("3 0 2 3", "3 0 2 4"), r"face 1 names vertex 4, the mesh has 4"),
    "a negative vertex": (GOOD.replace("3 0 2 3", "3 0 2 -1"), "face 1 names vertex -1"),
    "half a vertex": (GOOD.replace("3 0 2 3", "3 0 2 2.5"), "line 8: vertex 2.5 is no integer"),
    "not a number of corners": (GOOD.replace("3 0 2 3", "nan 0 2 3"), "line 8: begins with nan"),
    "colours too few": (GOOD.replace("OFF", "COFF"), "line 3: has 3 numbers, and a vertex has 6 or more"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_bad_files_are_refused_in_one_line(tmp_path, name):
    content, message = BAD[name]
    with pytest.raises(UserError, match=message) as raised:
        read(tmp_path, content)
    assert "\n" not in str(raised.value)
