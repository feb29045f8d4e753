"""The report of a comparison: one HTML file that needs nothing else, and its figures as files."""

from __future__ import annotations

import io
import json
import math
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import PIL.Image
from numpy.typing import NDArray

from slepian_prt.evaluation import pages, plots, sweep_report
from slepian_prt.evaluation.compare import Comparison, Method, View
from slepian_prt.evaluation.ladder import AT_VERTICES, IN_PICTURE, Rung
from slepian_prt.evaluation.metrics import error_map
from slepian_prt.evaluation.plots import percent
from slepian_prt.evaluation.sweep import Sweep
from slepian_prt.files import write_all
from slepian_prt.relighting.pictures import Picture, exposure, to_srgb

# Colour (Okabe & Ito, safe for colour-blind readers), marker and dash of each basis: any one of them tells it.
STYLES: dict[str, tuple[str, str, str]] = {
    "adapted": ("#D55E00", "o", "-"),
    "adapted+light": ("#D55E00", "*", "--"),
    "adapted+pca": ("#D55E00", "s", "-."),
    "transport": ("#E69F00", "s", "-"),
    "slepian": ("#0072B2", "D", "--"),
    "incident": ("#56B4E9", "^", "--"),
    "sh": ("#222222", "x", ":"),
    "cpca": ("#009E73", "v", "-."),
    "pca": ("#009E73", "^", ":"),
    "haar": ("#7F7F7F", "p", "--"),
    "d3dx": ("#000000", "h", ""),
    "direct": ("#CC79A7", "P", ":"),
}

DESCRIPTIONS = {
    "adapted": "eigenvectors of the mean transport over the cap, learnt from a pilot of a few hundred vertices",
    "transport": "the same for unshadowed diffuse transport, known without looking at the scene",
    "slepian": "the paper's Slepian functions of the cap of normals, for exit radiance",
    "incident": "Slepian functions of the cap that holds all incident light (the cap of normals widened by 90°)",
    "sh": "spherical harmonics cut at a lower degree",
    "adapted+light": "the same, made for the mean spectrum of the maps compared here: the relit error counts",
    "adapted+pca": "principal axes inside nearly complete adapted coefficients of each cap, which are stored",
    "pca": "mean and principal components of each cap; has to see all vectors and to store its bases",
    "cpca": "the same with clusters iterated by reconstruction error (Sloan 2003)",
    "haar": "the largest Haar wavelets of each vertex on a cube (Ng 2003), 8 bits each and their places",
    "d3dx": "what Direct3D's library recommends: degrees up to 5, cpca with 24 terms",
    "direct": "transfer projected on the Slepian functions of the cap of normals itself: what not to do",
    "none": "all spherical harmonics, nothing compressed",
}

_GROUPED_BY = {
    "normal": "their normals",
    "bent": "the mean direction of the light that reaches them",
    "surface": "neighbourhoods on the surface",
    "view": "their reflection directions",
}

_ERROR_SCALE = 0.25  # the end of the colour scale of error maps, relative to the mean luminance


def write_report(comparison: Comparison, folder: str | Path, command: str, sweep: Sweep | None = None) -> Path:
    """Write report.html, results.json and the figures; return the path of the report.

    Everything is made before the first byte is written. The report shows the Pareto fronts of a ``sweep`` too.
    """
    folder = Path(folder)
    figures = {
        "transfer_error": _error_plot(comparison, "terms"),
        "relit_error": _relit_plot(comparison),
        "error_by_bytes": _error_plot(comparison, "bytes_per_vertex"),
        "ladder": ladder_plot(comparison.ladder),
    }
    pictures = [_view_pictures(comparison, view) for view in comparison.views]
    html = _render(comparison, figures, pictures, command, sweep)
    files = {f"{name}.png": content for name, content in figures.items()}
    for view in pictures:
        for panel in view["panels"]:
            stem = f"{view['environment']}_{panel['file']}"
            files[f"{stem}.png"] = panel["png"]
            if "error_png" in panel:
                second = panel.get("error_file", f"{panel['file']}_error")
                files[f"{view['environment']}_{second}.png"] = panel["error_png"]
    files["results.json"] = (json.dumps(comparison.results(), indent=1) + "\n").encode()
    files["report.html"] = html.encode()
    write_all(folder, files)
    return folder / "report.html"


