"""No output takes the place of an input, under whatever name, nor of a file that an input names."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from slepian_prt.cli import main
from slepian_prt.errors import UserError
from slepian_prt.scene.named_files import check_output_file, check_output_files, files_behind

PLY = "ply\nformat ascii 1.0\ncomment TextureFile picture.png\nelement vertex 0\nend_header\n"
NAMING = {
    "a.obj": "mtllib a.mtl\n",
    "a.mtl": "newmtl x\nmap_Kd picture.png\n",
    "a.ply": PLY,
    "a.gltf": '{"images": [{"uri": "a%20picture.png"}]}',
    "a.xml": "<scene><include filename='parts/b.xml'/><string value=\"cat &amp; dog.exr\"/></scene>",
    "parts/b.xml": '<scene><string value="picture.png"/></scene>',  # Mitsuba: beside the outermost file
}


@pytest.fixture
def folder(tmp_path) -> Path:
    (tmp_path / "parts").mkdir()
    for name, content in NAMING.items():
        (tmp_path / name).write_text(content)
    for name in ("picture.png", "a picture.png", "cat & dog.exr", "other.png"):
        (tmp_path / name).touch()
    return tmp_path


@pytest.mark.parametrize(
    ("source", "named"),
    [
        ("a.obj", ["a.mtl", "picture.png"]),
        ("a.ply", ["picture.png"]),
        ("a.gltf", ["a picture.png"]),
        ("a.xml", ["parts/b.xml", "cat & dog.exr", "picture.png"]),
    ],
)
def test_what_is_named_is_found_and_not_replaced(folder, source, named):
    assert sorted(files_behind(folder / source)) == sorted(folder / name for name in (source, *named))
    for name in (source, *named):
        with pytest.raises(UserError, match="is the input; choose another name"):
            check_output_file(folder / name, folder / source)
    check_output_file(folder / "other.png", folder / source)


@pytest.mark.parametrize("linked", [os.symlink, os.link])
def test_other_names_of_an_input_are_the_input(folder, linked):
    linked(folder / "picture.png", folder / "out.png")
    with pytest.raises(UserError, match="is the input"):
        check_output_file(folder / "out.png", folder / "a.ply")
    with pytest.raises(UserError, match="is an input, and a file of the report has this name"):
        check_output_files(folder, lambda name: name == "out.png", folder / "a.ply")
    check_output_files(folder, lambda name: name == "other.png", folder / "a.ply")


def test_values_of_parameters_may_name_files(folder):
    with pytest.raises(UserError, match="is the input"):
        check_output_file(folder / "other.png", folder / "a.ply", parameters={"image": "other.png", "count": 4})


COMMANDS = {
    "precompute": ["precompute", "a.xml", "-o", "out.prt"],
    "capture": ["capture", "a.xml", "-o", "out.exr"],
    "dimension": ["dimension", "a.xml", "-o", "out.png"],
    "relight": ["relight", "x.prt", "--environment", "sky.exr", "--scene", "a.xml", "-o", "out.png"],
    "export": ["export", "x.prt", "--scene", "a.xml", "-o", "out.glb"],
    "view": ["view", "x.prt", "--environment", "sky.exr", "--scene", "a.xml", "-o", "out.html"],
    "sweep": ["sweep", "a.xml", "--environment", "sky.exr", "-o", "out"],
    "compare": ["compare", "a.xml", "--environment", "sky.exr", "-o", "out"],
}


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_refuses_before_it_begins(folder, monkeypatch, capsys, command):
    monkeypatch.chdir(folder)
    output = {"sweep": "out/sweep.csv", "compare": "out/report.html"}.get(command, COMMANDS[command][-1])
    (folder / "out").mkdir()
    os.link(folder / "picture.png", folder / output)
    assert main(COMMANDS[command]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "input" in line
    assert (folder / output).stat().st_size == 0
