"""Lighting as text, as GAMES202's program writes it."""

import numpy as np
import pytest

import slepian_prt as sp
from slepian_prt.errors import UserError
from slepian_prt.lighting.light_text import light_text, read_light_text
from slepian_prt.scene.mesh import make_mesh
from slepian_prt.sphere.rotation import rotate_sh
from tests.conftest import sphere
from tests.numerics import assert_exact

# As ``lightFout << x << " " << y << " " << z << std::endl`` writes it.
THEIRS = """1.05 0.9 0.8
0.5 0.4 0.3
-0.1 0 1e-05
0.2 0.1 0
0 0 0
0 0 0
0.25 -0.25 0.125
0 0 0
0 0 0.5
"""


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "light.txt"
    path.write_text(THEIRS)
    return path


def test_lines_are_harmonics_and_columns_colours(file):
    expected = np.array([[float(word) for word in line.split()] for line in THEIRS.splitlines()])
    assert_exact(read_light_text(file), expected.T, "parsed digits")


def test_what_is_written_is_read_back(tmp_path, rng):
    lighting = rng.normal(size=(3, 16)) * 10.0 ** rng.integers(-8, 8, size=(3, 16))
    (tmp_path / "a.txt").write_bytes(light_text(lighting))
    assert_exact(read_light_text(tmp_path / "a.txt"), lighting, "17 digits are all of a float64")


def test_a_byte_order_mark_is_no_part_of_it(tmp_path, file):
    (tmp_path / "notepad.txt").write_bytes(b"\xef\xbb\xbf" + file.read_bytes().replace(b"\n", b"\r\n"))
    assert_exact(read_light_text(tmp_path / "notepad.txt"), read_light_text(file), "the same digits")


def test_it_is_light_wherever_a_map_is(file):
    lighting = read_light_text(file)
    assert_exact(sp.project_environment(file, 2), rotate_sh(lighting, np.eye(3)), "the same numbers")
    turned = sp.project_environment(str(file), 4, rotate=90.0)
    np.testing.assert_allclose(turned[:, :9], rotate_sh(lighting, [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]), atol=1e-14)
    assert not turned[:, 9:].any()
    transfer = sp.precompute(sphere(1), bandlimit=3, samples=16)
    np.testing.assert_allclose(sp.relight(transfer, file), sp.relight(transfer, lighting), atol=1e-6)


def test_where_pictures_are_wanted_it_is_refused(file):
    with pytest.raises(UserError, match=r"light.txt: holds harmonics, and a picture is wanted here; name a map$"):
        sp.read_environment(file)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", r"has 0 lines of lighting"),
        (b"1 2 3\n" * 8, r"has 8 lines of lighting, and harmonics up to a degree are 1, 4, 9, 16"),
        (b"1 2 3\n1 2\n", "line 2: must be red, green and blue of a harmonic, three numbers"),
        (b"1 2 x\n", "line 1: must be"),
        (b"1 2 nan\n", "line 1: must be"),
        (b"\xff\xfe1", "it is no text"),
        (b"1_0 2 3\n", "line 1: must be red, green and blue of a harmonic, three numbers"),
        ("1 2 \u0663\n".encode(), "line 1: must be"),
        (b"1 2 3\n1 -1e300 0\n", r"line 2: is light beyond 1e\+30, more than pictures hold; scale it down"),
    ],
)
def test_what_is_refused(tmp_path, content, message):
    (tmp_path / "light.txt").write_bytes(content)
    with pytest.raises(UserError, match=message) as caught:
        read_light_text(tmp_path / "light.txt")
    assert "\n" not in str(caught.value)


def test_what_is_about_texels_is_said_to_change_nothing(tmp_path, file, caplog, capsys):
    from slepian_prt.cli import main

    before = sp.project_environment(file, 2)
    assert_exact(sp.project_environment(file, 2, clamp_negative=True), before, "the same numbers")
    assert caplog.messages == [f"{file}: holds harmonics, not texels; `clamp_negative` changes nothing in it"]
    sp.compress(sp.precompute(sphere(1), bandlimit=2, samples=4), "none").save(tmp_path / "a.prt")
    command = ["relight", str(tmp_path / "a.prt"), "--environment", str(file), "-o", str(tmp_path / "a.npz")]
    assert main([*command, "--clamp-negative"]) == 0
    assert f"note: {file}: holds harmonics, not texels; --clamp-negative changes nothing" in capsys.readouterr().err


def test_missing_file(tmp_path):
    with pytest.raises(UserError, match=r"nothing\.txt"):
        sp.project_environment(tmp_path / "nothing.txt", 2)


def test_the_command_takes_it(tmp_path, file, capsys):
    from slepian_prt.cli import main

    mesh = make_mesh(sphere(1).positions, sphere(1).faces)
    sp.compress(sp.precompute(mesh, bandlimit=3, samples=16), "none").save(tmp_path / "a.prt", keep_order=True)
    assert main(["relight", str(tmp_path / "a.prt"), "--environment", str(file), "-o", str(tmp_path / "a.npz")]) == 0
    expected = sp.relight(sp.load(tmp_path / "a.prt"), file)
    np.testing.assert_allclose(np.load(tmp_path / "a.npz")["radiance"], expected, atol=1e-5)
    assert "note: lighting of bandlimit 2 counts as dark in degree 3 of the transfer" in capsys.readouterr().err


@pytest.mark.slow
def test_pictures_are_drawn_under_it(tmp_path, file):
    """A scene with a mirror ball, whose pictures are gathered and show maps in mirrors: there are harmonics alone."""
    scene = tmp_path / "scene.xml"
    scene.write_text(
        """<scene version="3.0.0">
        <shape type="sphere" id="ball"><bsdf type="conductor"/></shape>
        <shape type="rectangle" id="floor"><transform name="to_world"><rotate x="1" angle="-90"/>
        <translate y="-1"/></transform></shape></scene>"""
    )
    packed = sp.compress(sp.precompute(scene, bandlimit=2, samples=16), "none")
    packed.save(tmp_path / "a.prt")
    from slepian_prt.cli import main

    common = ["relight", str(tmp_path / "a.prt"), "--environment", str(file), "--width", "16", "--spp", "1"]
    assert main([*common, "-o", str(tmp_path / "a.exr")]) == 0
    assert main([*common, "--background", "map", "-o", str(tmp_path / "b.exr")]) == 2
    picture = sp.render_picture(sp.load(tmp_path / "a.prt"), file, width=16, spp=1)
    assert np.isfinite(picture).all()
    assert picture.any()
