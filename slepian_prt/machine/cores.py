"""Cores that this process may use: those that it may run on, and the part of them that its control group grants."""

from __future__ import annotations

import math
import os
from contextlib import suppress
from pathlib import Path

from slepian_prt.machine.control_groups import folders_of, read_number


def usable_cores(root: Path = Path("/")) -> int:
    """How many threads can run at once, 1 or more: a part of a core counts as one.

    Parameters
    ----------
    root : Path
        What stands for ``/`` where control groups are looked for.
    """
    quota = core_quota(root)
    allowed = len(allowed_cores())
    return allowed if quota is None else max(1, min(allowed, math.ceil(quota - 1e-6)))


def allowed_cores() -> tuple[int, ...]:
    """Those that this process may run on; all where the system does not say."""
    if hasattr(os, "sched_getaffinity"):
        return tuple(sorted(os.sched_getaffinity(0)))
    return tuple(range(os.cpu_count() or 1))


def core_quota(root: Path = Path("/")) -> float | None:
    """Cores' worth of time that our control group, and each around it, grants; None without such a limit."""
    granted = []
    for folder in folders_of("cpu", root):
        with suppress(OSError, ValueError, IndexError):
            quota, period = (folder / "cpu.max").read_text().split()
            granted.append(int(quota) / int(period))  # "max" is no number
        old, period_of_old = read_number(folder / "cpu.cfs_quota_us"), read_number(folder / "cpu.cfs_period_us")
        if old is not None and period_of_old and old > 0:
            granted.append(old / period_of_old)
    return min((share for share in granted if share > 0.0), default=None)


def describe_cores(root: Path = Path("/")) -> str:
    """How many are used, and of how many, with what sets the limit."""
    there, allowed, used = os.cpu_count() or 1, len(allowed_cores()), usable_cores(root)
    if used < allowed:
        quota = core_quota(root)
        return f"{used} of {there} (limit of the control group, {quota:g})"
    return str(used) if used == there else f"{used} of {there} (those that this process may run on)"
