"""Output files that are complete or not there at all, and checks of where they go before any heavy work.

What is unfinished lies beside its place under a name that nobody can foresee, and is locked while it is written: what
killed processes left is told from what others write at this moment, and removed by the next that writes there.

A link in the place of an output is followed, as `open` and compilers follow it: what it leads to is replaced, and the
link stays. Where everybody may write, as in ``/tmp``, only links of ours or of the folder's owner are followed, which
is the rule that Linux has for `open` (``fs.protected_symlinks``).
"""

from __future__ import annotations

import contextlib
import errno
import os
import re
import secrets
import shutil
import stat
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import IO

from slepian_prt.errors import UserError

try:
    import fcntl
except ImportError:  # Windows, where what is open cannot be removed
    fcntl = None  # type: ignore[assignment]

# Vertices up to which transfer files keep the order of their source unasked: scripts pair them with arrays of their
# own, and it takes some 30 kB at most.
KEPT_ORDER = 1 << 14

# Bytes of a name that the name of what is unfinished begins with: most file systems have names of 255.
_BYTES_OF_NAME = 150

# Links that lead to links, at most, as Linux has it.
_MOST_LINKS = 40

_UNFINISHED = re.compile(r"\.[0-9a-f]{16}\.part")

# Whether this process has put an output into its place, or was about to.
_has_placed = False

# Of what is opened by us alone: no link is followed, and no child inherits it.
PRIVATE_FLAGS = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)


@contextlib.contextmanager
def atomic_output(path: str | Path) -> Iterator[IO[bytes]]:
    """A file that appears under its name only when the with-block ends well; otherwise nothing is left.

    It has the permissions that `open` would give: those of the file that it replaces, or what the umask leaves. Of a
    link, what it leads to is written. Other names of the file that is replaced (hard links) keep the old content.

    Raises
    ------
    UserError
        The folder is missing or not writable, the file is write-protected, or the disk is full.
    """
    target = _target(Path(path))
    try:
        forget_partial(target)
        file, partial = _begin(target)
    except OSError as error:
        raise UserError(
            f"{path}: cannot be written ({error.strerror or error}); choose another folder for the output"
        ) from None
    try:
        with file:
            yield file
            file.flush()
            os.fsync(file.fileno())
            if fcntl is not None:  # while it is locked
                _replace(partial, target)
        if fcntl is None:
            _replace(partial, target)
    except OSError as error:
        raise UserError(
            f"{path}: cannot be written ({error.strerror or error}); free some space or choose another folder for the "
            "output"
        ) from None
    finally:
        with contextlib.suppress(OSError):
            partial.unlink(missing_ok=True)


def may_have_written() -> bool:
    """Whether this process has put an output into its place, or was just about to; False where it is known not to."""
    return _has_placed


def forget_partial(path: str | Path) -> None:
    """Remove what processes left that were killed while they wrote an output; what others write now stays."""
    path = Path(path)
    with contextlib.suppress(OSError), os.scandir(path.parent) as entries:
        for entry in entries:
            beginning = _beginning(path.name)
            if entry.name.startswith(beginning) and _UNFINISHED.fullmatch(entry.name, len(beginning)):
                _forget(path.parent / entry.name)


@contextlib.contextmanager
def complete_folder(folder: str | Path) -> Iterator[Path]:
    """A new folder, whose files are put into their place when the with-block ends well; else nothing is left.

    Where there is no folder of the name, the new one becomes it in one step. Links in it are followed as by
    `atomic_output`.

    Raises
    ------
    UserError
    """
    folder = Path(folder)
    if folder.exists() and not folder.is_dir():
        raise UserError(f"{folder}: is a file; name a folder for several results")
    try:
        with _staged(folder) as staged:
            try:
                yield staged
            except UserError as error:  # which names what users need not know
                raise UserError(str(error).replace(str(staged), str(folder))) from None
            _put_into_place(staged, folder, sorted(path.name for path in staged.iterdir()))
    except OSError as error:
        raise _unwritable_folder(folder, error) from None


def write_all(folder: Path, files: dict[str, bytes]) -> None:
    """All files or, if one cannot be written, none: they are put into place, in order, when all are on the disk."""
    try:
        with _staged(folder) as staged:
            for name, content in files.items():
                with (staged / name).open("xb") as file:
                    file.write(content)
                    file.flush()
                    os.fsync(file.fileno())
            _put_into_place(staged, folder, files)
    except OSError as error:
        raise _unwritable_folder(folder, error) from None