# --- Pictures --------------------------------------------------------------------------------------------------------


def _view_pictures(comparison: Comparison, view: View) -> dict[str, Any]:
    """All pictures of one environment, exposed alike and cropped to what they show."""
    scale = exposure(view.reference.picture)
    crop = _crop(view.reference.picture.alpha)
    shown = {
        "reference": ("path-traced reference", view.reference.picture, None, ""),
        "vertices": (
            "radiance at the vertices, no bandlimit",
            view.interpolated,
            view.reference.picture,
            "the reference",
        ),
        "full_sh": (
            f"full SH, {(comparison.transfer.bandlimit + 1) ** 2} functions",
            view.full,
            view.reference.picture,
            "the reference",
        ),
    }
    for basis, picture in view.compressed.items():
        shown[basis] = (f"{basis}, {comparison.shown_terms} functions", picture, view.full, "full SH")
    panels = []
    for file, (title, picture, against, name) in shown.items():
        panel: dict[str, Any] = {"file": file, "title": title, "png": _png(to_srgb(picture, scale)[crop])}
        if against is not None:
            errors = error_map(picture, against)[crop]
            panel["error_png"] = _error_png(errors)
            mean = float(np.nanmean(errors)) if np.isfinite(errors).any() else 0.0
            panel["error_title"] = f"its difference from {name}, {percent(mean)} on average"
        else:
            panel["error_png"], panel["error_title"] = _map_png(view), f"the environment map {view.environment.name}"
            panel["error_file"] = "map"
        panels.append(panel)
    return {
        "environment": view.environment.name,
        "panels": panels,
        "noise": view.reference.noise,
        "samples": view.reference.samples,
        "negative": comparison.negative[view.environment.name],
        "clamped": view.environment.clamped,
    }


