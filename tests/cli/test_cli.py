"""The command as a user meets it."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import trimesh

from slepian_prt.cli import main
from slepian_prt.renderer.variants import bitmap_module
from tests.conftest import bumpy
from tests.terminal import run_in_terminal

COMMAND = [sys.executable, "-m", "slepian_prt"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A mesh, two maps and a transfer file."""
    folder = tmp_path_factory.mktemp("cli")
    mesh = bumpy(3)
    trimesh.Trimesh(mesh.positions, mesh.faces, process=False).export(folder / "ball.ply")
    mi = bitmap_module()
    rng = np.random.default_rng(3)
    mi.Bitmap(rng.random((16, 32, 3)).astype(np.float32)).write(str(folder / "map.exr"))
    broken = np.ones((16, 32, 3), dtype=np.float32)
    broken[4, 4] = -500.0
    mi.Bitmap(broken).write(str(folder / "negative.exr"))
    mi.Bitmap(np.ones((16, 16, 3), dtype=np.float32)).write(str(folder / "square.exr"))
    for name in ("other.exr", "ladder.png"):
        (folder / name).write_bytes((folder / "map.exr").read_bytes())
    assert run(["precompute", folder / "ball.ply", "-o", folder / "ball.prt", *SMALL]) == 0
    (folder / "cut.prt").write_bytes((folder / "ball.prt").read_bytes()[:5000])
    return folder


SMALL = ["--bandlimit", "4", "--samples", "64", "--clusters", "8"]


def run(arguments) -> int:
    return main([str(a) for a in arguments])


def test_precompute_reports(folder, capsys):
    assert run(["precompute", folder / "ball.ply", "-o", folder / "again.prt", "--terms", "9", *SMALL]) == 0
    captured = capsys.readouterr()
    assert "shadows" in captured.out
    assert "642 vertices, adapted, 9 functions of 25 in 8 caps" in captured.out
    assert captured.err == ""  # quiet in a pipe


def test_info(folder, capsys):
    assert run(["info", folder / "ball.prt", "--json"]) == 0
    content = json.loads(capsys.readouterr().out)
    stable = {"vertices", "bandlimit", "clusters", "terms", "bytes_per_vertex", "predicted_error", "effects"}
    assert stable | {"rays_traced", "seconds"} <= set(content)
    assert content["vertices"] == 642
    assert content["predicted_error"] <= 0.02
    assert {"name", "verdict", "contribution", "reason"} <= set(content["effects"][0])
    assert run(["info", folder / "ball.prt"]) == 0
    assert "predicted_error" in capsys.readouterr().out


@pytest.mark.parametrize("suffix", ["npz", "ply", "glb", "png", "exr"])
def test_relight(suffix, folder, capsys):
    out = folder / f"lit.{suffix}"
    assert run(["relight", folder / "ball.prt", "--environment", folder / "map.exr", "-o", out, "--width", "64"]) == 0
    assert out.stat().st_size > 100
    assert "642 vertices under map.exr" in capsys.readouterr().out


def test_pictures_as_asked_for(folder, capsys):
    """From another side, before a colour or the map, brighter: what the options say reaches the picture."""
    arguments = ["relight", folder / "ball.prt", "--environment", folder / "map.exr", "--width", "32", "-o"]
    given = {
        "plain": [],
        "side": ["--look-at", "9,0,0", "0,0,0"],
        "wide": ["--fov", "90"],
        "lying": ["--up", "z"],
        "white": ["--background", "white"],
        "map": ["--background", "map"],
        "bright": ["--exposure", "1"],
    }
    pictures = {}
    for name, options in given.items():
        assert run([*arguments, folder / f"{name}_picture.exr", *options]) == 0
        pictures[name] = np.array(bitmap_module().Bitmap(str(folder / f"{name}_picture.exr")))
    assert "have no effect" not in capsys.readouterr().err
    plain = pictures["plain"]
    assert all(other.shape != plain.shape or (other != plain).any() for n, other in pictures.items() if n != "plain")
    assert pictures["side"].shape == (24, 32, 4)
    np.testing.assert_allclose(pictures["white"][0, 0], 1.0)
    assert 0.0 < pictures["map"][0, 0, :3].min() < 1.0
    np.testing.assert_allclose(pictures["bright"][..., :3], 2.0 * plain[..., :3], rtol=1e-6)
    assert run([*arguments, folder / "lit.npz", "--fov", "30"]) == 0
    assert "--width, --fov have no effect on .npz files" in capsys.readouterr().err


