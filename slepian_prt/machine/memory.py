"""Memory that is there: of the machine or, where that is less, of the control group that we run in."""

from __future__ import annotations

import logging
import os
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from slepian_prt.errors import UserError
from slepian_prt.machine.control_groups import folders_of, read_number
from slepian_prt.machine.variables import variable_set

log = logging.getLogger(__name__)

_GIB = 1 << 30

# Limits of control groups above this are none: version 1 writes the largest number of pages there is.
_NO_LIMIT = 1 << 60

# The environment variable that says how many bytes work may take, also in processes that are started.
MAX_MEMORY = "SLEPIAN_PRT_MAX_MEMORY"

_SIZE = re.compile(r"(?P<number>\d+(\.\d*)?|\.\d+)\s*(?P<unit>[KMGT]?)(i?B)?", re.IGNORECASE)
_LEAST = 1 << 20

# Part of the memory that is allowed from which on an estimated need is told.
_CLOSE = 0.8

# Part of an estimate that is needed in any case.
_SURE = 0.8


def available_memory(root: Path = Path("/")) -> int | None:
    """Bytes that can be taken without swapping; None where the system does not tell.

    Parameters
    ----------
    root : Path
        What stands for ``/`` where the system and its control groups are asked, for tests.
    """
    known = [size for size in (_of_machine(root), *_of_groups(root), _of_process(root)) if size is not None]
    return min(known) if known else None


def allowed_memory() -> int | None:
    """Bytes that ``SLEPIAN_PRT_MAX_MEMORY`` or `memory_limited` allow, else those available.

    Raises
    ------
    UserError
        The variable is no size.
    """
    given = limit_given()
    return available_memory() if given is None else given


def limit_given() -> int | None:
    """Bytes that ``SLEPIAN_PRT_MAX_MEMORY`` or `memory_limited` allow; None if neither does."""
    text = os.environ.get(MAX_MEMORY)
    return parse_size(text, MAX_MEMORY) if text else None


def parse_size(text: str, name: str) -> int:
    """Bytes that ``2G``, ``500M`` or a number of bytes stand for; units are powers of 1024.

    Raises
    ------
    UserError
        No size, or less than a mebibyte.
    """
    match = _SIZE.fullmatch(text.strip())
    size = int(float(match["number"]) * 1024 ** " KMGT".index(match["unit"].upper() or " ")) if match else 0
    if size < _LEAST:
        raise UserError(f"{name} must be a size of 1M at least, as 2G or 500M, not {text!r}")
    return size


@contextmanager
def memory_limited(size: int | None) -> Iterator[None]:
    """Work within the block, also of processes that it starts, takes ``size`` bytes at most; None changes nothing."""
    if size is None:
        yield
        return
    with variable_set(MAX_MEMORY, str(size)):
        yield


def check_memory(need: int, work: str, remedy: str) -> None:
    """Raise UserError now, not when the process is killed, for work that needs more bytes than are allowed.

    Parameters
    ----------
    need : int
        Bytes of the whole process, with those that it holds already.
    work : str
        What needs them, as the subject of a sentence.
    remedy : str
        What to change.
    """
    there = _there()
    if there is not None and need > there[0]:
        raise UserError(_told(need, work, *there, _remedies(remedy)))


def check_estimate(need: float, work: str, remedy: str, least: float | None = None) -> None:
    """As `check_memory`, of a need that is estimated: what may fit yet is only told, with a warning.

    Parameters
    ----------
    need, work, remedy : as of `check_memory`
        What needs 80 % of what is allowed is told.
    least : float, optional
        Bytes that are needed in any case; by default 80 % of the estimate. Where not even they are allowed the work is
        refused.
    """
    there = _there()
    if there is None or need <= _CLOSE * there[0]:
        return
    if (_SURE * need if least is None else least) > there[0]:
        raise UserError(_told(need, work, *there, _remedies(remedy)))
    log.warning("%s", _told(need, work, *there, f"if that is too little, {_remedies(remedy)}"))


def _there() -> tuple[int, str] | None:
    """Bytes that this process may have in all, and what says so; None where nothing does."""
    limit = limit_given()
    if limit is not None:
        return limit, "`max_memory` allows"
    left = available_memory()
    return None if left is None else (left + held_memory(), "there are")


def _told(need: float, work: str, allowed: int, says: str, remedy: str) -> str:
    return f"{work} needs about {describe_size(need)} of memory, {says} {describe_size(allowed)}; {remedy}"


def _remedies(remedy: str) -> str:
    """What to change, where a limit was given first that: what a process needs in any case may be above it."""
    return remedy if limit_given() is None else f"raise `max_memory`, or {remedy}"


def held_memory(root: Path = Path("/")) -> int:
    """Bytes of memory that this process holds; 0 where the system does not tell."""
    with suppress(OSError, ValueError, IndexError):
        import resource

        return int((root / "proc/self/statm").read_text().split()[1]) * resource.getpagesize()
    return 0


def describe_size(size: float) -> str:
    """Bytes in GiB, or MiB where that is less than one."""
    return f"{size / _GIB:.1f} GiB" if size >= _GIB else f"{size / (1 << 20):.0f} MiB"


def _of_machine(root: Path) -> int | None:
    if sys.platform == "win32":
        return _of_windows()
    with suppress(OSError, ValueError, IndexError):
        for line in (root / "proc/meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return 1024 * int(line.split()[1])
    return None  # macOS tells its programs only how much there is in all


def _of_windows() -> int | None:
    import ctypes

    class Status(ctypes.Structure):
        _fields_ = (
            ("length", ctypes.c_ulong),
            ("load", ctypes.c_ulong),
            ("all", ctypes.c_ulonglong),
            ("available", ctypes.c_ulonglong),
            ("others", ctypes.c_ulonglong * 5),
        )

    status = Status(length=ctypes.sizeof(Status))
    asked = getattr(ctypes, "windll").kernel32.GlobalMemoryStatusEx(ctypes.byref(status))  # noqa: B009 - not on Linux
    return int(status.available) if asked else None


def _of_groups(root: Path) -> Iterator[int]:
    """What our control group, and each around it, may still take; pages of files count as free, as they can go."""
    for folder in folders_of("memory", root):
        for limit, usage in (("memory.max", "memory.current"), ("memory.limit_in_bytes", "memory.usage_in_bytes")):
            most, used = read_number(folder / limit), read_number(folder / usage)
            if most is None or used is None or most >= _NO_LIMIT:
                continue
            yield max(0, most - max(0, used - _pages_of_files(folder / "memory.stat")))


def _pages_of_files(statistics: Path) -> int:
    """Bytes that can be dropped, of this group and those in it."""
    with suppress(OSError, ValueError):
        lines = (line.split() for line in statistics.read_text().splitlines())
        sizes = {name: int(size) for name, size in lines}
        for kind in ("total_", ""):  # version 1 counts a group by itself, and with those in it
            if f"{kind}inactive_file" in sizes:
                return sizes[f"{kind}inactive_file"] + sizes.get(f"{kind}active_file", 0)
    return 0


def _of_process(root: Path) -> int | None:
    """What is left of the addresses that ``ulimit -v`` allows this process."""
    try:
        import resource
    except ImportError:  # Windows
        return None
    most, _ = resource.getrlimit(resource.RLIMIT_AS)
    if most == resource.RLIM_INFINITY:
        return None
    with suppress(OSError, ValueError, IndexError):
        pages = int((root / "proc/self/statm").read_text().split()[0])
        return max(0, most - pages * resource.getpagesize())
    return most
