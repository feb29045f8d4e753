"""PLY against files written here, row by row, by the format's description."""

import struct

import numpy as np
import pytest

from slepian_prt.errors import UserError
from slepian_prt.scene.formats.ply import read_ply
from tests.numerics import assert_exact

CODES = {
    "char": "b", "int8": "b", "uchar": "B", "uint8": "B", "short": "h", "int16": "h", "ushort": "H", "uint16": "H",
    "int": "i", "int32": "i", "uint": "I", "uint32": "I", "float": "f", "float32": "f", "double": "d", "float64": "d",
}  # fmt: skip

FORMATS = ["ascii", "binary_little_endian", "binary_big_endian"]

SQUARE = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (1.0, 1.0, 0.5), (0.0, 1.0, 0.0)]

XYZ = ["double x", "double y", "double z"]

LIST = "list uchar int vertex_indices"


def write(elements, form="ascii", comments=(), end="\n"):
    """A file of elements (name, properties, rows); a list property takes a list of each row."""
    lines = ["ply", f"format {form} 1.0", *(f"comment {c}" for c in comments)]
    for name, properties, rows in elements:
        lines += [f"element {name} {len(rows)}", *(f"property {p}" for p in properties)]
    body = b""
    order = ">" if "big" in form else "<"
    for _, properties, rows in elements:
        for row in rows:
            words = []
            for p, value in zip(properties, row, strict=True):
                *kinds, _ = [k for k in p.split() if k != "list"]
                values = (
                    [(kinds[0], len(value)), *((kinds[1], v) for v in value)]
                    if len(kinds) == 2
                    else [(kinds[0], value)]
                )
                for kind, v in values:
                    words.append(repr(v))
                    body += b"" if form == "ascii" else struct.pack(order + CODES[kind], v)
            body += (" ".join(words) + end).encode() if form == "ascii" else b""
    return end.join([*lines, "end_header", ""]).encode() + body


def read(tmp_path, content):
    path = tmp_path / "part.ply"
    path.write_bytes(content)
    return read_ply(path)


def random_polygons(seed, count=60):
    """Fans around random vertices: polygons of one to seven corners of a circle."""
    rng = np.random.default_rng(seed)
    angle = 2 * np.pi * np.arange(40) / 40
    vertices = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    return vertices, [np.sort(rng.choice(40, rng.integers(1, 8), replace=False)).tolist() for _ in range(count)]


@pytest.mark.parametrize("form", FORMATS)
@pytest.mark.parametrize("count", ["uchar", "int", "ushort", "int8"])
def test_polygons_of_mixed_sizes_between_other_properties(tmp_path, form, count):
    vertices, polygons = random_polygons(3)
    faces = [(0.5, p, -1, [0.25] * (k % 3), 7) for k, p in enumerate(polygons)]
    plan = ["float quality", f"list {count} uint vertex_index", "short region", "list int double more", "uint8 flags"]
    content = write(
        [
            ("camera", ["int a", "list uchar char name"], [(5, [1, 2, 3]), (6, [])]),
            (
                "vertex",
                ["uchar flag", "double z", "double x", "double y"],
                [(1, z, x, y) for x, y, z in vertices.tolist()],
            ),
            ("edge", ["int vertex1", "int vertex2"], [(0, 1), (1, 2), (2, 3)]),
            ("face", plan, faces),
            ("material", ["float a"], [(1.0,)]),
        ],
        form,
    )
    file = read(tmp_path, content)
    (part,) = file.parts
    assert_exact(part.positions, vertices, "repr and the bits of a double lose nothing")
    fans = [(p[0], p[k], p[k + 1]) for p in polygons for k in range(1, len(p) - 1)]
    assert_exact(part.faces, fans, "corners of a circle are convex")
    short = sum(len(p) < 3 for p in polygons)
    assert file.notes == (f"{short} faces of fewer than three different corners left out",)


@pytest.mark.parametrize("form", FORMATS)
@pytest.mark.parametrize("kind", CODES)
def test_all_types_of_numbers(tmp_path, form, kind):
    vertices = [(3, 1, 0), (1, 4, 0), (5, 9, 2)]
    vertices = [tuple(map(float, v)) for v in vertices] if CODES[kind] in "fd" else vertices
    content = write(
        [
            ("vertex", [f"{kind} {k}" for k in "xyz"], vertices),
            ("face", [f"list uint8 {kind} vertex_indices"], [([0, 1, 2],)]),
        ],
        form,
    )
    (part,) = read(tmp_path, content).parts
    assert part.positions.dtype == np.float64
    assert_exact(part.positions, vertices, "small integers")
    assert_exact(part.faces, [[0, 1, 2]], "small integers")


