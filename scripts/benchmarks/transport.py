"""Transport beside the ray tracer's own limit, and over the ladder of Stanford dragons."""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from benchmarks.common import DRAGONS, PEAK_MEMORY, ROOT, data_folder, in_child, line

import slepian_prt as sp
from slepian_prt.scene.loading import open_scene
from slepian_prt.scene.receivers import morton
from slepian_prt.scene.scene import mitsuba_scene
from slepian_prt.transport.direct import DirectTransfer
from slepian_prt.transport.directions import direction_set
from slepian_prt.transport.interreflection import gather_operator
from slepian_prt.transport.occlusion import OcclusionTables
from slepian_prt.transport.survey import Survey
from slepian_prt.transport.visibility import VisibilityTracer

SAMPLES = 1024
RUNS = 5

# A folder with another version, to be timed beside this one.
OLD = os.environ.get("SLEPIAN_PRT_OLD", "")


class _Timed:
    """A Mitsuba scene whose rays are evaluated before the clock starts: raw `ray_test` on prebuilt rays."""

    def __init__(self, geometry: Any) -> None:
        self.geometry, self.seconds, self.spent, self.kept = geometry, 0.0, 0.0, []

    def ray_test(self, ray: Any) -> Any:
        import drjit as dr

        dr.eval(ray)
        dr.sync_thread()
        begin, spent = time.perf_counter(), time.process_time()
        hit = self.geometry.ray_test(ray)
        dr.eval(hit)
        dr.sync_thread()
        self.seconds += time.perf_counter() - begin
        self.spent += time.process_time() - spent
        if not self.kept:
            self.kept.append((np.array(ray.o).T, np.array(ray.d).T))
        return hit


def _meshes() -> list[Path]:
    found = [data_folder() / "meshes" / "nefertiti.ply", DRAGONS / "dragon_vrip_res2.ply"]
    for path in found:
        if not path.is_file():
            print(f"{path.name}: not here, left out (SLEPIAN_PRT_DATA, scripts/fetch_dragons)")
    return [path for path in found if path.is_file()]


def transport() -> None:
    """Rays per second of precompute and its stages, beside raw ray_test on the same rays and trimesh with Embree."""
    for path in _meshes():
        for bandlimit in (10, 20):
            _throughput(path, bandlimit)


