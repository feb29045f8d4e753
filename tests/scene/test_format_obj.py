"""OBJ and MTL by their description, and against a reader of one line at a time."""

import numpy as np
import pytest

from slepian_prt.errors import UserError
from slepian_prt.scene.formats.obj import read_obj
from tests.numerics import assert_exact

SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 .5\nv 0 1 0\n"
POSITIONS = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0.5], [0, 1, 0]])
TWO = [[0, 1, 2], [0, 2, 3]]


def read(tmp_path, content, library=None):
    path = tmp_path / "part.obj"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    if library is not None:
        (tmp_path / "part.mtl").write_text(library)
    return read_obj(path)


SAME = {
    "positions": SQUARE + "f 1 2 3\nf 1 3 4\n",
    "a quadrilateral": SQUARE + "f 1 2 3 4",
    "relative": "v 0 0 0\nv 1 0 0\nv 1 1 .5\nf -3 -2 -1\nv 0 1 0\nf -4 -2 -1\n",
    "all forms": SQUARE + "vt 0 0\nf 1/1 2/1 3/1\nf 1 3/ 4//\n",
    "before the vertices": "f 1 2 3\nf 1 3 4\n" + SQUARE,
    "Windows": SQUARE.replace("\n", "\r\n") + "\r\n\r\nf 1 2 3 4\r\n",
    "old Macs": SQUARE.replace("\n", "\r") + "f 1 2 3 4\r",
    "tabs": SQUARE.replace(" ", "\t\t") + "\t f\t1 2 3\t \n f 1\t3 4",
    "continued": SQUARE + "f 1 \\\n2 3 \\\n 4\n",
    "continued on Windows": SQUARE.replace("\n", "\r\n") + "f 1 \\\r\n2 3 \\\r\n 4\r\n",
    "comments": f"# made # here\n{SQUARE.replace('.5', '.5 # top')}f 1 2 3 4 # 5 6\n#f 1 2 4\n",
    "blank lines": "\n \n" + SQUARE.replace("\n", "\n\n") + "\nf 1 2 3\n\t\nf 1 3 4\n\n",
    "groups": SQUARE + "o a b\ng # x\nf 1 2 3\ng\ns off\nusemtl none\nf 1 3 4\n",
    "weights": SQUARE.replace("0\n", "0 1.0\n") + "f 1 2 3 4\n",
    "equal positions": SQUARE + "v 0 0 -0\nv 1 1 .5\nf 1 2 3\nf 5 6 4\n",
    "a mark of the byte order": "\ufeff" + SQUARE + "f 1 2 3 4\n",
}


@pytest.mark.parametrize("name", SAME)
def test_all_ways_to_write_two_triangles(tmp_path, name):
    file = read(tmp_path, SAME[name])
    (part,) = file.parts
    assert_exact(part.positions, POSITIONS, "short decimals")
    assert_exact(part.faces, TWO, "indices")
    assert part.normals is None
    assert part.colors is None
    assert part.uv is None
    assert part.material is None
    assert file.notes == ()


def test_text_in_any_encoding(tmp_path):
    file = read(tmp_path, f"o Würfel\nusemtl Maß\n{SQUARE}f 1 2 3 4\n".encode("latin-1") + b"g \xff\xfe\n")
    assert_exact(file.parts[0].faces, TWO, "indices")


@pytest.mark.parametrize("encoding", ["utf-16-le", "utf-16-be"])
def test_text_of_two_bytes_a_letter(tmp_path, encoding):
    content = f"\ufeffmtllib a.mtl\r\nusemtl Maß\r\n{SQUARE}f 1 2 3 4\r\n".encode(encoding)
    (tmp_path / "a.mtl").write_bytes("\ufeffnewmtl Maß\r\nKd .5 .25 0\r\n".encode(encoding))
    (part,) = read(tmp_path, content).parts
    assert_exact(part.positions, POSITIONS, "short decimals")
    assert_exact(part.faces, TWO, "indices")
    assert part.material.color == (0.5, 0.25, 0)


