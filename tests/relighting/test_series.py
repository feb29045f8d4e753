import os
import stat
import subprocess
import sys

import numpy as np
import pytest
import trimesh
from matplotlib import pyplot as plt

from slepian_prt.compression.stream import compress
from slepian_prt.errors import UserError
from slepian_prt.lighting.projection import project_environment
from slepian_prt.relighting.files import films, outputs, wishes
from slepian_prt.relighting.relight import relight
from slepian_prt.relighting.series import Lights, relight_series
from slepian_prt.transport.transfer import precompute
from tests.conftest import bumpy
from tests.relighting.mitsuba.test_integrator import sky


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A transfer file and two maps."""
    path = tmp_path_factory.mktemp("series")
    compress(precompute(bumpy(3), bandlimit=5, samples=64), tolerance=0.05, clusters=8).save(path / "bumpy.prt")
    for number, name in enumerate(("first", "second")):
        np.save(path / f"{name}.npy", sky(number))
        texels = sky(number)
        import OpenEXR

        with OpenEXR.File({"type": OpenEXR.scanlineimage}, {"RGB": texels}) as file:
            file.write(str(path / f"{name}.exr"))
    return path


def run(folder, *arguments: str, env: dict[str, str] | None = None) -> subprocess.CompletedProcess:
    command = [sys.executable, "-m", "slepian_prt", "relight", "bumpy.prt", *arguments]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, env={**os.environ, **(env or {})})


def test_many_lights_are_each_light(folder, rng):
    from slepian_prt.compression.files.prt_file import load

    packed = load(folder / "bumpy.prt")
    lights = rng.normal(size=(7, 3, 36))
    together = relight(packed, lights)
    assert together.shape == (7, len(packed.mesh.positions), 3)
    for one, light in zip(together, lights, strict=True):
        np.testing.assert_allclose(one, relight(packed, light), atol=1e-5)
    transfer = precompute(bumpy(2), bandlimit=5, samples=16)
    together = relight(transfer, lights)
    np.testing.assert_allclose(together[3], relight(transfer, lights[3]), atol=1e-5)
    with pytest.raises(UserError, match="finite"):
        relight(packed, np.full((3, 36), np.nan))
    with pytest.raises(UserError, match="shape"):
        relight(packed, np.zeros((0, 3, 36)))


@pytest.mark.slow
def test_a_turntable_turns_the_light(folder):
    done = run(folder, "--environment", "first.exr", "--rotate", "10", "--turntable", "5", "-o", "all.npz")
    assert done.returncode == 0, done.stderr
    assert "5 results" in done.stdout
    from slepian_prt.compression.files.prt_file import load

    packed = load(folder / "bumpy.prt")
    radiance = np.load(folder / "all.npz")["radiance"]
    for number, one in enumerate(radiance):
        light = project_environment(folder / "first.exr", 5, rotate=10 + 72 * number)
        np.testing.assert_allclose(one, relight(packed, light), atol=1e-5)


@pytest.mark.slow
def test_pictures_in_a_folder_have_one_exposure(folder):
    done = run(folder, "--environment", "first.exr", "--turntable", "3", "--width", "48", "-o", "frames/")
    assert done.returncode == 0, done.stderr
    assert sorted(os.listdir(folder / "frames")) == ["0000.png", "0001.png", "0002.png"]
    frames = [plt.imread(folder / "frames" / name) for name in sorted(os.listdir(folder / "frames"))]
    assert {frame.shape for frame in frames} == {(frames[0].shape[0], 48, 4)}
    # One exposure: the brightest frame is the same as by itself, others are darker than by themselves.
    assert max(frame[..., :3].max() for frame in frames) > 0.8
    # Dim and bright maps keep their proportion.
    done = run(folder, "--environment", "first.exr", "--environment", "second.exr", "--format", "exr", "--width", "48",
               "-o", "pictures")  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert sorted(os.listdir(folder / "pictures")) == ["first.exr", "second.exr"]
    done = run(folder, "--environment", "first.exr", "--environment", "second.exr", "--format", "ply", "-o", "pictures")
    assert done.returncode == 0, done.stderr
    assert sorted(os.listdir(folder / "pictures")) == ["first.exr", "first.ply", "second.exr", "second.ply"]
    assert len(trimesh.load(folder / "pictures" / "first.ply", process=False).vertices) == 642


@pytest.mark.slow
def test_what_a_window_does_is_told(folder):
    done = run(folder, "--environment", "first.exr", "--window", "hann", "--window-width", "3", "-o", "w.npz")
    assert done.returncode == 0, done.stderr
    assert "first: window hann of width 3 changes radiance by" in done.stderr


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--turntable", "0", "-o", "x.npz"], "turntable must be between 1 and 3600"),
        (["--turntable", "3", "-o", "x.png"], "one file for several results"),
        (["--turntable", "3", "--environment", "second.exr", "-o", "x.npz"], "turns one map"),
        (["-o", "x.mp4"], "a film needs several lights"),
        (["--environment", "second.exr", "-o", "x.jpg"], "unknown kind of output '.jpg'; name a folder"),
        (["--environment", "first.exr", "-o", "x.npz"], "different names"),
        (["--window-width", "3", "-o", "x.npz"], "a width needs a window"),
        (["--window", "hann", "--window-width", "-3", "-o", "x.npz"], "width of the window must be larger than 0"),
        (["--environment", "second.exr", "-o", "bumpy.prt/deeper"], "is not a folder"),
    ],
)
def test_wrong_requests(arguments, message, folder):
    before = sorted(os.listdir(folder))
    done = run(folder, "--environment", "first.exr", *arguments)
    assert done.returncode == 2
    assert message in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert sorted(os.listdir(folder)) == before


@pytest.mark.slow
def test_a_film_goes_through_the_encoder(folder, tmp_path):
    """An encoder that keeps what it is given."""
    fake = tmp_path / "ffmpeg"
    fake.write_text(f"#!{sys.executable}\nimport sys\nopen(sys.argv[-1], 'wb').write(sys.stdin.buffer.read())\n")
    fake.chmod(fake.stat().st_mode | stat.S_IXUSR)
    path = {"PATH": f"{tmp_path}{os.pathsep}{os.environ['PATH']}"}
    done = run(folder, "--environment", "first.exr", "--turntable", "4", "--width", "49", "-o", "film.mp4", env=path)
    assert done.returncode == 0, done.stderr
    film = np.frombuffer((folder / "film.mp4").read_bytes(), np.uint8)
    frames = film.reshape(4, -1, 48, 3)  # sides are even
    assert frames.shape[1] % 2 == 0
    assert frames[0, 0, 0].min() == 255  # white around
    assert (frames[0] != frames[2]).any()
    fake.write_text(f"#!{sys.executable}\nimport sys\nprint('no such codec', file=sys.stderr)\nsys.exit(1)\n")
    done = run(folder, "--environment", "first.exr", "--turntable", "4", "--width", "49", "-o", "bad.mp4", env=path)
    assert done.returncode == 2
    assert "ffmpeg could not encode the film (no such codec)" in done.stderr
    assert not (folder / "bad.mp4").exists()


def test_without_an_encoder(monkeypatch):
    monkeypatch.setattr(films.shutil, "which", lambda _: None)
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(UserError, match="films need ffmpeg"):
        wishes.check_output("film.mp4", [], ["a", "b"], wishes.Wish(), several=True)


def test_series_that_fail_leave_nothing(folder, tmp_path, monkeypatch):
    from slepian_prt.compression.files.prt_file import load

    packed = load(folder / "bumpy.prt")
    lights = Lights((str(folder / "first.exr"),), turntable=3)
    series = relight_series(packed, lights, "bumpy.prt", lambda _: None)
    written = []

    def fails(path, *_):
        written.append(path)
        if len(written) == 2:
            raise OSError(28, "No space left on device")
        path.write_bytes(b"x")

    monkeypatch.setattr(outputs, "write_radiance", fails)
    with pytest.raises(UserError, match="No space left on device"):
        outputs.write_relit(str(tmp_path / "out"), packed, series, wishes.Wish(".npz"))
    assert list(tmp_path.iterdir()) == []