def _throughput(path: Path, bandlimit: int) -> None:
    ours: list[tuple[float, float]] = []
    raw: list[tuple[float, float]] = []
    robust: list[tuple[float, float]] = []
    stages = defaultdict(list)
    with open_scene(path) as scene:
        plan = Survey.of(scene).plan(bandlimit, SAMPLES)
        positions = scene.traced_positions
        order = plan.shadowed[np.argsort(morton(positions[plan.shadowed]), kind="stable")]
        directions = direction_set(plan.nodes)
        block = max(1, (1 << 21) // directions.size)
        begin = time.perf_counter()
        DirectTransfer(scene, bandlimit, plan.nodes, plan.shadowed[:block], 0).estimate()
        first = time.perf_counter() - begin
        blocks = [order[start : start + block] for start in range(0, order.size, block)]
        modes = [
            (mitsuba_scene(replace(scene, robust=mode)), seconds) for mode, seconds in ((False, raw), (True, robust))
        ]
        for _ in range(RUNS):
            begin, spent = time.perf_counter(), time.process_time()
            rays = DirectTransfer(scene, bandlimit, plan.nodes, plan.shadowed, 0).estimate().rays
            ours.append((time.perf_counter() - begin, time.process_time() - spent))
            tracer, tables = VisibilityTracer(scene, directions, 0), OcclusionTables(directions, bandlimit)
            for geometry, seconds in modes:
                tracer.geometry = timed = _Timed(geometry)
                for chosen in blocks:
                    tracer.trace(chosen)
                seconds.append((timed.seconds, timed.spent))
            tracer.geometry = scene.geometry
            traced = projected = 0.0
            for chosen in blocks:
                begin = time.perf_counter()
                samples = tracer.trace(chosen)
                middle = time.perf_counter()
                tables.open(samples)
                traced, projected = traced + middle - begin, projected + time.perf_counter() - middle
            stages["trace"].append(traced)
            stages["project"].append(projected)
            begin = time.perf_counter()
            gather_operator(scene, SAMPLES // 4, plan.shadowed, None, 1)
            stages["gather"].append(time.perf_counter() - begin)
        peer, is_robust = _embree(timed.kept[0], scene), scene.is_robust
    name = f"{path.stem}, L = {bandlimit}"
    median = {stage: statistics.median(seconds) for stage, seconds in stages.items()}
    wall, spent = np.median(ours, axis=0)
    line(f"{name}: rays per second, tracing and projecting", f"{rays / wall / 1e6:.1f} M{' (robust)' * is_robust}")
    for mode, seconds in (("non-robust", raw), ("robust", robust)):
        # Run by run, so that what else the machine does is in both; seconds of the cores are what an idle one would do.
        part, of_cores = np.median(np.array(seconds) / np.array(ours), axis=0)
        limit = rays / np.median(seconds, axis=0)[0]
        line(f"{name}: raw {mode} ray_test on the same rays, prebuilt", f"{limit / 1e6:.1f} M")
        line(f"{name}: ours, part of raw {mode}; by seconds of the cores", f"{part:.0%}; {of_cores:.0%}")
    if OLD:
        old = _by_old(path, bandlimit)
        line(f"{name}: seconds, and of the cores, old and new", f"{old}; {wall:.2f} {spent:.2f}")
    beside = "embreex is not installed" if peer is None else f"{peer / 1e6:.1f} M"
    line(f"{name}: trimesh + embreex on a block of them", beside)
    line(f"{name}: vertex-samples per second", f"{plan.shadowed.size * SAMPLES / wall / 1e6:.1f} M")
    text = ", ".join(f"{stage} {seconds:.2f} s" for stage, seconds in median.items())
    line(f"{name}: stages one after the other", f"{text}, write {_write(path, bandlimit):.2f} s")
    line(f"{name}: first block, with direction tables and kernels", f"{first:.2f} s")
    if bandlimit == 10:
        _whole_command(name, path, float(np.median(raw, axis=0)[0]))


def _by_old(path: Path, bandlimit: int) -> str:
    """Seconds that the version in the folder OLD takes to trace and project, and seconds of the cores."""
    code = f"""
import time, numpy as np
from slepian_prt.scene.loading import open_scene
from slepian_prt.transport.direct import DirectTransfer
from slepian_prt.transport.survey import Survey
with open_scene({str(path)!r}) as scene:
    plan, times = Survey.of(scene).plan({bandlimit}, {SAMPLES}), []
    for _ in range({RUNS + 1}):
        begin = time.perf_counter(), time.process_time()
        DirectTransfer(scene, {bandlimit}, plan.nodes, plan.shadowed, 0).estimate()
        times.append((time.perf_counter() - begin[0], time.process_time() - begin[1]))
print("%.2f %.2f" % tuple(np.median(times[1:], axis=0)))
"""
    return in_child(code, OLD)


def _whole_command(name: str, path: Path, raw: float) -> None:
    """From the shell, beside twice the raw rays and two seconds."""
    for which, folder in (("old", OLD), ("new", str(ROOT))):
        if not folder:
            continue
        with tempfile.TemporaryDirectory() as out:
            command = [sys.executable, "-m", "slepian_prt", "precompute", str(path), "-o", f"{out}/out.prt"]
            environment = {**os.environ, "PYTHONPATH": folder}
            times = []
            for _ in range(3):
                begin, before = time.perf_counter(), os.times()
                subprocess.run(
                    [*command, "--samples", str(SAMPLES)], cwd=out, env=environment, capture_output=True, check=True
                )
                after = os.times()
                spent = sum(after[2:4]) - sum(before[2:4])
                times.append((time.perf_counter() - begin, spent))
            wall, spent = np.median(times, axis=0)
        line(f"{name}: {which} command, seconds and of the cores", f"{wall:.1f} {spent:.1f}")
    line(f"{name}: twice the raw rays and two seconds", f"{2.0 * raw + 2.0:.1f}")


def _embree(rays: tuple[np.ndarray, np.ndarray], scene: Any) -> float | None:
    try:
        from trimesh.ray.ray_pyembree import RayMeshIntersector
    except ImportError:
        return None
    import trimesh

    mesh = trimesh.Trimesh(scene.traced_positions, scene.mesh.faces, process=False)
    intersector = RayMeshIntersector(mesh, scale_to_box=False)
    intersector.intersects_any(*(part[:1000] for part in rays))
    times = []
    for _ in range(3):
        begin = time.perf_counter()
        intersector.intersects_any(*rays)
        times.append(time.perf_counter() - begin)
    return len(rays[0]) / statistics.median(times)


def _write(path: Path, bandlimit: int) -> float:
    """Seconds to compress at the default tolerance and to write the file."""
    transfer = sp.precompute(path, bandlimit, 64)
    with tempfile.TemporaryDirectory() as folder:
        begin = time.perf_counter()
        sp.compress(transfer).save(Path(folder) / "out.prt")
        return time.perf_counter() - begin


def dragons() -> None:
    """Time and peak memory of precompute over the Stanford dragons; each run in a process of its own."""
    if not DRAGONS.is_dir():
        sys.exit("the dragons are not here; run scripts/fetch_dragons")
    for bandlimit in (10, 20):
        for name in ("dragon_vrip_res4", "dragon_vrip_res3", "dragon_vrip_res2", "dragon_vrip"):
            path = DRAGONS / f"{name}.ply"
            code = (
                "import tempfile, pathlib, time; from slepian_prt.compression.stream import compress_scene;"
                "from slepian_prt.compression.settings import CompressionSettings;"
                "from slepian_prt.transport.settings import TransportSettings;"
                "begin = time.perf_counter();"
                f"transport = TransportSettings({bandlimit}); settings = CompressionSettings(tolerance=0.05);"
                f"p = compress_scene({str(path)!r}, settings, transport);"
                "p.save(pathlib.Path(tempfile.mkdtemp()) / 'out.prt'); total = time.perf_counter() - begin;"
                "rate = p.rays_traced / p.seconds['transport'] / 1e6;"
                "print(len(p.mesh.positions), 'vertices,',"
                "f\"transport {p.seconds['transport']:.1f} s, {rate:.1f} Mrays/s,\","
                "f\"compress {p.seconds['compress']:.1f} s, {p.bytes_per_vertex:.1f} bytes per vertex,\","
                f"f'in all {{total:.1f}} s,', {PEAK_MEMORY})"
            )
            line(f"precompute, L = {bandlimit}, {name}", in_child(code))
