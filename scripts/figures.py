"""Makes the figures and tables of the README and of docs/; see ``scripts/figures``."""

from __future__ import annotations

import math
import os
import shutil
import sys
import tempfile
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from paper import pit
from paper.dimension import dimension
from paper.empirical import empirical_spectrum

import slepian_prt as sp
from slepian_prt.evaluation import spectra
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

ROOT = Path(__file__).parent.parent
FIGURES = ROOT / "docs" / "figures"
COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7")

plt.rcParams.update({"font.size": 11, "axes.spines.top": False, "axes.spines.right": False})


def save(figure: plt.Figure, name: str) -> None:
    FIGURES.mkdir(parents=True, exist_ok=True)
    figure.savefig(FIGURES / f"{name}.png", dpi=150, bbox_inches="tight")
    plt.close(figure)
    print(f"docs/figures/{name}.png")


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
        page.wait_for_timeout(_AT_REST)
        write("viewer", page.screenshot())
        browser.close()


# Milliseconds after which a page has drawn all that it will.
_AT_REST = 8000


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


def write(name: str, picture: bytes) -> None:
    FIGURES.mkdir(parents=True, exist_ok=True)
    (FIGURES / f"{name}.png").write_bytes(picture)
    print(f"docs/figures/{name}.png")


def paper_figure_2() -> None:
    """Spectra of the concentration problem, as Fig. 2 of Lessig & Fiume: L = 5 and 20, several caps, N and N_g."""
    figure, axes = plt.subplots(1, 2, figsize=(12, 4.6))
    for axis, bandlimit, half_angles in ((axes[0], 5, (10, 20, 30, 60)), (axes[1], 20, (5, 10, 20, 30))):
        for color, angle in zip(COLORS, half_angles, strict=True):
            result = spectra.spectrum(bandlimit, math.radians(angle), epsilon=0.01)
            spectra.draw_spectrum(axis, result.eigenvalues, f"Θ = {angle}°", color=color)
            axis.axvline(result.numbers["shannon"], color=color, linestyle=":", linewidth=1.2)
            axis.axvline(result.numbers["n_g"], color=color, linestyle="-.", linewidth=1.2)
        axis.set_xlim(0.5, min((bandlimit + 1) ** 2, 60 if bandlimit == 20 else 36))
        axis.set_title(f"L = {bandlimit}")
        axis.set_xlabel("index")
        axis.set_ylabel("concentration λ")
        axis.grid(True, color="#dddddd", linewidth=0.6)
        axis.legend(frameon=False, title="dotted N, dash-dotted N_g(0.01)")
    save(figure, "paper_figure_2")


def paper_figure_3() -> None:
    """Fig. 3 of the paper, and what explains the difference that it leaves: the transport-weighted spectrum.

    Left, diffuse transport at L = 2. Right, Phong with exponent 128 at L = 10, whose axis is the reflection
    direction: normals in a cap Θ make axes in a cap 2Θ.
    """
    figure, axes = plt.subplots(1, 2, figsize=(12, 4.8))
    cases = (
        (axes[0], "diffuse, L = 2", 2, 1.0, (10, 20, 40), False, 9),
        (axes[1], "Phong 128, L = 10, normals within Θ", 10, 128.0, (5, 10, 20), True, 60),
    )
    worst = 0.0
    for axis, title, bandlimit, exponent, angles, reflection, reach in cases:
        zonal = sp.cosine_lobe(bandlimit, exponent)
        for color, angle in zip(COLORS, angles, strict=False):
            half_angle = math.radians(angle * (2 if reflection else 1))
            plain = sp.cap_basis(bandlimit, half_angle).eigenvalues
            weighted = sp.cap_basis(bandlimit, half_angle, kernel=zonal).eigenvalues
            measured = empirical_spectrum(zonal, half_angle, reflection=reflection)
            weighted = weighted / weighted[0]
            kept = (weighted > 1e-8)[: measured.size]
            worst = max(worst, float(np.abs(np.log10(measured[kept] / weighted[: measured.size][kept])).max()))
            spectra.draw_spectrum(axis, plain[:reach] / plain[0], f"Θ = {angle}°", color=color)
            spectra.draw_spectrum(axis, weighted[:reach], "", color=color, dash="--")
            axis.plot(np.arange(1, reach + 1), measured[:reach], "o", color=color, markersize=4, fillstyle="none")
        axis.set_yscale("log")
        axis.set_ylim(1e-9, 2.0)
        axis.set_title(title)
        axis.set_xlabel("index")
        axis.set_ylabel("eigenvalue relative to the first")
        axis.grid(True, color="#dddddd", linewidth=0.6)
        if not reflection:
            axis.plot([], [], "k-", label="Slepian (the paper)")
            axis.plot([], [], "k--", label="transport-weighted (ours)")
            axis.plot([], [], "ko", fillstyle="none", label="SVD of an empirical operator")
        axis.legend(frameon=False, fontsize=9, **({"bbox_to_anchor": (1.0, 1.0)} if reflection else {}))
    print(f"transport-weighted against empirical: at most {10**worst - 1:.0%} apart down to 1e-8 of the first")
    save(figure, "paper_figure_3")


