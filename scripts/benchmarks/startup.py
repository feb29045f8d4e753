"""Seconds of whole processes, from the shell, and what first light is made of."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median

import numpy as np
import trimesh
from benchmarks.common import data_folder, line, median_seconds

import slepian_prt as sp
from slepian_prt.compression.decoder import decode_all, forget
from slepian_prt.relighting.factors import all_factors
from slepian_prt.relighting.operator import TransferOperator
from slepian_prt.transport.directions import direction_set

_RUNS = 7


def startup() -> None:
    """Commands beside a Python that does nothing and one that imports Mitsuba; first light; direction tables."""
    skull = data_folder() / "meshes" / "skull.ply"
    studio = str(data_folder() / "environments" / "studio.exr")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        trimesh.creation.icosphere(4).export(folder / "sphere.ply")
        files = {bandlimit: folder / f"skull_{bandlimit}.prt" for bandlimit in (10, 20)}
        for bandlimit, file in files.items():
            sp.compress(sp.precompute(skull, bandlimit=bandlimit, samples=256), tolerance=0.02).save(file)
        relight = ("relight", str(files[10]), "--environment", studio, "-o")
        _process("python -c pass", "-c", "pass")
        _process("python -c 'import mitsuba'", "-c", "import mitsuba")
        _process("import slepian_prt", "-c", "import slepian_prt")
        _command("--help", "--help")
        _command("info, skull, L = 10", "info", str(files[10]))
        _command("info, skull, L = 20", "info", str(files[20]))
        _command("relight to .npz, skull, L = 10", *relight, str(folder / "relit.npz"))
        _command("relight to .png, 800 pixels wide, skull, L = 10", *relight, str(folder / "relit.png"))
        _command("precompute a sphere of 2,562 vertices", "precompute", str(folder / "sphere.ply"), "-o",
                 str(folder / "sphere.prt"))  # fmt: skip
        for bandlimit, file in files.items():
            _first_light(f"skull, L = {bandlimit}, tolerance 0.02", file)
    for bandlimit in (10, 20):
        _tables(bandlimit)


def _command(name: str, *arguments: str) -> None:
    _process(name, "-m", "slepian_prt", *arguments)


def _process(name: str, *arguments: str) -> None:
    """Wall seconds of a process, and those that its processors worked: the latter hardly depend on what else runs."""
    wall, busy = [], []
    for _ in range(_RUNS):
        before, begin = _seconds_of_children(), time.perf_counter()
        subprocess.run([sys.executable, *arguments], check=True, capture_output=True, env=os.environ)
        wall.append(time.perf_counter() - begin)
        busy.append(_seconds_of_children() - before)
    line(name, f"{median(wall):.2f} s ({median(busy):.2f} s of processors)")


def _seconds_of_children() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _first_light(name: str, file: Path) -> None:
    lighting = np.random.default_rng(0).normal(size=(1, 3, (sp.load(file).bandlimit + 1) ** 2))
    stages: dict[str, list[float]] = {"load": [], "decode": [], "operator": [], "product": []}
    for _ in range(_RUNS):
        clock = [time.perf_counter()]
        packed = sp.load(file)
        clock.append(time.perf_counter())
        decode_all(packed)
        clock.append(time.perf_counter())
        operator = TransferOperator(all_factors(packed), packed.clusters.members)
        clock.append(time.perf_counter())
        operator.apply(lighting)
        clock.append(time.perf_counter())
        forget(packed)
        for stage, seconds in zip(stages, np.diff(clock), strict=True):
            stages[stage].append(float(seconds))
    told = ", ".join(f"{stage} {1e3 * median(seconds):.0f} ms" for stage, seconds in stages.items())
    line(f"first light of {name}", told)


def _tables(bandlimit: int) -> None:
    """What the first block of receivers waits for."""

    def make() -> None:
        direction_set.cache_clear()
        direction_set(900).tables(bandlimit)

    line(f"900 directions and their tables, L = {bandlimit}", f"{1e3 * median_seconds(make):.0f} ms")
