"""Commands that are killed at random moments come to the same result when they are begun again."""

from __future__ import annotations

import random

import pytest

from scripts.kill_runs import is_whole, kill_runs


@pytest.mark.slow
def test_precompute_that_is_killed_comes_to_the_same_bytes():
    _, counted = kill_runs("precompute", 1, random.Random(5), subdivisions=3)
    assert {fault: counted[fault] for fault in ("torn", "differs", "left", "failed")} == {
        "torn": 0, "differs": 0, "left": 0, "failed": 0,
    }  # fmt: skip


@pytest.mark.parametrize(
    ("name", "whole"),
    [
        ("a.png", b"\x89PNG...IEND\xaeB`\x82"),
        ("a.html", b"<html></html>\n"),
        ("a.json", b'{"a": 1}\n'),
        ("a.csv", b"a,b\n1,2\n"),
    ],
)
def test_half_a_file_is_seen(tmp_path, name, whole):
    (tmp_path / name).write_bytes(whole)
    assert is_whole(tmp_path / name)
    (tmp_path / name).write_bytes(whole[:-3])
    assert not is_whole(tmp_path / name)
