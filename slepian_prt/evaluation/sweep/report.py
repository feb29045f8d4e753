"""A sweep as files: numbers, plots with the Pareto front, and a page that needs nothing else."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np

from slepian_prt.evaluation import pages, plots
from slepian_prt.evaluation.sweep.results import Point, Sweep, find_setbacks, pareto_front
from slepian_prt.files import check_folder, write_all
from slepian_prt.scene.named_files import check_output_files

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

# Width of a character below a plot, as a part of the width of the plot.
_CHARACTER = 0.0128


def check_sweep(folder: str, inputs: Sequence[str | Path], parameters: Mapping[str, Any] | None = None) -> None:
    """Raise UserError unless a sweep can be written there, and none of its files in the place of an input."""
    check_folder(folder)
    plots_of = tuple(f"_{cost}.png" for cost in _COSTS)
    check_output_files(
        folder, lambda name: name.startswith("sweep.") or name.endswith(plots_of), *inputs, parameters=parameters
    )


def write_sweep(sweep: Sweep, folder: str | Path) -> Path:
    """Write sweep.html, sweep.json, sweep.csv and the plots; return the path of the page.

    Raises
    ------
    UserError
        The folder cannot be written.
    """
    folder = Path(folder)
    context = front_context(sweep)
    files = {f"{name}_{cost}.png": content for (name, cost), content in context["figures"].items()}
    files["sweep.json"] = (json.dumps(sweep.results(), indent=1) + "\n").encode()
    files["sweep.csv"] = _csv(sweep).encode()
    files["sweep.html"] = _page(sweep, context).encode()
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
            measured = {"error": errors[name], "full_error": full[name], "noise": sweep.noise[name]}
            writer.writerow({**row, "environment": name, **measured})
    return text.getvalue()


def _plot(sweep: Sweep, name: str, cost: str, title: str) -> bytes:
    """Error against a cost; the front is drawn and its points are named."""
    figure, axes = plots.make_figure()
    axis = axes[0, 0]
    _draw_points(axis, sweep, name, cost)
    front = pareto_front(sweep.points, name, cost)
    x, y = [getattr(point, cost) for point in front], [point.error[name] for point in front]
    axis.step(x, y, where="post", color="#222222", linewidth=1.2, label="Pareto front")
    if sweep.noise[name] > _NEAR * min(point.error[name] for point in sweep.points):
        axis.axhline(sweep.noise[name], color="#777777", linestyle=":", linewidth=1.2, label="noise of the reference")
    plots.scale_abscissa(axis)
    plots.finish_axis(axis, title, f"relative error under {name}")
    _name_points(axis, sweep, _well_apart(front, name), name, cost)
    plots.add_legend(axis)
    return plots.encode_figure(figure)


def _draw_points(axis: Any, sweep: Sweep, name: str, cost: str) -> None:
    """All settings, with a colour and marker for each bandlimit."""
    bandlimits = sorted({point.setting.bandlimit for point in sweep.points})
    colors = matplotlib.colormaps["viridis_r"](np.linspace(0.15, 1.0, len(bandlimits)))
    for number, bandlimit in enumerate(bandlimits):
        points = [point for point in sweep.points if point.setting.bandlimit == bandlimit]
        axis.plot(
            [getattr(point, cost) for point in points],
            [point.error[name] for point in points],
            _MARKERS[number % len(_MARKERS)],
            color=colors[number],
            label=f"L = {bandlimit}",
            markersize=5,
        )


def _name_points(axis: Any, sweep: Sweep, points: Sequence[Point], name: str, cost: str) -> None:
    """Numbers beside points, and what they stand for in two columns below the plot."""
    lines = []
    for number, point in enumerate(points, start=1):
        place = (getattr(point, cost), point.error[name])
        axis.plot(*place, "o", markersize=11, markerfacecolor="none", markeredgecolor="#222222", markeredgewidth=1.0)
        axis.annotate(str(number), place, xytext=(6, 6), textcoords="offset points", fontsize=10)
        error, amount = plots.percent(point.error[name]), _amount(point, cost)
        lines.append(f"{number}  {_short_label(sweep, point)}: {error}, {amount}")
    half, apart = (len(lines) + 1) // 2, _CHARACTER * (2 + max(map(len, lines), default=0))
    for column, part in enumerate((lines[:half], lines[half:])):
        axis.text(apart * column, -0.2, "\n".join(part), transform=axis.transAxes, va="top", fontsize=9)


def _well_apart(front: Sequence[Point], name: str) -> list[Point]:
    """Points of a front that are well apart, from the cheapest to the most exact."""
    step = _NAMED
    while True:
        chosen: list[Point] = []
        for point in front:
            if not chosen or point.error[name] <= step * chosen[-1].error[name]:
                chosen.append(point)
        if front and chosen[-1] is not front[-1]:
            chosen[-1 if len(chosen) > 1 else len(chosen) :] = [front[-1]]
        if len(chosen) <= _MOST_NAMED:
            return chosen
        step *= 0.95


def _amount(point: Point, cost: str) -> str:
    """What a setting costs, for readers."""
    return plots.seconds(point.seconds) if cost == "seconds" else f"{point.bytes_per_vertex:.2g} bytes"


def _short_label(sweep: Sweep, point: Point) -> str:
    """What of a setting is not the same in all."""
    setting = point.setting
    texts = {
        "samples": f"{setting.samples} rays",
        "bandlimit": f"L = {setting.bandlimit}",
        "clusters": f"{setting.clusters} caps",
        "basis": setting.basis,
        "tolerance": f"tolerance {setting.tolerance:g}",
        "bounces": "all bounces" if setting.bounces is None else f"{setting.bounces} bounces",
    }
    varied = [text for field, text in texts.items() if len({getattr(p.setting, field) for p in sweep.points}) > 1]
    return ", ".join(varied) or setting.label


def front_context(sweep: Sweep) -> dict[str, Any]:
    """What the template of errors against time and bytes is rendered with."""
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


def _page(sweep: Sweep, context: dict[str, Any]) -> str:
    return pages.load_template("sweep.html.j2").render(
        **context,
        results=sweep.results(),
        setbacks=find_setbacks(sweep),
        command=sweep.command,
        name=Path(sweep.source).name,
    )


def _cheapest(sweep: Sweep, name: str) -> list[tuple[float, Point | None]]:
    """The fastest setting for each of some errors."""
    good = {wanted: [p for p in sweep.points if p.error[name] <= wanted] for wanted in (0.2, 0.1, 0.05, 0.02)}
    return [(wanted, min(points, key=lambda p: p.seconds, default=None)) for wanted, points in good.items()]


def describe(sweep: Sweep) -> list[dict[str, Any]]:
    """The Pareto front in time under each environment, for a terminal."""
    return [
        {
            "environment": name,
            "setting": _short_label(sweep, point),
            "error": point.error[name],
            "seconds": point.seconds,
            "bytes_per_vertex": point.bytes_per_vertex,
        }
        for name in sweep.environments
        for point in pareto_front(sweep.points, name, "seconds")
    ]
