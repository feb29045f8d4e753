"""The documentation is true: every example runs, every link leads somewhere, the site builds without a warning."""

from __future__ import annotations

import contextlib
import io
import logging
import re
import shlex
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

import slepian_prt as sp
from slepian_prt.compression.bases import BASES

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md", *sorted(DOCS.rglob("*.md"))]

_FENCE = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
# Numbers, and units and signs that come and go with their size.
_NUMBER = re.compile(r"[-+]?\d[\d.,]*(e[-+]?\d+)?( [kMG](?=rays))?")


def blocks(page: Path) -> list[tuple[str, str, int]]:
    """(language, text, line) of each fenced block of a page."""
    text = page.read_text()
    return [(m[1], m[2], text.count("\n", 0, m.start()) + 1) for m in _FENCE.finditer(text)]


# A picture to be captured.
STILL = """<scene version="3.0.0">
  <sensor type="perspective" id="front">
    <transform name="to_world"><lookat origin="0, 1, 5" target="0, 0.5, 0" up="0, 1, 0"/></transform>
    <float name="fov" value="30"/>
    <film type="hdrfilm"><integer name="width" value="48"/><integer name="height" value="36"/></film>
  </sensor>
  <shape type="sphere" id="ball"><point name="center" x="0" y="0.6" z="0"/><float name="radius" value="0.6"/>
    <bsdf type="dielectric"/></shape>
  <shape type="rectangle" id="floor"><transform name="to_world"><rotate x="1" angle="-90"/></transform></shape>
</scene>"""

EXAMPLES = [page for page in PAGES if any(kind in ("python", "console") for kind, _, _ in blocks(page))]


# --- Examples --------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="session")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Small stand-ins for the files that examples name as the reader's own."""
    folder = tmp_path_factory.mktemp("stand-ins")
    ball = trimesh.creation.icosphere(3)
    ball.vertices *= 1.0 + 0.3 * np.prod(np.sin(4.0 * ball.vertices), axis=1, keepdims=True)
    ball.export(folder / "skull.ply")
    (folder / "scenes").symlink_to(ROOT / "scenes")
    (folder / "studio.exr").symlink_to(ROOT / "scenes" / "sky.exr")
    (folder / "sunrise.exr").symlink_to(ROOT / "scenes" / "sky.exr")
    (folder / "still.xml").write_text(STILL)
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("page", EXAMPLES, ids=lambda page: str(page.relative_to(ROOT)))
def test_examples_run(page, files, tmp_path, monkeypatch):
    """Blocks of a page run in order in one folder and one namespace; outputs that are shown have the form shown."""
    for file in files.iterdir():
        (tmp_path / file.name).symlink_to(file)
    monkeypatch.chdir(tmp_path)
    if "matplotlib.pyplot" in sys.modules:
        sys.modules["matplotlib.pyplot"].close("all")  # the current axes are those of no other page
    names: dict[str, Any] = {"__name__": "__main__"}
    for language, text, line in blocks(page):
        if language == "python":
            exec(compile("\n" * line + text, str(page), "exec"), names)
        elif language == "console":
            for command, shown in commands(text):
                check_output(run(command, monkeypatch), shown, f"{page.name}:{line}: {command}")


def commands(text: str) -> list[tuple[str, list[str]]]:
    """(command, lines of output shown) of a console block; a backslash continues a command."""
    found: list[tuple[str, list[str]]] = []
    for line in text.replace("\\\n", " ").splitlines():
        if line.startswith("$ "):
            found.append((line[2:].split("  #")[0].strip(), []))
        else:
            found[-1][1].append(line)
    return found


def run(command: str, monkeypatch: pytest.MonkeyPatch) -> str:
    """What the command prints. It runs in this process, which has Mitsuba at hand; pictures are taken small."""
    from slepian_prt.cli import main

    program, *arguments = shlex.split(command)
    assert program == "slepian-prt", f"examples call slepian-prt, not {program}"
    captured = arguments[1:2] == ["still.prt"]  # whose pictures have the size that they have
    if arguments[0] in ("relight", "compare") and "--width" not in arguments and not captured:
        arguments += ["--width", "100"]
    monkeypatch.setattr(sys, "argv", ["slepian-prt", *arguments])
    log = logging.getLogger("slepian_prt")
    handlers, level = list(log.handlers), log.level
    output = io.StringIO()
    try:
        with contextlib.redirect_stdout(output), contextlib.redirect_stderr(output):
            status = main()
    finally:
        log.handlers, log.level = handlers, level
    assert status == 0, f"{command}\n{output.getvalue()}"
    return output.getvalue()


