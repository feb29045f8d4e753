"""The command `capture`, and `relight` and `info` of what it writes."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from slepian_prt.cli import main
from slepian_prt.compression.files.prt_file import load
from slepian_prt.renderer.variants import bitmap_module

SCENE = """<scene version="3.0.0">
  <default name="width" value="16"/>
  <sensor type="perspective" id="front">
    <float name="fov" value="40"/>
    <transform name="to_world"><lookat origin="0, 0.5, 4" target="0, 0.5, 0" up="0, 1, 0"/></transform>
    <film type="hdrfilm"><integer name="width" value="$width"/><integer name="height" value="12"/></film>
  </sensor>
  <sensor type="radiancemeter" id="meter"><film type="hdrfilm"><integer name="width" value="1"/>
    <integer name="height" value="1"/><rfilter type="box"/></film></sensor>
  <shape type="sphere" id="ball"><point name="center" x="0" y="0.6" z="0"/><float name="radius" value="0.5"/>
    <bsdf type="dielectric"/></shape>
  <emitter type="constant"/>
  <shape type="rectangle" id="floor"><transform name="to_world"><rotate x="1" angle="-90"/></transform></shape>
</scene>"""


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Path:
    monkeypatch.setenv("SLEPIAN_PRT_CACHE", str(tmp_path / "cache"))
    (tmp_path / "scene.xml").write_text(SCENE)
    texels = np.ones((16, 32, 3), dtype=np.float32)
    texels[:8] = 3.0
    bitmap_module().Bitmap(texels).write(str(tmp_path / "sky.exr"))
    return tmp_path


def run(*arguments) -> int:
    return main([str(a) for a in arguments])


def test_one_render_then_any_light(folder, capsys):
    file = folder / "picture.prt"
    small = ["--samples", "16", "--bandlimit", "3", "-D", "width=20"]
    assert run("capture", folder / "scene.xml", "-o", file, *small) == 0
    told = capsys.readouterr().out
    assert "20 x 12 pixels of camera 'front', 16 paths of each" in told
    packed = load(file)
    assert (packed.film.width, packed.film.height, packed.bandlimit) == (20, 12, 3)
    assert packed.parameters == {"width": "20"}
    for rotate in (0, 90):
        out = folder / f"{rotate}.exr"
        sky = folder / "sky.exr"
        assert run("relight", file, "--environment", sky, "--rotate", rotate, "--background", "map", "-o", out) == 0
        pixels = np.array(bitmap_module().Bitmap(str(out)))
        assert pixels.shape == (12, 20, 4)
        assert pixels[0, 0, 0] == pytest.approx(3.0, rel=1e-3)  # the sky itself
    assert run("relight", file, "--environment", sky, "-o", folder / "all.npz") == 0
    numbers = np.load(folder / "all.npz")
    assert numbers["radiance"].shape == (12, 20, 3)
    assert numbers["coverage"].shape == numbers["noise"].shape == (12, 20)
    assert "240 pixels under sky.exr, noise 0." in capsys.readouterr().out
    assert run("info", file, "--json") == 0
    content = json.loads(capsys.readouterr().out)
    assert content["film"] == "20 x 12 of front"
    assert 0.0 < content["noise"] < 1.0


def test_coefficients_for_other_tools(folder, capsys):
    out = folder / "picture.exr"
    assert run("capture", folder / "scene.xml", "-o", out, "--samples", "4", "--bandlimit", "1") == 0
    with OpenEXR.File(str(out), separate_channels=True) as file:
        assert "l01.m-01.G" in file.channels()


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["scene.xml", "-o", "x.png"], "captures are written as .prt, or their coefficients as .exr"),
        (["scene.xml", "-o", "x.prt", "--sensor", "back"], "no camera 'back'; name one by number or id: 0 ('front')"),
        (["scene.xml", "-o", "x.prt", "--sensor", "meter"], "name another with --sensor front"),
        (["sky.exr", "-o", "x.prt"], "has no camera; give a Mitsuba .xml scene"),
        (["scene.xml", "-o", "x.prt", "--samples", "1"], "samples must be an integer in [2, 65536], not 1"),
        (
            ["scene.xml", "-o", "x.prt", "--samples", "4", "--max-error", "0.1"],
            "leave out --max-error and --max-seconds",
        ),
        (["scene.xml", "-o", "x.prt", "--environment", "sky.exr"], "--environment says what --max-error is about"),
        (["scene.xml", "-o", "x.prt", "--tolerance", "2"], "tolerance must be a number in (0, 1), not 2"),
        (["scene.xml", "-o", "x.prt", "-D", "height=3"], "has no parameter $height; it has $width"),
        (["nothing.xml", "-o", "x.prt"], "nothing.xml: no such file"),
        (["scene.xml", "-o", "nowhere/x.prt"], "the folder nowhere does not exist"),
    ],
)
def test_mistakes_are_told_in_one_line(arguments, told, folder, capsys, monkeypatch):
    monkeypatch.chdir(folder)
    assert run("capture", *arguments) == 2
    error = capsys.readouterr().err
    assert told in error
    assert error.count("\n") == 1
    assert not list(folder.glob("x.*"))


def test_pictures_of_pixels_are_no_meshes(folder, capsys):
    file = folder / "picture.prt"
    assert run("capture", folder / "scene.xml", "-o", file, "--samples", "2", "--bandlimit", "1") == 0
    sky = ["--environment", folder / "sky.exr"]
    capsys.readouterr()
    assert run("relight", file, *sky, "-o", folder / "x.ply") == 2
    assert "which are no mesh; name one of .png, .exr, .npz" in capsys.readouterr().err
    assert run("relight", file, *sky, "--look-at", "0,0,3", "0,0,0", "-o", folder / "x.png") == 2
    assert "which only light can change; leave out --look-at" in capsys.readouterr().err
    assert not list(folder.glob("x.*"))


@pytest.mark.slow
def test_a_process_that_is_killed_goes_on(folder):
    """As it happens to users: SIGKILL, then the same command; the result is that of an undisturbed one."""
    command = [sys.executable, "-m", "slepian_prt", "capture", "scene.xml", "--samples", "32", "--bandlimit", "2", "-o"]
    code = (
        "import os, signal, sys; from slepian_prt.transport.capturing.pixel_means import PixelMeans\n"
        "add = PixelMeans.add\n"
        "def kill(*a):\n    add(*a); os.kill(os.getpid(), signal.SIGKILL)\n"
        "PixelMeans.add = kill; sys.argv = sys.argv[1:]; from slepian_prt.__main__ import main; main()"
    )
    run_in = {"cwd": folder, "capture_output": True, "text": True, "env": dict(os.environ)}
    killed = subprocess.run([sys.executable, "-c", code, *command[2:], "out.exr"], check=False, **run_in)
    assert killed.returncode == -signal.SIGKILL
    assert not list(folder.glob("*.exr.*"))
    assert not (folder / "out.exr").exists()
    assert [path.suffix for path in (folder / "cache").iterdir()] == [".capture"]
    done = subprocess.run([*command, "out.exr"], check=True, **run_in)
    assert "1 of 2 blocks of pixels were finished before and are kept" in done.stderr
    assert list((folder / "cache").iterdir()) == []
    subprocess.run([*command, "again.exr"], check=True, **run_in)
    pictures = [np.array(bitmap_module().Bitmap(str(folder / name))) for name in ("out.exr", "again.exr")]
    assert pictures[0].shape == (12, 16, 3 * 9 + 3)
    np.testing.assert_allclose(pictures[0], pictures[1], atol=1e-4)
