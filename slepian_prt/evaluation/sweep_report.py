"""A sweep as files: numbers, plots with the Pareto front, and a page that needs nothing else."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np

from slepian_prt.evaluation import pages, plots
from slepian_prt.evaluation.sweep import Point, Sweep, findings, pareto
from slepian_prt.files import write_all

_COSTS = {
    "seconds": "seconds, transport and compression",
    "bytes_per_vertex": "bytes per vertex, everything but the mesh counted",
}

# The noise of a reference is drawn if it is at least this part of the smallest error; it is told in any case.
_NEAR = 0.2

# A marker for each bandlimit, in order; its colour, from light to dark, says the same.
_MARKERS = ("o", "s", "^", "D", "v", "P", "X", "<", "p", ">", "h", "*")

# Of the front, settings are named that are better than the last one by this factor at least.
_NAMED = 0.87
_MOST_NAMED = 14


def write_sweep(sweep: Sweep, folder: str | Path) -> Path:
    """Write sweep.html, sweep.json, sweep.csv and the plots; return the path of the page.

    Raises
    ------
    UserError
        The folder cannot be written.
    """
    folder = Path(folder)
    shown = fronts(sweep)
    files = {f"{name}_{cost}.png": content for (name, cost), content in shown["figures"].items()}
    files["sweep.json"] = (json.dumps(sweep.results(), indent=1) + "\n").encode()
    files["sweep.csv"] = _csv(sweep).encode()
    files["sweep.html"] = _page(sweep, shown).encode()
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
    colours = matplotlib.colormaps["viridis_r"](np.linspace(0.15, 1.0, len(bandlimits)))
    for number, bandlimit in enumerate(bandlimits):
        chosen = [point for point in sweep.points if point.setting.bandlimit == bandlimit]
        axis.plot(
            [getattr(point, cost) for point in chosen],
            [point.error[name] for point in chosen],
            _MARKERS[number % len(_MARKERS)],
            color=colours[number],
            label=f"L = {bandlimit}",
            markersize=5,
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
    shown = _named(front, name)
    for number, point in enumerate(shown, start=1):
        place = (getattr(point, cost), point.error[name])
        axis.plot(*place, "o", markersize=11, markerfacecolor="none", markeredgecolor="#222222", markeredgewidth=1.0)
        axis.annotate(str(number), place, xytext=(6, 6), textcoords="offset points", fontsize=10)
    plots.legend(axis)
    lines = [
        f"{number}  {_short(sweep, point)}: {plots.percent(point.error[name])}, {_amount(point, cost)}"
        for number, point in enumerate(shown, start=1)
    ]
    half = (len(lines) + 1) // 2
    for column, part in enumerate((lines[:half], lines[half:])):
        axis.text(0.62 * column, -0.2, "\n".join(part), transform=axis.transAxes, va="top", fontsize=9)
    return plots.finish(figure)


def _named(front: Sequence[Point], name: str) -> list[Point]:
    """Points of a front that are well apart, from the cheapest to the most exact."""
    step = _NAMED
    while True:
        found: list[Point] = []
        for point in front:
            if not found or point.error[name] <= step * found[-1].error[name]:
                found.append(point)
        if front and found[-1] is not front[-1]:
            found[-1 if len(found) > 1 else len(found) :] = [front[-1]]
        if len(found) <= _MOST_NAMED:
            return found
        step *= 0.95


def _amount(point: Point, cost: str) -> str:
    """What a setting costs, for readers."""
    return plots.seconds(point.seconds) if cost == "seconds" else f"{point.bytes_per_vertex:.2g} bytes"


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


def fronts(sweep: Sweep) -> dict[str, Any]:
    """What a page needs to show errors against time and bytes."""
    return {
        "sweep": sweep,
        "sweep_command": sweep.command,
        "figures": {
            (name, cost): _plot(sweep, name, cost, title)
            for name in sweep.environments
            for cost, title in _COSTS.items()
        },
        "costs": _COSTS,
        "cheapest": {name: _cheapest(sweep, name) for name in sweep.environments},
    }


def _page(sweep: Sweep, shown: dict[str, Any]) -> str:
    return pages.template("sweep.html.j2").render(
        **shown,
        results=sweep.results(),
        findings=findings(sweep),
        command=sweep.command,
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