def paper_figure_4() -> None:
    """Fig. 4 of the paper, partial occlusion: the floor of a hemispherical pit under radially symmetric light.

    Spectrum of Eq. 9 (radially symmetric Slepian functions, C = 4(L+1)Θ) against that of exact transport, by
    integration over the open disk, and of ray-traced transport.
    """
    figure, (sketch, axis) = plt.subplots(1, 2, figsize=(12, 4.8), width_ratios=(1, 1.6))
    arc = np.linspace(-np.pi / 2, np.pi / 2, 181)
    sketch.plot(np.sin(arc), -np.cos(arc), color="#555555", linewidth=2)
    part = np.linspace(-np.radians(20), np.radians(20), 41)
    sketch.plot(np.sin(part), -np.cos(part), color=COLORS[0], linewidth=5)
    sketch.text(0.0, -1.15, "floor: normals within Θ", color=COLORS[0], ha="center")
    for x in (-1.0, 1.0):
        sketch.plot([0, x], [-1, 0], color="#999999", linestyle=":")
    sketch.annotate("", (0, 0.1), (0, -0.5), arrowprops={"arrowstyle": "->"})
    sketch.text(0.04, -0.25, "h")
    sketch.text(0, 0.2, "light, symmetric about h", ha="center")
    sketch.set_ylim(-1.3, 0.4)
    sketch.set_aspect("equal")
    sketch.axis("off")
    bandlimit, worst = 10, 0.0
    for color, angle in zip(COLORS, (5, 10, 20, 40), strict=True):
        angles = np.linspace(0.0, math.radians(angle), 41)
        plain = sp.cap_basis(bandlimit, angles[-1], radially_symmetric=True).eigenvalues
        exact = pit.pit_spectrum(pit.exact_pit_transfer(bandlimit, angles), angles)
        traced = pit.pit_spectrum(pit.traced_pit_transfer(bandlimit, angles), angles)
        kept = exact > 1e-7
        worst = max(worst, float(np.abs(traced[: kept.size][kept] / exact[kept] - 1).max()))
        index = np.arange(1, bandlimit + 2)
        axis.plot(index, plain / plain[0], "-", color=color, label=f"Θ = {angle}°")
        axis.plot(index, exact, "--", color=color)
        axis.plot(index, traced, "o", color=color, fillstyle="none", markersize=5)
        number = sp.generalized_shannon_number(bandlimit, angles[-1], 0.01, radially_symmetric=True)
        axis.axvline(number, color=color, linestyle="-.", linewidth=1)
    axis.plot([], [], "k-", label="Slepian, Eq. 9")
    axis.plot([], [], "k--", label="exact transport in the pit")
    axis.plot([], [], "ko", fillstyle="none", label="ray-traced")
    axis.plot([], [], "k-.", linewidth=1, label="N_g(0.01), C = 4(L+1)Θ")
    axis.set_yscale("log")
    axis.set_ylim(1e-12, 3)
    axis.set_xlim(0.8, 11.5)
    axis.set_title("L = 10")
    axis.set_xlabel("index")
    axis.set_ylabel("eigenvalue relative to the first")
    axis.grid(True, color="#dddddd", linewidth=0.6)
    axis.legend(frameon=False, fontsize=9, loc="upper right", bbox_to_anchor=(1.36, 1.0))
    print(f"ray-traced against exact: at most {worst:.1%} apart down to 1e-7 of the first")
    save(figure, "paper_figure_4")