def check_readable(path: str | Path, wanted: str = "a file", remedy: str = "check the path") -> None:
    """Raise UserError for a folder, which says to name what is ``wanted``, and for a file that is not there."""
    if os.path.isdir(path):  # other than Path's, false for names that no file can have
        raise UserError(f"{path}: is a folder; name {wanted}")
    if not os.path.isfile(path):
        if os.path.exists(path):
            raise UserError(f"{path}: is a pipe or a device; name {wanted}")
        raise UserError(f"{path}: no such file; {remedy}")


def check_writable(path: str | Path, *inputs: str | Path) -> None:
    """Raise UserError now if `atomic_output` could not begin or would replace an input, not after the heavy work."""
    if not str(path):
        raise UserError("the name of the output is empty; name a file")
    check_other(path, inputs)
    folder = _target(Path(path)).parent
    if not folder.is_dir():
        raise UserError(f"{path}: the folder {folder} does not exist; create it or choose another")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise UserError(f"{path}: the folder {folder} is not writable; choose another folder for the output")


def check_other(path: str | Path, inputs: Iterable[str | Path]) -> None:
    """Raise UserError if a file is one of the inputs, under whatever name."""
    for source in inputs:
        if _is_same(Path(path), Path(source)):
            raise UserError(f"{path}: is the input; choose another name for the output")


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
        probe = existing / f".slepian-prt-{secrets.token_hex(8)}"
        os.close(os.open(probe, os.O_WRONLY | os.O_CREAT | os.O_EXCL | PRIVATE_FLAGS, 0o600))
        probe.unlink()
    except OSError as error:
        raise UserError(
            f"{folder}: cannot be written to ({error.strerror or error}); choose another folder for the output"
        ) from None


def add_line(path: Path, line: str) -> None:
    """Append a line to a file of ours, on the disk when this returns; what was cut off before it stays a line alone.

    Raises
    ------
    UserError
        The file is a link, somebody else's, or cannot be written.
    """
    try:
        handle = os.open(path, os.O_RDWR | os.O_APPEND | os.O_CREAT | PRIVATE_FLAGS, 0o666)
        with os.fdopen(handle, "r+b", buffering=0) as file:
            if not is_ours(os.fstat(handle)):
                raise UserError(f"{path}: belongs to another user; choose another folder for the output")
            torn = file.seek(0, os.SEEK_END) > 0
            if torn:
                file.seek(-1, os.SEEK_END)
                torn = file.read(1) != b"\n"
            _note_placed()
            content = ("\n" * torn + line + "\n").encode()
            while content:
                content = content[file.write(content) :]
            os.fsync(handle)
    except OSError as error:
        reason = "it is a link" if error.errno == errno.ELOOP else error.strerror or error
        raise UserError(f"{path}: cannot be written ({reason}); free some space or choose another folder") from None


def lock(handle: int) -> bool:
    """Lock an open file or folder for as long as it is open; False where the file system or Windows has no locks.

    Raises
    ------
    BlockingIOError
        Another process has it.
    """
    if fcntl is None:
        return False
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise
    except OSError:
        return False
    return True


def is_at(handle: int, path: Path) -> bool:
    """Whether what is open is still what lies at a path: who waited for a lock may have what was removed meanwhile."""
    try:
        return fcntl is None or os.path.samestat(os.fstat(handle), os.lstat(path))
    except OSError:
        return False


def is_own_file(path: Path) -> bool:
    """Whether there is a regular file of ours, no link to one: what others may have put there is not believed."""
    try:
        status = path.lstat()
    except OSError:
        return False
    return stat.S_ISREG(status.st_mode) and is_ours(status)


def is_ours(status: os.stat_result) -> bool:
    """Whether the user whom we work for owns a file; without users, as on Windows, all are ours."""
    return not hasattr(os, "geteuid") or status.st_uid == os.geteuid()


def _is_same(path: Path, other: Path) -> bool:
    try:
        return path.samefile(other)
    except (OSError, ValueError):  # one is not there
        return False


