"""What more workers gain: one and two of them on a dragon; and, from the costs of its stages, a plan for many more."""

from __future__ import annotations

import json
import math
import os
import pickle
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from benchmarks.common import DRAGONS, ROOT, data_folder, in_child, line

import slepian_prt as sp
from slepian_prt.compression.codec.surface import surface_of
from slepian_prt.compression.grouping import group_scene
from slepian_prt.compression.learning import LearnedBases, learn_bases, pilot_of
from slepian_prt.compression.projection import choose_projection
from slepian_prt.compression.settings import CompressionSettings
from slepian_prt.compression.stored_mesh.stored import store_mesh
from slepian_prt.compression.stream import compress_scene, encode_planned
from slepian_prt.compression.tracing import cut_receivers, trace_and_project
from slepian_prt.compression.tracing_by_workers import TracingJob
from slepian_prt.transport.estimator import Estimator
from slepian_prt.transport.planned import PlannedScene, plan_scene
from slepian_prt.transport.portable import make_portable
from slepian_prt.transport.settings import TransportSettings

RUNS = 3
SAMPLES = 1024

# The plan: vertices and their bandlimit, workers of one core each, and bytes per second between any two of them.
_VERTICES, _BANDLIMIT, _WORKERS, _NETWORK = 100_000_000, 20, (1, 16, 256), 1e9


def scaling() -> None:
    """Workers of one thread each on the largest dragon that is here, and what many would gain."""
    path = DRAGONS / "dragon_vrip.ply"
    if not path.is_file():
        path = data_folder() / "meshes" / "skull.ply"
        print(f"no dragon is here (scripts/fetch_dragons); {path.name} instead")
    _strong(path)
    _moved(path)
    for bandlimit in (10, _BANDLIMIT):
        costs = _measure(path, bandlimit)
        costs.tell(f"{path.stem}, L = {bandlimit}")
    costs.plan()


def _strong(path: Path) -> None:
    """The whole command, file and all, by one and by two workers."""
    from slepian_prt.distributed.crew import open_crew

    seconds: dict[int, list[float]] = {1: [], 2: []}
    with tempfile.TemporaryDirectory() as folder:
        for _ in range(RUNS):
            for workers, taken in seconds.items():
                begin = time.perf_counter()
                with open_crew(workers) as crew:
                    crew.client.run(_one_thread)
                    settings = CompressionSettings(), TransportSettings(10, SAMPLES)
                    packed = compress_scene(path, *settings, crew=crew)
                packed.save(Path(folder) / "out.prt")
                taken.append(time.perf_counter() - begin)
    alone, both = (statistics.median(taken) for taken in seconds.values())
    line(f"{path.stem}, L = 10: one worker of one thread; two", f"{alone:.1f} s; {both:.1f} s")
    gains = [one / two / 2.0 for one, two in zip(*seconds.values(), strict=True)]
    line(
        f"{path.stem}, L = 10: efficiency of two", f"{statistics.median(gains):.2f} ({min(gains):.2f}-{max(gains):.2f})"
    )


# A client of workers that run, from the shell: what it holds beyond the scene, and what goes through the scheduler.
_CLIENT = """
import json, os, sys
from slepian_prt.compression.settings import CompressionSettings
from slepian_prt.compression.stream import compress_scene
from slepian_prt.distributed.crew import open_crew
from slepian_prt.transport.settings import TransportSettings

def memory(name):
    return next(int(line.split()[1]) / 1024 for line in open("/proc/self/status") if line.startswith(name))

def counted():
    import importlib
    return dict(importlib.import_module("benchmarks.traffic").counted)

held = []
with open_crew(scheduler={address!r}) as crew:
    before = sum(crew.client.run_on_scheduler(counted).values())
    packed = compress_scene(
        {path!r}, CompressionSettings(), TransportSettings(10, {samples}), crew=crew,
        on_plan=lambda _: held.append(memory("VmRSS")),
    )
    moved = sum(crew.client.run_on_scheduler(counted).values()) - before
    workers = max(crew.client.run(memory, "VmHWM").values())
packed.save({output!r})
print(json.dumps(dict(
    vertices=packed.vertex_count, moved=moved, file=os.path.getsize({output!r}), beyond=memory("VmHWM") - held[0],
    client=memory("VmHWM"), workers=workers,
)))
"""


