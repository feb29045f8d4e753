"""`info` of a coarse mesh: notes of the mesh, and what is lost between its vertices."""

import json
import math
import re
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import patch

import numpy as np
import pytest
import trimesh

import slepian_prt as sp
from slepian_prt.cli import main
from slepian_prt.cli.caps import print_caps
from slepian_prt.compression.files.container import Contents, write
from slepian_prt.compression.files.prt_file import load
from slepian_prt.evaluation.dimension.caps import CapDimension, cap_dimensions, describe_count
from tests.terminal import run_in_terminal


@pytest.fixture(scope="module")
def coarse(tmp_path_factory) -> Path:
    """The transfer file of a cube on two triangles, with faces that are left out and corners that are not used."""
    folder = tmp_path_factory.mktemp("coarse")
    floor = trimesh.Trimesh([[-3, 0, -3], [3, 0, -3], [3, 0, 3], [-3, 0, 3]], [[0, 2, 1], [0, 3, 2]], process=False)
    box = trimesh.creation.box((1, 1, 1), trimesh.transformations.translation_matrix([0, 0.5, 0]))
    mesh = trimesh.util.concatenate([floor, box])
    faces = np.concatenate([mesh.faces, [[0, 0, 1]], mesh.faces[3:4], mesh.faces[5:6]])
    lines = [f"v {x} {y} {z}" for x, y, z in mesh.vertices] + [f"f {a} {b} {c}" for a, b, c in faces + 1]
    (folder / "coarse.obj").write_text("\n".join(lines))
    options = ["--samples", "16", "--bandlimit", "2"]
    assert main(["precompute", str(folder / "coarse.obj"), "-o", str(folder / "coarse.prt"), *options]) == 0
    return folder / "coarse.prt"


