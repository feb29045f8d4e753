"""Lists of scenes, and names of outputs."""

import io
import sys
from pathlib import Path

import pytest

from slepian_prt.datasets.naming import name_scans, read_list
from slepian_prt.errors import UserError


def test_a_list_is_relative_to_its_file(tmp_path):
    listed = tmp_path / "lists" / "all.txt"
    listed.parent.mkdir()
    listed.write_bytes("\ufeff# scans\r\n\r\n  ../a b.obj \r\n/data/c.ply\r\n# d.obj\r\n".encode())
    assert read_list(listed) == [str(tmp_path / "lists" / ".." / "a b.obj"), "/data/c.ply"]


def test_a_list_on_the_standard_input(monkeypatch):
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(b"a.obj\n\n#b.obj\nsub/c.obj")))
    assert read_list("-") == ["a.obj", str(Path("sub/c.obj"))]


@pytest.mark.parametrize(("content", "message"), [(b"# nothing\n\n", "names no scene"), (b"\xff\xfe\xff", "not UTF-8")])
def test_lists_that_say_nothing(content, message, tmp_path):
    (tmp_path / "list.txt").write_bytes(content)
    with pytest.raises(UserError, match=f"list.txt: .*{message}"):
        read_list(tmp_path / "list.txt")


def test_a_missing_list(tmp_path):
    with pytest.raises(UserError, match="no such file"):
        read_list(tmp_path / "none.txt")


def test_names_are_those_of_the_files():
    assert name_scans(["x/a.obj", Path("y/b.c.ply")]) == {"x/a.obj": "a", str(Path("y/b.c.ply")): "b.c"}


def test_a_scan_given_twice_is_one():
    assert list(name_scans(["a.obj", "b.obj", "a.obj"])) == ["a.obj", "b.obj"]


def test_files_of_one_name_are_told_apart_by_their_folders():
    """By as few as are needed, whatever the case of letters; others keep their names."""
    names = name_scans(["s/1/mesh.obj", "s/2/Mesh.obj", "s/2/other.obj"])
    assert names == {"s/1/mesh.obj": "1-mesh", "s/2/Mesh.obj": "2-Mesh", "s/2/other.obj": "other"}
    names = name_scans(["p/s/mesh.obj", "q/s/mesh.obj", "t/mesh.obj"])
    assert list(names.values()) == ["p-s-mesh", "q-s-mesh", "t-mesh"]


@pytest.mark.parametrize("same", [["a/x.obj", "a/x.glb"], ["a/x.obj", "a/X.obj"], ["a/b.obj", "c/b.obj", "a-b.obj"]])
def test_scans_that_cannot_be_told_apart(same):
    with pytest.raises(UserError, match="would have the same names; rename one of the two"):
        name_scans(same)
