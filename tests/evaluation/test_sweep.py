import csv
import json
import math
import os
import subprocess
import sys
from dataclasses import replace
from itertools import pairwise

import numpy as np
import OpenEXR
import pytest
import trimesh

from slepian_prt.errors import UserError
from slepian_prt.evaluation.compare import compare
from slepian_prt.evaluation.sweep.axes import Axes, Setting
from slepian_prt.evaluation.sweep.checkpoint import SweepCheckpoint
from slepian_prt.evaluation.sweep.report import _well_apart, write_sweep
from slepian_prt.evaluation.sweep.results import Point, Sweep, find_setbacks, pareto_front
from slepian_prt.evaluation.sweep.run import sweep
from slepian_prt.lighting.environment import make_environment
from slepian_prt.transport.planned import plan_scene
from slepian_prt.transport.settings import TransportSettings
from tests.conftest import bumpy
from tests.relighting.mitsuba.test_integrator import sky

AXES = Axes(samples=(16, 256), bandlimits=(2, 6), clusters=(8,), tolerances=(0.3, 0.02))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A mesh that shadows itself, and a map."""
    path = tmp_path_factory.mktemp("sweep")
    mesh = bumpy(3)
    trimesh.Trimesh(mesh.positions, mesh.faces, process=False).export(path / "bumpy.ply")
    with OpenEXR.File({"type": OpenEXR.scanlineimage}, {"RGB": sky()}) as file:
        file.write(str(path / "sky.exr"))
    return path


@pytest.fixture(scope="module")
def found(folder):
    return sweep(folder / "bumpy.ply", [make_environment(sky(), name="sky")], AXES, TransportSettings(), noise=0.01)


def point(samples=16, bandlimit=4, tolerance=0.1, error=0.1, seconds=1.0, size=1.0) -> Point:
    setting = Setting(samples, bandlimit, 8, "adapted", tolerance)
    return Point(setting, {"sky": error}, {"sky": error}, size, seconds, 0.0, 0.0, 0.1, 0.001)


def test_every_combination_is_measured(found):
    assert [p.setting for p in found.points] == list(AXES.settings())
    assert len(found.points) == 8
    assert 0.0 < found.noise["sky"] <= 0.02
    assert {"load", "plan", "kernels", "references"} <= set(found.shared)
    for one in found.points:
        assert one.transport_seconds > 0.0
        assert one.compress_seconds > 0.0
        assert one.bytes_per_vertex > 0.0
        # Compression adds to what few rays and the bandlimit lose, no more than its tolerance allows.
        assert one.full_error["sky"] * 0.9 < one.error["sky"] < one.full_error["sky"] + one.setting.tolerance


def test_more_rays_degrees_and_bytes_are_better(found):
    by = {p.setting: p.error["sky"] for p in found.points}
    best, worst = min(by.values()), max(by.values())
    assert by[Setting(256, 6, 8, "adapted", 0.02)] == best
    assert by[Setting(16, 2, 8, "adapted", 0.3)] > 2.0 * best
    assert worst < 1.0


def test_lower_bandlimits_are_the_first_coefficients(folder, found):
    """The shared rays give what a run of its own would give."""
    alone = sweep(
        folder / "bumpy.ply",
        [make_environment(sky(), name="sky")],
        replace(AXES, samples=(256,), bandlimits=(2,), tolerances=(0.02,)),
        TransportSettings(),
        noise=0.01,
    )
    shared = next(p for p in found.points if p.setting == alone.points[0].setting)
    # Which rays are traced depends a little on the bandlimit.
    assert alone.points[0].error["sky"] == pytest.approx(shared.error["sky"], rel=0.03)


def test_bounces_are_an_axis(folder):
    """The first bounce on a bright surface matters; what is left after it is below the noise here."""
    axes = replace(AXES, samples=(256,), bandlimits=(6,), tolerances=(0.02,), bounces=(None, 0, 1))
    environments = [make_environment(sky(), name="sky")]
    found = sweep(folder / "bumpy.ply", environments, axes, TransportSettings(albedo=0.9), noise=0.01)
    error = {p.setting.bounces: p.error["sky"] for p in found.points}
    assert error[0] > 1.3 * error[1]
    assert error[0] > 1.3 * error[None]
    assert "0 bounces" in next(p.setting.label for p in found.points if p.setting.bounces == 0)


def test_the_front():
    points = [
        point(error=0.3, seconds=1.0), point(error=0.2, seconds=2.0), point(error=0.25, seconds=3.0),
        point(error=0.1, seconds=4.0), point(error=0.1, seconds=5.0),
    ]  # fmt: skip
    assert [p.seconds for p in pareto_front(points, "sky", "seconds")] == [1.0, 2.0, 4.0]


def test_what_does_not_help_is_said():
    points = (point(samples=16, error=0.1), point(samples=64, error=0.2), point(samples=256, error=0.15))
    told = find_setbacks(Sweep("x.ply", 1, ("sky",), {"sky": 0.001}, points, {}, ()))
    assert len(told) == 1
    assert told[0].startswith("Under sky, samples 16 to 64 raises the error from 10.00% to 20.00%")


def test_files(found, tmp_path):
    page = write_sweep(replace(found, command="slepian-prt sweep …"), tmp_path / "out")
    assert sorted(p.name for p in page.parent.iterdir()) == [
        "sky_bytes_per_vertex.png", "sky_seconds.png", "sweep.csv", "sweep.html", "sweep.json",
    ]  # fmt: skip
    results = json.loads((page.parent / "sweep.json").read_text())
    assert len(results["points"]) == 8
    assert results["points"][0]["seconds"] == pytest.approx(found.points[0].seconds)
    assert results["machine"]["cores"] >= 1
    rows = list(csv.DictReader((page.parent / "sweep.csv").read_text().splitlines()))
    assert [float(row["error"]) for row in rows] == [p.error["sky"] for p in found.points]
    text = page.read_text()
    assert text.count("data:image/png;base64,") == 2
    assert "http" not in text.replace("http-equiv", "")
    assert "16 rays, L = 2, 8 caps, adapted, 0.3" in text
    assert Sweep.read(page.parent / "sweep.json") == replace(found, command="slepian-prt sweep …")


def test_what_is_no_finished_sweep(tmp_path):
    with pytest.raises(UserError, match=r"name the sweep\.json of a finished sweep"):
        Sweep.read(tmp_path / "sweep.json")
    for content in ("", "[]", "{}", '{"scene": 1}'):
        (tmp_path / "sweep.json").write_text(content)
        with pytest.raises(UserError, match=r"is not the sweep\.json"):
            Sweep.read(tmp_path / "sweep.json")


def test_a_front_names_settings_that_are_apart():
    points = [point(seconds=1.0 + i, error=0.5 * 0.98**i) for i in range(150)]
    named = _well_apart(pareto_front(points, "sky", "seconds"), "sky")
    assert 5 < len(named) <= 14
    assert named[0] is points[0]
    assert named[-1] is points[-1]
    errors = [p.error["sky"] for p in named]
    assert all(b <= 0.9 * a for a, b in pairwise(errors[:-1]))
    assert _well_apart([points[0]], "sky") == [points[0]]


def test_a_stopped_sweep_goes_on(folder, tmp_path):
    environments, transport = [make_environment(sky(), name="sky")], TransportSettings()
    axes = replace(AXES, bandlimits=(2,), tolerances=(0.3, 0.1))
    path = tmp_path / "partial"
    with plan_scene(folder / "bumpy.ply", transport) as planned:
        checkpoint = SweepCheckpoint(path, planned, environments, 0.05)
    kept = replace(point(samples=max(axes.samples), bandlimit=2, tolerance=0.3), error={"sky": 0.123})
    checkpoint.add(kept)
    with path.open("a") as file:
        file.write('{"key": "cut sho')
    done = []
    found = sweep(
        folder / "bumpy.ply",
        environments,
        axes,
        transport,
        noise=0.05,
        checkpoint=path,
        advance=lambda n, _: done.append(n),
    )
    assert kept in found.points
    assert sum(done) == len(found.points) == 4
    assert not path.exists()
    # Another job is not taken for the same, nor another mesh of the same name.
    checkpoint.add(kept)
    moved = replace(bumpy(3), positions=1.1 * bumpy(3).positions)
    for scene, other in ((folder / "bumpy.ply", TransportSettings(seed=1)), (moved, transport)):
        with plan_scene(scene, other) as planned:
            assert SweepCheckpoint(path, planned, environments, 0.05).points == {}


@pytest.mark.parametrize(
    "change",
    [
        {"error": {"sky": math.inf}}, {"error": {"sky": math.nan}}, {"error": {"other": 0.1}}, {"error": [0.1]},
        {"tolerance": "0.3"}, {"samples": 2**70}, {"samples": -1}, {"bounces": []}, {"bytes_per_vertex": 1e300},
        {"relight_seconds": None}, {"basis": 3}, {"key": None}, {"error": {"sky": -1.0}},
    ],
)  # fmt: skip
def test_lines_of_a_stopped_sweep_that_are_no_results_are_passed_over(change, folder, tmp_path, caplog):
    environments, path = [make_environment(sky(), name="sky")], tmp_path / "partial"
    with plan_scene(folder / "bumpy.ply", TransportSettings()) as planned:
        checkpoint = SweepCheckpoint(path, planned, environments, 0.05)
        names = {"error": {"sky": 0.1}, "full_error": {"sky": 0.1}}
        good, other = (replace(point(samples=n, bandlimit=2, tolerance=0.3), **names) for n in (16, 32))
        checkpoint.add(good)
        line = json.loads(path.read_text())
        with path.open("ab") as file:
            file.write((json.dumps(line | {"samples": 99} | change) + "\n").encode())
            file.write(b"[" * 100_000 + b"\n\xff\xfe\n" + b'{"key": "cut sh')
        checkpoint.add(other)
        with caplog.at_level("WARNING"):
            assert list(SweepCheckpoint(path, planned, environments, 0.05).points.values()) == [good, other]
    assert "measured again" in caplog.text


@pytest.mark.slow
def test_the_command(folder):
    command = [
        sys.executable, "-m", "slepian_prt", "sweep", "bumpy.ply", "--environment", "sky.exr", "-o", "out",
        "--samples", "16,64", "--bandlimit", "3", "--clusters", "8", "--tolerance", "0.2", "--noise", "0.05",
    ]  # fmt: skip
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "not beaten in time" in done.stdout
    assert done.stdout.strip().endswith("out/sweep.html: 2 settings")
    assert not [name for name in os.listdir(folder / "out") if "partial" in name]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--samples", "16,x"], "--samples must be numbers with commas between"),
        (["--samples", "16,16"], "samples has a value twice"),
        (["--samples", "0"], "samples must be an integer"),
        (["--bandlimit", "90"], "bandlimit must be"),
        (["--basis", "wavelets"], "basis must be one of"),
        (["--tolerance", "0"], "tolerance must be"),
        (["--clusters", "0"], "clusters must be"),
        (["--noise", "0"], "noise must be a number in (0, 1)"),
        (["--environment", "sky.exr"], "different names"),
        (["--environment", "none.exr"], "no such file"),
        (["-o", "bumpy.ply"], "not a folder"),
    ],
)
def test_wrong_requests(arguments, message, folder):
    command = [sys.executable, "-m", "slepian_prt", "sweep", "bumpy.ply", "--environment", "sky.exr", "-o", "never"]
    done = subprocess.run([*command, *arguments], cwd=folder, capture_output=True, text=True)
    assert done.returncode == 2
    assert message in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert not (folder / "never").exists()


@pytest.mark.slow
def test_a_scene_that_is_not_there(folder):
    command = [sys.executable, "-m", "slepian_prt", "sweep", "none.ply", "--environment", "sky.exr", "-o", "never"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    assert done.returncode == 2
    assert "none.ply: no such file" in done.stderr
    assert not (folder / "never").exists()


def test_axes_without_values():
    with pytest.raises(UserError, match="tolerances has no values"):
        Axes(tolerances=()).check()
    assert np.prod([len(values) for values in vars(AXES).values()]) == len(list(AXES.settings()))


@pytest.mark.parametrize("noise", [0.0, 1.0, float("nan"), -0.1])
def test_noise_that_makes_no_sense(noise):
    light = make_environment(np.ones((4, 8, 3)))
    for run in (sweep, compare):
        axes = {"axes": Axes(), "transport": TransportSettings()} if run is sweep else {}
        with pytest.raises(UserError, match=r"^noise must be a number in \(0, 1\), not"):
            run("ball.ply", [light], noise=noise, **axes)


def test_work_on_a_scene_with_a_curve_is_kept(tmp_path):
    """Curves know no area; another one is another scene."""
    keys = []
    for middle in (0.2, 0.2, 0.3):
        (tmp_path / "hair.txt").write_text(f"-1 1 0 .05\n0 1 {middle} .05\n0 1 -0.5 .05\n0 1 0.5 .05\n1 1 0 .05\n")
        (tmp_path / "scene.xml").write_text(
            f"""<scene version="3.0.0"><shape type="rectangle"><bsdf type="diffuse"/></shape><shape type="bsplinecurve">
            <string name="filename" value="{tmp_path}/hair.txt"/><bsdf type="conductor"/></shape></scene>"""
        )
        with plan_scene(tmp_path / "scene.xml", TransportSettings(1, 16)) as planned:
            keys.append(SweepCheckpoint(None, planned, (), 0.1)._key)
    assert keys[0] == keys[1] != keys[2]
