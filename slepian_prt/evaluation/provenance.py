"""Where a result comes from: versions of what it depends on, and the machine that its times were measured on."""

from __future__ import annotations

import os
import platform
from importlib.metadata import version
from pathlib import Path
from typing import Any


def versions() -> dict[str, str]:
    """Versions of this package, of what it computes with, and of Python."""
    packages = ("slepian_prt", "mitsuba", "drjit", "numpy", "scipy")
    return {**{name: version(name) for name in packages}, "python": platform.python_version()}


def machine() -> dict[str, Any]:
    """Processor, number of cores that may be used, and operating system."""
    model = platform.processor() or platform.machine()
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                model = line.partition(":")[2].strip()
                break
    except OSError:
        pass
    return {"processor": model, "cores": len(os.sched_getaffinity(0)), "system": platform.system()}
