"""`precompute` of many scenes."""

import io
import json
import sys
from pathlib import Path

import pytest

from slepian_prt.cli import main
from slepian_prt.cli.precompute import precompute
from slepian_prt.compression.files.prt_file import load
from slepian_prt.datasets.jobs import FORMATS
from slepian_prt.datasets.records import NAME
from tests.datasets.scans import bent_ball, write_ball, write_obj

SMALL = ["--bandlimit", "2", "--samples", "16", "--clusters", "4"]


@pytest.fixture
def folder(tmp_path) -> Path:
    for seed, name in enumerate("ab"):
        write_ball(tmp_path / f"{name}.obj", seed, 1)
    (tmp_path / "list.txt").write_text("# two scans, one of them missing\n\na.obj\nnone.obj\n")
    return tmp_path


def run(*arguments) -> int:
    return main(["precompute", *(str(a) for a in arguments), *SMALL])


def test_scenes_into_a_folder(folder, capsys):
    assert run(folder / "a.obj", folder / "b.obj", "-o", folder / "out") == 0
    told = capsys.readouterr()
    assert told.err == ""
    first, second, last = told.out.splitlines()
    assert first.startswith("a.prt: 42 vertices, ")
    assert second.startswith("b.prt: 42 vertices, ")
    assert last.startswith(f"{folder / 'out'}: 2 done, 0 failed; ")
    assert run(folder / "a.obj", folder / "b.obj", "-o", folder / "out") == 0
    assert capsys.readouterr().out.startswith(f"{folder / 'out'}: 0 done, 2 there already, 0 failed; ")


def test_one_scene_into_a_folder(folder, capsys):
    """That is there, or that a / tells from a file."""
    assert run(folder / "a.obj", "-o", f"{folder}/out/") == 0
    assert run(folder / "b.obj", "-o", folder / "out") == 0
    assert load(folder / "out" / "b.prt").vertex_count == load(folder / "out" / "a.prt").vertex_count == 42


def test_a_list_and_what_fails_in_it(folder, capsys):
    assert run("--from", folder / "list.txt", folder / "b.obj", "-o", folder / "out") == 1
    told = capsys.readouterr()
    assert [line.split(":")[0] for line in told.out.splitlines()] == ["b.prt", "a.prt", str(folder / "out")]
    assert told.err.splitlines() == [
        f"slepian-prt: {folder}/none.obj: no such file; check the path",
        f"slepian-prt: 1 of 3 scenes failed; {folder}/out/{NAME} says why",
    ]


def test_a_list_on_the_standard_input(folder, monkeypatch):
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(f"{folder}/a.obj\n".encode())))
    assert run("--from", "-", "-o", folder / "out") == 0
    assert (folder / "out" / "a.prt").is_file()


def test_json_is_what_the_records_have(folder, capsys):
    """A line for each scene on the standard output, and nothing else there; also of those that are there already."""
    assert run("--from", folder / "list.txt", "-o", folder / "out", "--json") == 1
    lines = capsys.readouterr().out.splitlines()
    assert lines == (folder / "out" / NAME).read_text().splitlines()
    assert [json.loads(line).get("failure") is None for line in lines] == [True, False]
    assert run(folder / "a.obj", "-o", folder / "out", "--json") == 0
    (again,) = map(json.loads, capsys.readouterr().out.splitlines())
    assert again == {**json.loads(lines[0]), "kept": True}


def test_notes_come_with_their_scene(folder, capsys):
    """Once, on standard error; with --json in the line."""
    ball = bent_ball(0, 1)
    path = write_obj(folder / "flat.obj", ball.vertices, [*(ball.faces + 1).tolist(), [1, 1, 2]])
    assert run(path, "-o", f"{folder}/out/") == 0
    assert capsys.readouterr().err == f"note: {path}: 1 faces of zero area left out\n"
    assert run(path, "-o", f"{folder}/json/", "--json") == 0
    told = capsys.readouterr()
    assert told.err == ""
    assert json.loads(told.out)["notes"] == ["1 faces of zero area left out"]


def test_training_formats(folder, capsys):
    assert run(folder / "a.obj", folder / "b.obj", "--format", "pifu", "--format", "icon", "-o", folder / "out") == 0
    assert capsys.readouterr().out.startswith("a/bounce/bounce0.txt: 42 vertices, ")
    written = {str(path.relative_to(folder / "out")) for path in (folder / "out").rglob("*") if path.is_file()}
    parts = ("bounce/bounce0.txt", "bounce/face.npy", "prt/bounce.npy", "prt/face.npy")
    assert written == {NAME, *(f"{name}/{part}" for name in "ab" for part in parts)}


def test_a_format_that_needs_another_file(folder, capsys):
    """In the words of the command line."""
    bent_ball(0, 1).export(folder / "ball.ply")
    assert run(folder / "ball.ply", "--format", "icon", "-o", folder / "out") == 1
    told = capsys.readouterr().err.splitlines()[0]
    assert told == (
        f"slepian-prt: {folder}/ball.ply: PIFu and ICON read OBJ files only; convert it, or choose --format prt"
    )


@pytest.mark.slow
def test_a_goal_for_each_scene(folder, capsys):
    """The error that was verified is told."""
    write_ball(folder / "c.obj", 3, 3)
    arguments = [folder / "c.obj", "-o", f"{folder}/out/", "--max-error", "0.3", "--light-prior", "1/(l+1)"]
    assert main(["precompute", *map(str, arguments), "--json"]) == 0
    line = json.loads(capsys.readouterr().out)
    assert line["error"] == pytest.approx(max(load(folder / "out" / "c.prt").verified.values()), rel=1e-3)


def test_an_interrupt_says_how_to_go_on(folder, capsys, monkeypatch):
    def interrupt(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("slepian_prt.datasets.scan.compress_scene", interrupt)
    assert run(folder / "a.obj", folder / "b.obj", "-o", folder / "out") == 130
    told = capsys.readouterr().err
    assert told == f"slepian-prt: interrupted; the same command goes on from what is in {folder / 'out'}\n"


def test_all_formats_can_be_asked_for():
    (option,) = (option for option in precompute.params if option.name == "formats")
    assert tuple(option.type.choices) == FORMATS
