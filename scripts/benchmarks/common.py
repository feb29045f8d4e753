"""What all benchmarks use."""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]

# Of scripts/fetch_dragons.
DRAGONS = ROOT / "downloads" / "stanford-dragon"

# Of a Linux process since its start; ru_maxrss would include what its parent had used.
PEAK_MEMORY = "next(f'{int(x.split()[1]) / 1024:.0f} MB' for x in open('/proc/self/status') if x.startswith('VmHWM'))"


def data_folder() -> Path:
    """Meshes and environments."""
    return Path(os.environ.get("SLEPIAN_PRT_DATA") or ROOT.parent / "shared" / "data")


def median_seconds(work: Callable[[], object], runs: int = 5) -> float:
    times = []
    for _ in range(runs):
        begin = time.perf_counter()
        work()
        times.append(time.perf_counter() - begin)
    return statistics.median(times)


def line(what: str, value: str) -> None:
    print(f"{what:<78} {value}", flush=True)


def in_child(code: str, folder: str = "") -> str:
    """Run code in a fresh process, so that its peak memory is its own; with the package in a folder, if given."""
    where: dict[str, Any] = {}
    if folder:  # also as the working folder, which comes first
        where = {"cwd": folder, "env": {**os.environ, "PYTHONPATH": folder}}
    command = [sys.executable, "-c", code]
    return subprocess.run(command, capture_output=True, text=True, check=True, **where).stdout.strip()
