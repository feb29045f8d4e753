"""The run-time format: what 16 bytes per vertex add to the error of a file under real maps, and how long they take."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

import numpy as np
from benchmarks.common import data_folder, line, median_seconds

import slepian_prt as sp
from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.lighting.environment import about_up
from slepian_prt.sphere.rotation import rotate_sh

SCANS = ("skull", "nefertiti")
MAPS = ("studio", "courtyard", "interior", "sunrise")
TURNS = (0.0, 90.0, 180.0, 270.0)


def runtime() -> None:
    """The error that the run-time format adds, by functions and caps; seconds to make it, and for a light."""
    for name in SCANS:
        path = data_folder() / "meshes" / f"{name}.ply"
        if not path.is_file():
            print("SLEPIAN_PRT_DATA must name the folder of scanned meshes; they are left out")
            return
        with tempfile.TemporaryDirectory() as folder:
            stored = Path(folder) / "scan.prt"
            sp.compress(sp.precompute(path, bandlimit=10, samples=1024), tolerance=0.05).save(stored)
            _scan(name, stored)


def _scan(name: str, stored: Path) -> None:
    packed = sp.load(stored)
    maps = [sp.project_environment(data_folder() / "environments" / f"{one}.exr", packed.bandlimit) for one in MAPS]
    lights = [rotate_sh(light, about_up(turn)) for light in maps for turn in TURNS]
    line(f"{name}: error of the file itself, expected under these maps", f"{_mean_file_error(packed, lights):.2%}")
    wanted = [sp.relight(packed, light) / packed.mesh.receivers.albedo for light in lights]
    for functions in (8, 16, 24, 32):
        for caps in (96, 255):
            gpu = sp.gpu_transfer(packed, functions, caps=caps)
            measured = [_error(gpu.relight(light), exact) for light, exact in zip(lights, wanted, strict=True)]
            line(
                f"  {functions} functions, {caps} caps: error added, mean of 4 maps x 4 turns",
                f"{np.mean(measured):.2%}",
            )
    fewer = sp.gpu_transfer(packed, bits=6)
    measured = [_error(fewer.relight(light), exact) for light, exact in zip(lights, wanted, strict=True)]
    line("  16 functions in 6 bits each", f"{np.mean(measured):.2%}")
    start = time.perf_counter()
    gpu = sp.gpu_transfer(sp.load(stored))
    line("  loading, decoding and making it", f"{time.perf_counter() - start:.2f} s")
    line("  the table of a new light", f"{1e3 * median_seconds(lambda: gpu.light(lights[0])):.2f} ms")


def _error(found: np.ndarray, wanted: np.ndarray) -> float:
    return float(np.linalg.norm(found - wanted) / np.linalg.norm(wanted))


def _mean_file_error(packed: CompressedTransfer, lights: list[np.ndarray]) -> float:
    return float(np.mean([packed.predicted_relit_error(light) for light in lights]))