def test_notes_and_the_row_about_light_between_vertices(coarse, capsys):
    assert main(["info", str(coarse), "--json"]) == 0
    content = json.loads(capsys.readouterr().out)
    assert content["notes"][0] == "1 faces of zero area left out"
    assert len(content["notes"]) == 2
    row = next(effect for effect in content["effects"] if effect["name"] == "light between vertices")
    assert row["verdict"] == "not simulated"
    assert 0.05 < row["contribution"] < 1.0
    assert "subdivide" in row["reason"]
    assert main(["info", str(coarse)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert next(line for line in lines if line.startswith("notes ")).endswith("; ".join(content["notes"]))
    row = next(line for line in lines if line.startswith("light between vertices"))
    assert "not simulated" in row
    assert row.rstrip().endswith("subdivide the faces to see more of it")


def test_what_was_left_out_of_a_verification(coarse, tmp_path, capsys):
    """Stored, and shown as a count and a share; files of before have none."""
    left_out = {"studio": {"inside": 104, "black": 0}, "sky": {"inside": 104, "black": 335}}
    checked = {"verified": {"studio": 0.027, "sky": 0.01}, "verified_left_out": left_out}
    replace(load(coarse), verified_vertices=3072, **checked).save(tmp_path / "verified.prt")
    assert main(["info", str(tmp_path / "verified.prt"), "--json"]) == 0
    content = json.loads(capsys.readouterr().out)
    assert content["verified_error"] == checked["verified"]
    assert (content["verified_vertices"], content["verified_left_out"]) == (3072, left_out)
    assert main(["info", str(tmp_path / "verified.prt")]) == 0
    lines = {line.split()[0]: line.split(maxsplit=1)[1] for line in capsys.readouterr().out.splitlines()[:25]}
    assert lines["verified_vertices"] == "3072"
    assert lines["verified_left_out"] == (
        "studio 104 inside (3.39%), studio 0 black (0%), sky 104 inside (3.39%), sky 335 black (10.9%)"
    )
    assert main(["info", str(coarse)]) == 0
    shown = capsys.readouterr().out
    assert "verified_left_out" not in shown
    assert "None" not in shown


@pytest.mark.slow
def test_it_fits_a_terminal(coarse):
    """80 columns: no line is longer, but for a path without a place to break it, and no word is broken or lost."""
    shown = run_in_terminal([sys.executable, "-m", "slepian_prt", "info", str(coarse)], columns=80)
    plain = re.sub(r"\x1b\[[0-9;]*m", "", shown).replace("\r", "")
    assert max(len(line) for line in plain.splitlines() if "coarse.obj" not in line) <= 80
    words = plain.split()
    for word in ("interpolated", "subdivide", "orientation;", "consistent", "rays"):
        assert word in words


def test_the_dimension_of_the_whole_and_of_each_cap(coarse, capsys):
    """Plain, by the paper; with --caps as measured, a line for each cap and one for all; as JSON both."""
    assert main(["info", str(coarse), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)["paper_dimension"]
    assert (told["functions"], told["epsilon"]) == (9, 0.01)
    assert told["count"] == sp.concentration_count(2, math.radians(told["half_angle_degrees"]), 0.01)
    assert main(["info", str(coarse)]) == 0
    line = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("paper_dimension "))
    counted = describe_count(told["count"], math.radians(told["half_angle_degrees"]))
    assert line.split(maxsplit=1)[1] == f"{counted}, of 9 functions; --caps measures the transport"
    expected = cap_dimensions(load(coarse), 0.1)
    assert main(["info", str(coarse), "--caps", "--error", "0.1", "--json"]) == 0
    content = json.loads(capsys.readouterr().out)
    assert content["error"] == 0.1
    assert [effect["name"] for effect in content["effects"]] == [effect.name for effect in load(coarse).effects]
    assert [(row["cap"], row["vertices"], row["by_the_paper"]) for row in content["caps"]] == [
        (row.cap, row.vertices, row.expected) for row in expected
    ]
    assert [row["dimension"] for row in content["caps"]] == pytest.approx([row.dimension for row in expected], rel=1e-9)
    assert [row["half_angle_degrees"] for row in content["caps"]] == pytest.approx(
        [math.degrees(row.half_angle) for row in expected], rel=1e-12
    )
    assert main(["info", str(coarse), "--caps", "--error", "0.1"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].split() == ["cap", "vertices", "half-angle", "by", "the", "paper", "dimension", "coherence"]
    assert len(lines) == len(expected) + 2
    assert lines[1].split()[-2:] == [f"{expected[0].dimension:.1f}", f"{expected[0].coherence:.2f}"]
    middle = math.ceil(np.median([row.dimension for row in expected]))
    assert lines[-1].startswith(f"a cap has effective dimension {middle} of 9, coherence {1 - middle / 9:.2f} (the med")
    assert lines[-1].endswith(f"; the paper counts {counted}")


def test_older_files_point_to_their_caps(coarse, tmp_path, capsys):
    """They do not say how wide caps are, and nothing else in them tells without decoding."""
    contents = Contents(coarse)
    manifest = {name: value for name, value in contents.manifest.items() if name != "half_angle"}
    write(tmp_path / "old.prt", manifest, contents.arrays())
    assert main(["info", str(tmp_path / "old.prt")]) == 0
    line = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("paper_dimension "))
    assert line.split(maxsplit=1)[1] == "not in this older file; --caps tells it"
    assert main(["info", str(tmp_path / "old.prt"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["paper_dimension"] is None


def test_caps_of_pixels_are_not_held_against_the_paper(capsys):
    """Theirs are directions of light: there is no count for normals, in no form."""
    packed = SimpleNamespace(bandlimit=4, predicted_error=0.0, path_noise=None, film_outline=None)
    rows = (CapDimension(3, 40, 0.2, None, 2.6, 25), CapDimension(1, 20, 0.1, None, 1.5, 25))
    with patch("slepian_prt.evaluation.dimension.caps.cap_dimensions", return_value=rows):
        print_caps(packed, 0.05, None)
        lines = capsys.readouterr().out.splitlines()
        print_caps(packed, 0.05, {"film": "8 x 8 of front"})
    assert lines[1].split() == ["3", "40", "11.5", "none", "2.6", "0.90"]
    assert lines[-1] == "a cap has effective dimension 3 of 25, coherence 0.88 (the median of 2; error 5 %)"
    content = json.loads(capsys.readouterr().out)
    assert [row["by_the_paper"] for row in content["caps"]] == [None, None]
    assert content["film"] == "8 x 8 of front"


def test_an_error_that_the_file_has_itself_is_remarked_on(coarse, capsys):
    """Also beside JSON, which it is not in."""
    least = load(coarse).predicted_error
    for error, remarks in ((1.9 * least, 1), (2.1 * least, 0)):
        assert main(["info", str(coarse), "--caps", "--error", str(error), "--json"]) == 0
        printed = capsys.readouterr()
        assert json.loads(printed.out)["error"] == error
        assert printed.err.count("\n") == remarks
        assert printed.err.startswith(remarks * "note: transfer vectors have an error of ")


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--error", "0.1"], "--error is about the dimension in caps; give --caps too"),
        (["--caps", "--error", "1"], "--error must be a number in [1e-05, 1), not 1.0"),
    ],
)
def test_errors_that_make_no_sense(coarse, capsys, options, said):
    assert main(["info", str(coarse), *options]) == 2
    assert capsys.readouterr().err == f"slepian-prt: {said}\n"


def test_texts_of_a_file_give_no_commands_to_terminals(coarse, capsys):
    """Whoever made it chose them: what is the model called, how long took what, what is noted."""
    hostile, escaped = "\x1b]0;title\x07\u202e", r"\x1b]0;title\x07\u202e"
    packed = load(coarse)
    effect = replace(packed.effects[0], name=hostile, reason=hostile)
    texts = {
        "source": hostile, "notes": (hostile,), "seconds": {hostile: 1.0}, "basis": hostile, "prior": hostile,
        "lamp_names": (hostile,), "parameters": {hostile: hostile}, "verified": {hostile: 0.1}, "effects": (effect,),
    }  # fmt: skip
    shown = SimpleNamespace(
        **{name: getattr(packed, name) for name in dir(packed) if not name.startswith("__")},
    )
    for name, text in texts.items():
        setattr(shown, name, text)
    with patch("slepian_prt.cli.info.read_transfer", lambda *_, **__: shown):
        for arguments in (["info", "x.prt"], ["info", "x.prt", "--json"]):
            assert main(arguments) == 0
            printed = capsys.readouterr().out
            assert printed.replace("\n", "").isprintable()
            assert arguments[-1] == "--json" or printed.count(escaped) >= len(texts) + 1
