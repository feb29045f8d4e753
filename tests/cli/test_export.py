"""`export` from the command line."""

import numpy as np
import pytest

import slepian_prt as sp
from slepian_prt.cli import main
from tests.conftest import bumpy
from tests.export.glb_reader import read_glb


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """With ball.prt, the ball.ply that it is of, and a map."""
    import trimesh

    folder = tmp_path_factory.mktemp("export")
    ball = bumpy(2)
    trimesh.Trimesh(ball.positions, ball.faces, process=False).export(folder / "ball.ply")
    options = ["--samples", "16", "--bandlimit", "3", "--clusters", "4"]
    assert main(["precompute", str(folder / "ball.ply"), "-o", str(folder / "ball.prt"), *options]) == 0
    return folder


def test_what_it_costs_is_told_in_one_line(folder, capsys):
    from slepian_prt.examples import example

    capsys.readouterr()
    sky = str(example("sky"))
    for what, name in (("transfer", "a.glb"), ("occlusion", "a.ply"), ("l1", "b.glb")):
        command = ["export", str(folder / "ball.prt"), "-o", str(folder / name), "--as", what, "--environment", sky]
        assert main(command) == 0
        (line,) = capsys.readouterr().out.splitlines()
        assert line.startswith(f"{folder / name}: 162 vertices as {what}, which costs ")
        assert "% of radiance here, " in line
        assert "% under sky; " in line
        assert line.endswith("% with what the file lost")


def test_light_of_the_course_is_taken(folder, tmp_path, capsys):
    """And is written as it came, where nothing turns it; the loss is that under the map that it is of."""
    sky = str(sp.example("sky"))
    theirs = tmp_path / "theirs.txt"
    np.savetxt(theirs, sp.project_environment(sky, 2).T)
    command = ["export", str(folder / "ball.prt"), "--as", "games202", "-o", str(tmp_path / "t.txt"), "--environment"]
    capsys.readouterr()
    assert main([*command, str(theirs)]) == 0
    told = capsys.readouterr()
    assert "% under theirs; " in told.out
    assert "GAMES202 has degrees 0 to 2; 3 is left out" in told.err
    assert "counts as dark in degree 3 of the transfer" in told.err
    np.testing.assert_allclose(np.loadtxt(tmp_path / "light.txt"), np.loadtxt(theirs), rtol=1e-12, atol=1e-12)
    assert main([*command, str(theirs), "--rotate", "90", "--up", "z"]) == 0
    turned = sp.project_environment(sky, 2, rotate=90.0)
    np.testing.assert_allclose(np.loadtxt(tmp_path / "light.txt"), turned.T, rtol=0.0, atol=1e-11)


def test_maps_have_different_names(folder, tmp_path, capsys):
    command = ["export", str(folder / "ball.prt"), "-o", str(tmp_path / "a.glb")]
    assert main([*command, "--environment", "x/light.exr", "--environment", "y/light.exr"]) == 2
    assert "environments must have different names, not light, light" in capsys.readouterr().err


def test_what_is_up_stands_upright(folder):
    assert main(["export", str(folder / "ball.prt"), "-o", str(folder / "up.glb"), "--up", "z"]) == 0
    root = read_glb(folder / "up.glb").root
    (top,) = root["scenes"][0]["nodes"]
    x, y, z, w = root["nodes"][top]["rotation"]
    turned = np.array([2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)])
    np.testing.assert_allclose(turned, [0.0, 1.0, 0.0], atol=1e-15)  # where z is taken


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["-o", "ball.prt"], "transfer is written as .glb, not '.prt'"),
        (["-o", "ball.ply", "--as", "occlusion"], "is the input; choose another name for the output"),
        (
            ["-o", "a.ply"],
            "transfer is written as .glb, not '.ply'; --as occlusion and the like are written as .ply too",
        ),
        (
            ["-o", "a.glb", "--as", "occlusion", "--functions", "8"],
            "--functions is about --as transfer and has no effect",
        ),
        (["-o", "a.glb", "--functions", "12"], "--functions must be a multiple of 8 from 8 to 128, not 12"),
        (["-o", "a.glb", "--attributes", "half"], "'half' is not one of 'bytes', 'float', 'texture'"),
        (["-o", "a.glb", "--scene", "none.xml"], "none.xml: no such file; check the path of --scene"),
    ],
)
def test_bad_input_is_one_line(folder, capsys, monkeypatch, options, message):
    monkeypatch.chdir(folder)
    capsys.readouterr()
    assert main(["export", "ball.prt", *options]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert message in line


def test_what_is_about_maps_needs_one(tmp_path, capsys):
    for option in (("--rotate", "30"), ("--clamp-negative",)):
        assert main(["export", str(tmp_path / "x.prt"), *option, "-o", str(tmp_path / "x.glb")]) == 2
        assert f"{option[0]} is about a map to tell the loss under" in capsys.readouterr().err