def _map_png(view: View) -> bytes:
    """The environment map, made small, with its centre column the direction -x."""
    texels = view.environment.texels
    step = max(1, texels.shape[0] // 128)
    rows, columns = texels.shape[0] // step * step, texels.shape[1] // step * step
    small = texels[:rows, :columns].reshape(rows // step, step, columns // step, step, 3).mean(axis=(1, 3))
    picture = Picture(small, np.ones(small.shape[:2], dtype=np.float32))
    return _png(to_srgb(picture, exposure(picture)))


def _crop(alpha: NDArray) -> tuple[slice, slice]:
    rows, columns = (np.flatnonzero((alpha > 0.0).any(axis=axis)) for axis in (1, 0))
    if rows.size == 0:
        return slice(None), slice(None)
    margin = 6
    return (
        slice(max(rows[0] - margin, 0), rows[-1] + margin + 1),
        slice(max(columns[0] - margin, 0), columns[-1] + margin + 1),
    )


def _png(image: NDArray[np.uint8], palette: NDArray[np.uint8] | None = None) -> bytes:
    """PNG of an (H, W, 3) picture, or of (H, W) indices into a (256, 3) palette."""
    picture = PIL.Image.fromarray(image)
    if palette is not None:
        picture.putpalette(palette.tobytes())
    buffer = io.BytesIO()
    picture.save(buffer, format="png", optimize=True)
    return buffer.getvalue()


def _error_png(errors: NDArray) -> bytes:
    """An error map on the colour scale; what is not covered is white. A palette keeps the page a third as large."""
    palette = (plt.get_cmap("magma")(np.linspace(0.0, 1.0, 255))[:, :3] * 255.0 + 0.5).astype(np.uint8)
    index = np.clip(np.nan_to_num(errors) / _ERROR_SCALE, 0.0, 1.0) * 254.0 + 0.5
    image = np.where(np.isnan(errors), 255, index.astype(np.uint8)).astype(np.uint8)
    return _png(image, np.concatenate([palette, [[255, 255, 255]]]).astype(np.uint8))


# --- Plots -----------------------------------------------------------------------------------------------------------


def _curves(comparison: Comparison, *, coded: bool = False) -> dict[tuple[str, bool], list[Method]]:
    """Methods by basis, those cut to K functions and, if wanted, apart from them those that are coded."""
    curves: dict[tuple[str, bool], list[Method]] = {}
    for method in comparison.methods:
        is_coded = method.coding == "coded"
        if method.basis != "none" and (coded or not is_coded):
            curves.setdefault((method.basis, is_coded), []).append(method)
    return curves


def _error_plot(comparison: Comparison, abscissa: str) -> bytes:
    """Transfer error against functions (with predictions), or mean relit error against bytes."""
    figure, axes = plots.figure()
    axis = axes[0, 0]
    by_terms = abscissa == "terms"
    for (basis, coded), methods in _curves(comparison, coded=not by_terms).items():
        colour, marker, dash = STYLES[basis]
        x = [getattr(m, abscissa) for m in methods]
        y = [m.transfer_error if by_terms else float(np.mean(list(m.relit_error.values()))) for m in methods]
        label, face = (f"{basis}, coded", "none") if coded else (basis, colour)
        axis.plot(x, y, dash, color=colour, marker=marker, mfc=face, label=label, linewidth=1.8, markersize=6)
        if by_terms and basis == "adapted":
            predicted = [m.predicted_error for m in methods]
            axis.plot(x, predicted, "+", color="black", markersize=11, label="predicted for adapted", zorder=5)
    plots.logarithmic(axis)
    if by_terms:
        axis.set_xlabel("functions per vertex, K")
        axis.set_ylabel("relative error of the transfer vectors")
    else:
        axis.set_xscale("log")
        axis.xaxis.set_major_locator(matplotlib.ticker.LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.xaxis.set_major_formatter(matplotlib.ticker.FuncFormatter(lambda v, _: f"{v:g}"))
        axis.xaxis.set_minor_formatter(matplotlib.ticker.NullFormatter())
        axis.set_xlabel("bytes per vertex, everything but the mesh counted")
        axis.set_ylabel("relative error of relit radiance (mean)")
    plots.decorate(axis)
    plots.legend(axis)
    return plots.finish(figure)


def _relit_plot(comparison: Comparison) -> bytes:
    names = [view.environment.name for view in comparison.views]
    figure, axes = plots.figure(len(names))
    for axis, name in zip(axes[0], names, strict=True):
        for (basis, _), methods in _curves(comparison).items():
            colour, marker, dash = STYLES[basis]
            axis.plot(
                [m.terms for m in methods],
                [m.relit_error[name] for m in methods],
                dash,
                color=colour,
                marker=marker,
                label=basis,
                linewidth=1.8,
                markersize=6,
            )
        plots.logarithmic(axis)
        axis.set_title(name)
        axis.set_xlabel("functions per vertex, K")
        axis.set_ylabel("relative error of relit radiance")
        plots.decorate(axis)
    figure.tight_layout()
    plots.legend(axes[0, -1])
    return plots.finish(figure)


def ladder_plot(rungs: Sequence[Rung]) -> bytes:
    """The errors of all steps under each environment, one below the other, with the noise that they are known to."""
    names = list(dict.fromkeys(rung.environment for rung in rungs))
    stages = list(dict.fromkeys(rung.stage for rung in rungs if rung.error > 0.0))
    figure, axes = plots.figure(len(names))
    figure.set_size_inches(3.2 + 4.6 * len(names), 1.5 + 0.55 * len(stages))
    kinds = ((IN_PICTURE, "#D55E00", "o", -0.12), (AT_VERTICES, "#0072B2", "s", 0.12))
    for axis, name in zip(axes[0], names, strict=True):
        for against, colour, marker, shift in kinds:
            seen = [r for r in rungs if r.environment == name and r.against == against and r.error > 0.0]
            places = [stages.index(r.stage) + shift for r in seen]
            axis.plot([r.error for r in seen], places, marker, color=colour, markersize=7, label=f"against {against}")
            for rung, place in zip(seen, places, strict=True):
                if rung.noise > 0.0:
                    axis.plot([rung.noise, rung.error], [place, place], "-", color=colour, linewidth=1.0, alpha=0.6)
        axis.set_xscale("log")
        axis.xaxis.set_major_locator(matplotlib.ticker.LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.xaxis.set_major_formatter(matplotlib.ticker.FuncFormatter(lambda v, _: f"{100 * v:g} %"))
        axis.xaxis.set_minor_formatter(matplotlib.ticker.NullFormatter())
        labels = [textwrap.fill(stage, 26) for stage in stages] if axis is axes[0, 0] else [""] * len(stages)
        axis.set_yticks(range(len(stages)), labels)
        axis.set_ylim(len(stages) - 0.5, -0.5)
        axis.set_xlabel(f"relative RMS error under {name}")
        axis.grid(True, axis="x", which="major", color="#dddddd", linewidth=0.6)
        axis.set_axisbelow(True)
    figure.tight_layout()
    axes[0, 0].legend(frameon=False, fontsize=10, ncols=2, loc="lower left", bbox_to_anchor=(0.0, 1.0))
    return plots.finish(figure)


# --- HTML ------------------------------------------------------------------------------------------------------------


def _render(
    comparison: Comparison,
    figures: dict[str, bytes],
    pictures: list[dict[str, Any]],
    command: str,
    sweep: Sweep | None,
) -> str:
    results = comparison.results()
    swept = {} if sweep is None else sweep_report.fronts(sweep)
    return pages.template("report.html.j2").render(
        **{name: value for name, value in swept.items() if name != "figures"},
        results=results,
        mean=lambda errors: float(np.mean(list(errors.values()))),
        findings=_findings(comparison),
        half_angles=[math.degrees(a) for a in comparison.half_angles],
        shown=comparison.shown_terms,
        grouped_by=_GROUPED_BY["view" if results["toward_camera"] else results["group_by"]],
        figures={**figures, **swept.get("figures", {})},
        pictures=pictures,
        descriptions=DESCRIPTIONS,
        error_scale=_ERROR_SCALE,
        scale_bar=_error_png(np.linspace(0.0, _ERROR_SCALE, 256)[None].repeat(12, axis=0)),
        command=command,
        name=Path(results["scene"]).name,
    )


def _findings(comparison: Comparison) -> list[str]:
    """The few sentences that a reader takes away, each with its numbers."""
    at = {m.basis: m for m in comparison.methods if m.terms == comparison.shown_terms and m.coding != "coded"}
    coded = [m for m in comparison.methods if m.basis == "adapted" and m.coding == "coded"]
    full = (comparison.transfer.bandlimit + 1) ** 2
    found = []

    def mean(basis: str) -> float:
        return float(np.mean(list(at[basis].relit_error.values())))

    if "adapted" in at and "sh" in at:
        found.append(
            f"With {comparison.shown_terms} of {full} functions per vertex, relit radiance is off by "
            f"{percent(mean('adapted'))} with the adapted basis, by {percent(mean('sh'))} with spherical harmonics."
        )
    if "cpca" in at and "adapted" in at:
        found.append(
            f"Principal components of each cluster reach {percent(mean('cpca'))}; they need all vectors at once, and "
            f"{at['cpca'].bytes_per_vertex:.0f} instead of {at['adapted'].bytes_per_vertex:.0f} bytes per vertex."
        )
    if "adapted" in at:
        found.append(
            f"The error of the transfer vectors was predicted as {percent(at['adapted'].predicted_error)} and "
            f"measured as {percent(at['adapted'].transfer_error)}."
        )
    if coded:
        best = coded[len(coded) // 2]
        whole = comparison.methods[-1]
        found.append(
            f"Rounded, predicted from neighbours and entropy-coded, the adapted basis takes "
            f"{best.bytes_per_vertex:.1f} bytes per vertex at a relit error of "
            f"{percent(float(np.mean(list(best.relit_error.values()))))}; full SH in float16 takes "
            f"{whole.bytes_per_vertex:.0f}."
        )
    for view in comparison.views:
        name = view.environment.name
        rungs = [r for r in comparison.ladder if r.environment == name]
        seen = [r for r in rungs if r.against == IN_PICTURE]
        known = [r for r in rungs if r.against == AT_VERTICES]
        found.append(
            f"Under {name}, full SH differs from the path-traced picture by {percent(seen[2].error)} (noise of the "
            f"reference {percent(seen[0].noise)}): {percent(seen[1].error)} is there without any bandlimit, from "
            f"interpolating between vertices, and the bandlimit changes the radiance at the vertices by "
            f"{percent(known[1].error)}."
        )
    return found