def functions() -> None:
    """Maps of the first functions of a cap of 40° at L = 10: plain, and weighted by diffuse transport."""
    bandlimit, half_angle, count, size = 10, math.radians(40), 8, 161
    x, y = np.meshgrid(np.linspace(-1, 1, size), np.linspace(1, -1, size))
    inside = x * x + y * y < 1
    # Lambert's equal-area azimuthal projection of the whole sphere, the cap in the middle.
    rho = np.sqrt(x[inside] ** 2 + y[inside] ** 2)
    theta, phi = 2 * np.arcsin(rho), np.arctan2(y[inside], x[inside])
    d = np.column_stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])
    harmonics = sp.real_sh(bandlimit, d)
    figure, axes = plt.subplots(2, count, figsize=(1.7 * count, 4.1))
    kernels = (("Slepian", None), ("diffuse transport", sp.cosine_lobe(bandlimit)))
    for row, (name, kernel) in zip(axes, kernels, strict=True):
        basis = sp.cap_basis(bandlimit, half_angle, kernel=kernel)
        for i, axis in enumerate(row):
            image = np.full(x.shape, np.nan)
            image[inside] = harmonics @ basis.functions[:, i]
            largest = np.nanmax(np.abs(image))
            axis.imshow(image, cmap="RdBu_r", vmin=-largest, vmax=largest, extent=(-1, 1, -1, 1))
            axis.add_patch(plt.Circle((0, 0), math.sin(half_angle / 2), fill=False, color="black", linewidth=0.8))
            axis.add_patch(plt.Circle((0, 0), 1, fill=False, color="#999999", linewidth=0.8))
            value = basis.eigenvalues[i] / (basis.eigenvalues[0] if kernel is not None else 1.0)
            axis.set_title(f"m = {basis.orders[i]:+d}, {value:.3g}", fontsize=9)
            axis.axis("off")
        row[0].text(-0.12, 0.5, name, transform=row[0].transAxes, rotation=90, va="center", ha="right")
    save(figure, "functions")


def shannon() -> None:
    """docs/shannon.md: every estimate of the number of functions against the exact count."""
    grid = [(l, t) for l in (2, 5, 10, 20, 50, 100) for t in (5, 10, 20, 30, 60, 90)]
    rows, errors = [], []
    for bandlimit, angle in grid:
        half_angle = math.radians(angle)
        concentrations = sp.cap_basis(bandlimit, half_angle).eigenvalues
        for epsilon in (0.5, 0.1, 0.01, 0.001):
            count = int((concentrations > epsilon).sum())
            estimates = [
                sp.shannon_number(bandlimit, half_angle),
                sp.generalized_shannon_number(bandlimit, half_angle, epsilon, log_base=math.e),
                sp.generalized_shannon_number(bandlimit, half_angle, epsilon),
                sp.refined_shannon_number(bandlimit, half_angle, epsilon),
            ]
            numbers = " | ".join(f"{x:.1f}" for x in estimates)
            rows.append(f"| {bandlimit} | {angle}° | {epsilon:g} | {count} | {numbers} |")
            if count:
                errors.append([estimates[0], *(abs(x / count - 1) for x in estimates)])
    table = np.array(errors)
    names = ("N", "N_g, natural logarithms", "N_g, base-10 logarithms (the paper, as we read it)", "N_ref")
    lines = [
        "# Shannon numbers against exact counts",
        "",
        "Made by `scripts/figures shannon`. The count is that of concentrations above ε of a cap of half-angle Θ at",
        "bandlimit L. Mean relative error over the grid below (cases with a count above zero):",
        "",
        "| estimate | all | N ≥ 3 | N ≥ 10 |",
        "| --- | --- | --- | --- |",
    ]
    for column, name in enumerate(names, start=1):
        means = (table[table[:, 0] >= least, column].mean() for least in (0, 3, 10))
        lines.append(f"| {name} | " + " | ".join(f"{mean:.3f}" for mean in means) + " |")
    lines += [
        "",
        "Radially symmetric functions alone (order 0), C = 4(L+1)Θ, at ε = 0.5:",
        "",
        "| L | Θ | count | C/4π |",
        "| --- | --- | --- | --- |",
    ]
    for bandlimit, angle in ((10, 30), (20, 60), (50, 20), (100, 60)):
        count = sp.concentration_count(bandlimit, math.radians(angle), 0.5, radially_symmetric=True)
        number = sp.generalized_shannon_number(bandlimit, math.radians(angle), 0.5, radially_symmetric=True)
        lines.append(f"| {bandlimit} | {angle}° | {count} | {number:.2f} |")
    lines += ["", "| L | Θ | ε | count | N | N_g natural | N_g base 10 | N_ref |", "| --- " * 8 + "|", *rows, ""]
    (ROOT / "docs" / "shannon.md").write_text("\n".join(lines))
    print("docs/shannon.md")


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