@pytest.mark.parametrize("form", ["{0}//{0}", "{0}/-1/{0}", "{0}/{0}/9"])
def test_normals_and_texture_coordinates_of_which_the_file_has_none_are_not_named(tmp_path, form):
    (tmp_path / "a.mtl").write_text("newmtl a\nmap_Kd a.png\n")
    square = "f " + " ".join(form.format(k) for k in (1, 2, 3, 4))
    file = read(tmp_path, f"mtllib a.mtl\nusemtl a\n{SQUARE}{square}\n")
    assert_exact(file.parts[0].faces, TWO, "indices")
    assert file.parts[0].normals is None
    assert file.parts[0].uv is None
    named = ["texture coordinates"] * ("//" not in form) + ["normals"]
    expected = [f"its faces name {names}, and it has none" for names in named]
    assert file.notes == (*expected, "1 faces of a have no texture coordinates")


def write_randomly(rng):
    """Vertices, normals and faces of all forms in any order, and the corners as one reads them line by line."""
    lines, positions, uv, normals, corners = [], [], [], [], []
    few = rng.normal(size=(4, 3)).round(3)  # so that normals repeat
    for _ in range(rng.integers(60, 120)):
        kind = rng.integers(5) if len(positions) > 2 and uv and normals else rng.integers(3)
        if kind == 0:
            positions.append(rng.normal(size=3).round(6))
            lines.append("v {} {} {}".format(*positions[-1]))
        elif kind == 1:
            uv.append(rng.random(2).round(6))
            lines.append("vt {} {}".format(*uv[-1]))
        elif kind == 2:
            normals.append(few[rng.integers(4)])
            lines.append("vn {} {} {}".format(*normals[-1]))
        else:
            words = []
            form = rng.integers(4)
            for p in rng.choice(len(positions), 3, replace=False):
                t, n = rng.integers(len(uv)), rng.integers(len(normals))
                corners.append((positions[p], normals[n] if form in (1, 3) else np.zeros(3)))
                numbers = [
                    i - total if rng.random() < 0.5 else i + 1
                    for i, total in ((p, len(positions)), (t, len(uv)), (n, len(normals)))
                ]
                words.append(["{0}", "{0}//{2}", "{0}/{1}", "{0}/{1}/{2}"][form].format(*numbers))
            lines.append("f " + " ".join(words))
    return "\n".join(lines), np.array(positions), corners


@pytest.mark.parametrize("seed", range(20))
def test_corners_are_those_of_a_reader_of_one_line_at_a_time(tmp_path, seed):
    content, positions, corners = write_randomly(np.random.default_rng(seed))
    (part,) = read(tmp_path, content).parts
    read_positions = part.positions[part.faces].reshape(-1, 3)
    assert_exact(read_positions, [p for p, _ in corners], "decimals of few digits")
    if part.normals is None:
        assert not np.any([n for _, n in corners])
        return
    assert_exact(part.normals[part.faces].reshape(-1, 3), [n for _, n in corners], "decimals of few digits")
    # Vertices of the file keep their numbers, and no pair of position and normal comes twice.
    assert_exact(part.positions[: len(positions)], positions, "decimals of few digits")
    pairs = np.concatenate([part.positions, part.normals], axis=1)[np.unique(part.faces)]
    assert len(np.unique(pairs, axis=0)) == len(pairs)


def test_normals_split_only_where_they_differ(tmp_path):
    normals = "vn 0 0 1\nvn 0 0 1\nvn 1 0 0\n"
    (part,) = read(tmp_path, SQUARE + normals + "f 1//1 2//1 3//2\nf 1//2 3//3 4\n").parts
    assert_exact(part.faces, [[0, 1, 2], [0, 4, 3]], "indices")
    assert_exact(part.positions[4], POSITIONS[2], "a copy")
    assert_exact(part.normals, [[0, 0, 1]] * 3 + [[0, 0, 0], [1, 0, 0]], "zero where the file gives none")


def test_equal_positions_with_normals_stay(tmp_path):
    content = SQUARE + "v 0 0 0\nvn 0 0 1\nf 1//1 2//1 3//1\nf 5//1 3//1 4//1\n"
    (part,) = read(tmp_path, content).parts
    assert_exact(part.faces, [[0, 1, 2], [4, 2, 3]], "indices")


