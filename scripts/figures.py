"""Makes the figures and tables of the README and of docs/; see ``scripts/figures``."""

from __future__ import annotations

import math
import os
import shutil
import sys
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from drawing import COLORS, ROOT, save, write
from paper.counts import shannon
from paper.dimension import dimension
from paper.grouping import grouping
from paper.hemispherical import hemispherical
from paper.occlusion import paper_figure_4
from paper.sampling import sampling
from paper.spectra import functions, paper_figure_2, paper_figure_3
from paper.torrance_sparrow import torrance_sparrow

import slepian_prt as sp
from slepian_prt.evaluation.compare import compare
from slepian_prt.evaluation.metrics import flip_errors, relative_rms
from slepian_prt.evaluation.reference import render_reference
from slepian_prt.evaluation.report_plots import plot_ladder
from slepian_prt.evaluation.sweep.axes import Axes
from slepian_prt.evaluation.sweep.report import front_context
from slepian_prt.evaluation.sweep.run import sweep
from slepian_prt.lighting.environment import make_environment
from slepian_prt.relighting.damping import damp
from slepian_prt.relighting.drawing.camera import trace_camera
from slepian_prt.relighting.drawing.pictures import exposure, to_srgb
from slepian_prt.scene.loading import open_scene
from slepian_prt.transport.settings import TransportSettings

# Bytes per vertex of the teaser: spherical harmonics of degrees 0 to 3 in float16.
TEASER_BYTES = 32.0


def teaser() -> None:
    """The shipped scene in the same bytes: path-traced, coded up to degree 20, and SH up to degree 3."""
    path, sky = ROOT / "scenes" / "knot.ply", sp.read_environment(ROOT / "scenes" / "sky.exr")
    transfer = sp.precompute(path, bandlimit=20, samples=1024)
    lighting = sp.project_environment(sky, 20)
    packed = _compressed_to(transfer, TEASER_BYTES)
    low = sp.compress(transfer, "sh", terms=16, coding="float16")
    with open_scene(path) as scene:
        camera = trace_camera(scene, 560)
        reference = render_reference(scene, sky, width=560, noise=0.01)
    exact = camera.masked(reference.picture)
    pictures = [("path-traced", exact)]
    for title, made in (("slepian_prt, degrees up to 20", packed), ("spherical harmonics, degrees up to 3", low)):
        picture = camera.picture(sp.relight(made, lighting))
        error = relative_rms(picture.radiance, exact.radiance)
        pictures.append((f"{title}\n{made.bytes_per_vertex:.0f} bytes per vertex, {error:.0%} off", picture))
    scale = exposure(exact)
    figure, axes = plt.subplots(1, len(pictures), figsize=(14, 5))
    for axis, (title, picture) in zip(axes, pictures, strict=True):
        axis.imshow(to_srgb(picture, scale))
        axis.set_title(title, fontsize=12)
        axis.axis("off")
    figure.subplots_adjust(wspace=0.02)
    save(figure, "teaser")


def _compressed_to(transfer: sp.Transfer, bytes_per_vertex: float) -> sp.CompressedTransfer:
    """The finest tolerance that takes no more than so many bytes, to 3 %."""
    low, high = 0.01, 0.5
    while True:
        middle = math.sqrt(low * high)
        packed = sp.compress(transfer, tolerance=middle)
        if 0.97 * bytes_per_vertex <= packed.bytes_per_vertex <= bytes_per_vertex:
            return packed
        low, high = (middle, high) if packed.bytes_per_vertex > bytes_per_vertex else (low, middle)


def clean() -> None:
    """From which tolerance on a coded picture looks like one of full spherical harmonics: FLIP and bytes."""
    tolerances = (0.2, 0.1, 0.05, 0.035, 0.02, 0.01, 0.005)
    scenes = [("knot, sky", sp.example("knot"), sp.example("sky"))]
    folder = os.environ.get("SLEPIAN_PRT_DATA")
    if folder:
        data = Path(folder)
        scenes.append(("skull, studio", data / "meshes" / "skull.ply", data / "environments" / "studio.exr"))
    print("| scene | tolerance | FLIP, mean and 95th percentile | error of radiance | bytes per vertex |")
    print("| --- | --- | --- | --- | --- |")
    for name, path, environment in scenes:
        transfer, lighting = sp.precompute(path), sp.project_environment(environment, 10, clamp_negative=True)
        full = sp.relight(transfer, lighting)
        with open_scene(path) as scene:
            camera = trace_camera(scene, 800)
        exact = camera.picture(full)
        for tolerance in tolerances:
            packed = sp.compress(transfer, tolerance=tolerance)
            radiance = sp.relight(packed, lighting)
            errors = flip_errors(camera.picture(radiance), exact, exposure(exact))
            print(
                f"| {name} | {tolerance:g} | {errors.mean():.3f}, {np.quantile(errors, 0.95):.2f} "
                f"| {relative_rms(radiance, full):.1%} | {packed.bytes_per_vertex:.2g} |"
            )


