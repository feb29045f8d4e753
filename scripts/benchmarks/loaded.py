"""A machine that also does other work: what two busy loops cost, one thread of BLAS, and eight threads that relight."""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, nullcontext
from pathlib import Path

import numpy as np
from benchmarks.common import line, median_seconds
from threadpoolctl import threadpool_limits

import slepian_prt as sp
from slepian_prt.compression.grouping import group_transfer
from slepian_prt.compression.principal_components import iterate_clusters
from slepian_prt.compression.settings import CompressionSettings
from slepian_prt.machine import threads

_THREADS = 8

# Wanted of one run beside two busy loops, against one of an idle machine of two cores.
_WANTED = 2.2


def loaded() -> None:
    """One --max-error run idle and beside two busy loops; stages with one and many threads of BLAS; 8 threads relight.

    SLEPIAN_PRT_BENCHMARK_RUNS (3) says how often each, SLEPIAN_PRT_BENCHMARK_AROUND (192) how many vertices the model
    has along a knot (a quarter of that around it).
    """
    runs = int(os.environ.get("SLEPIAN_PRT_BENCHMARK_RUNS", "3"))
    around = int(os.environ.get("SLEPIAN_PRT_BENCHMARK_AROUND", "192"))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        _write_knot(folder / "knot.obj", around)
        _write_light(folder / "light.hdr")
        _command(folder, runs)
        transfer = sp.precompute(folder / "knot.obj", 10, 64)
    _stages(transfer, runs)
    _relighting(transfer, runs)


