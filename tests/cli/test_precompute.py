"""Options of `precompute` beside those of the library."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from slepian_prt.cli import main
from slepian_prt.compression.files.prt_file import load
from slepian_prt.renderer.variants import bitmap_module

SMALL = ["--bandlimit", "2", "--samples", "16", "--clusters", "4"]


@pytest.fixture
def folder(tmp_path) -> Path:
    """A ball, and a map with a texel that is far below zero."""
    trimesh.creation.icosphere(2).export(tmp_path / "ball.ply")
    texels = np.ones((16, 32, 3), dtype=np.float32)
    texels[4, 4] = -500.0
    bitmap_module().Bitmap(texels).write(str(tmp_path / "negative.exr"))
    return tmp_path


def run(arguments) -> int:
    return main([str(a) for a in arguments])


@pytest.mark.parametrize(
    "given", [["--light-prior"], ["--max-error", "0.2", "--light-prior"], ["--max-error", "0.2", "--environment"]]
)
def test_clamp_negative_for_the_light_of_precompute(given, folder, capsys):
    """The one rule: what matters is refused, and clamped when that is asked for."""
    out = folder / "clamped.prt"
    command = ["precompute", folder / "ball.ply", "-o", out, *SMALL, *given, folder / "negative.exr"]
    assert run(command) == 2
    told = capsys.readouterr().err
    assert "negative.exr" in told
    assert "--clamp-negative" in told
    assert told.count("\n") == 1
    assert not out.exists()
    assert run([*command, "--clamp-negative"]) == 0
    assert "1 negative texels set to zero" in capsys.readouterr().err


def test_clamp_negative_without_a_map(folder, capsys):
    out = folder / "clamped.prt"
    assert run(["precompute", folder / "ball.ply", "-o", out, *SMALL, "--clamp-negative"]) == 0
    assert capsys.readouterr().err == (
        "note: --clamp-negative has no effect without a map: give --environment or --light-prior\n"
    )


# --- Hard edges ------------------------------------------------------------------------------------------------------


@pytest.fixture
def cube(tmp_path) -> Path:
    """Eight vertices, no normals."""
    trimesh.creation.box().export(tmp_path / "cube.off")
    return tmp_path / "cube.off"


def test_crease_angle(cube, capsys):
    """With hard edges a cube is its 24 corners of faces, each with the light of its face's own half of the sky."""
    out = cube.with_suffix(".prt")
    assert run(["precompute", cube, "-o", out, *SMALL, "--crease-angle", "30"]) == 0
    assert capsys.readouterr().err == ""
    packed = load(out)
    np.testing.assert_allclose(np.abs(packed.mesh.normals).max(axis=1), 1.0, atol=1e-7)
    assert len(packed.mesh.positions) == 24
    assert run(["precompute", cube, "-o", out, *SMALL]) == 0
    assert len(load(out).mesh.positions) == 8


def test_crease_angle_of_a_file_with_normals(tmp_path, capsys):
    ball = trimesh.creation.icosphere(1)
    trimesh.Trimesh(ball.vertices, ball.faces, vertex_normals=ball.vertices).export(tmp_path / "ball.ply")
    out = tmp_path / "ball.prt"
    assert run(["precompute", tmp_path / "ball.ply", "-o", out, *SMALL, "--crease-angle", "30"]) == 0
    told = capsys.readouterr().err
    assert told.endswith("ball.ply: all of it has normals in the file, so that --crease-angle has no effect\n")
    assert told.count("\n") == 1
    assert len(load(out).mesh.positions) == 42


@pytest.mark.parametrize("command", ["precompute", "compare", "sweep"])
def test_crease_angles_that_make_no_sense(command, cube, folder, capsys):
    light = [] if command == "precompute" else ["--environment", folder / "negative.exr"]
    out = folder / ("x.prt" if command == "precompute" else "x")
    (folder / "scene.xml").write_text('<scene version="3.0.0"/>')
    clamped = ["--clamp-negative"] if light else []
    for scene, angle, message in (
        (cube, "200", "--crease-angle must be a number of degrees in [0, 180], not 200.0"),
        (cube, "nan", "--crease-angle must be a number of degrees in [0, 180], not nan"),
        (folder / "scene.xml", "30", "its shapes say themselves which edges are hard; leave out the crease angle"),
    ):
        assert run([command, scene, "-o", out, *light, *clamped, "--crease-angle", angle]) == 2
        told = capsys.readouterr().err.splitlines()
        assert message in told[-1]
        assert not out.exists() or not list(out.iterdir())