def _moved(path: Path) -> None:
    """Through a scheduler of its own, with two workers of its own, as on a cluster."""
    address = f"tcp://127.0.0.1:{_free_port()}"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT / "scripts"), str(ROOT)])}
    options: dict[str, Any] = {"env": environment, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    port = address.rsplit(":", 1)[1]
    dask = [sys.executable, "-m", "dask"]
    scheduler = [
        "scheduler",
        "--host",
        "127.0.0.1",
        "--port",
        port,
        "--no-dashboard",
        "--preload",
        "benchmarks.traffic",
    ]
    workers = ["worker", address, "--nworkers", "2", "--nthreads", "1", "--no-dashboard"]
    with tempfile.TemporaryDirectory() as folder:
        running = [subprocess.Popen([*dask, *each], cwd=folder, **options) for each in (scheduler, workers)]
        try:
            code = _CLIENT.format(
                address=address, path=str(path), samples=SAMPLES // 4, output=str(Path(folder) / "out.prt")
            )
            found = json.loads(in_child(code, str(ROOT)))
        finally:
            for process in running:
                process.terminate()
                process.wait()
    count = found["vertices"]
    through = f"{found['moved'] / count:.1f}; {found['file'] / count:.1f}"
    line(f"{path.stem}, L = 10: bytes per vertex through the scheduler; of the file", through)
    line(f"{path.stem}, L = 10: memory of the client beyond the scene", f"{found['beyond']:.0f} MB")
    whole = f"{found['client']:.0f} MB; {found['workers']:.0f} MB"
    line(f"{path.stem}, L = 10: memory in all, of the client; of a worker, at most", whole)


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def _one_thread() -> None:
    import drjit as dr

    dr.set_thread_count(1)


@dataclass(frozen=True)
class _Costs:
    """Seconds of one core (not of the clock: other work on the machine does not count), and bytes, for each vertex.

    Attributes
    ----------
    once : dict of str to float
        What the client does alone.
    opening : float
        What each worker does before its first block, for all vertices.
    tracing, coding : float
        What workers share.
    sent, kept, coded : float
        Bytes: of the scene that goes to each worker, of coefficients that stay there, and of caps that come back.
    vertices, blocks, pieces : int
        That this was measured on.
    """

    once: dict[str, float]
    opening: float
    tracing: float
    coding: float
    sent: float
    kept: float
    coded: float
    vertices: int
    blocks: int
    pieces: int

    def tell(self, name: str) -> None:
        alone = ", ".join(f"{stage} {1e6 * taken:.1f}" for stage, taken in self.once.items())
        line(f"{name}: us per vertex, once, by the client", alone)
        line(f"{name}: us per vertex, by each worker, to open the scene", f"{1e6 * self.opening:.1f}")
        shared = f"{1e6 * self.tracing:.1f}, {1e6 * self.coding:.1f}"
        line(f"{name}: us per vertex, shared: tracing and projecting, coding", shared)
        moved = f"{self.sent:.0f}; {self.kept:.0f}; {self.coded:.1f}"
        line(f"{name}: bytes per vertex sent to each worker; kept there; back", moved)
        line(f"{name}: blocks traced, pieces coded", f"{self.blocks}, {self.pieces}")

    def plan(self) -> None:
        """Seconds for many more vertices, all costs in proportion to them."""
        count = _VERTICES
        alone = count * sum(self.once.values())
        parallel = count * (self.tracing + self.coding)
        line(f"{count:,} vertices, L = {_BANDLIMIT}: hours of one core that can be shared", f"{parallel / 3600:.1f}")
        line(f"{count:,} vertices: the client alone, minutes", f"{alone / 60:.0f}")
        first = None
        for workers in _WORKERS:
            # The scene goes from worker to worker, so that it is everywhere after so many rounds.
            sending = count * self.sent / _NETWORK * math.ceil(math.log2(workers + 1))
            bringing = count * self.coded / _NETWORK
            whole = alone + count * self.opening + sending + parallel / workers + bringing
            first = first or whole
            line(
                f"{count:,} vertices, {workers} workers: hours in all; speed-up; efficiency; client alone",
                f"{whole / 3600:.2f}; {first / whole:.1f}; {first / whole / workers:.0%}; {alone / whole:.0%}",
            )


def _measure(path: Path, bandlimit: int) -> _Costs:
    import drjit as dr

    _warm_up()
    dr.set_thread_count(1)
    settings = CompressionSettings()
    once: dict[str, float] = {}
    begin = time.process_time()

    def stop(stage: str) -> None:
        nonlocal begin
        once[stage] = time.process_time() - begin
        begin = time.process_time()

    with plan_scene(path, TransportSettings(bandlimit, SAMPLES)) as planned:
        stop("load, plan")
        count = len(planned.scene.receivers)
        receivers = store_mesh(planned.scene.mesh, planned.scene.parts).mesh.receivers
        stop("store mesh")
        grouping = group_scene(settings, planned)
        stop("group")
        source = planned.estimator()
        vectors = source.estimate(pilot_of(grouping, 0)).vectors
        learned = learn_bases(settings, receivers, grouping, bandlimit, 0, vectors)
        stop("learn")
        costs = _trace_and_code(planned, source, learned, path)
        opening = _open(planned, source, learned, path)
    sent = len(pickle.dumps(opening[1]))
    per_vertex = {stage: taken / count for stage, taken in once.items()}
    return replace(costs, once={**per_vertex, **costs.once}, opening=opening[0] / count, sent=sent / count)


def _trace_and_code(planned: PlannedScene, source: Estimator[Any], learned: LearnedBases, path: Path) -> _Costs:
    count = len(planned.scene.receivers)
    begin = time.process_time()
    with trace_and_project(planned, source, learned) as projected:
        traced = time.process_time()
        packed = encode_planned(planned, projected)
        coded = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        packed.save(Path(folder) / "out.prt")
    saved = time.process_time() - coded
    cut = cut_receivers(source, projected.projection)
    kept = float(np.dot(learned.clusters.sizes, projected.projection.widths)) * 4.0 / count
    costs = {"save": saved / count}
    per_vertex = (traced - begin) / count, (coded - traced) / count
    return _Costs(costs, 0.0, *per_vertex, 0.0, kept, packed.bytes_per_vertex, count, len(cut.blocks), len(cut.pieces))


def _open(planned: PlannedScene, source: Estimator[Any], learned: LearnedBases, path: Path) -> tuple[float, TracingJob]:
    """Seconds that a worker takes before its first block, and what it is sent."""
    projection = choose_projection(replace(learned, widest={}))  # as a command does that chooses once
    cut = cut_receivers(source, projection)
    job = TracingJob(make_portable(planned, path), projection.as_sent(), cut, "scaling", "")
    sent = pickle.dumps(job)
    begin = time.process_time()
    arrived: TracingJob = pickle.loads(sent)
    with arrived.open() as opened:
        few = opened.cut.blocks[0][:64]
        next(iter(opened.source.blocks([few], opened.projection.block)))
        surface_of(opened.projection.learned.receivers).rows([arrived.projection.learned.clusters.members[0]])
        return time.process_time() - begin, job


def _warm_up() -> None:
    """What is paid for once, whatever the scene: imports, kernels, tables."""
    compress_scene(sp.example("knot"), CompressionSettings(), TransportSettings(4, 64))
