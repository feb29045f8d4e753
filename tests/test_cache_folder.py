"""The cache folder is private, and work in use stays whatever the clock says."""

from __future__ import annotations

import contextlib
import os
import stat
import time
from pathlib import Path

import platformdirs
import pytest

from slepian_prt.cache_folder import keeps_work, locked_cache_file, locked_cache_folder, work_kept

pytestmark = pytest.mark.skipif(os.name != "posix", reason="locks and permissions of POSIX")

as_root = pytest.mark.skipif(os.name == "posix" and os.geteuid() != 0, reason="only root gives files away")

SOMEBODY = 12345


@pytest.fixture
def cache(tmp_path, monkeypatch) -> Path:
    folder = tmp_path / "cache"
    monkeypatch.setenv("SLEPIAN_PRT_CACHE", str(folder))
    return folder


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def test_what_is_made_is_private(cache):
    with locked_cache_folder("a.blocks") as folder, locked_cache_file("b.capture") as file:
        assert folder == cache / "a.blocks"
        assert mode(cache) == mode(folder) == 0o700
        assert stat.S_IMODE(os.fstat(file.fileno()).st_mode) == 0o600
    assert os.listdir(cache) == ["b.capture"]


def test_the_usual_folder_is_made_private(tmp_path, monkeypatch):
    monkeypatch.delenv("SLEPIAN_PRT_CACHE", raising=False)
    monkeypatch.setattr(platformdirs, "user_cache_path", lambda _: tmp_path / "usual")
    (tmp_path / "usual").mkdir()
    (tmp_path / "usual").chmod(0o777)
    with locked_cache_folder("a.blocks") as folder:
        assert folder == tmp_path / "usual" / "a.blocks"
    assert mode(tmp_path / "usual") == 0o700


def test_in_a_shared_folder_there_is_a_private_one(cache):
    cache.mkdir()
    cache.chmod(0o1777)
    with locked_cache_folder("a.blocks") as folder:
        assert folder == cache / f"slepian_prt-{os.geteuid()}" / "a.blocks"
        assert mode(folder.parent) == 0o700
    assert mode(cache) == 0o1777


def test_where_others_may_rename_it_nothing_is_kept(cache, caplog):
    cache.mkdir()
    cache.chmod(0o777)
    with caplog.at_level("INFO"), locked_cache_folder("a.blocks") as folder:
        assert folder is None
    assert "everybody may rename what is in it; set SLEPIAN_PRT_CACHE" in caplog.text


@as_root
@pytest.mark.parametrize("what", ["folder", "private", "journal", "link"])
def test_what_is_another_users_is_not_used(cache, caplog, what):
    cache.mkdir()
    cache.chmod(0o700 if what in ("journal", "link") else 0o1777)
    foreign = cache / (f"slepian_prt-{os.geteuid()}" if what == "private" else "a.blocks")
    if what == "folder":
        os.chown(cache, SOMEBODY, SOMEBODY)
        with locked_cache_folder("a.blocks") as folder:
            assert folder.parent == cache / f"slepian_prt-{os.geteuid()}"  # ours, as in /tmp
        return
    if what == "link":
        (cache / "elsewhere").mkdir()
        foreign.symlink_to("elsewhere")
    else:
        foreign.mkdir()
        os.chown(foreign, SOMEBODY, SOMEBODY)
    with caplog.at_level("INFO"), locked_cache_folder("a.blocks") as folder:
        assert folder is None
    assert ("it is no folder" if what == "link" else "it belongs to another user") in caplog.text


@as_root
def test_blocks_of_others_are_not_used(cache):
    """Of a time when others could write there."""
    folder = cache / "a.blocks"
    folder.mkdir(parents=True)
    for name in ("mine", "foreign", "linked"):
        (folder / name).touch()
    os.chown(folder / "foreign", SOMEBODY, SOMEBODY)
    (folder / "linked").unlink()
    (folder / "linked").symlink_to("mine")
    folder.chmod(0o777)
    with locked_cache_folder("a.blocks") as found:
        assert sorted(os.listdir(found)) == ["lock", "mine"]
        assert mode(found) == 0o700


def test_one_process_at_a_time(cache):
    with locked_cache_folder("a.blocks"), locked_cache_folder("a.blocks") as second:
        assert second is None
    with locked_cache_file("a.capture") as file:
        assert file is not None
        assert locked_cache_file("a.capture") is None


def test_a_file_that_is_removed_while_it_is_opened(cache, monkeypatch):
    """By the process that had it: a lock of what nobody finds any more would keep nobody out."""
    import slepian_prt.cache_folder as module

    locked, calls = module.lock, []

    def lock(handle: int) -> bool:
        calls.append(handle)
        if len(calls) == 1:
            (cache / "a.capture").unlink()
        return locked(handle)

    monkeypatch.setattr(module, "lock", lock)
    with locked_cache_file("a.capture") as file:
        assert os.path.samestat(os.fstat(file.fileno()), (cache / "a.capture").stat())
    assert len(calls) == 2


@pytest.mark.parametrize("jump", [-1e9, 1e9])
def test_a_clock_that_jumps_removes_no_work_in_use(cache, monkeypatch, jump):
    now = time.time()
    with locked_cache_folder("a.blocks") as used, locked_cache_file("c.capture"):
        (used / "block").touch()
        monkeypatch.setattr(time, "time", lambda: now + jump)
        with locked_cache_folder("b.blocks"), locked_cache_file("d.capture"):
            assert (used / "block").exists()
            assert (cache / "c.capture").exists()


def test_old_work_is_removed(cache):
    names = ("a.blocks", "b.blocks")
    for name in names:
        (cache / name).mkdir(parents=True)
    os.utime(cache / "a.blocks", (0, 0))
    with locked_cache_folder("c.blocks"):
        assert sorted(os.listdir(cache)) == ["b.blocks", "c.blocks"]


def test_finished_work_is_kept_until_its_result_is_written(cache):
    with contextlib.suppress(OSError), work_kept():
        with locked_cache_folder("a.blocks") as folder:
            (folder / "block").touch()
        with locked_cache_folder("a.blocks") as again:
            assert again == folder
        raise OSError("full")
    with work_kept(), locked_cache_folder("a.blocks") as folder:
        assert (folder / "block").exists()
    assert os.listdir(cache) == []


@pytest.mark.parametrize("kind", ["blocks", "nothing", "blocks of a result", "finished"])
def test_what_an_interrupt_leaves_to_go_on_with_is_known(kind, cache, monkeypatch):
    monkeypatch.setattr("slepian_prt.cache_folder._keeps_work", False)
    with contextlib.suppress(KeyboardInterrupt), contextlib.ExitStack() as stack:
        if kind == "blocks of a result":
            stack.enter_context(work_kept())
        with locked_cache_folder("a.blocks") as folder:
            if kind != "nothing":
                (folder / "0.block").write_bytes(b"")
            if kind in ("blocks", "nothing"):
                raise KeyboardInterrupt
        if kind == "blocks of a result":
            raise KeyboardInterrupt
    assert keeps_work() == (kind in ("blocks", "blocks of a result"))
    assert (cache / "a.blocks").is_dir() == (kind != "finished")
