"""--max-error beside the cheapest of an exhaustive sweep, each as a command of its own."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.common import data_folder, line

MAPS = ("courtyard", "interior", "studio", "sunrise")
ERRORS = (0.1, 0.05, 0.02)

_VERIFIED = re.compile(r"error ([\d.]+)% \(predicted ([\d.]+)%; noise of the reference ([\d.]+)%\)")
_TIMES = re.compile(r"predicted ([\d.]+) s, took ([\d.]+) s")


def accuracy() -> None:
    """Errors asked for on two scans under four maps: found, predicted, and the time beside the cheapest setting."""
    with tempfile.TemporaryDirectory() as name:
        for mesh in ("nefertiti", "skull"):
            goals(data_folder() / "meshes" / f"{mesh}.ply", exhaustive(mesh, Path(name) / mesh))


def exhaustive(mesh: str, folder: Path) -> dict:
    """sweep.json of rays, bandlimits and tolerances."""
    maps = [part for name in MAPS for part in ("--environment", str(environment(name)))]
    axes = ["--samples", "64,256,1024", "--bandlimit", "3,4,5,6,8,10,15,20,30"]
    axes += ["--tolerance", "0.3,0.2,0.1,0.05,0.03,0.02,0.01"]
    seconds, _ = command("sweep", data_folder() / "meshes" / f"{mesh}.ply", *maps, *axes, "-o", folder)
    found = json.loads((folder / "sweep.json").read_text())
    line(f"{mesh}: sweep of {len(found['points'])} settings", f"{seconds:.0f} s")
    return found


def goals(mesh: Path, sweep: dict) -> None:
    """Every map and error."""
    for name in MAPS:
        for error in ERRORS:
            what = f"{mesh.stem}, {name}, --max-error {error:g}"
            points = [p for p in sweep["points"] if met(p["error"][name], sweep["reference_noise"][name], error)]
            cheapest = min(points, key=lambda p: p["seconds"], default=None)
            options = ("--max-error", error, "--environment", environment(name))
            seconds, told = command("precompute", mesh, *options, "-o", mesh.stem + ".prt")
            verified, times = _VERIFIED.search(told), _TIMES.search(told)
            if verified is None or times is None:
                best = min(p["error"][name] for p in sweep["points"])
                line(what, f"{told.strip().splitlines()[-1]} (best of the sweep {best:.2%})")
                continue
            found, predicted = float(verified[1]), float(verified[2])
            value = f"error {found:.2f} % (predicted {predicted / found:.2f} of it), "
            value += f"time {times[2]} s (predicted {float(times[1]) / float(times[2]):.2f} of it)"
            if cheapest is None:
                line(what, value + "; no setting of the sweep meets it")
                continue
            numbers = [part for axis in ("samples", "bandlimit", "tolerance") for part in (f"--{axis}", cheapest[axis])]
            alone, _ = command("precompute", mesh, *numbers, "-o", mesh.stem + ".prt")
            line(what, value + f"; command {seconds:.1f} s, {seconds / alone:.2f} of the cheapest of the sweep")


def met(error: float, noise: float, wanted: float) -> bool:
    """The noise of the reference taken off."""
    return max(error**2 - noise**2, 0.0) <= wanted**2


def environment(name: str) -> Path:
    return data_folder() / "environments" / f"{name}.exr"


def command(*arguments: object) -> tuple[float, str]:
    """Seconds and what was printed."""
    begin = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        done = subprocess.run(
            [sys.executable, "-m", "slepian_prt", *map(str, arguments)], capture_output=True, text=True, cwd=folder
        )
    if done.returncode not in (0, 2):
        sys.exit(done.stderr)
    return time.perf_counter() - begin, done.stdout + done.stderr
