"""The user's cache folder, where unfinished work waits for the next run: private, and never another user's.

It is where SLEPIAN_PRT_CACHE says, or where the system has such folders. What is made there is for its owner's eyes
alone, links are not followed, and what another user owns is not used. In a folder that others may write to, such as
``/tmp``, a private one of its own is made.
"""

from __future__ import annotations

import contextlib
import logging
import os
import secrets
import shutil
import stat
import time
from collections.abc import Iterator
from contextvars import ContextVar
from pathlib import Path
from typing import IO

import platformdirs

from slepian_prt.files import PRIVATE_FLAGS, is_at, is_ours, lock

log = logging.getLogger(__name__)

# Finished work of jobs that nobody came back to.
_STALE_SECONDS = 14 * 24 * 3600.0

# Times that a file is opened again because the process that had it has just removed it.
_TRIES = 8

_PRIVATE = 0o700

# Folders of finished jobs whose results are not on the disk yet, each with its lock; None where nobody asked for it.
_KEPT: ContextVar[dict[str, tuple[Path, IO[bytes]]] | None] = ContextVar("_KEPT", default=None)


# Whether work that this process finished waits in the cache folder for the next run.
_keeps_work = False


def keeps_work() -> bool:
    """Whether work that ended before its time has left something that the same command goes on with."""
    return _keeps_work


def note_kept() -> None:
    """Work has ended before its time, and what is finished of it stays."""
    global _keeps_work
    _keeps_work = True


def locked_cache_file(name: str) -> IO[bytes] | None:
    """A file of the cache folder that no other process has while it is open, to append.

    None without a folder that can be written to by us alone, or while another process has it. What is of its kind, two
    weeks old and not in use is removed.
    """
    try:
        return _locked(_cache_folder(Path(name).suffix) / name)
    except OSError as error:
        _tell(error)
        return None


@contextlib.contextmanager
def locked_cache_folder(name: str) -> Iterator[Path | None]:
    """A folder as `locked_cache_file` has files, removed when the with-block ends well and kept when it does not.

    Within `work_kept` it is removed when that ends.
    """
    kept = _KEPT.get()
    if kept is not None and name in kept:
        yield kept[name][0]
        return
    opened = None
    try:
        opened = _locked_folder(_cache_folder(Path(name).suffix) / name)
    except OSError as error:
        _tell(error)
    if opened is None:
        yield None
        return
    folder, held = opened
    with contextlib.ExitStack() as stack:
        stack.enter_context(held)
        try:
            yield folder
        except BaseException:
            _note_if_kept(folder)
            raise
        if kept is None:
            _remove(folder)
        else:
            kept[name] = folder, held
            stack.pop_all()


@contextlib.contextmanager
def work_kept() -> Iterator[None]:
    """Keep finished work until the block ends well: a result that cannot be written costs no second computation."""
    kept: dict[str, tuple[Path, IO[bytes]]] = {}
    token = _KEPT.set(kept)
    try:
        yield
        for folder, _ in kept.values():
            _remove(folder)
    except BaseException:
        for folder, _ in kept.values():
            _note_if_kept(folder)
        raise
    finally:
        _KEPT.reset(token)
        for _, held in kept.values():
            held.close()


def _note_if_kept(folder: Path) -> None:
    with contextlib.suppress(OSError):
        if set(os.listdir(folder)) - {"lock"}:
            note_kept()


def _tell(error: OSError) -> None:
    log.info("%s: cannot keep unfinished work (%s)", error.filename or "the cache folder", error.strerror or error)


def _refused(folder: Path, why: str) -> PermissionError:
    return PermissionError(0, f"{why}; set SLEPIAN_PRT_CACHE to a folder of yours", str(folder))


