"""Draw Mitsuba scenes with the integrator `slepian_prt` and with Mitsuba's path tracer, in their own light.

    scripts/compare_scenes FOLDER|SCENE.xml … [-o PICTURES] [--width N] [--bandlimit L] [--samples N] [--spp N]

Each .xml file that is a scene goes through `slepian-prt precompute` in a process of its own; then its own camera is
taken by both integrators. What is said of each scene:

    held      part of the picture whose surfaces the transfer file holds
    error     relative RMS on these pixels, the noise of both pictures taken off
    others    the same on all other pixels that show something: mirrors, glass, lamps, what is gathered
    noise     of our picture, and of the reference, on held pixels
    seconds   of precompute; of our picture; of the reference, which has four times the samples
    bytes     of the file

and below it the rows of the plan, that is what is not simulated or is gathered. With ``-o``, pictures: the path
tracer's, ours, and half grey plus the difference. It exits with 1 if a scene cannot be precomputed.

Scenes that were compared, to be cloned beside: github.com/mitsuba-renderer/mitsuba-data (scenes, docs/scenes,
tests/scenes), mitsuba-renderer/mitsuba-tutorials (scenes), VElysianP/mitsuba_scenes.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.files.prt_file import load
from slepian_prt.relighting.drawing.pictures import Picture, to_srgb
from slepian_prt.relighting.mitsuba.integrator import register
from slepian_prt.relighting.mitsuba.scene_integrator import scene_integrator
from slepian_prt.renderer.variants import imported_mitsuba, usable_variant

# Pixels of the reference brighter than so many times its 99th percentile are lamps and fireflies: they say nothing.
_BRIGHTEST = 4.0


@dataclass(frozen=True)
class Comparison:
    """How two pictures of one scene differ.

    Attributes
    ----------
    held : float
        Part of the pixels.
    error, others : float
        Relative RMS on held pixels, and on others that show a surface.
    noise, reference_noise : float
        Of our picture and of the reference, on held pixels.
    """

    held: float
    error: float
    others: float
    noise: float
    reference_noise: float


def scenes_in(paths: list[Path]) -> Iterator[Path]:
    """The scene files that are named, or stand in folders that are."""
    for path in paths:
        for file in sorted(path.rglob("*.xml")) if path.is_dir() else [path]:
            text = file.read_text(errors="replace")
            if not path.is_dir() or ("<scene" in text and ("<sensor" in text or "<include" in text)):
                yield file


def relative_rms(ours: NDArray, right: NDArray, chosen: NDArray) -> tuple[float, float, float]:
    """Between two pictures on some pixels, and their own noise; of both there are two halves (2, H, W, 3)."""
    if not chosen.any():
        return 0.0, 0.0, 0.0
    power = max(float((right.mean(axis=0)[chosen] ** 2).sum()), 1e-30)
    noises = [float(((0.5 * (halves[0] - halves[1]))[chosen] ** 2).sum()) for halves in (ours, right)]
    squared = float(((ours.mean(axis=0) - right.mean(axis=0))[chosen] ** 2).sum()) - sum(noises)
    error, noise, reference_noise = np.sqrt(np.maximum([squared, *noises], 0.0) / power)
    return float(error), float(noise), float(reference_noise)


def compare(ours: NDArray, right: NDArray, held: NDArray, shown: NDArray) -> Comparison:
    """Of two pictures, two halves each; ``held`` and ``shown`` say of pixels what they show."""
    brightness = right.mean(axis=0).max(axis=2)
    usual = shown
    if shown.any():
        usual = brightness <= _BRIGHTEST * max(float(np.percentile(brightness[shown], 99.0)), 1e-30)
    error, noise, reference_noise = relative_rms(ours, right, held & usual)
    others, _, _ = relative_rms(ours, right, shown & ~held & usual)
    return Comparison(float(held.mean()), error, others, noise, reference_noise)


def masks(mi: Any, scene: Any, integrator: Any, width: int, height: int) -> tuple[NDArray, NDArray]:
    """Of the middles of the pixels: whether they show a held surface, and whether any surface."""
    y, x = np.divmod(np.arange(width * height), width)
    place = mi.Point2f(((x + 0.5) / width).astype(np.float32), ((y + 0.5) / height).astype(np.float32))
    ray, _ = scene.sensors()[0].sample_ray(0.0, 0.5, place, mi.Point2f(0.5, 0.5))
    shown = np.array(scene.ray_intersect_preliminary(mi.Ray3f(ray)).is_valid()).reshape(height, width)
    return np.array(integrator.integrator.meets_held(scene, ray)).reshape(height, width), shown


def narrowed(mi: Any, scene: Any, width: int) -> tuple[int, int]:
    """Make the film of the scene's first camera so wide; its size."""
    parameters = mi.traverse(scene.sensors()[0])
    columns, rows = (int(n) for n in np.ravel(parameters["film.size"]))
    size = (min(width, columns), max(1, round(rows * min(width, columns) / columns)))
    parameters["film.size"] = list(size)
    if "film.crop_size" in parameters:
        parameters["film.crop_size"] = list(size)
    parameters.update()
    return size