@pytest.mark.parametrize("end", ["\r\n", "\r"])
def test_ends_of_lines(tmp_path, end):
    content = write([("vertex", XYZ, SQUARE), ("face", [LIST], [([0, 1, 2],), ([0, 2, 3],)])], end=end)
    assert_exact(read(tmp_path, content).parts[0].faces, [[0, 1, 2], [0, 2, 3]], "indices")


@pytest.mark.parametrize("form", FORMATS)
def test_a_line_of_the_header_without_a_keyword_is_a_comment(tmp_path, form):
    content = good(form).replace(b" 1.0\n", b" 1.0\nmade by hand, element by element\n\n", 1)
    (part,) = read(tmp_path, content).parts
    assert_exact(part.positions, SQUARE, "copies")


def test_text_of_two_bytes_a_letter(tmp_path):
    (part,) = read(tmp_path, good().decode().encode("utf-16")).parts
    assert_exact(part.positions, SQUARE, "copies")


def test_attributes_of_vertices(tmp_path):
    plan = [*XYZ, "float nx", "float ny", "float nz", "uchar red", "uchar green", "uchar blue", "uchar alpha"]
    rows = [(*p, 0.0, 0.0, 2.0, 255, 0, 51, 9) for p in SQUARE]
    (part,) = read(tmp_path, write([("vertex", plan, rows), ("face", [LIST], [([0, 1, 2],)])])).parts
    assert_exact(part.normals, [[0, 0, 2]] * 4, "copies")
    np.testing.assert_allclose(part.colors, [[1, 0, ((51 / 255 + 0.055) / 1.055) ** 2.4]] * 4, rtol=1e-6)
    assert part.material is None


@pytest.mark.parametrize(
    ("kind", "value", "linear"),
    [
        ("float", 0.5, 0.5),
        ("double", 3.0, 3.0),
        ("ushort", 65535, 1.0),
        ("int", 255, 1.0),
        ("uchar", 1, 1 / 255 / 12.92),
    ],
)
@pytest.mark.parametrize("prefix", ["", "diffuse_"])
@pytest.mark.parametrize("form", FORMATS)
def test_floats_are_linear_and_integers_are_not(tmp_path, kind, value, linear, prefix, form):
    plan = [*XYZ, *(f"{kind} {prefix}{c}" for c in ("red", "green", "blue"))]
    rows = [(*p, value, value, value) for p in SQUARE]
    (part,) = read(tmp_path, write([("vertex", plan, rows), ("face", [LIST], [([0, 1, 2],)])], form)).parts
    np.testing.assert_allclose(part.colors, np.full((4, 3), linear), rtol=1e-6)


WEDGES = [([0, 1, 2], [0.0, 0.0, 1.0, 0.0, 1.0, 0.75]), ([0, 2, 3], [0.5, 0.0, 1.0, 1.0, 0.0, 1.0])]


@pytest.mark.parametrize("form", FORMATS)
def test_texture_coordinates_of_corners_split_nothing(tmp_path, form):
    elements = [("vertex", XYZ, SQUARE), ("face", [LIST, "list uchar float texcoord"], WEDGES)]
    (part,) = read(tmp_path, write(elements, form, ["TextureFile my skin.png"])).parts
    assert len(part.positions) == 4
    assert part.material.texture.source == tmp_path / "my skin.png"
    right = np.array([uv for _, uv in WEDGES], dtype=np.float32).reshape(2, 3, 2) * [1, -1] + [0, 1]
    assert_exact(part.uv, right, "quarters")


def test_texture_coordinates_of_polygons(tmp_path):
    arrow = [(0.0, 0.0, 0.0), (1.0, -1.0, 0.0), (0.0, 2.0, 0.0), (-1.0, -1.0, 0.0)]
    uv = [c for x, y, _ in arrow for c in (x, 1 - y)]
    elements = [("vertex", XYZ, arrow), ("face", [LIST, "list uchar float texcoord"], [([0, 1, 2, 3], uv)])]
    (part,) = read(tmp_path, write(elements, comments=["TextureFile a.png"])).parts
    assert_exact(part.uv, part.positions[part.faces][..., :2], "each corner brings its own")


