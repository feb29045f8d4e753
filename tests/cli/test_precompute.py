"""Options of `precompute` beside those of the library."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from slepian_prt.cli import main
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