def check_output(printed: str, shown: list[str], where: str) -> None:
    """Each line shown was printed, in this order, numbers aside; a line that ends in … was printed up to there."""
    lines = iter([_plain(line) for line in printed.splitlines()])
    for expected in map(_plain, shown):
        if expected and expected != "…":
            assert any(_fits(line, expected) for line in lines), (
                f"{where}\nshows {expected!r}, which is not in\n{printed}"
            )


def _plain(line: str) -> str:
    return " ".join(_NUMBER.sub("0", line).split())


def _fits(line: str, expected: str) -> bool:
    return line.startswith(expected[:-1].rstrip()) if expected.endswith("…") else line == expected


def test_setup_commands_exist():
    """Blocks of shell that are not run name scripts that are there."""
    for page in PAGES:
        for language, text, line in blocks(page):
            known = ("python", "console", "sh", "text", "json", "xml", "glsl", "yaml")
            assert language in known, f"{page}:{line}: {language}"
            for script in re.findall(r"scripts/(\w+)", text):
                assert (ROOT / "scripts" / script).is_file(), f"{page}:{line}: scripts/{script}"


def test_links_lead_somewhere():
    for page in PAGES:
        for target in re.findall(r"\]\(([^)#\s]+)", page.read_text()):
            if not target.startswith(("http://", "https://")):
                assert (page.parent / target).exists(), f"{page.relative_to(ROOT)} links to {target}"


# --- The site, the public names, the wheel ---------------------------------------------------------------------------


@pytest.mark.slow
def test_site_builds_without_warnings(tmp_path):
    options = ["--fail-on-warning", "--keep-going", "--nitpicky", "--quiet"]
    command = [sys.executable, "-m", "sphinx", *options, "-b", "html", str(DOCS), str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "slepian_prt.precompute" in (tmp_path / "api.html").read_text()


def test_public_names_are_listed():
    """In the docstring of the package, in groups, and in the API page."""
    listed = set()
    for line in sp.__doc__.splitlines():
        if found := re.match(r"    (\w+(, \w+)?)  +[A-Z]", line):
            listed |= set(found[1].split(", "))
    documented = set(re.findall(r"^\.\. auto\w+:: (\w+)$", (DOCS / "api.md").read_text(), re.MULTILINE))
    assert listed == set(sp.__all__)
    assert documented == set(sp.__all__)
    assert all(not name.startswith("_") for name in dir(sp))


def test_the_tree_in_contributing_is_complete():
    """Every module is named in the row of its folder."""
    rows = dict(re.findall(r"^\| `?([\w/]*)`? \| (.*) \|$", (DOCS / "contributing.md").read_text(), re.MULTILINE))
    for path in (ROOT / "slepian_prt").rglob("*.py"):
        folder = path.parent.relative_to(ROOT / "slepian_prt").as_posix()
        row = rows["slepian_prt/" if folder == "." else f"{folder}/"]
        if not path.stem.startswith("__"):
            assert f"`{path.stem}`" in row, f"{path.relative_to(ROOT)} is not in the table of docs/contributing.md"


def test_every_basis_is_explained():
    table = (DOCS / "guide" / "precompute.md").read_text()
    for name in BASES:
        assert f"`{name}`" in table, f"basis {name} is not in docs/guide/precompute.md"


def test_examples_are_shipped():
    assert sp.example() == sp.example("knot")
    for name in ("knot", "sky", "cornell", "glossy", "room"):
        assert sp.example(name).samefile(ROOT / "scenes" / sp.example(name).name)
    with pytest.raises(sp.UserError, match="no example is named 'skull'; choose one of knot, sky, cornell, glossy"):
        sp.example("skull")


@pytest.mark.slow
def test_wheel_holds_everything(tmp_path):
    """What the package reads beside its code is in the wheel, examples among it."""
    source = tmp_path / "source"
    source.mkdir()
    for name in ("slepian_prt", "scenes", "pyproject.toml", "README.md", "LICENSE"):
        subprocess.run(["cp", "-a", str(ROOT / name), str(source)], check=True)
    options = ["--quiet", "--no-deps", "--no-build-isolation", "--disable-pip-version-check", "--no-index"]
    command = [sys.executable, "-m", "pip", "wheel", *options, "-w", str(tmp_path), str(source)]
    subprocess.run(command, check=True, capture_output=True)
    (wheel,) = tmp_path.glob("*.whl")
    held = set(zipfile.ZipFile(wheel).namelist())
    package = ROOT / "slepian_prt"
    for path in package.rglob("*"):
        if path.is_file() and "__pycache__" not in path.parts:
            assert str(path.relative_to(ROOT)) in held, path
    for example in (ROOT / "scenes").iterdir():
        assert f"slepian_prt/scenes/{example.name}" in held
