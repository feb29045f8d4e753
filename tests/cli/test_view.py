"""`view`: a page of a transfer file, and one line for what cannot become one."""

from __future__ import annotations

import webbrowser
from pathlib import Path

import numpy as np
import pytest

import slepian_prt as sp
from slepian_prt.cli import main
from slepian_prt.cli import view as command
from slepian_prt.renderer.variants import bitmap_module
from tests.viewer.page_reader import blocks, read_payload
from tests.viewer.tiny import lamplit, tiny, tiny_film, traced


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Transfer files of a mesh, of one with lamps, of a film, and of full SH; two maps."""
    folder = tmp_path_factory.mktemp("view")
    tiny().save(folder / "ball.prt")
    lamplit().save(folder / "lamps.prt")
    tiny_film().save(folder / "film.prt")
    tiny_film(8).save(folder / "wide.prt")
    traced().save(folder / "full.npz")
    for name in ("day", "night"):
        texels = np.full((16, 32, 3), 1.0 if name == "day" else 0.1, np.float32)
        bitmap_module().Bitmap(texels).write(str(folder / f"{name}.exr"))
    return folder


@pytest.fixture
def run(folder, tmp_path, monkeypatch, capsys):
    """Runs `view` in the folder of the files; status, and what it said on standard output and error."""
    monkeypatch.chdir(folder)

    def view(*arguments: str, output: str | None = None) -> tuple[int, str, str]:
        status = main(["view", *arguments, "-o", output or str(tmp_path / "page.html")])
        return (status, *capsys.readouterr())

    return view


def content(path: Path):
    return read_payload(blocks(path)["payload"])


def test_a_page_with_two_maps(run, tmp_path):
    status, said, remarks = run(
        "ball.prt", "--environment", "day.exr", "--environment", "night.exr", "--functions", "8"
    )
    assert (status, remarks) == (0, "")
    size = (tmp_path / "page.html").stat().st_size
    assert said.startswith(f"{tmp_path / 'page.html'}: {size / 1e6:.3g} MB with day, night, 8 bytes per vertex")
    read = content(tmp_path / "page.html")
    assert [light["name"] for light in read["lights"]] == ["day", "night"]
    assert read["models"][0]["functions"] == 8


def test_options_of_pictures_reach_the_page(run, tmp_path):
    options = ["--up", "z", "--fov", "30", "--look-at", "0,-5,1", "0,0,0", "--background", "navy", "--exposure", "-1"]
    status, *_ = run("ball.prt", "--environment", "day.exr", *options)
    read = content(tmp_path / "page.html")
    assert status == 0
    assert (read["up"], read["camera"]["fov"]) == ("z", 30.0)
    assert [row[3] for row in read["camera"]["to_world"]] == [0.0, -5.0, 1.0, 1.0]
    assert (read["display"]["background"], read["display"]["exposure"]) == ("#000080", -1.0)


def test_parameters_are_told_as_options(run, tmp_path):
    status, _, remarks = run("ball.prt")
    assert status == 0
    assert remarks == (
        "note: the scene has no light of its own; the page has the sky that is shipped, --environment names others\n"
    )
    told = dict(dict(content(tmp_path / "page.html")["statistics"])["Light transport"])
    assert "--albedo" in told["interreflection"]


@pytest.mark.parametrize("other", ["full.npz", "ball.prt"])
def test_a_second_file_behind_the_slider(run, tmp_path, other):
    assert run("ball.prt", "--environment", "day.exr", "--compare-with", other)[0] == 0
    read = content(tmp_path / "page.html")
    assert [model["functions"] for model in read["models"]] == [16, 64 if other.endswith(".npz") else 16]
    assert len(read["geometries"]) == 1


def test_lamps_are_scaled(run, tmp_path):
    assert run("lamps.prt", "--fixed-lights", "0", "--fixed-lights", "desk=1")[0] == 0
    read = content(tmp_path / "page.html")
    fixed = lamplit().fixed
    assert read["models"][0]["fixed"].mean() == pytest.approx((fixed.direct + fixed.bounced)[1].mean(), rel=1e-3)


def test_a_film(run, tmp_path):
    assert run("film.prt", "--environment", "day.exr")[0] == 0
    assert content(tmp_path / "page.html")["film"]["name"] == "eye"


FAULTS = {
    "no transfer file": (["day.exr"], "day.exr: is not a transfer file"),
    "missing file": (["none.prt"], "none.prt: no such file"),
    "missing map": (["ball.prt", "--environment", "none.exr"], "none.exr: no such file; name an environment map"),
    "no map": (["ball.prt", "--environment", "ball.prt"], "ball.prt: "),
    "no map to be behind": (["lamps.prt", "--background", "map"], "which are no background; name its map with --env"),
    "missing comparison": (["ball.prt", "--compare-with", "none.prt"], "none.prt: no such file"),
    "other vectors": (["ball.prt", "--compare-with", "other.npz"], "other.npz: "),
    "film and mesh": (["film.prt", "--compare-with", "ball.prt"], "--compare-with is a model and the file a picture"),
    "two films": (["film.prt", "--compare-with", "wide.prt"], "--compare-with is a picture of 8 x 4 pixels and the"),
    "camera of a film": (["film.prt", "--fov", "30"], "only light can change; leave out --fov"),
    "functions": (["ball.prt", "--functions", "12"], "Invalid value for '--functions': '12' is not one of"),
    "lamp": (["lamps.prt", "--fixed-lights", "sun=2"], "--fixed-lights names 'sun', which is no lamp"),
    "names": (["ball.prt", "--environment", "day.exr", "--environment", "day.exr"], "must have different names"),
    "scene": (["ball.prt", "--scene", "none.xml"], "none.xml: no such file; check the path of --scene"),
    "rotation": (["ball.prt", "--rotate", "nan"], "rotation must be a finite number of degrees"),
}


@pytest.mark.parametrize(("arguments", "message"), FAULTS.values(), ids=FAULTS)
def test_mistakes_get_one_line(run, folder, tmp_path, arguments, message):
    np.savez(folder / "other.npz", a=np.zeros(3))
    status, said, remarks = run(*arguments)
    lines = [line for line in remarks.splitlines() if not line.startswith("note:")]
    assert (status, said, len(lines)) == (2, "", 1)
    assert lines[0].startswith("slepian-prt: ")
    assert message in lines[0]
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("output", "message"), [
    ("page.png", "page.png: pages are written as .html; name the file so"),
    ("nowhere/page.html", "the folder nowhere does not exist"),
])  # fmt: skip
def test_outputs_that_are_none(run, output, message):
    status, _, remarks = run("ball.prt", output=output)
    assert status == 2
    assert message in remarks


def test_no_input_is_replaced(run, folder):
    before = (folder / "ball.prt").read_bytes()
    (folder / "same.html").write_bytes(before)
    status, _, remarks = run("same.html", output="same.html")
    assert status == 2
    assert remarks == "slepian-prt: same.html: is the input; choose another name for the output\n"
    assert (folder / "same.html").read_bytes() == before


def test_a_page_that_is_too_large_offers_less(run, monkeypatch, tmp_path):
    monkeypatch.setattr("slepian_prt.viewer.page_file.LARGEST_PAGE", 100_000)
    status, _, remarks = run("ball.prt", "--environment", "day.exr")
    assert status == 2
    assert "take --functions 8, or two pages instead of --compare-with" in remarks
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("terminal", "screen", "opens"), [
    (True, True, True), (True, False, False), (False, True, False),
])  # fmt: skip
def test_pages_open_where_there_is_a_terminal_and_a_screen(run, tmp_path, monkeypatch, terminal, screen, opens):
    opened = []
    monkeypatch.setattr(webbrowser, "open", lambda url: opened.append(url) or True)
    monkeypatch.setattr(command.sys, "platform", "linux")
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setenv("DISPLAY", ":0") if screen else monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.setattr("sys.stdout.isatty", lambda: terminal)
    _, _, remarks = run("ball.prt", "--environment", "day.exr")
    assert opened == ([(tmp_path / "page.html").as_uri()] if opens else [])
    assert ("no browser is at hand here; open it in one" in " ".join(remarks.split())) == (terminal and not screen)
    opened.clear()
    run("ball.prt", "--environment", "day.exr", "--no-open")
    assert not opened


def test_the_same_from_python(tmp_path, folder):
    sp.save_page(tmp_path / "page.html", traced(), folder / "day.exr", functions=8, background="white")
    read = content(tmp_path / "page.html")
    assert (read["title"], read["display"]["background"]) == ("bumpy", "#ffffff")
    assert read["models"][0]["label"] == "full SH"
    with pytest.raises(sp.UserError, match=r"pages are written as \.html"):
        sp.save_page(tmp_path / "page.png", traced())
    with pytest.raises(sp.UserError, match=r"day\.exr: pages are written"):
        sp.save_page(folder / "day.exr", traced(), folder / "day.exr")