@pytest.mark.parametrize("normals", [False, True])
def test_faces_of_several_textures(tmp_path, normals):
    plan = [*XYZ, *(["float nx", "float ny", "float nz"] if normals else [])]
    vertices = [(*p, *((0.0, 0.0, 1.0) if normals else ())) for p in [*SQUARE, (9.0, 9.0, 9.0)]]
    faces = [(*WEDGES[0], 1), (*WEDGES[1], 0), ([0, 1, 3], WEDGES[0][1], 7)]
    elements = [("vertex", plan, vertices), ("face", [LIST, "list uchar float texcoord", "int texnumber"], faces)]
    parts = read(tmp_path, write(elements, comments=["TextureFile a.png", "TextureFile b.png"])).parts
    assert [p.material and p.material.texture.name for p in parts] == [None, "a.png", "b.png"]
    for part, face in zip(parts, [[0, 1, 3], [0, 2, 3], [0, 1, 2]], strict=True):
        assert_exact(part.positions[part.faces[0]], np.array(SQUARE)[face], "copies")
        assert len(part.positions) == 3
    # The surface goes on from one texture to the next: the same point at each position.
    corner = [np.flatnonzero((part.positions == 0).all(axis=1))[0] for part in parts]
    assert len({int(part.points[k]) for part, k in zip(parts, corner, strict=True)}) == 1
    for part, k in zip(parts, corner, strict=True):
        assert part.normals is None or part.normals[k].tolist() == [0, 0, 1]


@pytest.mark.parametrize("names", [("s", "t"), ("u", "v"), ("texture_u", "texture_v")])
def test_texture_coordinates_of_vertices(tmp_path, names):
    seam = [*SQUARE, SQUARE[0], SQUARE[2]]
    plan = [*XYZ, *(f"float {n}" for n in names)]
    rows = [(*p, k / 8, k / 16) for k, p in enumerate(seam)]
    elements = [("vertex", plan, rows), ("face", [LIST], [([0, 1, 2],), ([4, 5, 3],)])]
    (part,) = read(tmp_path, write(elements, comments=["TextureFile a.png"])).parts
    assert_exact(part.faces, [[0, 1, 2], [0, 2, 3]], "vertices that the seam split are one")
    assert_exact(part.uv, [[[k / 8, 1 - k / 16] for k in face] for face in ([0, 1, 2], [4, 5, 3])], "sixteenths")


def test_vertices_of_equal_position_stay_where_no_texture_split_them(tmp_path):
    soup = [SQUARE[k] for k in (0, 1, 2, 0, 2, 3)]
    (part,) = read(tmp_path, write([("vertex", XYZ, soup), ("face", [LIST], [([0, 1, 2],), ([3, 4, 5],)])])).parts
    assert_exact(part.faces, [[0, 1, 2], [3, 4, 5]], "indices")


@pytest.mark.parametrize("form", FORMATS)
def test_triangle_strips(tmp_path, form):
    strips = [([0, 1, 2, 3, 4, -1, 5, 6, 7, -1, 0, 1],), ([2, 3, 3, 4, 5],)]
    points = [(float(k), float(k * k), 0.0) for k in range(8)]
    (part,) = read(
        tmp_path, write([("vertex", XYZ, points), ("tristrips", ["list int int vertex_indices"], strips)], form)
    ).parts
    # By hand: every other triangle of a strip runs the other way, and those with a repeated corner are none.
    assert_exact(part.faces, [[0, 1, 2], [2, 1, 3], [2, 3, 4], [5, 6, 7], [3, 4, 5]], "indices")


def test_what_is_left_out_is_noted(tmp_path):
    plan = [LIST, "uchar red", "uchar green", "uchar blue"]
    file = read(
        tmp_path,
        write([("vertex", XYZ, SQUARE), ("face", plan, [([0, 1, 2], 1, 2, 3)])], comments=["TextureFile a.png"]),
    )
    assert file.notes == ("its texture a left out, as it has no texture coordinates", "colours of its faces left out")
    assert file.parts[0].material is None
    bad = [([0, 1, 2], [0.0, 0.0])]
    file = read(tmp_path, write([("vertex", XYZ, SQUARE), ("face", [LIST, "list uchar float texcoord"], bad)]))
    assert file.notes == ("texture coordinates of its faces left out, as some faces have not two for each corner",)


@pytest.mark.parametrize("form", FORMATS)
def test_a_cloud_of_points_has_no_faces(tmp_path, form):
    (part,) = read(tmp_path, write([("vertex", [*XYZ, "float f_dc_0"], [(*p, 0.5) for p in SQUARE])], form)).parts
    assert part.faces.shape == (0, 3)
    (part,) = read(tmp_path, write([("vertex", XYZ, SQUARE), ("face", [LIST], [])], form)).parts
    assert part.faces.shape == (0, 3)


