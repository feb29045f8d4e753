"""Values of a scene's parameters on the command line, as on Mitsuba's own."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from slepian_prt.cli import main
from slepian_prt.compression.files.prt_file import load

SMALL = ["--bandlimit", "2", "--samples", "16", "--clusters", "4"]


@pytest.fixture
def scene(tmp_path) -> Path:
    """A disk of radius $r and reflectance $gray, which is 0.5 by default."""
    path = tmp_path / "scene.xml"
    path.write_text(
        '<scene version="3.0.0"><default name="gray" value="0.5"/>\n<shape type="disk"><transform name="to_world">'
        '<scale value="$r"/></transform><bsdf type="diffuse"><rgb name="reflectance" value="$gray"/></bsdf></shape>'
        "</scene>"
    )
    return path


def run(*arguments: object) -> int:
    return main([str(argument) for argument in arguments])


@pytest.mark.parametrize(
    "given", [["-D", "r=3", "-D", "gray=0.25"], ["-Dr=3", "-Dgray=0.25"], ["--define", "r=3", "--define", "gray=0.25"]]
)
def test_parameters_of_a_scene(given, scene, tmp_path):
    out = tmp_path / "scene.prt"
    assert run("precompute", scene, "-o", out, *SMALL, *given) == 0
    mesh = load(out).mesh
    np.testing.assert_allclose(np.linalg.norm(mesh.positions, axis=1).max(), 3.0, rtol=1e-3)  # as files keep positions
    np.testing.assert_allclose(mesh.albedo, 0.25, atol=0.5 / 255.0)


@pytest.mark.parametrize("command", ["precompute", "compare", "sweep"])
def test_a_parameter_without_a_value(command, scene, tmp_path, capfd):
    out = tmp_path / ("scene.prt" if command == "precompute" else "folder")
    assert run(command, scene, "-o", out) == 2
    told = capfd.readouterr()
    assert told.out == ""
    assert told.err == f"slepian-prt: {scene}: its parameter $r (line 2) has no value; give -D r=…\n"


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (["-D", "r"], "-D must be NAME=VALUE, not 'r'"),
        (["-D", "=3"], "-D must be NAME=VALUE, not '=3'"),
        (["-Dr=1", "-Dr=2"], "-D r is given twice; give it once"),
        (["-Dr=1", "-Dspp=2"], "has no parameter $spp; it has $gray, $r"),
        (["-Dr=large"], "line 2: could not parse floating point value"),
    ],
)
def test_parameters_that_make_no_sense(given, message, scene, tmp_path, capfd):
    assert run("precompute", scene, "-o", tmp_path / "scene.prt", *SMALL, *given) == 2
    told = capfd.readouterr().err
    assert message in told
    assert told.count("\n") == 1


def test_parameters_of_a_mesh(tmp_path, capfd):
    trimesh.creation.box().export(tmp_path / "box.ply")
    assert run("precompute", tmp_path / "box.ply", "-o", tmp_path / "box.prt", "-Dr=1") == 2
    assert "box.ply: is no Mitsuba .xml scene, and no other takes parameters" in capfd.readouterr().err