def draw(mi: Any, file: Path, transfer: Path, options: argparse.Namespace) -> tuple[NDArray, NDArray, Any, list[float]]:
    """Halves of our picture and of the reference, masks, and seconds of both."""
    scene = mi.load_file(str(file))
    width, height = narrowed(mi, scene, options.width)
    integrator = scene_integrator(mi, load(transfer))
    has_media = any(shape.interior_medium() is not None for shape in scene.shapes())
    path = mi.load_dict({"type": "volpath" if has_media else "path", "max_depth": 32})

    def picture(drawer: Any, samples: int, seed: int) -> NDArray:
        return np.array(mi.render(scene, integrator=drawer, spp=samples, seed=seed), dtype=np.float64)[..., :3]

    started = time.perf_counter()
    ours = np.stack([picture(integrator, options.spp, seed) for seed in (0, 1)])
    between = time.perf_counter()
    right = np.stack([picture(path, 4 * options.spp, seed) for seed in (2, 3)])
    seconds = [between - started, time.perf_counter() - between]
    return ours, right, masks(mi, scene, integrator, width, height), seconds


def precompute(file: Path, transfer: Path, options: argparse.Namespace) -> tuple[int, list[str], float]:
    """Exit status, what is said, and seconds."""
    command = [
        str(Path(sys.executable).parent / "slepian-prt"), "precompute", str(file), "-o", str(transfer),
        "--bandlimit", str(options.bandlimit), "--samples", str(options.samples), "--tolerance", "0.01",
    ]  # fmt: skip
    started = time.perf_counter()
    done = subprocess.run(command, capture_output=True, text=True)
    return done.returncode, (done.stdout + done.stderr).strip().splitlines(), time.perf_counter() - started


def write_strip(path: Path, ours: NDArray, right: NDArray, shown: NDArray) -> None:
    """The reference, ours, and their difference about grey, side by side."""
    from PIL import Image

    level = float(np.percentile(right[shown].max(axis=1), 95.0)) if shown.any() else float(right.max())
    scale = 0.85 / max(level, 1e-30)
    strip = np.hstack([right, ours, 0.5 / scale + (ours - right)])
    picture = Picture(strip.astype(np.float32), np.ones(strip.shape[:2], dtype=np.float32))
    Image.fromarray(to_srgb(picture, scale)).save(path)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="+", type=Path)
    parser.add_argument("-o", "--output", type=Path)
    parser.add_argument("--width", type=int, default=240)
    parser.add_argument("--bandlimit", type=int, default=10)
    parser.add_argument("--samples", type=int, default=512)
    parser.add_argument("--spp", type=int, default=128)
    options = parser.parse_args()
    mi = imported_mitsuba()
    mi.set_variant(usable_variant())
    mi.set_log_level(mi.LogLevel.Error)
    register()
    if options.output:
        options.output.mkdir(parents=True, exist_ok=True)
    failed = 0
    for file in scenes_in(options.scenes):
        print(f"{file}", flush=True)
        with tempfile.TemporaryDirectory() as folder:
            transfer = Path(folder) / "scene.prt"
            status, said, seconds = precompute(file, transfer, options)
            if status:
                failed += 1
                print(f"    exit {status}: {said[-1] if said else ''}", flush=True)
                continue
            ours, right, (held, shown), (own, reference) = draw(mi, file, transfer, options)
            found = compare(ours, right, held, shown)
            size = transfer.stat().st_size
        print(
            f"    held {found.held:.0%}, error {found.error:.3f}, others {found.others:.3f}, "
            f"noise {found.noise:.3f} and {found.reference_noise:.3f}; "
            f"{seconds:.1f} s, {own:.1f} s, {reference:.1f} s; {size} bytes"
        )
        print("\n".join(f"    {line}" for line in said), flush=True)
        if options.output:
            write_strip(
                options.output / f"{file.parent.name}-{file.stem}.png", ours.mean(axis=0), right.mean(axis=0), shown
            )
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