def good(form="ascii"):
    return write([("vertex", XYZ, SQUARE), ("face", [LIST], [([0, 1, 2],), ([0, 2, 3],)])], form)


MIXED = write([("vertex", XYZ, SQUARE), ("face", [LIST], [([0, 1, 2],), ([0, 1, 2, 3],)])], "binary_little_endian")

HUGE = "1000000000000000000"

BAD = {
    "garbage": (b"not a mesh at all", "does not begin with 'ply'"),
    "no end of the header": (good()[:60], "has no end_header"),
    "an unknown type": (good().replace(b"double x", b"quad x"), "line 4 of its header, 'property quad x'"),
    "an element of two words": (good().replace(b"face 2", b"face 2 2"), "line 7 of its header, 'element face 2 2'"),
    "a negative count": (good().replace(b"face 2", b"face -2"), "line 7 of its header"),
    "no format": (good().replace(b"format ascii 1.0\n", b""), "names no format"),
    "no vertices": (write([("face", [LIST], [([0, 1, 2],)])]), "no vertices with x, y and z"),
    "fewer numbers": (good()[:-4], "declares 2 rows of 'face', and the file ends before"),
    "more numbers": (good() + b"3 0 1 3\n", "has 4 numbers more than its header declares"),
    "fewer vertices": (good().replace(b"vertex 4", b"vertex 3"), "has 8 numbers more than its header"),
    "a short line": (good().replace(b"1.0 0.0 0.0\n", b"1.0 0.0\n", 1), "line 11: has 2 numbers, and a vertex has 3"),
    "a long line": (good().replace(b"3 0 1 2", b"3 0 1 2 9 1 1 1"), "line 14: has 8 numbers, and this face has 4 by"),
    "a short list": (good().replace(b"3 0 1 2", b"3 0 1"), "line 14: has 3 numbers, and this face has 4 by"),
    "a word": (good().replace(b"1.0 1.0 0.5", b"1.0 1.0 half"), "line 12: 'half' is not a number"),
    "a vertex that is not there": (good().replace(b"3 0 2 3", b"3 0 2 4"), "face 1 names vertex 4, the mesh has 4"),
    "half a vertex": (good().replace(b"3 0 2 3", b"3 0 2 2.5"), "names vertex 2.5, which is no integer"),
    "not a number as a vertex": (good().replace(b"3 0 2 3", b"3 0 2 nan"), "names vertex nan, which is no integer"),
    "a negative list": (good().replace(b"3 0 2 3", b"-3 0 2 3"), "has a list of -3.0 values"),
    "a list of nan": (good().replace(b"3 0 2 3", b"nan 0 2 3"), "has a list of nan values"),
    "a list without end": (good().replace(b"3 0 2 3", b"inf 0 2 3"), "has a list of inf values"),
    "a long list": (good().replace(b"3 0 2 3", b"1e300 0 2 3"), "declares 2 rows of 'face'"),
    "binary, cut off": (good("binary_little_endian")[:-1], "declares 2 rows of 'face', and the file ends before"),
    "mixed, cut off": (MIXED[:-1], "declares 2 rows of 'face', and the file ends before"),
    "binary, too long": (good("binary_big_endian") + b"\1\2\3", "has 3 bytes more than its header declares"),
    "huge": (good("binary_big_endian").replace(b"face 2", f"face {HUGE}".encode()), f"declares {HUGE} rows"),
    "huge text": (good().replace(b"vertex 4", f"vertex {HUGE}".encode()), f"declares {HUGE} rows"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_bad_files_are_refused_in_one_line(tmp_path, name):
    content, message = BAD[name]
    with pytest.raises(UserError, match=message) as raised:
        read(tmp_path, content)
    assert "\n" not in str(raised.value)


def read_or_refuse(tmp_path, content):
    try:
        return read(tmp_path, content)
    except UserError:
        return None


@pytest.mark.parametrize("form", FORMATS)
def test_damaged_files_are_read_or_refused(tmp_path, form):
    vertices, polygons = random_polygons(5, 8)
    whole = write([("vertex", XYZ, vertices.tolist()), ("face", [LIST], [(p,) for p in polygons])], form)
    rng = np.random.default_rng(0)
    for _ in range(150):
        damaged = bytearray(whole)
        for place in rng.integers(len(whole), size=3):
            damaged[place] = rng.integers(256)
        file = read_or_refuse(tmp_path, bytes(damaged[: rng.integers(len(whole) // 2, len(whole) + 1)]))
        for part in file.parts if file else ():
            assert part.faces.max(initial=0) < len(part.positions)
