"""STL against files written here by the format's description."""

import numpy as np
import pytest

from slepian_prt.errors import UserError
from slepian_prt.scene.formats.stl import read_stl
from tests.numerics import assert_exact


def grid(n):
    """A bent sheet of 2 n² triangles."""
    u, v = np.meshgrid(np.arange(n + 1), np.arange(n + 1), indexing="ij")
    positions = np.stack([u / n, v / n, np.sin(u / n)], axis=-1).reshape(-1, 3).astype(np.float32)
    i = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    a, b, c, d = i[:-1, :-1].ravel(), i[1:, :-1].ravel(), i[1:, 1:].ravel(), i[:-1, 1:].ravel()
    return positions, np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])


def binary(corners, header=b"made here"):
    corners = np.asarray(corners, dtype="<f4").reshape(-1, 3, 3)
    body = b"".join(np.zeros(3, "<f4").tobytes() + triangle.tobytes() + b"\x12\x34" for triangle in corners)
    return header.ljust(80, b" ") + len(corners).to_bytes(4, "little") + body


def text(corners, name=b"part", end=b"\n"):
    lines = [b"solid " + name]
    for triangle in np.asarray(corners).reshape(-1, 3, 3):
        lines += [b"  facet normal 0 0 nan", b"    outer loop"]
        lines += [b"      vertex %.9g %.9g %.9g" % tuple(corner) for corner in triangle]
        lines += [b"    endloop", b"  endfacet"]
    return end.join([*lines, b"endsolid " + name, b""])


def read(tmp_path, content):
    path = tmp_path / "part.stl"
    path.write_bytes(content)
    (part,) = read_stl(path).parts
    return part


POSITIONS, FACES = grid(7)
CORNERS = POSITIONS[FACES].astype(np.float64)
ONE = text(CORNERS[0])

GOOD = {
    "binary": binary(CORNERS),
    "binary, which begins as text does": binary(CORNERS, b"solid part\n facet normal"),
    "text": text(CORNERS),
    "of Windows": text(CORNERS, end=b"\r\n"),
    "of old Macs": text(CORNERS, end=b"\r"),
    "in capitals": text(CORNERS).upper(),
    "with words of the format in its name": text(CORNERS, name=b"vertex 1 2 3 facet endfacet"),
    "of two solids": text(CORNERS[:20]) + b"\n" + text(CORNERS[20:], b""),
    "of few lines": text(CORNERS).replace(b"\n    outer", b" outer").replace(b"\n      vertex", b" vertex"),
    "with a mark of the byte order": b"\xef\xbb\xbf" + text(CORNERS),
    "of two bytes a letter": text(CORNERS).decode().encode("utf-16"),
}


@pytest.mark.parametrize("name", GOOD)
def test_corners_are_joined(tmp_path, name):
    part = read(tmp_path, GOOD[name])
    assert part.positions.shape == POSITIONS.shape
    assert part.normals is None
    corners = part.positions[part.faces].astype(np.float32)
    assert_exact(corners, CORNERS, "float32 numbers are copied, also through nine digits")


@pytest.mark.parametrize("shift", [0.0, 1000.0])
def test_corners_that_differ_by_rounding_are_one(tmp_path, shift):
    rng = np.random.default_rng(1)
    moved = (CORNERS + shift).astype(np.float32)
    moved = np.nextafter(moved, moved + rng.choice([-1, 1], moved.shape).astype(np.float32))
    part = read(tmp_path, binary(moved))
    assert len(part.positions) == len(POSITIONS)
    np.testing.assert_allclose(part.positions[part.faces], moved, atol=4 * np.spacing(np.float32(1 + shift)))


def test_neither_thin_triangles_nor_chains_collapse(tmp_path):
    step = 6e-7  # below the tolerance, which is 1e-6 of the diagonal
    thin = [[[0, 0, 0], [1, 0, 0], [1, step, 0]], [[0, 0, 0], [1, step, 0], [1, 2 * step, 0]]]
    part = read(tmp_path, binary(thin))
    assert len(part.positions) == 4
    apart = [[[0, 0, 0], [k * step, 1, 0], [0, 0, -1]] for k in range(9)]
    part = read(tmp_path, binary(apart))
    np.testing.assert_allclose(part.positions[part.faces], apart, atol=2e-6)
    assert len(part.positions) > 4


@pytest.mark.parametrize("content", [binary([]), text([])])
def test_a_file_of_no_triangles_has_no_faces(tmp_path, content):
    assert read(tmp_path, content).faces.shape == (0, 3)


def test_a_degenerate_triangle_is_left_to_the_checks(tmp_path):
    part = read(tmp_path, binary(np.concatenate([CORNERS, CORNERS[:1, [0, 0, 1]]])))
    assert len(part.faces) == len(FACES) + 1
    assert part.faces[-1, 0] == part.faces[-1, 1]


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_what_is_not_finite_is_left_to_the_checks(tmp_path, value):
    corners = CORNERS.copy()
    corners[3, 1, 2] = value
    assert not np.isfinite(read(tmp_path, binary(corners)).positions).all()


BAD = {
    "garbage": (b"xx", "holds no mesh"),
    "cut off": (binary(CORNERS)[:-30], "its header counts 98 triangles, which take 4984 bytes, and the file has 4954"),
    "with a count of zero": (binary(CORNERS)[:80] + bytes(4) + binary(CORNERS)[84:], "counts 0 triangles"),
    "text cut off in a facet": (ONE[: ONE.index(b"endloop")] + b"endsolid part", "line 2: the facet is cut off"),
    "text cut off after a facet": (ONE[: ONE.index(b"endsolid")], "does not end with 'endsolid'"),
    "a quadrilateral": (
        ONE.replace(b"    endloop", b"vertex 1 2 3\nendloop"),
        "line 2: the facet is cut off, or is no",
    ),
    "a word": (ONE.replace(b"vertex 0 0 0", b"vertex 0 0 zero"), "line 4: 'zero' is not a number"),
    "a decimal comma": (ONE.replace(b"vertex 0 0 0", b"vertex 0 0 0,5"), "line 4: '0,5' is not a number"),
    "two points": (ONE.replace(b"vertex 0 0 0", b"vertex 0 0 0.5.5"), "line 4: '0.5.5' is not a number"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_files_are_refused_in_one_line(tmp_path, name):
    content, message = BAD[name]
    with pytest.raises(UserError, match=message) as raised:
        read(tmp_path, content)
    assert "\n" not in str(raised.value)
    assert str(raised.value).startswith(str(tmp_path / "part.stl"))
