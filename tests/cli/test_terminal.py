"""What a terminal shows: in a pseudo terminal of a given width."""

import logging
import re
import subprocess
import sys

import pytest

from slepian_prt.cli import _remarks, main
from slepian_prt.cli.messages import note, say
from slepian_prt.cli.terminal import print_plan, print_table
from slepian_prt.scene.left_out import GATHERED, LeftOut
from slepian_prt.transport.effects import Effect
from tests.terminal import run_in_terminal

CHOICES = """
from slepian_prt.cli.messages import note, say
from slepian_prt.cli.terminal import print_plan, print_table
from slepian_prt.scene.left_out import GATHERED, LeftOut
from slepian_prt.transport.effects import Effect
headings = ["", "rays", "error of transport", "predicted error", "bytes/vertex, at most", "transport", "compression"]
row = ["→", "64", "26.82%", "37.72% ± 0.37%", "0.095", "0.8 s", "1.2 s"]
print_table(dict.fromkeys(headings, "right"), [row], spare=("compression", "transport", "error of transport"))
say("a sentence that is longer than some terminals are wide: " + "x" * 12 + ", of words that are not broken")
note("it is `effects=direct` that was asked for")
"""


def shown(columns: int, code: str = CHOICES) -> list[str]:
    """Lines on a terminal so wide."""
    text = run_in_terminal([sys.executable, "-c", code], columns)
    return re.sub(r"\x1b\[[0-9;]*m", "", text).splitlines()


@pytest.mark.parametrize("columns", [52, 64, 80, 120])
def test_tables_and_sentences_fit(columns):
    lines = shown(columns)
    text = "\n".join(lines)
    assert max(map(len, lines)) <= columns
    assert "…" not in text
    assert "37.72% ± 0.37%" in text
    assert "xxxxxxxxxxxx, of" in re.sub(r"\n +", " ", text)
    assert lines[-1] == "note: it is --effects direct that was asked for"


def test_a_narrow_terminal_shows_what_matters():
    assert "compression" in "".join(shown(120))
    narrow = "".join(shown(52))
    assert "compression" not in narrow
    assert "bytes/vertex" in narrow


def test_a_pipe_gets_one_line_a_row():
    run = subprocess.run([sys.executable, "-c", CHOICES], capture_output=True, text=True, check=True)
    assert len(run.stdout.splitlines()) == 3
    assert run.stdout.splitlines()[0].split("  ")[-1] == "compression"


def test_long_cells_stay_on_one_line_in_a_pipe(capsys):
    reason = "left out: " + "a material that is not known, " * 12
    print_table({"effect": "left", "reason": "left"}, [["materials", reason.strip()]])
    assert len(capsys.readouterr().out.splitlines()) == 2


def test_the_plan_says_what_is_gathered(capsys):
    rows = (LeftOut("mirror reflection of material 'Chrome'", 0.25, "why", GATHERED), LeftOut("media"))
    print_plan([Effect(row.name, row.verdict, row.share, None, 0, row.reason) for row in rows])
    mirror, media = capsys.readouterr().out.splitlines()[1:]
    assert re.split(r"  +", mirror.strip()) == [rows[0].name, "gathered", "0.250", "none", "why"]
    assert re.split(r"  +", media.strip())[1:3] == ["not simulated", "unknown"]


HOSTILE = "\x1b]0;title\x07\x1b[2Ja\r\nb\u202ec\udcff"
ESCAPED = r"\x1b]0;title\x07\x1b[2Ja\r\nb\u202ec\udcff"


def test_names_give_no_commands_to_terminals(capsys, monkeypatch, tmp_path):
    """In results, remarks, tables and errors; those of the library too, which name materials and files."""
    monkeypatch.setattr(logging.getLogger("slepian_prt"), "propagate", False)  # reports of tests are UTF-8
    say(f"{HOSTILE}: done")
    note(f"texture {HOSTILE}")
    print_table({"material": "left"}, [[HOSTILE]])
    with _remarks():
        logging.getLogger("slepian_prt.scene").info("texture %s counts as white", HOSTILE)
    name = HOSTILE.replace("/", "")
    assert main(["info", f"{tmp_path}/{name}.prt"]) == main([name]) == main(["info", f"--{name}"]) == 2
    printed = capsys.readouterr()
    for text, count in ((printed.out, 2), (printed.err, 5)):
        assert text.count(ESCAPED) == count
        assert text.replace("\n", "").isprintable()
    assert len(printed.err.splitlines()) == 5
