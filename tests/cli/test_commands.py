"""The table of commands, what they import, and their options beside the library's."""

import ast
import dataclasses
import inspect
import re
import subprocess
import sys
from pathlib import Path

import click
import pytest

import slepian_prt
from slepian_prt.cli import cli, main
from slepian_prt.cli.commands import COMMANDS, with_flags
from slepian_prt.cli.options import check_noise, check_width
from slepian_prt.compression.settings import DEFAULT_TOLERANCE, CompressionSettings
from slepian_prt.errors import UserError
from slepian_prt.evaluation.compare import compare
from slepian_prt.transport.transfer import TransportSettings

PACKAGE = Path(slepian_prt.__file__).parent


def command(name: str) -> click.Command:
    found = cli.get_command(click.Context(cli), name)
    assert found is not None
    return found


def options(name: str) -> dict[str, click.Option]:
    return {option.name: option for option in command(name).params if isinstance(option, click.Option)}


def imported_by(*arguments: str) -> set[str]:
    code = f"import sys; from slepian_prt.cli import main; main({list(arguments)}); print(*sys.modules)"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(run.stdout.splitlines()[-1].split())


def test_help_imports_nothing_heavy():
    assert not imported_by("--help") & {"numpy", "rich", "mitsuba", "trimesh", "slepian_prt.transport.transfer"}


def test_a_command_does_not_import_the_others():
    modules = imported_by("info", "no-such-file.prt", "--help")
    assert {name for name in COMMANDS if f"slepian_prt.cli.{name}" in modules} == {"info"}
    assert "numpy" not in modules


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_help(name):
    text = command(name).get_help(click.Context(command(name), info_name=name))
    assert "Usage:" in text
    assert command(name).help


def test_the_list_of_commands_is_not_cut():
    text = cli.get_help(click.Context(cli, info_name="slepian-prt"))
    assert "path-traced references, as a report and as JSON." in " ".join(text.split())


@pytest.mark.parametrize("kind", [TransportSettings, CompressionSettings])
def test_defaults_are_those_of_the_library(kind):
    given = options("precompute")
    for field in dataclasses.fields(kind):
        default = given[field.name].default
        if isinstance(default, str | int | float):
            assert default == field.default, field.name
        else:  # click's words for none
            assert field.default is None, field.name
    assert f"[default: {DEFAULT_TOLERANCE}]" in given["tolerance"].help


def test_the_noise_of_compare_is_that_of_the_library():
    assert options("compare")["noise"].default == inspect.signature(compare).parameters["noise"].default


def test_choices_are_those_of_the_library():
    assert options("precompute")["basis"].type.choices[-3:] == ("pca", "cpca", "none")
    assert options("relight")["window"].type.choices == ("hann", "lanczos")


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("name a map with `environment`", "name a map with --environment"),
        ("not asked for (`effects=direct`)", "not asked for (--effects direct)"),
        ("ask for `max_error=0.05` or more", "ask for --max-error 0.05 or more"),
        ("give `parameters={'spp': …}`", "give -D spp=…"),
        ("give `parameters={'colour': '0.1, 0.2, 0.3'}`", "give -D colour='0.1, 0.2, 0.3'"),
        ("occlusion_classes must be an integer", "--occlusion-classes must be an integer"),
        ("ball.ply: albedo must be less", "ball.ply: albedo must be less"),
        ("half_angles must be less", "half_angles must be less"),
        ("`fish`.ply: no such file", "`fish`.ply: no such file"),
        ("samples and noise", "samples and noise"),
    ],
)
def test_parameters_become_flags(text, shown):
    assert with_flags(text) == shown


def sentences(path: Path) -> list[str]:
    """The strings of a file, docstrings left out; what is put into f-strings is a ``?``."""
    tree = ast.parse(path.read_text())
    parts = {id(part) for node in ast.walk(tree) if isinstance(node, ast.JoinedStr) for part in ast.walk(node)}
    docstrings = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            found.append("".join(part.value if isinstance(part, ast.Constant) else "?" for part in node.values))
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in parts | docstrings:
            found.append(node.value)
    return found


def test_the_library_names_parameters_and_the_command_line_knows_them():
    for path in PACKAGE.rglob("*.py"):
        for text in sentences(path):
            if PACKAGE / "cli" not in path.parents:
                assert not re.search(r"--[a-z]", text), f"{path}: {text}"
            for quoted in re.findall(r"`\w+(?:=[^`]*)?`", text):
                assert with_flags(quoted).startswith("--"), f"{path}: {text}"


@pytest.mark.parametrize("width", [None, 16, 8192])
def test_sensible_widths(width):
    assert check_width(None, None, width) == width


def test_widths_that_make_no_sense():
    with pytest.raises(UserError, match="must be"):
        check_width(None, None, 15)


@pytest.mark.parametrize("noise", [0.0, 1.0, 2.0, -1.0, float("nan"), float("inf")])
def test_noise_that_makes_no_sense(noise):
    with pytest.raises(UserError, match=r"^noise must be a number in \(0, 1\), not"):
        check_noise(None, None, noise)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("SLEPIAN_PRT_THREADS", "must be a whole number from 1 to 1024, not 'x'"),
        ("SLEPIAN_PRT_MAX_MEMORY", "must be a size of 1M at least, as 2G or 500M, not 'x'"),
    ],
)
def test_variables_are_looked_at_also_where_nothing_asks_for_them(monkeypatch, capsys, name, said):
    monkeypatch.setenv(name, "x")
    assert main(["relight", "a.prt", "-o", "a.npz"]) == 2
    assert capsys.readouterr().err == f"slepian-prt: {name} {said}\n"
    assert main(["relight", "--help"]) == 0
