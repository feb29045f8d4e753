"""What runs here: versions, the variant that is used, LLVM, cores and measured speed, with a remedy for each fault."""

from __future__ import annotations

import importlib.metadata
import platform
import subprocess
import sys
from dataclasses import asdict, dataclass
from typing import Any

from slepian_prt.errors import UserError
from slepian_prt.machine.cores import describe_cores, usable_cores
from slepian_prt.machine.memory import MAX_MEMORY, available_memory, describe_size, limit_given
from slepian_prt.machine.threads import THREADS, thread_count
from slepian_prt.renderer import llvm
from slepian_prt.renderer.variants import NO_DEVICE, cuda_failure, usable_variant

_DRIVER = (
    "Mitsuba's cuda_* variants need an NVIDIA driver of version 535 or newer, of 570 for the newest cards, with "
    "OptiX in it (in a container: NVIDIA_DRIVER_CAPABILITIES=all), and a device of compute capability 7.5 or higher"
)
_PACKAGES = ("mitsuba", "drjit", "numpy", "scipy", "trimesh", "OpenEXR")


@dataclass(frozen=True)
class Finding:
    """One line of the doctor: what was looked at, what was found, and, if it is not well, what to do."""

    subject: str
    value: str
    ok: bool = True
    remedy: str = ""

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)


def examine() -> list[Finding]:
    """Look at everything; anything that may kill the process is tried in a child."""
    findings = [Finding("python", f"{platform.python_version()} on {platform.machine()} {platform.system()}")]
    findings += [_package(name) for name in _PACKAGES]
    findings.append(_cores())
    findings.append(_memory())
    path, tried = llvm.find()
    if path is None and not tried:
        findings.append(Finding("LLVM", "no libLLVM found", False, llvm.REMEDY))
    for attempt in tried:
        if attempt.works:
            findings.append(Finding("LLVM", f"{attempt.path} works"))
        else:
            # One that fails matters only if none works.
            remedy = llvm.REMEDY if path is None else ""
            findings.append(Finding("LLVM", f"{attempt.path}: {attempt.failure}", path is not None, remedy))
    findings.append(_cuda())
    try:
        variant = usable_variant()
    except UserError:
        findings.append(Finding("variant", "none works", False, "mend what is reported above"))
        return findings
    findings.append(Finding("variant", variant))
    findings.append(_speed())
    return findings


def _cores() -> Finding:
    """How many are used, of how many, and why."""
    threads, cores = thread_count(), usable_cores()
    told = "" if threads == cores else f", worked on by {threads} thread{'s' if threads > 1 else ''} ({THREADS})"
    return Finding("cores", describe_cores() + told)


def _memory() -> Finding:
    left, limit = available_memory(), limit_given()
    told = "" if limit is None else f", of which {describe_size(limit)} may be taken ({MAX_MEMORY})"
    return Finding("memory", ("unknown" if left is None else f"{describe_size(left)} left") + told)


def _cuda() -> Finding:
    """The device that OptiX uses, or why none; one that is there and does not work may be mended."""
    failure = cuda_failure()
    if failure == NO_DEVICE:
        return Finding("CUDA", f"{failure} (not needed)")
    if failure:
        return Finding("CUDA", f"does not work: {failure}", remedy=_DRIVER)
    return Finding("CUDA", f"{_device()} works")


def _device() -> str:
    """The first device's name, memory and driver, as NVIDIA's own tool has them; "a device" without the tool."""
    command = ["nvidia-smi", "--query-gpu=name,memory.total,driver_version", "--format=csv,noheader"]
    try:
        run = subprocess.run(command, capture_output=True, text=True, timeout=30)
    except (OSError, subprocess.TimeoutExpired):
        return "a device"
    name, *about = (part.strip() for part in run.stdout.partition("\n")[0].split(","))
    return f"{name} ({', driver '.join(about)})" if run.returncode == 0 and len(about) == 2 else "a device"


def _package(name: str) -> Finding:
    try:
        version = importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return Finding(name, "not installed", False, f"pip install {name}")
    if name == "mitsuba" and not version.startswith("3.9."):
        return Finding(name, version, False, "this version is not supported: pip install 'mitsuba>=3.9,<3.10'")
    return Finding(name, version)


def _speed() -> Finding:
    run = subprocess.run([sys.executable, "-m", f"{__package__}.speed"], capture_output=True, text=True, timeout=300)
    if run.returncode != 0:
        lines = (run.stdout + run.stderr).strip().splitlines()
        reason = lines[-1] if lines else f"exit status {run.returncode}"
        return Finding("speed", f"tracing fails: {reason[:200]}", False, "reinstall Mitsuba, or " + llvm.REMEDY)
    return Finding("speed", f"{1e-6 * float(run.stdout):.1f} Mrays/s (shadow rays, all stages of transport)")
