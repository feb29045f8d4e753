"""Everything that a graphics card does: rays beside the tracer's own, whole precomputes, relit frames."""

from __future__ import annotations

import os
import statistics
import sys
import time
from typing import Any

import numpy as np
from benchmarks.common import DRAGONS, PEAK_MEMORY, data_folder, in_child, line

import slepian_prt as sp
from slepian_prt.compression.settings import CompressionSettings
from slepian_prt.compression.stream import compress_scene
from slepian_prt.relighting.mitsuba.device_operator import DeviceOperator
from slepian_prt.relighting.operator import transfer_operator
from slepian_prt.renderer.variants import cuda_failure, mitsuba, usable_variant
from slepian_prt.scene.loading import open_scene
from slepian_prt.transport.direct import DirectTransfer
from slepian_prt.transport.settings import TransportSettings
from slepian_prt.transport.survey import Survey

SAMPLES = 1024
LADDER = ("dragon_vrip_res4", "dragon_vrip_res3", "dragon_vrip_res2", "dragon_vrip")
FRAMES = 100

# Processors, on which nobody would take this way, are shown the first two dragons: of the last each run takes minutes.
ON_PROCESSORS = 2


class _Timed:
    """A Mitsuba scene whose rays are evaluated before the clock starts: raw `ray_test` on prebuilt rays."""

    def __init__(self, geometry: Any) -> None:
        self.geometry, self.seconds = geometry, 0.0

    def ray_test(self, ray: Any) -> Any:
        import drjit as dr

        dr.eval(ray)
        dr.sync_thread()
        begin = time.perf_counter()
        hit = self.geometry.ray_test(ray)
        dr.eval(hit)
        dr.sync_thread()
        self.seconds += time.perf_counter() - begin
        return hit


def gpu() -> None:
    """Rays beside raw OptiX, whole precomputes of the dragons, relit frames; --variant llvm_ad_rgb on processors."""
    if not usable_variant().startswith("cuda_") and not os.environ.get("SLEPIAN_PRT_VARIANT"):
        print(f"no graphics card to measure ({cuda_failure()}); add --variant llvm_ad_rgb to see it run on processors")
        return
    if not DRAGONS.is_dir():
        sys.exit("the dragons are not here; run scripts/fetch_dragons")
    ladder = LADDER if usable_variant().startswith("cuda_") else LADDER[:ON_PROCESSORS]
    line("variant", usable_variant())
    for bandlimit in (10, 20):
        _rays(ladder[-1], bandlimit)
    for bandlimit in (10, 20):
        for name in ladder:
            _whole(name, bandlimit)
    _frames(ladder[-1])


def _rays(dragon: str, bandlimit: int) -> None:
    """Trace and project all receivers of a dragon on the device, beside its rays alone."""
    import drjit as dr

    with open_scene(DRAGONS / f"{dragon}.ply") as scene:
        plan = Survey.of(scene).plan(bandlimit, SAMPLES)
        source = DirectTransfer(scene, bandlimit, plan.nodes, plan.shadowed, 0, on_device=True)
        pieces = source.pieces()

        def run() -> tuple[float, int]:
            before, begin = source.rays, time.perf_counter()
            for _ in source.blocks(pieces):
                dr.sync_thread()
            return time.perf_counter() - begin, source.rays - before

        first, _ = run()
        times = [run() for _ in range(3)]
        ours, rays = statistics.median(seconds for seconds, _ in times), times[0][1]
        tracer = source._instruments[0]
        tracer.geometry = timed = _Timed(tracer.geometry)
        run()
        raws = []
        for _ in range(3):
            timed.seconds = 0.0
            run()
            raws.append(timed.seconds)
        raw = statistics.median(raws)
    name = f"{len(scene.receivers):,} vertices, L = {bandlimit}"
    line(f"{name}: rays per second, traced and made vectors, on the device", f"{rays / ours / 1e6:.0f} M")
    line("  the same rays by ray_test alone, prebuilt", f"{rays / raw / 1e6:.0f} M")
    line("  part of raw (wanted: 0.6); seconds; the first time, with kernels and tables",
         f"{raw / ours:.2f}; {ours:.2f}; {first:.2f}")  # fmt: skip


def _whole(name: str, bandlimit: int) -> None:
    """All of precompute in a process of its own, imports and a first small scene aside, file written."""
    settings = "CompressionSettings(tolerance=0.05)"
    code = f"""
import pathlib, tempfile, time
from slepian_prt.compression.settings import CompressionSettings
from slepian_prt.compression.stream import compress_scene
from slepian_prt.transport.settings import TransportSettings
folder = pathlib.Path({str(DRAGONS)!r})
def run(name):
    begin = time.perf_counter()
    made = compress_scene(str(folder / f"{{name}}.ply"), {settings}, TransportSettings({bandlimit}, {SAMPLES}))
    made.save(pathlib.Path(tempfile.mkdtemp()) / "out.prt")
    return made, time.perf_counter() - begin
run({LADDER[0]!r})
made, total = run({name!r})
parts = ", ".join(f"{{stage}} {{seconds:.2f}}" for stage, seconds in made.seconds.items())
print(f"{{total:.2f}} s ({{parts}}), {{made.bytes_per_vertex:.1f}} bytes a vertex,", {PEAK_MEMORY})
"""
    wanted = " (wanted: 3 s)" if (name, bandlimit) == (LADDER[-1], 10) else ""
    line(f"precompute, {name}, L = {bandlimit}, {SAMPLES} rays{wanted}", in_child(code))


def _frames(dragon: str) -> None:
    """Radiance of a dragon under a light that turns, left on the device; and by NumPy."""
    import drjit as dr

    path = str(DRAGONS / f"{dragon}.ply")
    packed = compress_scene(path, CompressionSettings(tolerance=0.05), TransportSettings(10, SAMPLES))
    environment = data_folder() / "environments" / "studio.exr"
    light = environment if environment.is_file() else np.random.default_rng(0).random((64, 128, 3))
    lights = [sp.project_environment(light, 10, rotate=360.0 * frame / FRAMES) for frame in range(FRAMES)]
    operator = transfer_operator(packed)
    with mitsuba() as mi:
        device = DeviceOperator(mi, operator)
        ready = [mi.Float(one.astype(np.float32).ravel()) for one in lights]

        def one_by_one() -> None:
            for one in ready:
                dr.eval(device.radiance(one))
            dr.sync_thread()

        def together() -> None:
            dr.eval(device.radiance(mi.Float(np.stack(lights[:8]).astype(np.float32).ravel())))
            dr.sync_thread()

        one_by_one(), together()
        frames, eight = (FRAMES / _median(one_by_one)), (8 / _median(together))
    host = 5 / _median(lambda: [operator.apply(one[None]) for one in lights[:5]])
    line(f"{packed.vertex_count:,} vertices, L = 10: relit frames per second", f"{frames:.0f}")
    line("  eight lights at once; by NumPy on the processors, one by one", f"{eight:.0f}; {host:.0f}")


def _median(work: Any) -> float:
    times = []
    for _ in range(3):
        begin = time.perf_counter()
        work()
        times.append(time.perf_counter() - begin)
    return statistics.median(times)