def test_rotation_changes_the_light(folder):
    results = []
    for degrees in (0, 90, 360):
        out = folder / f"turned{degrees}.npz"
        arguments = [
            "relight",
            folder / "ball.prt",
            "--environment",
            folder / "map.exr",
            "--rotate",
            degrees,
            "-o",
            out,
        ]
        assert run(arguments) == 0
        results.append(np.load(out)["radiance"])
    np.testing.assert_allclose(results[0], results[2], atol=1e-5)
    assert np.abs(results[0] - results[1]).max() > 0.01


def test_clamp_negative(folder, capsys):
    arguments = ["relight", folder / "ball.prt", "--environment", folder / "negative.exr", "-o", folder / "n.npz"]
    assert run(arguments) == 2
    assert run([*arguments, "--clamp-negative"]) == 0
    assert "1 negative texels set to zero" in capsys.readouterr().err


BAD = {
    "missing mesh": (["precompute", "{}/no.ply", "-o", "{}/x.prt"], "no such file"),
    "missing xml": (["precompute", "{}/no.xml", "-o", "{}/x.prt"], "no such file"),
    "not a mesh": (["precompute", "{}/map.exr", "-o", "{}/x.prt"], "unknown mesh format"),
    "bandlimit": (["precompute", "{}/ball.ply", "-o", "{}/x.prt", "--bandlimit", "51"], "[0, 50], not 51"),
    "bandlimit no number": (["precompute", "{}/ball.ply", "-o", "{}/x.prt", "--bandlimit", "x"], "--bandlimit"),
    "terms": (
        ["precompute", "{}/ball.ply", "-o", "{}/x.prt", "--terms", "500"],
        "terms must be an integer in [1, 121]",
    ),
    **{
        f"tolerance {tolerance}": (
            ["precompute", "{}/ball.ply", "-o", "{}/x.prt", "--tolerance", tolerance],
            "--tolerance must be a number in (0, 1), not",
        )
        for tolerance in ("0", "1", "2", "nan")
    },
    "tolerance of a sweep": (
        ["sweep", "{}/ball.ply", "--environment", "{}/map.exr", "-o", "{}/x", "--tolerance", "0.1,2"],
        "--tolerance must be a number in (0, 1), not 2.0",
    ),
    "epsilon": (
        ["precompute", "{}/ball.ply", "-o", "{}/x.prt", "--truncate", "n_g", "--epsilon", "nan"],
        "--epsilon must be a number in (0, 1), not nan",
    ),
    "samples": (["precompute", "{}/ball.ply", "-o", "{}/x.prt", "--samples", "0"], "samples must be"),
    "two rules": (["precompute", "{}/ball.ply", "-o", "{}/x.prt", "--terms", "4", "--tolerance", "0.1"], "only one of"),
    "unknown basis": (["precompute", "{}/ball.ply", "-o", "{}/x.prt", "--basis", "fourier"], "'fourier'"),
    "no folder": (["precompute", "{}/ball.ply", "-o", "{}/none/x.prt"], "does not exist"),
    "no scene": (["precompute", "-o", "{}/out"], "no SCENE is given"),
    "several into a file": (["precompute", "{}/ball.ply", "{}/ball.ply", "-o", "{}/x.prt"], "go into a folder"),
    "json of a file": (["precompute", "{}/ball.ply", "-o", "{}/x.prt", "--json"], "into a folder"),
    "unknown format": (["precompute", "{}/ball.ply", "-o", "{}/out/", "--format", "ply"], "'ply'"),
    "goal of order 2": (
        ["precompute", "{}/ball.ply", "-o", "{}/out/", "--format", "pifu", "--max-error", "0.1"],
        "--max-error and --max-seconds are about prt; leave them out, or add --format prt",
    ),
    "no list": (["precompute", "--from", "{}/none.txt", "-o", "{}/out"], "no such file"),
    "file as folder": (["precompute", "{}/ball.ply", "-o", "{}/ball.ply/"], "is not a folder"),
    "no output": (["precompute", "{}/ball.ply"], "--output"),
    "no file": (["info", "{}/none.prt"], "no such file"),
    "cut file": (["info", "{}/cut.prt"], "cut short or damaged"),
    "foreign file": (["info", "{}/ball.ply"], "not a transfer file"),
    "no map": (["relight", "{}/ball.prt", "--environment", "{}/no.exr", "-o", "{}/x.png"], "no such file"),
    "square map": (["relight", "{}/ball.prt", "--environment", "{}/square.exr", "-o", "{}/x.png"], "twice as wide"),
    "negative map": (
        ["relight", "{}/ball.prt", "--environment", "{}/negative.exr", "-o", "{}/x.png"],
        "--clamp-negative",
    ),
    "mesh as map": (["relight", "{}/ball.prt", "--environment", "{}/ball.ply", "-o", "{}/x.png"], "cannot be read"),
    "unknown output": (["relight", "{}/ball.prt", "--environment", "{}/map.exr", "-o", "{}/x.gif"], "unknown kind"),
    "rotation": (
        ["relight", "{}/ball.prt", "--environment", "{}/map.exr", "--rotate", "nan", "-o", "{}/x.png"],
        "finite number of degrees",
    ),
    "width": (
        ["relight", "{}/ball.prt", "--environment", "{}/map.exr", "--width", "0", "-o", "{}/x.png"],
        "width must be",
    ),
    "compare without map": (["compare", "{}/ball.ply", "-o", "{}/x"], "name a map with --environment"),
    "compare same map twice": (
        ["compare", "{}/ball.ply", "--environment", "{}/map.exr", "--environment", "{}/map.exr", "-o", "{}/x"],
        "different names",
    ),
    "compare into a file": (
        ["compare", "{}/ball.ply", "--environment", "{}/map.exr", "-o", "{}/ball.ply"],
        "not a folder",
    ),
    "compare unknown basis": (
        ["compare", "{}/ball.ply", "--environment", "{}/map.exr", "--basis", "x", "-o", "{}/x"],
        "basis must be one of",
    ),
    "negative seed": (["precompute", "{}/ball.ply", "-o", "{}/x.prt", "--seed", "-1"], "seed must be"),
    "no name": (["precompute", "{}/ball.ply", "-o", ""], "output is empty"),
    "over the mesh": (["precompute", "{}/ball.ply", "-o", "{}/ball.ply"], "is the input"),
    "over the map": (["relight", "{}/ball.prt", "--environment", "{}/map.exr", "-o", "{}/map.exr"], "is the input"),
    "noise": (
        ["compare", "{}/ball.ply", "--environment", "{}/map.exr", "--noise", "0", "-o", "{}/x"],
        "--noise must be a number in (0, 1)",
    ),
    "no report name": (["compare", "{}/ball.ply", "--environment", "{}/map.exr", "-o", ""], "folder is empty"),
    "folder as map": (["relight", "{}/ball.prt", "--environment", "{}", "-o", "{}/x.png"], "is a folder"),
    "mesh as file": (["info", "{}/ball.ply"], "is a mesh, not a transfer file; first run: slepian-prt precompute"),
    "relight a mesh": (
        ["relight", "{}/ball.ply", "--environment", "{}/map.exr", "-o", "{}/x.png"],
        "is a mesh, not a transfer file; first run: slepian-prt precompute",
    ),
    "over the mesh of the file": (
        ["relight", "{}/ball.prt", "--environment", "{}/map.exr", "-o", "{}/ball.ply"],
        "is the input",
    ),
    "over the map, in a folder": (
        [
            "relight",
            "{}/ball.prt",
            "--environment",
            "{}/map.exr",
            "--environment",
            "{}/other.exr",
            "--format",
            "exr",
            "-o",
            "{}",
        ],
        "is the input",
    ),
    **{
        f"{command} {' '.join(given)}": (
            [command, f"{{}}/ball.{suffix}", "--environment", "{}/map.exr", "-o", f"{{}}/{output}", *given],
            message,
        )
        for command, suffix, output in (("relight", "prt", "x.png"), ("compare", "ply", "x"))
        for given, message in (
            (["--look-at", "1,2,3", "1,2,3"], "--look-at must be two different points"),
            (["--look-at", "1,2", "1,2,3"], "--look-at must be two points X,Y,Z"),
            (["--look-at", "1,2,nan", "1,2,3"], "finite numbers"),
            (["--look-at", "0,9,0", "0,1,0"], "--look-at looks along the axis y, which is to be up"),
            (["--look-at", "0,0,9", "0,0,0", "--up", "z"], "give --up y"),
            (["--fov", "180"], "--fov must be an angle between 0 and 180"),
            (["--fov", "nan"], "--fov must be an angle"),
            (["--up", "x"], "--up"),
            (["--background", "blueish"], "--background must be transparent, map, a colour"),
            (["--exposure", "nan"], "--exposure must be a number of stops"),
        )
    },
    "map of a scene that has none": (
        ["relight", "{}/ball.prt", "--background", "map", "-o", "{}/x.png"],
        "name its map",
    ),
    "all and some": (
        ["compare", "{}/ball.ply", "--environment", "{}/map.exr", "--all", "--basis", "sh", "-o", "{}/x"],
        "give one of the two",
    ),
    "report over a map": (
        ["compare", "{}/ball.ply", "--environment", "{}/ladder.png", "-o", "{}"],
        "a file of the report has this name",
    ),
    "folder as file": (["info", "{}"], "is a folder"),
    "unknown command": (["fly"], "fly"),
}


