"""Many small meshes with one command beside the work that is their own; order 2 as PIFu and ICON want it."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from benchmarks.common import data_folder, line, median_seconds

import slepian_prt as sp
from slepian_prt.datasets.obj_rows import read_rows
from slepian_prt.datasets.order_two import trace_order_two
from slepian_prt.scene.mesh import Mesh
from slepian_prt.transport.transfer import precompute

MESHES, ALONE = 50, 5
RAYS, DENSE = (None, 24, 64, 256), 4096


def datasets() -> None:
    """Seconds of a set of small meshes; seconds and errors of order 2."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        _small_meshes(folder)
        scans = [data_folder() / "meshes" / f"{scan}.ply" for scan in ("nefertiti", "skull")]
        for path in [sp.example("knot"), *(scan for scan in scans if scan.is_file())]:
            _order_two(path, folder)


def _small_meshes(folder: Path) -> None:
    meshes = [_write(folder / f"{seed:02}.obj", *_dented(seed)) for seed in range(MESHES)]
    begin = time.perf_counter()
    results = _command([*meshes, "-o", f"{folder}/all/", "--json"])
    whole = time.perf_counter() - begin
    again = median_seconds(lambda: _command([*meshes, "-o", f"{folder}/all/", "--json"]), 3)
    alone = []
    begin = time.perf_counter()
    for mesh in meshes[:ALONE]:
        alone += _command([mesh, "-o", f"{folder}/{mesh.stem}/", "--json"])
    singly = (time.perf_counter() - begin) / ALONE
    vertices = results[0]["vertices"]
    line(f"{MESHES} meshes of {vertices} vertices: one command; each", f"{whole:.1f} s; {1e3 * whole / MESHES:.0f} ms")
    stages = {stage: np.median([result["seconds"][stage] for result in results]) for stage in results[0]["seconds"]}
    line("  median stages", ", ".join(f"{stage} {1e3 * seconds:.0f} ms" for stage, seconds in stages.items()))
    line("  beside their transport and compression in that command", f"{whole / _own(results):.2f}x")
    line(
        f"  beside their transport and compression each in a process of its own ({ALONE} of them)",
        f"{whole / (_own(alone) * MESHES / ALONE):.2f}x",
    )
    line("  beside commands of their own", f"{whole / (singly * MESHES):.2f}x")
    line("  the same command again, all of it there", f"{again:.2f} s")


def _own(results: list[dict]) -> float:
    return sum(result["seconds"]["transport"] + result["seconds"]["compress"] for result in results)


def _command(arguments: list) -> list[dict]:
    """Results of a command in a process of its own."""
    command = [sys.executable, "-m", "slepian_prt", "precompute", *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return [json.loads(text) for text in done.stdout.splitlines()]


def _dented(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """A ball of 2,562 vertices with bumps and dents that shadow each other."""
    import trimesh

    rng, ball = np.random.default_rng(seed), trimesh.creation.icosphere(4)
    radius = np.ones(len(ball.vertices))
    for _ in range(6):
        middle = rng.normal(size=3)
        toward = ball.vertices @ (middle / np.linalg.norm(middle)) - 1.0
        radius += rng.uniform(-0.45, 0.6) * np.exp(rng.uniform(4.0, 20.0) * toward)
    return ball.vertices * radius[:, None], ball.faces


def _write(path: Path, positions: np.ndarray, faces: np.ndarray) -> Path:
    lines = ["v {:.8g} {:.8g} {:.8g}".format(*position) for position in positions]
    path.write_text("\n".join([*lines, *("f {} {} {}".format(*face) for face in faces + 1)]) + "\n")
    return path


def _order_two(scan: Path, folder: Path) -> None:
    """Each as an OBJ file, the second time that it is done, when kernels and tables are there."""
    mesh = sp.read_mesh(scan)
    path = _write(folder / f"{scan.stem}.obj", mesh.positions, mesh.faces)
    dense = precompute(mesh, bandlimit=2, samples=DENSE, effects="direct").vectors[:, 0]
    size = np.linalg.norm(dense)
    for samples in RAYS:
        results = [_done(path, folder / f"out{time.time_ns()}", samples) for _ in range(4)]
        error = np.linalg.norm(trace_order_two(_rows(path), samples).vectors - dense) / size
        best = min(results[1:], key=lambda result: result.seconds["all"])
        stages = ", ".join(f"{stage} {1e3 * seconds:.0f}" for stage, seconds in best.seconds.items())
        line(
            f"{scan.stem}, {best.vertices} vertices, order 2, {best.rays / best.vertices:.0f} rays each"
            + ("" if samples else " (usual)"),
            f"error {error:.1%} (told {best.error:.1%}); ms: {stages}",
        )


def _rows(path: Path) -> Mesh:
    return read_rows(path).mesh


def _done(path: Path, folder: Path, samples: int | None) -> sp.ScanResult:
    (result,) = sp.precompute_set([path], folder, formats="pifu", **({} if samples is None else {"samples": samples}))
    assert result.failure is None, result.failure
    return result