def effects() -> None:
    """The Cornell-like box: shadows alone, with interreflection in gray and in colour, and path-traced."""
    path = ROOT / "scenes" / "cornell.xml"
    light = make_environment(np.ones((8, 16, 3)))
    pictures, rows = [], (("shadows", "direct"), ("interreflection", "shadows,interreflection"), ("in colour", "auto"))
    for title, wanted in rows:
        transfer = sp.precompute(path, bandlimit=6, samples=1024, effects=wanted)
        radiance = sp.relight(transfer, sp.project_environment(light, 6))
        with open_scene(path) as scene:
            pictures.append((title, trace_camera(scene, 360).picture(radiance)))
    with open_scene(path) as scene:
        reference = render_reference(scene, light, width=360, noise=0.02, bounces=transfer.bounces)
        pictures.append((f"path-traced, {transfer.bounces} bounces", reference.picture))
    scale = exposure(reference.picture)
    figure, axes = plt.subplots(1, len(pictures), figsize=(14, 3.8))
    for axis, (title, picture) in zip(axes, pictures, strict=True):
        error = relative_rms(picture.radiance, reference.picture.radiance)
        axis.imshow(to_srgb(picture, scale))
        note = f"noise {reference.noise:.1%}" if picture is reference.picture else f"{error:.1%} off path-traced"
        axis.set_title(f"{title}\n{note}", fontsize=11)
        axis.axis("off")
    figure.subplots_adjust(wspace=0.02)
    save(figure, "effects")


def captured() -> None:
    """The shipped scene of caustics, rendered once, under its sky turned by a quarter each time; ringing is damped."""
    packed = sp.compress_film(sp.capture(ROOT / "scenes" / "caustics.xml", samples=512))
    sky = sp.read_environment(ROOT / "scenes" / "sky.exr")
    figure, axes = plt.subplots(1, 4, figsize=(16, 3.2))
    for axis, degrees in zip(axes, (0, 90, 180, 270), strict=True):
        lighting = damp(packed, sp.project_environment(sky.rotated(degrees), 10), "hann", None).lighting
        axis.imshow(sp.render_picture(packed, lighting))
        axis.set_title(f"sky turned by {degrees}°", fontsize=10)
        axis.axis("off")
    figure.subplots_adjust(wspace=0.02)
    save(figure, "captured")


def viewer() -> None:
    """The page of the shipped scene in Chromium: few functions beside full SH, and what the panel says."""
    from playwright.sync_api import sync_playwright  # only here: other figures need no browser

    transfer = sp.precompute(ROOT / "scenes" / "knot.ply", bandlimit=10, samples=1024)
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        page_file = Path(folder) / "knot.html"
        packed = sp.compress(transfer, tolerance=0.02)
        sp.save_page(page_file, packed, ROOT / "scenes" / "sky.exr", compare_with=transfer)
        options = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=options)
        page = browser.new_page(viewport={"width": 1200, "height": 760})
        page.goto(f"{page_file.as_uri()}#mode=split&compare=model&functions=4&turn=-30&split=0.37&background=%23e4e7ea")
        page.wait_for_selector("#lights canvas", timeout=_LONGEST)  # the picture of the map, which comes last
        page.wait_for_timeout(_AT_REST)
        write("viewer", page.screenshot())
        browser.close()


# Milliseconds for a page to open, and after which it has drawn all that it will.
_LONGEST, _AT_REST = 60_000, 8000


def accuracy() -> None:
    """The shipped scene: error against seconds and against bytes, with the settings that are not beaten."""
    scene, sky = ROOT / "scenes" / "knot.ply", sp.read_environment(ROOT / "scenes" / "sky.exr")
    axes = Axes((64, 256, 1024), (5, 10, 15, 20), tolerances=(0.3, 0.2, 0.1, 0.05, 0.02))
    measured = sweep(scene, [sky], axes, TransportSettings())
    for (_, cost), picture in front_context(measured)["figures"].items():
        write(f"accuracy_{cost}", picture)


def ladder() -> None:
    """The shipped scene: what each step from the path-traced picture to coded coefficients adds."""
    scene, sky = ROOT / "scenes" / "knot.ply", sp.read_environment(ROOT / "scenes" / "sky.exr")
    comparison = compare(
        scene, [sky], transport=TransportSettings(10, 1024), methods=("adapted",), terms=(16,), noise=0.005
    )
    write("ladder", plot_ladder(comparison.ladder))


def workers() -> None:
    """Efficiency of simulated workers, and how busy the scheduler and the client are."""
    from benchmarks.workers import replay_all

    runs = list(replay_all())
    number = [run.equivalent for run in runs]
    figure, axis = plt.subplots(figsize=(7, 4))
    axis.plot(
        number, [100.0 * run.efficiency for run in runs], "o-", color=COLORS[0], label="efficiency of the workers"
    )
    for name, color in (("scheduler", COLORS[1]), ("client", COLORS[2])):
        busy = [100.0 * getattr(run, f"{name}_seconds") / run.least_seconds for run in runs]
        axis.plot(number, busy, "o--", color=color, label=f"the {name} has to work, of the time of the tasks")
    axis.set(xscale="log", xlabel="workers of one core", ylabel="%", ylim=(0, 105))
    axis.set_xticks(number, [f"{each:g}" for each in number])
    axis.legend(frameon=False)
    save(figure, "workers")


FIGURE_MAKERS = {
    "teaser": teaser,
    "clean": clean,
    "effects": effects,
    "captured": captured,
    "viewer": viewer,
    "accuracy": accuracy,
    "ladder": ladder,
    "paper_figure_2": paper_figure_2,
    "paper_figure_3": paper_figure_3,
    "paper_figure_4": paper_figure_4,
    "functions": functions,
    "dimension": dimension,
    "shannon": shannon,
    "hemispherical": hemispherical,
    "grouping": grouping,
    "sampling": sampling,
    "torrance_sparrow": torrance_sparrow,
    "workers": workers,
}


def main() -> None:
    wanted = sys.argv[1:] or list(FIGURE_MAKERS)
    unknown = sorted(set(wanted) - set(FIGURE_MAKERS))
    if unknown:
        sys.exit(f"unknown figure {', '.join(unknown)}; there are {', '.join(FIGURE_MAKERS)}")
    np.set_printoptions(precision=4)
    for name in wanted:
        FIGURE_MAKERS[name]()


if __name__ == "__main__":
    main()