@pytest.mark.parametrize("case", BAD)
def test_mistakes_get_one_line_and_status_two(case, folder, capsys):
    arguments, message = BAD[case]
    before = sorted(folder.iterdir())
    assert run([a.format(folder) for a in arguments]) == 2
    captured = capsys.readouterr()
    lines = captured.err.strip().splitlines()
    assert len(lines) == 1, captured.err
    assert lines[0].startswith("slepian-prt: ")
    assert message in lines[0]
    assert "Traceback" not in captured.out + captured.err
    assert sorted(folder.iterdir()) == before


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_folder_that_is_not_writable(folder, tmp_path, capsys):
    tmp_path.chmod(0o500)
    assert run(["precompute", folder / "ball.ply", "-o", tmp_path / "x.prt", *SMALL]) == 2
    assert "not writable" in capsys.readouterr().err


def test_a_fault_of_ours_is_one_line_and_status_one(folder, capsys, monkeypatch):
    def fail(*_args, **_kwargs):
        raise RuntimeError("something\nwith lines")

    monkeypatch.setattr("slepian_prt.compression.files.prt_file.load", fail)
    assert run(["info", folder / "ball.prt"]) == 1
    error = capsys.readouterr().err
    assert len(error.strip().splitlines()) == 1
    assert "internal error, RuntimeError: something with lines" in error


