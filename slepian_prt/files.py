"""Output files that are complete or not there at all, and checks of where they go before any heavy work."""

from __future__ import annotations

import contextlib
import glob
import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import IO

import platformdirs

from slepian_prt.errors import UserError

# Vertices up to which transfer files keep the order of their source unasked: scripts pair them with arrays of their
# own, and it takes some 30 kB at most.
KEPT_ORDER = 1 << 14

# Finished work of jobs that nobody came back to.
_STALE_SECONDS = 14 * 24 * 3600.0


@contextlib.contextmanager
def atomic_output(path: str | Path) -> Iterator[IO[bytes]]:
    """A file that appears under its name only when the with-block ends well; otherwise nothing is left.

    Raises
    ------
    UserError
        The folder is missing or not writable, or the disk is full.
    """
    path = Path(path)
    partial = path.with_name(f".{path.name}.{os.getpid()}.part")
    if path.is_dir():
        raise UserError(f"{path}: is a folder; name a file")
    try:
        file = partial.open("wb")
    except OSError as error:
        raise UserError(
            f"{path}: cannot be written ({error.strerror or error}); choose another folder for the output"
        ) from None
    try:
        with file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        partial.replace(path)
    except OSError as error:
        raise UserError(f"{path}: cannot be written ({error.strerror or error})") from None
    finally:
        partial.unlink(missing_ok=True)


def forget_partial(path: str | Path) -> None:
    """Remove what processes left that were killed while they wrote `atomic_output`, if none may be writing now."""
    path = Path(path)
    for partial in path.parent.glob(f".{glob.escape(path.name)}.*.part"):
        partial.unlink(missing_ok=True)


def check_readable(path: str | Path, wanted: str = "a file", remedy: str = "check the path") -> None:
    """Raise UserError for a folder, which says to name what is ``wanted``, and for a file that is not there."""
    if os.path.isdir(path):  # other than Path's, false for names that no file can have
        raise UserError(f"{path}: is a folder; name {wanted}")
    if not os.path.isfile(path):
        raise UserError(f"{path}: {'is a pipe or a device' if os.path.exists(path) else 'no such file'}; {remedy}")


def check_writable(path: str | Path, *inputs: str | Path) -> None:
    """Raise UserError now if `atomic_output` could not begin or would replace an input, not after the heavy work."""
    if not str(path):
        raise UserError("the name of the output is empty; name a file")
    path = Path(path)
    for source in inputs:
        if path.exists() and Path(source).exists() and path.samefile(source):
            raise UserError(f"{path}: is the input; choose another name for the output")
    folder = path.parent
    if path.is_dir():
        raise UserError(f"{path}: is a folder; name a file")
    if path.exists() and not path.is_file():
        raise UserError(f"{path}: is not a regular file; choose another name for the output")
    if not folder.is_dir():
        raise UserError(f"{path}: the folder {folder} does not exist; create it or choose another")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise UserError(f"{path}: the folder {folder} is not writable; choose another folder for the output")


def check_folder(folder: str | Path) -> None:
    """Raise UserError now, not after the heavy work, if a folder that need not be there yet cannot be written to."""
    if not str(folder):
        raise UserError("the name of the output folder is empty; name a folder")
    folder = Path(folder)
    existing = folder
    while not existing.exists() and existing != existing.parent:
        existing = existing.parent
    try:
        if not existing.is_dir():
            raise UserError(f"{folder}: {existing} is not a folder; choose another")
        probe = existing / f".slepian-prt-{os.getpid():x}"
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise UserError(
            f"{folder}: cannot be written to ({error.strerror or error}); choose another folder for the output"
        ) from None


def write_all(folder: Path, files: dict[str, bytes]) -> None:
    """All files or, if one cannot be written, none: they are put into place when all are on the disk."""
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=f".{folder.name}.", dir=folder.parent) as partial:
            for name, content in files.items():
                (Path(partial) / name).write_bytes(content)
            folder.mkdir(exist_ok=True)
            for name in files:
                (Path(partial) / name).replace(folder / name)
    except OSError as error:
        raise UserError(
            f"{folder}: cannot be written ({error.strerror or error}); choose another folder for the output"
        ) from None


def locked_cache_file(name: str) -> IO[bytes] | None:
    """A file of the user's cache folder, or of SLEPIAN_PRT_CACHE, that no other process has while it is open.

    None without a folder that can be written, or while another process has it. What is of its kind and two weeks old is
    removed.
    """
    try:
        return _locked(_cache_folder(Path(name).suffix) / name)
    except OSError:
        return None


@contextlib.contextmanager
def locked_cache_folder(name: str) -> Iterator[Path | None]:
    """A folder as `locked_cache_file` has files, removed when the with-block ends well and kept when it does not."""
    try:
        folder = _cache_folder(Path(name).suffix) / name
        folder.mkdir(mode=0o700, exist_ok=True)
        lock = _locked(folder / "lock")
    except OSError:
        lock = None
    if lock is None:
        yield None
        return
    with lock:
        yield folder
        shutil.rmtree(folder, ignore_errors=True)


def _cache_folder(suffix: str) -> Path:
    folder = Path(os.environ.get("SLEPIAN_PRT_CACHE") or platformdirs.user_cache_path("slepian_prt"))
    folder.mkdir(parents=True, exist_ok=True)
    _forget_stale(folder, suffix)
    return folder


def _locked(path: Path) -> IO[bytes] | None:
    """The file, open to append; None while another process has it."""
    file = path.open("a+b")
    try:
        import fcntl

        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except ImportError:
        pass
    except OSError:
        file.close()
        return None
    return file


def _forget_stale(folder: Path, suffix: str) -> None:
    for path in folder.glob(f"*{suffix}"):
        with contextlib.suppress(OSError):
            if time.time() - path.stat().st_mtime > _STALE_SECONDS:
                shutil.rmtree(path) if path.is_dir() else path.unlink()