def _write_knot(path: Path, along: int) -> None:
    """A trefoil, whose parts shadow each other."""
    across = max(3, along // 4)
    t, u = np.meshgrid(np.arange(along) / along * 2 * np.pi, np.arange(across) / across * 2 * np.pi, indexing="ij")

    def center(at: np.ndarray) -> np.ndarray:
        return np.stack([np.sin(at) + 2 * np.sin(2 * at), np.cos(at) - 2 * np.cos(2 * at), -np.sin(3 * at)], axis=-1)

    tangent = center(t + 1e-4) - center(t - 1e-4)
    side = np.cross(tangent, [0.0, 0.0, 1.0])
    up = np.cross(side, tangent)
    side, up = (v / np.linalg.norm(v, axis=-1, keepdims=True) for v in (side, up))
    points = center(t) + 0.5 * (np.cos(u)[..., None] * side + np.sin(u)[..., None] * up)
    number = 1 + np.arange(along * across).reshape(along, across)
    right, above = np.roll(number, -1, axis=0), np.roll(number, -1, axis=1)
    corners = np.stack([number, right, np.roll(right, -1, axis=1), above], axis=-1).reshape(-1, 4)
    lines = ["v {:.6f} {:.6f} {:.6f}".format(*point) for point in points.reshape(-1, 3)]
    path.write_text("\n".join([*lines, *("f {} {} {} {}".format(*face) for face in corners)]) + "\n")


def _write_light(path: Path) -> None:
    """A bright sky with a soft lamp in it, as RGBE that is not compressed."""
    height, width = 32, 64
    polar, azimuth = (np.arange(height) + 0.5) / height * np.pi, (np.arange(width) + 0.5) / width * 2 * np.pi
    up = np.cos(polar)[:, None]
    toward = 0.6 * up + 0.8 * np.sin(polar)[:, None] * np.cos(azimuth)
    brightness = 64.0 + 64.0 * np.maximum(up, 0.0) + 120.0 * np.exp(6.0 * (toward - 1.0))
    texels = np.full((height, width, 4), 128, dtype=np.uint8)
    texels[..., :3] = brightness[..., None]
    path.write_bytes(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y %d +X %d\n" % (height, width) + texels.tobytes())


def _command(folder: Path, runs: int) -> None:
    """Idle and loaded runs take turns, so that what else goes on counts for both."""
    _run(folder)  # what is compiled and read for the first time counts for neither
    idle, beside = [], []
    for _ in range(runs):
        idle.append(_run(folder))
        with _busy(2):
            beside.append(_run(folder))
    for number, name in ((idle, "idle"), (beside, "beside two busy loops")):
        median = statistics.median(seconds for seconds, _ in number)
        told = (f"{stage} {statistics.median(own[stage] for _, own in number):.2f}" for stage in number[0][1])
        line(f"--max-error, {name}", f"{median:.1f} s ({', '.join(told)})")
    ratio = statistics.median(s for s, _ in beside) / statistics.median(s for s, _ in idle)
    line("--max-error, beside two busy loops / idle", f"{ratio:.2f} (wanted: at most {_WANTED})")


def _run(folder: Path) -> tuple[float, dict[str, float]]:
    """Seconds of one command in a process of its own, and of its stages; a failure ends the benchmark."""
    output = folder / "run.prt"
    output.unlink(missing_ok=True)
    command = ["precompute", "knot.obj", "--max-error", "0.05", "--environment", "light.hdr", "-o", "run.prt"]
    with tempfile.TemporaryDirectory() as cache:
        environment = {**os.environ, "SLEPIAN_PRT_CACHE": cache, "PYTHONPATH": os.pathsep.join(sys.path)}
        begin = time.perf_counter()
        done = subprocess.run(
            [sys.executable, "-m", "slepian_prt", *command], cwd=folder, capture_output=True, env=environment
        )
        seconds = time.perf_counter() - begin
    if done.returncode != 0:
        sys.exit(f"{' '.join(command)} ended with {done.returncode}:\n{done.stderr.decode()}")
    return seconds, sp.load(output).seconds


@contextmanager
def _busy(count: int) -> Iterator[None]:
    """Processes that do nothing else."""
    loops = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]
    try:
        yield
    finally:
        for loop in loops:
            loop.kill()
            loop.wait()


def _stages(transfer: sp.Transfer, runs: int) -> None:
    """The policy against BLAS with as many threads as there are cores, and beside two busy loops."""
    grouping = group_transfer(CompressionSettings(), transfer)
    axes, vectors = transfer.axes, transfer.vectors
    stages = {
        "clustered PCA, 4 terms": lambda: iterate_clusters(grouping.clusters, axes, vectors, 4),
        "clustered PCA, 64 terms": lambda: iterate_clusters(grouping.clusters, axes, vectors, 64),
        "compression, 16 terms": lambda: sp.compress(transfer, "adapted", terms=16, clusters=grouping),
        "compression, pca": lambda: sp.compress(transfer, "pca", terms=16, clusters=grouping),
        "compression, coded": lambda: sp.compress(transfer, clusters=grouping),
        "relighting of vectors, 60 lights": lambda: sp.relight(transfer, np.ones((60, 3, vectors.shape[2]))),
    }
    for name, work in stages.items():
        work()
        idle = median_seconds(work, runs)
        with threadpool_limits(threads.usable_cores(), "blas"), _policy_off():
            many = median_seconds(work, runs)
        with _busy(2):  # with threads of BLAS it would take minutes
            beside = median_seconds(work, runs)
        ratios = f"{idle / many:.2f}; beside / idle {beside / idle:.2f}"
        line(name, f"{idle:.2f} s, with threads of BLAS {many:.2f} s, beside two busy loops {beside:.2f} s ({ratios})")


@contextmanager
def _policy_off() -> Iterator[None]:
    kept, threads._one_thread = threads._one_thread, nullcontext()  # type: ignore[assignment]
    try:
        yield
    finally:
        threads._one_thread = kept


def _relighting(transfer: sp.Transfer, runs: int) -> None:
    """Eight requests at once, against one after another."""
    packed, repeats = sp.compress(transfer), 40
    lights = np.random.default_rng(0).normal(size=(_THREADS, 3, transfer.vectors.shape[2]))
    maps = np.random.default_rng(1).random((_THREADS, 256, 512, 3), dtype=np.float32)

    def relight(i: int) -> None:
        for _ in range(repeats):
            sp.relight(packed, lights[i])

    def project(i: int) -> None:
        sp.project_environment(maps[i], 10)

    for name, work in (("relight", relight), ("project_environment", project)):
        work(0)
        alone = median_seconds(lambda work=work: [work(i) for i in range(_THREADS)], runs)
        with ThreadPoolExecutor(_THREADS) as pool:
            together = median_seconds(lambda work=work, pool=pool: list(pool.map(work, range(_THREADS))), runs)
        told = {"one_after_another": round(alone, 3), "at_once": round(together, 3)}
        line(f"{name}, 8 threads at once / one after another", f"{together / alone:.2f} {json.dumps(told)}")
