"""The content of files that others name: of regular ones alone, and no more than fits into memory."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from slepian_prt.errors import UserError
from slepian_prt.machine.memory import check_memory

# Opening a pipe that nobody writes to waits for ever otherwise.
_FLAGS = getattr(os, "O_NONBLOCK", 0)


def is_file(path: Path) -> bool:
    """Whether there is such a file; of a name that no file can have it is false, too."""
    try:
        return path.is_file()
    except (OSError, ValueError):  # too long, or in a folder that may not be looked into; a NUL in it
        return False


def read_content(path: Path, most: int | None = None) -> bytes:
    """All of a file, or the first ``most`` bytes.

    Raises
    ------
    UserError
        Missing, not permitted, a folder, a pipe or a device, or more than fits into memory.
    """
    try:
        with open(path, "rb", opener=lambda name, flags: os.open(name, flags | _FLAGS)) as file:
            status = os.fstat(file.fileno())
            if not stat.S_ISREG(status.st_mode):
                raise UserError(f"{path}: is a pipe or a device; name a file")
            size = status.st_size if most is None else min(most, status.st_size)
            check_memory(size, f"{path}: what it holds", "make it smaller")
            return file.read(size)
    except UserError:
        raise
    except IsADirectoryError:
        raise UserError(f"{path}: is a folder; name a file") from None
    except FileNotFoundError:
        raise UserError(f"{path}: no such file; check the path") from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or "no file can have that name"
        raise UserError(f"{path}: cannot be read ({reason}); check the path and its permissions") from None
