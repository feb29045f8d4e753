"""`results.jsonl` as the record of what is there."""

import json
import subprocess
import sys

import pytest

from slepian_prt.datasets.jobs import ScanResult
from slepian_prt.datasets.records import NAME, open_records
from slepian_prt.errors import UserError

DONE = ScanResult("a.obj", "a", ("a.prt",), seconds={"all": 1.5}, error=0.02, bytes=9, vertices=3, rays=4)
FAILED = ScanResult("b.obj", "b", failure="b.obj: no such file; check the path")


def test_results_come_back_as_they_were():
    kept = ScanResult("ä.obj", "ä", ("ä.prt",), notes=("one\ntwo",), kept=True, fingerprint="f", digests={"ä.prt": "d"})
    for result in (DONE, FAILED, kept):
        assert "\n" not in result.as_line()
        assert ScanResult.from_line(result.as_line()) == result


def test_lines_have_what_is_promised():
    done, failed = (json.loads(result.as_line()) for result in (DONE, FAILED))
    assert {"source", "outputs", "seconds", "error", "bytes", "vertices", "notes"} <= set(done)
    assert "failure" not in done
    assert failed["failure"] == FAILED.failure
    assert "error" not in failed


@pytest.mark.parametrize("line", ["", '{"source": "a.o', "[1]", "3", '{"name": "a"}', "null"])
def test_lines_that_are_none(line):
    assert ScanResult.from_line(line) is None


def test_lines_of_later_versions():
    line = json.dumps({**json.loads(DONE.as_line()), "more": [1]})
    assert ScanResult.from_line(line) == DONE


def test_a_line_that_was_not_finished_costs_itself_alone(tmp_path):
    with open_records(tmp_path / "out") as records:
        records.add(DONE)
        records.add(FAILED)
    path = tmp_path / "out" / NAME
    path.write_bytes(path.read_bytes()[:-10])
    with open_records(tmp_path / "out") as records:
        assert records["a"] == DONE
        assert records["b"] is None
        records.add(FAILED)
    with open_records(tmp_path / "out") as records:
        assert records["a"] == DONE
        assert records["b"] == FAILED


def test_the_last_line_of_a_name_counts_and_stays(tmp_path):
    again = ScanResult("c/b.obj", "b", ("b.prt",))
    with open_records(tmp_path) as records:
        for result in (FAILED, DONE, again):
            records.add(result)
        records.tidy(["a", "b", "none"])
    lines = (tmp_path / NAME).read_text().splitlines()
    assert [ScanResult.from_line(line) for line in lines] == [DONE, again]
    with open_records(tmp_path) as records:
        records.add(FAILED)
        records.tidy(["b"])  # the rest is of other work
    assert [json.loads(line)["name"] for line in (tmp_path / NAME).read_text().splitlines()] == ["a", "b"]


@pytest.mark.skipif(sys.platform == "win32", reason="no locks")
def test_one_process_at_a_time(tmp_path):
    """In a process of its own: a lock holds against others."""
    code = (
        "from slepian_prt.datasets.records import open_records; from pathlib import Path\n"
        f"try:\n    open_records(Path({str(tmp_path)!r})).__enter__(); print('free')\n"
        "except Exception as error:\n    print(error)"
    )
    command = [sys.executable, "-c", code]
    with open_records(tmp_path):
        told = subprocess.run(command, capture_output=True, text=True).stdout
    assert "another process writes to it" in told
    assert subprocess.run(command, capture_output=True, text=True).stdout == "free\n"


def test_a_folder_that_cannot_be_made(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(UserError, match="cannot be written to"), open_records(tmp_path / "file" / "out"):
        pass
