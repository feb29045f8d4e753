"""Kill commands at random moments, and say whether the same command, begun again, comes to the same result.

    scripts/kill_runs [N] [--seed S] [--command precompute|sweep|compare]

Each command runs once undisturbed. Then it is begun N times, killed (SIGKILL, with all of its processes) after a time
drawn evenly from what it took undisturbed, and begun again, in folders of its own. Counted are

    killed     how often the kill came before the end
    torn       files under their final names that are no whole files after the kill
    went on    second runs that kept blocks or settings of the first
    differs    second runs whose results differ from those undisturbed: all bytes of a .prt but its timings, all
               figures of a sweep or comparison that are no seconds
    left       unfinished files, or work in the cache folder, after the second run
    failed     second runs that ended with anything but 0

It exits with 1 if anything is torn, differs, is left, or failed; what is wrong is told with its moment.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import zipfile
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

ROOT = Path(__file__).resolve().parent.parent

_MODEL = "bumpy.ply"
_LIGHT = ["--environment", str(ROOT / "scenes" / "sky.exr")]
COMMANDS = {
    "precompute": [_MODEL, "-o", "out.prt", "--bandlimit", "8", "--samples", "1024", "--clusters", "12"],
    "sweep": [_MODEL, *_LIGHT, "-o", "out", "--samples", "64,256", "--bandlimit", "3,5", "--clusters", "12",
              "--tolerance", "0.2,0.05", "--noise", "0.05"],
    "compare": [_MODEL, *_LIGHT, "-o", "out", "--bandlimit", "4", "--samples", "64", "--clusters", "12", "--terms", "4",
                "--width", "64", "--noise", "0.1", "--basis", "adapted", "--basis", "sh"],
}  # fmt: skip

COUNTED = ("killed", "torn", "went on", "differs", "left", "failed")
_FAULTS = ("torn", "differs", "left", "failed")

# No command takes as long.
_TIMEOUT = 600.0


def main() -> int:
    """Kill, begin again and print a table."""
    parser = argparse.ArgumentParser(
        prog="scripts/kill_runs", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("count", type=int, nargs="?", default=50, metavar="N", help="kills of each command (50)")
    parser.add_argument("--seed", type=int, help="of the moments; another one each time unless given")
    parser.add_argument("--command", action="append", choices=tuple(COMMANDS), help="only this one; may be repeated")
    options = parser.parse_args()
    seed = random.SystemRandom().randrange(1 << 32) if options.seed is None else options.seed
    print(f"seed {seed}", flush=True)
    moments = random.Random(seed)
    total: Counter[str] = Counter()
    print(f"{'command':12}{'seconds':>9}" + "".join(f"{name:>10}" for name in COUNTED), flush=True)
    for command in options.command or COMMANDS:
        seconds, counted = kill_runs(command, options.count, moments)
        total += counted
        print(f"{command:12}{seconds:9.1f}" + "".join(f"{counted[name]:10}" for name in COUNTED), flush=True)
    return int(any(total[fault] for fault in _FAULTS))


def kill_runs(command: str, count: int, moments: random.Random, subdivisions: int = 5) -> tuple[float, Counter[str]]:
    """Seconds of the undisturbed run, and what came of ``count`` others that were killed."""
    counted: Counter[str] = Counter()
    with tempfile.TemporaryDirectory(prefix="kill_runs-") as name:
        undisturbed = _folder(Path(name) / "undisturbed", subdivisions)
        started = time.perf_counter()
        status, said = _run(command, undisturbed)
        seconds = time.perf_counter() - started
        if status != 0:
            raise SystemExit(f"{command} fails undisturbed: {said}")
        wanted = results(undisturbed)
        for number in range(count):
            after = moments.uniform(0.0, seconds)
            folder = _folder(Path(name) / str(number), subdivisions)
            found = _kill_and_go_on(command, folder, after, wanted)
            for fault in (fault for fault in _FAULTS if found[fault]):
                print(f"{command}, killed after {after:.2f} s: {fault}", flush=True)
            counted += found
            shutil.rmtree(folder)
    return seconds, counted


def _kill_and_go_on(command: str, folder: Path, after: float, wanted: Any) -> Counter[str]:
    process = _begin(command, folder)
    try:
        process.communicate(timeout=after)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
    torn = sum(not is_whole(path) for path in _outputs(folder))
    status, said = _run(command, folder)
    left = [path.name for path in folder.rglob("*") if path.name.endswith((".part", ".partial.jsonl"))]
    left += [path.name for path in (folder / "cache").glob("*")]
    return Counter(
        {
            "killed": process.returncode == -signal.SIGKILL,
            "torn": torn,
            "went on": "finished before and" in said,
            "differs": status == 0 and results(folder) != wanted,
            "left": len(left),
            "failed": status != 0,
        }
    )


def _folder(folder: Path, subdivisions: int) -> Path:
    """With a model in it that shadows itself."""
    folder.mkdir()
    ball = trimesh.creation.icosphere(subdivisions)
    radius = 1.0 + 0.25 * np.prod(np.sin(4.0 * ball.vertices), axis=1) + 0.15 * np.sin(5.0 * ball.vertices[:, 0])
    trimesh.Trimesh(ball.vertices * radius[:, None], ball.faces, process=False).export(folder / _MODEL)
    return folder


def _begin(command: str, folder: Path) -> subprocess.Popen[str]:
    """In a session of its own, so that all of its processes can be killed."""
    path = os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH"))))
    return subprocess.Popen(
        [sys.executable, "-m", "slepian_prt", command, *COMMANDS[command]],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
        env={**os.environ, "PYTHONPATH": path, "SLEPIAN_PRT_CACHE": str(folder / "cache")},
    )


def _run(command: str, folder: Path) -> tuple[int, str]:
    process = _begin(command, folder)
    said, _ = process.communicate(timeout=_TIMEOUT)
    return process.returncode, said


def _outputs(folder: Path) -> list[Path]:
    """Files under their final names."""
    found = [folder / "out.prt", *(folder / "out").glob("[!.]*")]
    return [path for path in found if path.is_file() and path.name != "sweep.partial.jsonl"]


def is_whole(path: Path) -> bool:
    """Whether a file ends as files of its kind do."""
    if path.suffix == ".prt":
        return zipfile.is_zipfile(path) and zipfile.ZipFile(path).testzip() is None
    if path.suffix == ".json":
        try:
            json.loads(path.read_text())
        except ValueError:
            return False
        return True
    ends = {".png": b"IEND\xaeB`\x82", ".html": b"</html>", ".csv": b"\n"}
    return path.read_bytes().rstrip(b" " if path.suffix == ".csv" else b"\n").endswith(ends[path.suffix])


def results(folder: Path) -> Any:
    """What two runs have to agree in."""
    if (folder / "out.prt").is_file():
        with zipfile.ZipFile(folder / "out.prt") as file:
            contents: dict[str, Any] = {name: file.read(name) for name in file.namelist()}
        return {name: _untimed(json.loads(content)) if name.endswith(".json") else content
                for name, content in contents.items()}  # fmt: skip
    (file,) = (folder / "out").glob("*.json")
    return sorted(path.name for path in (folder / "out").iterdir()), _untimed(json.loads(file.read_text()))


def _untimed(value: Any) -> Any:
    """Without seconds, and what is chosen by them."""
    if isinstance(value, dict):
        return {key: _untimed(part) for key, part in value.items() if not re.search("seconds|pareto|spread", key)}
    return [_untimed(part) for part in value] if isinstance(value, list) else value


if __name__ == "__main__":
    sys.exit(main())
