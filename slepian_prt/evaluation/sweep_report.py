"""A sweep as files: numbers, plots with the Pareto front, and a page that needs nothing else."""

from __future__ import annotations

import base64
import csv
import io
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jinja2
import matplotlib

from slepian_prt.compression.archive import write_all
from slepian_prt.evaluation import plots
from slepian_prt.evaluation.sweep import Point, Sweep, findings, pareto

_COSTS = {
    "seconds": "seconds, transport and compression",
    "bytes_per_vertex": "bytes per vertex, everything but the mesh counted",
}

# The noise of a reference is drawn if it is at least this part of the smallest error; it is told in any case.
_NEAR = 0.2

# Colour (Okabe & Ito, safe for colour-blind readers) and marker by bandlimit, in order.
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
_MARKERS = ("o", "s", "^", "D", "v", "P")


def write_sweep(sweep: Sweep, folder: str | Path, command: str) -> Path:
    """Write sweep.html, sweep.json, sweep.csv and the plots; return the path of the page.

    Raises
    ------
    UserError
        The folder cannot be written.
    """
    folder = Path(folder)
    figures = {
        (name, cost): _plot(sweep, name, cost, title) for name in sweep.environments for cost, title in _COSTS.items()
    }
    files = {f"{name}_{cost}.png": content for (name, cost), content in figures.items()}
    files["sweep.json"] = (json.dumps({**sweep.results(), "command": command}, indent=1) + "\n").encode()
    files["sweep.csv"] = _csv(sweep).encode()
    files["sweep.html"] = _page(sweep, figures, command).encode()
    write_all(folder, files)
    return folder / "sweep.html"


def _csv(sweep: Sweep) -> str:
    """One line for each setting and environment."""
    text = io.StringIO()
    fields = [
        "samples", "bounces", "bandlimit", "clusters", "basis", "tolerance", "environment", "error", "full_error",
        "noise", "bytes_per_vertex", "transport_seconds", "transport_spread", "compress_seconds", "seconds",
        "prepare_seconds",
        "relight_seconds",
    ]  # fmt: skip
    writer = csv.DictWriter(text, fields, lineterminator="\n")
    writer.writeheader()
    for point in sweep.points:
        row = point.as_dict()
        errors, full = row.pop("error"), row.pop("full_error")
        for name in sweep.environments:
            own = {"environment": name, "error": errors[name], "full_error": full[name], "noise": sweep.noise[name]}
            writer.writerow({**row, **own})
    return text.getvalue()


def _plot(sweep: Sweep, name: str, cost: str, title: str) -> bytes:
    """Error against a cost; the front is drawn and its points are named."""
    figure, axes = plots.figure()
    axis = axes[0, 0]
    bandlimits = sorted({point.setting.bandlimit for point in sweep.points})
    for number, bandlimit in enumerate(bandlimits):
        chosen = [point for point in sweep.points if point.setting.bandlimit == bandlimit]
        axis.plot(
            [getattr(point, cost) for point in chosen],
            [point.error[name] for point in chosen],
            _MARKERS[number % len(_MARKERS)],
            color=_COLOURS[number % len(_COLOURS)],
            label=f"L = {bandlimit}",
            markersize=6,
        )
    front = pareto(sweep.points, name, cost)
    axis.step(
        [getattr(point, cost) for point in front],
        [point.error[name] for point in front],
        where="post",
        color="#222222",
        linewidth=1.2,
        label="Pareto front",
    )
    if sweep.noise[name] > _NEAR * min(point.error[name] for point in sweep.points):
        axis.axhline(sweep.noise[name], color="#777777", linestyle=":", linewidth=1.2, label="noise of the reference")
    plots.logarithmic(axis)
    axis.set_xscale("log")
    axis.xaxis.set_major_locator(matplotlib.ticker.LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.xaxis.set_major_formatter(matplotlib.ticker.FuncFormatter(lambda v, _: f"{v:g}"))
    axis.xaxis.set_minor_formatter(matplotlib.ticker.NullFormatter())
    axis.set_xlabel(title)
    axis.set_ylabel(f"relative error under {name}")
    plots.decorate(axis)
    for number, point in enumerate(front, start=1):
        axis.annotate(str(number), (getattr(point, cost), point.error[name]), xytext=(4, 5), textcoords="offset points")
    names = "\n".join(f"{number}  {_short(sweep, point)}" for number, point in enumerate(front, start=1))
    axis.text(1.03, 0.55, names, transform=axis.transAxes, va="top", fontsize=9)
    plots.legend(axis)
    return plots.finish(figure)


def _short(sweep: Sweep, point: Point) -> str:
    """What of a setting is not the same in all."""
    own = point.setting
    named = {
        "samples": f"{own.samples} rays",
        "bandlimit": f"L = {own.bandlimit}",
        "clusters": f"{own.clusters} caps",
        "basis": own.basis,
        "tolerance": f"tolerance {own.tolerance:g}",
        "bounces": "all bounces" if own.bounces is None else f"{own.bounces} bounces",
    }
    varied = [text for field, text in named.items() if len({getattr(p.setting, field) for p in sweep.points}) > 1]
    return ", ".join(varied) or own.label


def _page(sweep: Sweep, figures: dict[tuple[str, str], bytes], command: str) -> str:
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("slepian_prt", "evaluation"), autoescape=True, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters["uri"] = lambda png: "data:image/png;base64," + base64.b64encode(png).decode()
    environment.filters["percent"] = plots.percent
    environment.filters["seconds"] = plots.seconds
    cheapest = {name: _cheapest(sweep, name) for name in sweep.environments}
    return environment.get_template("sweep.html.j2").render(
        sweep=sweep,
        results=sweep.results(),
        figures=figures,
        costs=_COSTS,
        fronts={name: pareto(sweep.points, name, "seconds") for name in sweep.environments},
        cheapest=cheapest,
        findings=findings(sweep),
        command=command,
        name=Path(sweep.source).name,
    )


def _cheapest(sweep: Sweep, name: str) -> list[tuple[float, Point | None]]:
    """The fastest setting for each of some errors."""
    found: list[tuple[float, Point | None]] = []
    for wanted in (0.2, 0.1, 0.05, 0.02):
        good: Sequence[Point] = [point for point in sweep.points if point.error[name] <= wanted]
        found.append((wanted, min(good, key=lambda point: point.seconds) if good else None))
    return found


def describe(sweep: Sweep) -> list[dict[str, Any]]:
    """The Pareto front in time under each environment, for a terminal."""
    return [
        {
            "environment": name,
            "setting": _short(sweep, point),
            "error": point.error[name],
            "seconds": point.seconds,
            "bytes_per_vertex": point.bytes_per_vertex,
        }
        for name in sweep.environments
        for point in pareto(sweep.points, name, "seconds")
    ]