@pytest.mark.parametrize("scale", [1, 255])
def test_colours_of_vertices_are_display_values(tmp_path, scale):
    rows = [(0, 0, 0, 1, 0, 0.5), (1, 0, 0, 0, 0, 0), (0, 1, 0, 1, 1, 0.2)]
    content = "".join("v {} {} {} {} {} {}\n".format(*r[:3], *(scale * c for c in r[3:])) for r in rows)
    (part,) = read(tmp_path, content + "v 3 3 3\nf 1 2 3\n").parts
    linear = [[1, 0, ((0.5 + 0.055) / 1.055) ** 2.4], [0, 0, 0], [1, 1, ((0.2 + 0.055) / 1.055) ** 2.4], [1, 1, 1]]
    np.testing.assert_allclose(part.colors, linear, rtol=1e-6)


def test_colours_that_differ_at_a_position_do_not_break_the_surface(tmp_path):
    content = (
        "v 0 0 0 1 0 0\nv 1 0 0 1 0 0\nv 0 1 1 1 0 0\nv 1 0 0 0 1 0\nv 1 1 0 0 1 0\nv 0 1 1 0 1 0\nf 1 2 3\nf 4 5 6\n"
    )
    (part,) = read(tmp_path, content).parts
    assert len(part.positions) == 6
    assert part.normals is None
    assert_exact(part.points[[1, 2]], part.points[[3, 5]], "numbers of one point")
    assert len(np.unique(part.points)) == 4


def test_what_is_left_out_is_noted(tmp_path):
    file = read(tmp_path, SQUARE + "p 1\nl 1 2\nl 2 3\nf 1 2\nf 1 2 3\nsurf 0 1 0 1 1 2\ncurv 1 2\nwhat is this\n")
    assert file.notes == (
        "3 points and lines left out",
        "2 free-form surfaces (curv, surf) left out",
        "1 lines that begin with 'what' left out",
        "1 faces of fewer than three different corners left out",
    )
    assert_exact(file.parts[0].faces, [[0, 1, 2]], "indices")
    assert read(tmp_path, SQUARE).parts[0].faces.shape == (0, 3)


LIBRARY = """# library
newmtl red
  Kd 0.8 0.1 0.2
newmtl Skin #2
Kd 0 0 0
map_Kd -s 2 3 1 -o 0.5 -clamp on -bm 0.2 my skin.PNG
newmtl grey
Kd 0.25
"""

TEXTURED = SQUARE + "v 7 7 7\nvt 0 0\nvt 1 0\nvt 1 .25 0\nmtllib part.mtl\n"


def test_materials_make_parts(tmp_path):
    (tmp_path / "My Skin.png").write_bytes(b"")
    content = TEXTURED + "usemtl red\nf 1 2 3\nusemtl Skin #2\nf 1/1 3/2 4/3\nusemtl red\nf 1 2 4\n"
    file = read(tmp_path, content, LIBRARY)
    red, skin = file.parts
    assert red.material.color == (0.8, 0.1, 0.2)
    assert red.material.texture is None
    assert red.uv is None
    assert_exact(red.positions[red.faces], POSITIONS[[[0, 1, 2], [0, 1, 3]]], "copies")
    assert skin.material.color == (1, 1, 1)
    assert skin.material.texture.source == tmp_path / "My Skin.png"
    assert skin.material.texture.wrap == ("clamp", "clamp")
    assert_exact(skin.uv, [[[0.5, 1], [2.5, 1], [2.5, 0.25]]], "quarters: (2 u + 0.5, 1 - 3 v)")
    assert file.notes == ()
    # A surface of two materials is as smooth as one of one: corners of either are the same points.
    numbers = {tuple(p): k for part in (red, skin) for p, k in zip(part.positions, part.points, strict=True)}
    for part in (red, skin):
        assert part.normals is None
        assert [numbers[tuple(p)] for p in part.positions] == part.points.tolist()
    assert len(set(numbers.values())) == 4