def test_help_needs_no_renderer():
    code = "import sys; from slepian_prt.cli import main; main(['--help']); print('mitsuba' in sys.modules)"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert "precompute" in out
    assert out.strip().endswith("False")


@pytest.mark.slow
def test_interrupt_leaves_nothing(folder, tmp_path):
    ball = trimesh.creation.icosphere(6)
    bumps = ball.vertices * (1 + 0.2 * np.sin(6 * ball.vertices).prod(axis=1))[:, None]
    trimesh.Trimesh(bumps, ball.faces, process=False).export(tmp_path / "big.ply")
    process = subprocess.Popen(
        [*COMMAND, "precompute", tmp_path / "big.ply", "-o", tmp_path / "big.prt", "--samples", "8192"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        # A runner in the background hands down that interrupts are ignored.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    assert "effect" in process.stdout.readline()  # the plan is printed, the rays are being traced
    time.sleep(0.5)
    process.send_signal(signal.SIGINT)
    _, error = process.communicate(timeout=120)
    assert process.returncode == 130, error
    kept = "finished work is kept, and the same command goes on"
    assert error.strip() in (f"slepian-prt: interrupted; {what}" for what in ("nothing was written", kept))
    assert [p.name for p in tmp_path.iterdir()] == ["big.ply"]


def test_what_was_written_before_is_no_input(folder, tmp_path):
    """A mesh beside the file that has the name of its source is that only if the source is not where it was."""
    shutil.copy(folder / "ball.ply", tmp_path / "ball.ply")
    (tmp_path / "out").mkdir()
    assert main(["precompute", f"{tmp_path}/ball.ply", "-o", f"{tmp_path}/out/ball.prt", "--samples", "16"]) == 0
    again = [
        "relight",
        f"{tmp_path}/out/ball.prt",
        "--environment",
        f"{folder}/map.exr",
        "-o",
        f"{tmp_path}/out/ball.ply",
    ]
    assert main(again) == 0
    assert main(again) == 0
    (tmp_path / "ball.ply").unlink()
    assert main(again) == 2


@pytest.mark.slow
def test_progress_on_a_terminal(folder, tmp_path):
    ball = trimesh.creation.icosphere(6)
    bumps = ball.vertices * (1 + 0.2 * np.sin(6 * ball.vertices).prod(axis=1))[:, None]
    trimesh.Trimesh(bumps, ball.faces, process=False).export(tmp_path / "big.ply")
    text = run_in_terminal(
        [*COMMAND, "precompute", tmp_path / "big.ply", "-o", tmp_path / "big.prt", "--samples", "1024"],
        columns=120,
        stdout=subprocess.DEVNULL,
    )
    assert "vertices" in text
    assert "/s" in text
    assert "left" in text
    assert "40962" in text


@pytest.mark.slow
def test_compare_end_to_end(folder, capsys):
    arguments = ["compare", folder / "ball.ply", "--environment", folder / "map.exr", "-o", folder / "report"]
    assert run([*arguments, *SMALL, "--width", "64", "--terms", "4", "--basis", "adapted", "--basis", "sh"]) == 0
    assert "report.html" in capsys.readouterr().out
    results = json.loads((folder / "report" / "results.json").read_text())
    plain = [m["basis"] for m in results["methods"] if m["coding"] == "float16"]
    assert plain == ["adapted", "sh", "none"]
    assert {m["basis"] for m in results["methods"] if m["coding"] == "coded"} == {"adapted"}


@pytest.mark.slow
def test_doctor(capsys):
    assert run(["doctor", "--json"]) == 0
    findings = {f["subject"]: f for f in json.loads(capsys.readouterr().out)["findings"]}
    assert findings["mitsuba"]["value"].startswith("3.9.")
    assert "Mrays/s" in findings["speed"]["value"]


# --- Effects, materials and cameras ----------------------------------------------------------------------------------


def test_albedo_brings_interreflection(folder, capsys):
    out = folder / "bright.prt"
    assert run(["precompute", folder / "ball.ply", "-o", out, "--albedo", "0.9,0.5,0.2", *SMALL]) == 0
    assert "interreflection  simulated" in capsys.readouterr().out
    assert run(["info", out, "--json"]) == 0
    content = json.loads(capsys.readouterr().out)
    assert content["channels"] == 3
    assert content["bounces"] > 0
    assert {"name", "verdict", "contribution", "confidence", "rays", "reason"} <= set(content["effects"][0])
    assert run(["relight", out, "--environment", folder / "map.exr", "-o", folder / "bright.npz"]) == 0
    assert run(["precompute", folder / "ball.ply", "-o", out, "--albedo", "0.9", "--effects", "direct", *SMALL]) == 0
    assert "not asked for (--effects direct)" in capsys.readouterr().out


@pytest.mark.slow
def test_a_scene_is_relit_in_its_own_light_by_its_own_camera(folder, capsys):
    (folder / "scene.xml").write_text(
        """<scene version="3.0.0"><sensor type="perspective" id="eye"><transform name="to_world">
        <lookat origin="0, 0, 5" target="0, 0, 0" up="0, 1, 0"/></transform><film type="hdrfilm">
        <integer name="width" value="40"/><integer name="height" value="30"/></film></sensor>
        <emitter type="constant"/><shape type="sphere"><bsdf type="diffuse"/></shape></scene>"""
    )
    assert run(["precompute", folder / "scene.xml", "-o", folder / "scene.prt", *SMALL]) == 0
    assert run(["relight", folder / "scene.prt", "-o", folder / "scene.exr"]) == 0
    pixels = np.array(bitmap_module().Bitmap(str(folder / "scene.exr")))
    assert pixels.shape == (30, 40, 4)
    # A convex surface of reflectance 1/2 under light of radiance 1, in the middle of the picture.
    np.testing.assert_allclose(pixels[15, 20], [0.5, 0.5, 0.5, 1.0], atol=2e-2)
    assert run(["relight", folder / "scene.prt", "--width", "80", "-o", folder / "scene.exr"]) == 0
    assert np.array(bitmap_module().Bitmap(str(folder / "scene.exr"))).shape == (60, 80, 4)
    capsys.readouterr()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--effects", "magic"], "effects must be auto, direct, all, none"),
        (["--effects", "interreflection"], "interreflection needs shadows"),
        (["--albedo", "red"], "--albedo must be one number"),
        (["--albedo", "1.5"], "albedo must be one or three numbers between 0 and 1"),
        (["--bounces", "-1"], "bounces must be"),
        (["--view", "front"], "this scene has none"),
    ],
)
def test_bad_effects_and_materials(folder, arguments, message, capsys):
    out = folder / "never.prt"
    assert run(["precompute", folder / "ball.ply", "-o", out, *SMALL, *arguments]) == 2
    captured = capsys.readouterr()
    assert message in captured.err
    assert captured.err.count("\n") == 1
    assert not out.exists()


def test_relight_without_any_light(folder, capsys):
    assert run(["relight", folder / "ball.prt", "-o", folder / "never.npz"]) == 2
    assert "name a map with --environment" in capsys.readouterr().err
    assert not (folder / "never.npz").exists()


def test_options_of_pictures_are_called_as_they_are_given(folder, capsys):
    arguments = ["relight", folder / "ball.prt", "--environment", folder / "map.exr"]
    assert run([*arguments, "--spp", "0", "-o", folder / "x.png"]) == 2
    assert "--spp must be an integer in [1, 65536]" in capsys.readouterr().err
    assert run([*arguments, "--spp", "8", "-o", folder / "x.npz"]) == 0
    assert "--spp have no effect on .npz files" in capsys.readouterr().err
    assert run([*arguments, "--scene", folder / "no.xml", "-o", folder / "x.png"]) == 2
    assert "no.xml: no such file; check the path of --scene" in capsys.readouterr().err