def _cache_folder(suffix: str) -> Path:
    """The folder, made if need be and private, without what is old of a kind."""
    named = os.environ.get("SLEPIAN_PRT_CACHE")
    folder = Path(named or platformdirs.user_cache_path("slepian_prt"))
    folder.parent.mkdir(parents=True, exist_ok=True)
    with contextlib.suppress(FileExistsError):
        folder.mkdir(_PRIVATE)
    status = folder.stat()
    if not named:
        _make_private(folder, status)
    elif hasattr(os, "geteuid") and (not is_ours(status) or status.st_mode & 0o022):
        if status.st_mode & stat.S_IWOTH and not status.st_mode & stat.S_ISVTX:
            raise _refused(folder, "everybody may rename what is in it")
        folder = folder / f"slepian_prt-{os.geteuid()}"
        with contextlib.suppress(FileExistsError):
            folder.mkdir(_PRIVATE)
        _make_private(folder, folder.lstat())
    _forget_stale(folder, suffix)
    return folder


def _make_private(folder: Path, status: os.stat_result) -> None:
    """Let nobody else into a folder of ours.

    Raises
    ------
    PermissionError
        It is somebody else's, or a link.
    """
    if not stat.S_ISDIR(status.st_mode):
        raise _refused(folder, "it is no folder")
    if not is_ours(status):
        raise _refused(folder, "it belongs to another user")
    if os.name == "posix" and stat.S_IMODE(status.st_mode) != _PRIVATE:
        folder.chmod(_PRIVATE)


def _locked_folder(folder: Path) -> tuple[Path, IO[bytes]] | None:
    for _ in range(_TRIES):
        with contextlib.suppress(FileExistsError):
            folder.mkdir(_PRIVATE)
        with contextlib.suppress(FileNotFoundError):  # another process has just finished with it
            _make_private(folder, folder.lstat())
            held = _locked(folder / "lock")
            if held is None:
                return None
            _remove_foreign(folder)
            return folder, held
    return None


def _remove_foreign(folder: Path) -> None:
    """Of a folder that others could write to once, keep what is ours and no link."""
    with os.scandir(folder) as entries:
        for entry in entries:
            status = entry.stat(follow_symlinks=False)
            if not stat.S_ISREG(status.st_mode) or not is_ours(status):
                log.info("%s: is a link, or another user's, and not used", entry.path)
                shutil.rmtree(entry.path) if entry.is_dir(follow_symlinks=False) else os.unlink(entry.path)


def _locked(path: Path) -> IO[bytes] | None:
    """The file, open to append; None while another process has it."""
    for _ in range(_TRIES):
        file = open(path, "a+b", opener=_open_private)  # noqa: SIM115
        handle = file.fileno()
        try:
            status = os.fstat(handle)
            if not is_ours(status) or not stat.S_ISREG(status.st_mode):
                raise _refused(path, "it belongs to another user")
            if not lock(handle) and os.name == "posix":
                raise BlockingIOError
            if is_at(handle, path):
                return file
        except BlockingIOError:
            file.close()
            return None
        except OSError:
            file.close()
            raise
        file.close()  # it was removed by the process that had it
    return None


def _open_private(path: str, flags: int) -> int:
    return os.open(path, flags | PRIVATE_FLAGS, 0o600)


def _forget_stale(folder: Path, suffix: str) -> None:
    """Remove old work, whatever the clock says: none that a process has."""
    for path in folder.glob(f"*{suffix}"):
        with contextlib.suppress(OSError):
            if time.time() - path.lstat().st_mtime <= _STALE_SECONDS:
                continue
            if path.is_symlink():
                path.unlink()
                continue
            is_folder = path.is_dir()
            held = _locked(path / "lock" if is_folder else path)
            if held is not None:
                with held:
                    _remove(path) if is_folder else path.unlink()


def _remove(folder: Path) -> None:
    """Remove a folder that we have locked, in one step for those who look for it."""
    away = folder.with_name(f".{secrets.token_hex(8)}{folder.suffix}")
    with contextlib.suppress(OSError):
        folder.rename(away)
        shutil.rmtree(away, ignore_errors=True)