def _target(path: Path) -> Path:
    """Where an output goes: past links, to what may be replaced."""
    given = path
    for _ in range(_MOST_LINKS):
        if not path.is_symlink():
            break
        _check_link(path)
        path = path.parent / os.readlink(path)
    else:
        raise UserError(f"{given}: is a link that leads to itself; remove it")
    if path.is_dir():
        raise UserError(f"{given}: is a folder; name a file")
    if path.exists() and not path.is_file():
        raise UserError(f"{given}: is not a regular file; choose another name for the output")
    if path.exists() and not os.access(path, os.W_OK):
        raise UserError(f"{given}: is write-protected; choose another name for the output")
    return path


def _check_link(path: Path) -> None:
    """Raise UserError for a link that somebody else may have put there for us to write to what is ours."""
    folder, link = path.parent.stat(), path.lstat()
    if folder.st_mode & stat.S_IWOTH and not is_ours(link) and link.st_uid != folder.st_uid:
        raise UserError(
            f"{path}: is another user's link, in a folder that everybody may write to; choose another folder for the "
            "output"
        )


def _begin(target: Path) -> tuple[IO[bytes], Path]:
    """What an output is until it is complete, locked, and its path."""
    mode = stat.S_IMODE(target.stat().st_mode) if target.exists() else 0o666
    while True:
        partial = target.with_name(_unfinished(target.name))
        handle = os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_EXCL | PRIVATE_FLAGS, mode)
        if _is_held(handle, partial):
            return os.fdopen(handle, "wb"), partial
        os.close(handle)


def _is_held(handle: int, path: Path) -> bool:
    """Lock what is new; False if another process took it for a leftover first."""
    with contextlib.suppress(BlockingIOError):
        lock(handle)
        return is_at(handle, path)
    return False


def _replace(partial: Path, target: Path) -> None:
    """Put a file into its place, with the permissions of the one that was there."""
    if target.exists() and os.name == "posix":
        partial.chmod(stat.S_IMODE(target.stat().st_mode))
    if not _UNFINISHED.search(target.parent.name):
        _note_placed()
    partial.replace(target)


def _note_placed() -> None:
    """Before it is: a signal may come at any moment."""
    global _has_placed
    _has_placed = True


def _beginning(name: str) -> str:
    return f".{os.fsencode(name)[:_BYTES_OF_NAME].decode(errors='ignore')}"


def _unfinished(name: str) -> str:
    return f"{_beginning(name)}.{secrets.token_hex(8)}.part"


def _forget(path: Path) -> None:
    """Remove an unfinished file or folder, unless it is being written."""
    with contextlib.suppress(OSError):
        if fcntl is None:
            path.unlink()  # which fails where it is open
            return
        handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | PRIVATE_FLAGS)
        try:
            if lock(handle):
                shutil.rmtree(path, ignore_errors=True) if path.is_dir() else path.unlink()
        finally:
            os.close(handle)


@contextlib.contextmanager
def _staged(folder: Path) -> Iterator[Path]:
    """An empty folder on the disk of another, which need not be there yet; it is removed in the end."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    inside = folder.is_dir()
    near = folder / (folder.name or "output") if inside else folder
    forget_partial(near)
    handle = None
    while handle is None:
        staged = near.with_name(_unfinished(near.name))
        staged.mkdir()
        if fcntl is None:
            break
        handle = os.open(staged, os.O_RDONLY | PRIVATE_FLAGS)
        if not _is_held(handle, staged):
            os.close(handle)
            handle = None
    try:
        yield staged
    finally:
        shutil.rmtree(staged, ignore_errors=True)
        if handle is not None:
            os.close(handle)


def _put_into_place(staged: Path, folder: Path, names: Iterable[str]) -> None:
    if not os.path.lexists(folder):
        _note_placed()
        try:
            staged.rename(folder)
        except OSError:
            if not folder.is_dir():  # which another process may have made just now
                raise
        else:
            return
    targets = {name: _target(folder / name) for name in names}
    for name, target in targets.items():
        try:
            _replace(staged / name, target)
        except OSError as error:
            if error.errno != errno.EXDEV:
                raise
            with (staged / name).open("rb") as source, atomic_output(target) as file:
                shutil.copyfileobj(source, file)


def _unwritable_folder(folder: Path, error: OSError) -> UserError:
    return UserError(f"{folder}: cannot be written ({error.strerror or error}); choose another folder for the output")
