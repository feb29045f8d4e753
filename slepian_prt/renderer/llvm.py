"""Find an LLVM library with which Mitsuba's ``llvm_*`` variants work, without trusting it with our own process.

LLVM 14 is refused by Dr.Jit; 15 and 16 load and then abort the process at the first clamped kernel ("Cannot select …
fminimum"). So every candidate is tried in a child process first, and the outcome remembered per file.

Run as ``python -m slepian_prt.renderer.llvm`` it prints the library's path, or exits with status 1; ``scripts/setup``
uses that. Imports neither Mitsuba nor Dr.Jit.
"""

from __future__ import annotations

import contextlib
import ctypes
import glob
import importlib.metadata
import json
import os
import re
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

# scripts/setup unpacks Debian's libllvm19 here when it may not install packages.
UNPACKED = Path(sys.prefix) / "llvm"

_PATTERNS = (
    str(UNPACKED / "**" / "libLLVM*.so*"),
    "/usr/lib/llvm-*/lib/libLLVM*.so*",
    "/usr/lib/*-linux-gnu/libLLVM*.so*",
    "/usr/lib64/libLLVM*.so*",
    "/usr/lib/libLLVM*.so*",
    "/usr/local/lib/libLLVM*.so*",
    "/opt/homebrew/opt/llvm*/lib/libLLVM*.dylib",
    "/usr/local/opt/llvm*/lib/libLLVM*.dylib",
)

# Exercises what an unsuitable LLVM dies of: a clamped kernel and a ray query.
_PROBE = """
import sys
from slepian_prt.renderer import llvm
llvm.load_neighbours(sys.argv[1])
import mitsuba as mi, drjit as dr
mi.set_variant("llvm_ad_rgb")
scene = mi.load_dict({"type": "scene", "shape": {"type": "sphere"}})
x = dr.arange(mi.Float, 16) / 16
hit = scene.ray_test(mi.Ray3f(mi.Point3f(0, 0, -3), dr.normalize(mi.Vector3f(x, 0, 1))))
assert dr.count(hit)[0] == 6 and dr.allclose(dr.clip(x, 0.25, 0.5)[15], 0.5)
"""

REMEDY = (
    "install LLVM 19 or newer (Debian, Ubuntu: apt-get install libllvm19; Fedora: dnf install llvm-libs; macOS: brew "
    "install llvm), or run scripts/setup, or set DRJIT_LIBLLVM_PATH to a libLLVM file that works"
)


@dataclass(frozen=True)
class Probe:
    """Outcome of trying one library: ``failure`` is empty if it works, else the reason in a few words."""

    path: str
    failure: str

    @property
    def works(self) -> bool:
        """Whether nothing failed."""
        return not self.failure


def candidates() -> list[str]:
    """Library files worth trying: the one that the user names, else all found, newest first, each file once."""
    named = os.environ.get("DRJIT_LIBLLVM_PATH")
    if named:
        return [named]
    found: dict[str, str] = {}
    for pattern in _PATTERNS:
        for path in glob.glob(pattern, recursive=True):
            found.setdefault(os.path.realpath(path), path)
    return sorted(found, key=lambda path: (-_version(path), path))


def find() -> tuple[str | None, list[Probe]]:
    """The first candidate that works, or None, and what was tried up to it."""
    tried: list[Probe] = []
    for path in candidates():
        tried.append(probe(path))
        if tried[-1].works:
            return path, tried
    return None, tried


def probe(path: str) -> Probe:
    """Try a library in a child process. The outcome is remembered until the file or Mitsuba changes."""
    if not os.path.isfile(path):
        return Probe(path, "no such file")
    memory, key = _memory_file(), _fingerprint(path)
    remembered = _read_json(memory)
    if key in remembered:
        return Probe(path, remembered[key])
    failure = _try_in_child(path)
    remembered[key] = failure
    with contextlib.suppress(OSError):  # a read-only home costs the next start a second, nothing else
        _remember(memory, remembered)
    return Probe(path, failure)


def load_neighbours(path: str) -> None:
    """Load what an unpacked libLLVM depends on from its own folder, where the system does not look."""
    folder = Path(path).resolve().parent
    if UNPACKED not in folder.parents:
        return
    waiting = [p for p in sorted(folder.glob("*.so*")) if "LLVM" not in p.name and not p.is_symlink()]
    for _ in range(len(waiting)):  # they depend on each other in an order that we do not know
        failed = []
        for library in waiting:
            try:
                ctypes.CDLL(str(library), mode=ctypes.RTLD_GLOBAL)
            except OSError:
                failed.append(library)
        if len(failed) in (0, len(waiting)):
            return
        waiting = failed


def _try_in_child(path: str) -> str:
    environment = {**os.environ, "DRJIT_LIBLLVM_PATH": path}
    command = [sys.executable, "-c", _PROBE, path]
    try:
        run = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120)
    except subprocess.TimeoutExpired:
        return "did not answer within 120 s"
    if run.returncode == 0:
        return ""
    output = run.stdout + run.stderr
    if "too old" in output:
        return "too old for Dr.Jit"
    if "Cannot select" in output:
        return "kills the process (cannot compile a clamped kernel)"
    if run.returncode < 0:
        return f"kills the process (signal {-run.returncode})"
    lines = [line for line in output.splitlines() if line.strip()]
    return lines[-1].strip()[:200] if lines else f"exit status {run.returncode}"


def _version(path: str) -> float:
    match = re.search(r"/llvm[-@](\d+)", path) or re.search(r"LLVM[-.]?(?:so\.)?(\d+)", os.path.basename(path))
    return float(match.group(1)) if match else 0.0


def _fingerprint(path: str) -> str:
    real = os.path.realpath(path)
    status = os.stat(real)
    version = importlib.metadata.version("mitsuba")
    return f"{real}|{status.st_size}|{status.st_mtime_ns}|mitsuba {version}"


def _memory_file() -> Path:
    home = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
    return Path(home) / "slepian_prt" / "llvm.json"


def _remember(memory: Path, remembered: dict[str, str]) -> None:
    """Through a file whose name nobody can foresee, for a folder that others may write to."""
    memory.parent.mkdir(parents=True, exist_ok=True)
    handle, partial = tempfile.mkstemp(prefix=f"{memory.name}.", dir=memory.parent)
    try:
        with os.fdopen(handle, "w") as file:
            json.dump(remembered, file, indent=1)
        os.replace(partial, memory)
    except BaseException:
        with contextlib.suppress(OSError):
            os.unlink(partial)
        raise


def _read_json(path: Path) -> dict[str, str]:
    try:
        content = json.loads(path.read_text())
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}


def main() -> int:
    """Print the path of a library that works; returns 0, or 1 if there is none."""
    path, tried = find()
    if path:
        print(path)
        return 0
    for attempt in tried:
        print(f"{attempt.path}: {attempt.failure}", file=sys.stderr)
    print(f"no working LLVM library found: {REMEDY}", file=sys.stderr)
    return 1


if __name__ == "__main__":
    sys.exit(main())
