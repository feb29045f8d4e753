"""Outputs are complete or not there, wherever they go and whatever ends the process that writes them."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import stat
import subprocess
import sys
import tempfile
import textwrap
from pathlib import Path

import pytest

from slepian_prt import files
from slepian_prt.errors import UserError
from slepian_prt.files import add_line, atomic_output, check_writable, complete_folder, write_all

pytestmark = pytest.mark.skipif(os.name != "posix", reason="links, locks and permissions of POSIX")

as_root = pytest.mark.skipif(os.name == "posix" and os.geteuid() != 0, reason="only root gives files away")

SOMEBODY = 12345


def write(path: Path, content: bytes = b"new") -> None:
    with atomic_output(path) as file:
        file.write(content)


def test_nobody_can_foresee_where_it_is_written(tmp_path):
    """With the number of the process for a name, others could have put a link there."""
    names = set()
    for _ in range(2):
        with atomic_output(tmp_path / "out") as file:
            (partial,) = tmp_path.glob(".out*")
            file.write(b"new")
        names.add(partial.name)
    assert len(names) == 2
    assert all(re.fullmatch(r"\.out\.[0-9a-f]{16}\.part", name) for name in names)
    assert os.listdir(tmp_path) == ["out"]


def test_a_link_in_the_place_of_what_is_unfinished_is_not_followed(tmp_path, monkeypatch):
    """Even if somebody could foresee it."""
    (tmp_path / "precious").write_bytes(b"old")
    tokens = iter(["0" * 16, "1" * 16])
    monkeypatch.setattr("slepian_prt.files.secrets.token_hex", lambda _: next(tokens))
    monkeypatch.setattr("slepian_prt.files.forget_partial", lambda _: None)
    (tmp_path / f".out.{'0' * 16}.part").symlink_to("precious")
    with pytest.raises(UserError, match="File exists"):
        write(tmp_path / "out")
    assert (tmp_path / "precious").read_bytes() == b"old"


@pytest.mark.parametrize("umask", [0o022, 0o077])
def test_permissions_are_those_that_open_gives(tmp_path, umask):
    (tmp_path / "there").touch()
    (tmp_path / "there").chmod(0o640)
    before = os.umask(umask)
    try:
        write(tmp_path / "new"), write(tmp_path / "there")
        write_all(tmp_path / "folder", {"a": b"1"})
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "new").stat().st_mode) == 0o666 & ~umask
    assert stat.S_IMODE((tmp_path / "there").stat().st_mode) == 0o640
    assert stat.S_IMODE((tmp_path / "folder").stat().st_mode) == 0o777 & ~umask
    assert stat.S_IMODE((tmp_path / "folder" / "a").stat().st_mode) == 0o666 & ~umask


@pytest.mark.parametrize("there", [True, False])
def test_links_are_followed_and_stay(tmp_path, there):
    (tmp_path / "far").mkdir(), (tmp_path / "near").mkdir()
    target = tmp_path / "far" / "target"
    if there:
        target.write_bytes(b"old")
    (tmp_path / "near" / "second").symlink_to("../far/target")
    (tmp_path / "near" / "first").symlink_to("second")
    check_writable(tmp_path / "near" / "first")
    write(tmp_path / "near" / "first")
    assert target.read_bytes() == b"new"
    write_all(tmp_path / "near", {"first": b"newer"})
    assert target.read_bytes() == b"newer"
    assert sorted(os.listdir(tmp_path / "near")) == ["first", "second"]
    assert (tmp_path / "near" / "first").is_symlink()


def test_other_names_of_a_file_keep_its_content(tmp_path):
    (tmp_path / "out").write_bytes(b"old")
    (tmp_path / "other").hardlink_to(tmp_path / "out")
    write(tmp_path / "out")
    assert (tmp_path / "other").read_bytes() == b"old"


def test_a_link_to_itself(tmp_path):
    (tmp_path / "out").symlink_to("out")
    with pytest.raises(UserError, match="leads to itself"):
        write(tmp_path / "out")


@as_root
def test_links_of_others_where_everybody_may_write_are_not_followed(tmp_path):
    (tmp_path / "precious").write_bytes(b"old")
    (tmp_path / "out").symlink_to("precious")
    os.lchown(tmp_path / "out", SOMEBODY, SOMEBODY)
    write(tmp_path / "out", b"mine")  # a folder that is ours alone
    tmp_path.chmod(0o1777)
    with pytest.raises(UserError, match="another user's link"):
        write(tmp_path / "out")
    assert (tmp_path / "precious").read_bytes() == b"mine"


def test_what_is_write_protected_stays(tmp_path, monkeypatch):
    (tmp_path / "out").write_bytes(b"old")
    monkeypatch.setattr(os, "access", lambda path, mode: Path(path) != tmp_path / "out")
    for act in (check_writable, write):
        with pytest.raises(UserError, match="write-protected"):
            act(tmp_path / "out")


def test_two_at_once_are_both_whole_and_the_last_stays(tmp_path):
    """The second does not take what the first is writing for a leftover."""
    with atomic_output(tmp_path / "out") as first:
        first.write(b"first")
        write(tmp_path / "out", b"second")
        assert (tmp_path / "out").read_bytes() == b"second"
    assert (tmp_path / "out").read_bytes() == b"first"
    assert os.listdir(tmp_path) == ["out"]


def test_what_killed_processes_left_is_removed_by_the_next(tmp_path):
    code = f"""
        import os, signal
        from pathlib import Path
        from slepian_prt.files import atomic_output, complete_folder
        with atomic_output("out") as file, complete_folder("folder") as folder:
            (folder / "a").touch()
            file.write(b"half"), file.flush()
            os.kill(os.getpid(), {int(signal.SIGKILL)})
    """
    subprocess.run([sys.executable, "-c", textwrap.dedent(code)], cwd=tmp_path, check=False)
    left = os.listdir(tmp_path)
    assert len(left) == 2
    assert all(name.endswith(".part") for name in left)
    (tmp_path / ".out.txt.part").touch()  # a user's
    write(tmp_path / "out"), write_all(tmp_path / "folder", {"b": b"1"})
    assert sorted(os.listdir(tmp_path)) == [".out.txt.part", "folder", "out"]


def test_long_names_are_written_too(tmp_path):
    write(tmp_path / ("é" * 120))
    assert os.listdir(tmp_path) == ["é" * 120]


def test_a_folder_that_vanishes_meanwhile(tmp_path):
    folder = tmp_path / "gone"
    folder.mkdir()

    def vanish() -> None:
        with atomic_output(folder / "out") as file:
            file.write(b"new")
            for partial in folder.iterdir():
                partial.unlink()
            folder.rmdir()

    with pytest.raises(UserError, match=r"out: cannot be written \(No such file or directory\)"):
        vanish()


def test_a_full_disk_leaves_nothing(tmp_path):
    """RLIMIT_FSIZE stands for it: what is written beyond fails, here after some of it."""
    (tmp_path / "out").write_bytes(b"old")
    (tmp_path / "there").mkdir()
    (tmp_path / "there" / "a").write_bytes(b"old")
    code = """
        import os, resource, signal
        from pathlib import Path
        from slepian_prt.errors import UserError
        from slepian_prt.files import add_line, atomic_output, complete_folder, write_all
        resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 16, 1 << 16))
        much = b"x" * (1 << 17)
        def one():
            with atomic_output("out") as file: file.write(much)
        def folder():
            with complete_folder("new") as folder, atomic_output(folder / "b") as file: file.write(much)
        for act in (one, folder, lambda: write_all(Path("new"), {"a": b"", "b": much}),
                    lambda: write_all(Path("there"), {"a": b"new", "b": much}),
                    lambda: add_line(Path("lines"), "x" * (1 << 17))):
            try:
                act()
            except UserError as error:
                print(error)
    """
    run = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code)], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert [line.split(":")[0] for line in run.stdout.splitlines()] == ["out", "new/b", "new", "there", "lines"]
    assert run.stdout.count("File too large") == 5
    assert all("; free some space" in line or "; choose another folder" in line for line in run.stdout.splitlines())
    assert run.stdout.splitlines()[0].endswith("; free some space or choose another folder for the output")
    assert sorted(os.listdir(tmp_path)) == ["lines", "out", "there"]
    assert (tmp_path / "out").read_bytes() == (tmp_path / "there" / "a").read_bytes() == b"old"
    assert os.listdir(tmp_path / "there") == ["a"]
    add_line(tmp_path / "lines", "next")
    assert (tmp_path / "lines").read_bytes().splitlines()[1:] == [b"next"]


def test_a_folder_appears_whole(tmp_path):
    with complete_folder(tmp_path / "deep" / "folder") as staged:
        (staged / "a").write_bytes(b"1")
        assert not (tmp_path / "deep" / "folder").exists()
    assert os.listdir(tmp_path / "deep") == ["folder"]
    with contextlib.suppress(ZeroDivisionError), complete_folder(tmp_path / "deep" / "folder") as staged:
        (staged / "a").write_bytes(b"2")
        1 / 0  # noqa: B018
    assert (tmp_path / "deep" / "folder" / "a").read_bytes() == b"1"
    assert os.listdir(tmp_path / "deep" / "folder") == ["a"]


@pytest.mark.skipif(not os.access("/dev/shm", os.W_OK), reason="no second file system")
def test_a_folder_on_another_disk(tmp_path):
    with tempfile.TemporaryDirectory(dir="/dev/shm") as other:
        (tmp_path / "folder").symlink_to(other)
        write_all(tmp_path / "folder", {"a": b"1"})
        assert (Path(other) / "a").read_bytes() == b"1"
        (tmp_path / "own").mkdir()
        (tmp_path / "own" / "a").symlink_to(Path(other) / "a")
        write_all(tmp_path / "own", {"a": b"2"})
        assert (Path(other) / "a").read_bytes() == b"2"
        assert os.listdir(other) == ["a"]


def test_lines_are_added_to_nothing_but_a_file_of_ours(tmp_path):
    (tmp_path / "precious").write_bytes(b"old\n")
    (tmp_path / "lines").symlink_to("precious")
    with pytest.raises(UserError, match="it is a link"):
        add_line(tmp_path / "lines", "new")
    assert (tmp_path / "precious").read_bytes() == b"old\n"


def test_what_is_put_into_place_is_known(tmp_path, monkeypatch):
    """A folder that is not complete is not in its place, whatever is in it."""
    monkeypatch.setattr(files, "_has_placed", False)
    with contextlib.suppress(KeyboardInterrupt), complete_folder(tmp_path / "folder") as folder:
        write(folder / "a")
        raise KeyboardInterrupt
    assert not files.may_have_written()
    for place in (
        lambda: write(tmp_path / "a"),
        lambda: write_all(tmp_path / "new", {"a": b"new"}),
        lambda: write_all(tmp_path, {"b": b"new"}),
        lambda: add_line(tmp_path / "lines", "new"),
    ):
        monkeypatch.setattr(files, "_has_placed", False)
        place()
        assert files.may_have_written()