def test_one_material_keeps_the_order_of_the_file(tmp_path):
    (part,) = read(tmp_path, TEXTURED + "usemtl grey\nf 1 2 3\nf 1 3 4\n", LIBRARY).parts
    assert part.material.color == (0.25, 0.25, 0.25)
    assert_exact(part.positions, [*POSITIONS, [7, 7, 7]], "also of the vertex that no face uses")


def test_faces_without_texture_coordinates_lose_the_texture(tmp_path):
    file = read(tmp_path, TEXTURED + "usemtl Skin #2\nf 1/1 2/2 3/3\nf 1 3 4\n", LIBRARY)
    assert [part.material.texture is None for part in file.parts] == [False, True]
    assert file.notes == ("1 faces of Skin #2 have no texture coordinates",)


def test_missing_libraries_and_materials_are_noted(tmp_path):
    content = SQUARE + "mtllib nowhere.mtl part.mtl\nusemtl blue\nf 1 2 3\nusemtl red\nf 1 3 4\n"
    file = read(tmp_path, content, LIBRARY)
    assert file.notes == (
        "its material library nowhere.mtl is missing",
        "1 materials (blue) are in none of its libraries",
    )
    assert [part.material and part.material.name for part in file.parts] == [None, "red"]
    (part,) = read(tmp_path, SQUARE + "mtllib nowhere.mtl\nusemtl a\nf 1 2 3\nusemtl b\nf 1 3 4\n").parts
    assert part.material is None


@pytest.mark.parametrize("name", ["my lib.mtl", "sub/x.mtl", "sub\\x.mtl", "C:\\work\\X.MTL", '"my lib.mtl"'])
def test_libraries_are_found(tmp_path, name):
    (tmp_path / "sub").mkdir()
    for there in ("my lib.mtl", "sub/x.mtl", "x.mtl"):
        (tmp_path / there).write_text("newmtl a\nKd 0.5 0.5 0.5\n")
    file = read(tmp_path, f"{SQUARE}mtllib {name}\nusemtl a\nf 1 2 3 4\n")
    assert file.parts[0].material.color == (0.5, 0.5, 0.5)
    assert file.notes == ()


@pytest.mark.parametrize(
    ("says", "effects"),
    [
        ("Kd 1 1 1\nKs 0.5 0.5 0.5\nillum 2\nd 1.0\nTr 0.0\nKe 0 0 0\nNi 1.45\nNs 250", ()),
        ("d 0.5", ("transparency",)),
        ("d -halo 0.0", ("transparency",)),
        ("Tr 0.3", ("transparency",)),
        ("Tr 1", ()),
        ("d 1\nTr 1", ()),
        ("map_d leaf.png", ("transparency",)),
        ("illum 7", ("transmission",)),
        ("Ke 0 0.1 0", ("emitted light",)),
        ("map_Ke lamp.png", ("emitted light",)),
        ("map_Bump -bm 0.3 b.png", ("normal map",)),
        ("norm n.png", ("normal map",)),
        ("disp d.png", ("displacement",)),
        ("Ks 0.9 0.9 0.9", ("glossy reflection",)),
        ("Ks 0.9 0.9 0.9\nillum 1", ()),
        ("Ks 0.1 0.1 0.1\nillum 3", ("glossy reflection",)),
        ("Pc 0.5\nPs 0.1", ("clearcoat", "sheen")),
    ],
)
def test_effects_that_are_not_simulated(tmp_path, says, effects):
    file = read(tmp_path, SQUARE + "mtllib part.mtl\nusemtl a\nf 1 2 3 4", f"newmtl a\n{says}\n")
    assert file.parts[0].material.not_simulated == effects
    assert file.parts[0].material.color == (1, 1, 1)


def test_metal(tmp_path):
    content = TEXTURED + "usemtl a\nf 1/1 2/2 3/3\n"
    (part,) = read(tmp_path, content, "newmtl a\nPm 0.75\nKd .5 .5 .5\n").parts
    assert part.material.metallic == 0.75
    (part,) = read(tmp_path, content, "newmtl a\nmap_Pm m.png\n").parts
    assert part.material.metallic == 1
    assert part.material.metallic_texture.source == tmp_path / "m.png"
    assert_exact(part.uv, [[[0, 1], [1, 1], [1, 0.75]]], "quarters")


