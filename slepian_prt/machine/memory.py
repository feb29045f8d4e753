"""Memory that is there: of the machine or, where that is less, of the control group that we run in."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from slepian_prt.errors import UserError

_GIB = 1 << 30

_limit: int | None = None


def available_memory() -> int | None:
    """Bytes that can be taken without swapping; None where the system does not tell."""
    known = [size for size in (_of_machine(), *_of_groups()) if size is not None]
    return min(known) if known else None


def allowed_memory() -> int | None:
    """Bytes that `memory_limited` allows, else those available."""
    return available_memory() if _limit is None else _limit


@contextmanager
def memory_limited(size: int | None) -> Iterator[None]:
    """Within the block, `allowed_memory` is ``size`` bytes; None changes nothing."""
    global _limit
    before = _limit
    if size is not None:
        _limit = size
    try:
        yield
    finally:
        _limit = before


def check_memory(need: int, work: str, remedy: str) -> None:
    """Raise UserError now, not when the process is killed, for work that needs more bytes than are allowed.

    Parameters
    ----------
    need : int
        Bytes.
    work : str
        What needs them, as the subject of a sentence.
    remedy : str
        What to change.
    """
    allowed = allowed_memory()
    if allowed is not None and need > allowed:
        raise UserError(f"{work} needs about {need / _GIB:.1f} GiB of memory, {allowed / _GIB:.1f} are left; {remedy}")


def _of_machine() -> int | None:
    with suppress(OSError, ValueError, IndexError):
        for line in Path("/proc/meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return 1024 * int(line.split()[1])
    return None


def _of_groups() -> Iterator[int]:
    """What our control group, and each around it, may still take; pages of files count as free, as they can go."""
    for limit, usage, statistics in (
        ("/sys/fs/cgroup/memory.max", "memory.current", "memory.stat"),
        ("/sys/fs/cgroup/memory/memory.limit_in_bytes", "memory.usage_in_bytes", "memory.stat"),
    ):
        with suppress(OSError, ValueError):
            path = Path(limit)
            most = int(path.read_text())  # "max" of one without a limit
            used = int((path.parent / usage).read_text())
            lines = (line.split() for line in (path.parent / statistics).read_text().splitlines())
            files = {name: int(size) for name, size in lines}.get("inactive_file", 0)
            yield max(0, most - used + files)