BAD = {
    "garbage": ("hello world\n", "holds no mesh"),
    "nothing": ("\n", "holds no mesh"),
    "surfaces only": (SQUARE + "surf 0 1 0 1 1 2\n", r"has free-form surfaces \(surf\) and no polygons"),
    "lines only": (SQUARE + "l 1 2 3\n", "has points and lines and no faces"),
    "short faces only": (SQUARE + "f 1 2\nf 3\nf 2 2 4\n", "all 3 faces of it have fewer than three different corners"),
    "index 0": (SQUARE + "f 1 2 3\nf 0 1 2\n", "line 6: a face names vertex 0, and OBJ files count from 1"),
    "beyond the end": (SQUARE + "\nf 1 2 5\n", "line 6: a face names vertex 5, and there are only 4 in the file"),
    "before the begin": ("v 0 0 0\nf -1 -1 -2\nv 1 1 1\n", "line 2: a face names vertex -2, and there are not so many"),
    "no such normal": (SQUARE + "vn 0 0 1\nf 1//1 2//1 3//2\n", "line 6: a face names normal 2, .* only 1"),
    "no vertex": ("vn 0 0 1\nf 1 2 3\n", "line 2: a face names vertex 1, and there is none"),
    "no such uv": (SQUARE + "vt 0 0\nf 1/1 2/1 3/-2\n", "line 6: a face names texture coordinates -2"),
    "continued": (SQUARE + "f 1 \\\n2 3\nf 1 \\\n 2 9\n", "line 7: a face names vertex 9"),
    "a word": (SQUARE + "f 1 2 three\n", "line 5: 'three' is not a number"),
    "a fraction": (SQUARE + "f 1 2 2.5\n", "line 5: '2.5' is not a number of the kind"),
    "a minus within": (SQUARE + "f 1 2 3-4\n", "line 5: '3-4' is not a number"),
    "a bad corner": (SQUARE + "f 1 2/1/1/1 3\n", "line 5: '2/1/1/1' is no corner"),
    "an empty corner": (SQUARE + "f 1 2//1 /3\n", "line 5: '/3' is no corner"),
    "a bad coordinate": ("v 0 0 0\n" + SQUARE.replace(".5", "0,5") + "f 1 2 3\n", "line 4: '0,5' is not a number"),
    "two coordinates": (SQUARE + "v 1 2\nf 1 2 3\n", "line 5: 'v 1 2' has fewer than 3 numbers"),
    "a letter": (SQUARE + "f 1/1 2/f 3\n", "line 5: 'f' is not a number"),
    "a keyword within": (SQUARE + "f 1 2 f 3\n", "line 5: 'f' is not a number"),
    "an infinite index": (SQUARE + "f 1 2 99999999999999999999\n", "line 5: a face names vertex"),
    "a gap": (SQUARE.replace("\n", "\r\n") + "f 1 2 3\r\n\r\nf 1 2 9\r\n", "line 7: a face names vertex 9"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_files_are_refused_in_one_line(tmp_path, name):
    content, message = BAD[name]
    with pytest.raises(UserError, match=message) as raised:
        read(tmp_path, content)
    assert "\n" not in str(raised.value)


def read_or_refuse(tmp_path, content):
    try:
        return read(tmp_path, content, LIBRARY)
    except UserError:
        return None


def test_damaged_files_are_read_or_refused(tmp_path):
    whole = (
        TEXTURED + "usemtl red\nf 1 2 3\nusemtl Skin #2\nf 1/1 3/2 4/3 \\\n 2/1\nvn 0 0 1\nf 1//1 2/1 -1\n"
    ).encode()
    rng = np.random.default_rng(0)
    for _ in range(150):
        damaged = bytearray(whole)
        for place in rng.integers(len(whole), size=3):
            damaged[place] = rng.choice(list(b"0129/-.#\\vfn\n \r\t\xff\0"))
        file = read_or_refuse(tmp_path, bytes(damaged))
        for part in file.parts if file else ():
            assert part.faces.max(initial=0) < len(part.positions)
