"""The plots of a report: errors against functions and bytes, and those of the stages."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import Any

import numpy as np

from slepian_prt.evaluation import plots
from slepian_prt.evaluation.comparison import Comparison, MethodResult
from slepian_prt.evaluation.ladder import AT_VERTICES, IN_PICTURE, StageError
from slepian_prt.evaluation.methods import METHODS

# Inches: small enough to be read on a telephone.
_SIZE = (5.6, 3.9)

# Ends of an abscissa of errors are apart by this factor at least, so that two of its labels at 1, 2 and 5 are seen.
_NARROWEST = 6.0


def plot_by_terms(comparison: Comparison) -> bytes:
    """Error of the transfer vectors against functions, with what was predicted for the adapted basis."""
    figure, axes = plots.make_figure(size=_SIZE)
    axis = axes[0, 0]
    for basis, results in _curves(comparison.methods).items():
        terms = [result.terms for result in results]
        _draw_curve(axis, basis, terms, [result.transfer_error for result in results])
        if basis == "adapted":
            predicted = [result.predicted_error for result in results]
            axis.plot(terms, predicted, "+", color="black", markersize=11, label="predicted for adapted", zorder=5)
    plots.finish_axis(axis, "functions per vertex, K", "relative error of the transfer vectors")
    plots.add_legend_below(axis)
    return plots.encode_figure(figure)


def plot_by_bytes(comparison: Comparison) -> bytes:
    """Mean error of relit radiance against bytes, with the coded methods as curves of their own."""
    figure, axes = plots.make_figure(size=_SIZE)
    axis = axes[0, 0]
    for coded in (False, True):
        for basis, results in _curves(comparison.methods, coded=coded).items():
            errors = [float(np.mean(list(result.relit_error.values()))) for result in results]
            _draw_curve(axis, basis, [result.bytes_per_vertex for result in results], errors, coded=coded)
    plots.scale_abscissa(axis)
    plots.finish_axis(
        axis, "bytes per vertex, everything but the mesh counted", "relative error of relit radiance (mean)"
    )
    plots.add_legend_below(axis)
    return plots.encode_figure(figure)


def plot_relit(comparison: Comparison) -> bytes:
    """Error of relit radiance against functions, for each environment."""
    names = [view.environment.name for view in comparison.views]
    figure, axes = plots.make_figure(rows=len(names), size=(_SIZE[0], _SIZE[1] * len(names)))
    for axis, name in zip(axes[:, 0], names, strict=True):
        for basis, results in _curves(comparison.methods).items():
            _draw_curve(axis, basis, [r.terms for r in results], [r.relit_error[name] for r in results])
        axis.set_title(name)
        axis.tick_params(labelbottom=True)
        plots.finish_axis(axis, "functions per vertex, K", "relative error of relit radiance")
    figure.tight_layout()
    plots.add_legend_below(axes[-1, 0])
    return plots.encode_figure(figure)


def _curves(results: Sequence[MethodResult], *, coded: bool = False) -> dict[str, list[MethodResult]]:
    """Results by basis but those of full SH: those that are coded, or those that are cut to K functions."""
    curves: dict[str, list[MethodResult]] = {}
    for result in results:
        if result.basis in METHODS and (result.coding == "coded") == coded:
            curves.setdefault(result.basis, []).append(result)
    return curves


def _draw_curve(axis: Any, basis: str, x: Sequence[float], errors: Sequence[float], *, coded: bool = False) -> None:
    color, marker, dash = METHODS[basis].style
    label, face = (f"{basis}, coded", "none") if coded else (basis, color)
    line = {"linestyle": dash or "none", "linewidth": 1.8, "marker": marker, "markersize": 6}
    axis.plot(x, errors, color=color, markerfacecolor=face, label=label, **line)


def plot_ladder(ladder: Sequence[StageError]) -> bytes:
    """The errors of all stages under each environment, one below the other, with the noise that they are known to."""
    names = list(dict.fromkeys(error.environment for error in ladder))
    stages = list(dict.fromkeys(error.stage for error in ladder if error.error > 0.0))
    figure, axes = plots.make_figure(rows=len(names), size=(_SIZE[0], (1.5 + 0.55 * len(stages)) * len(names)))
    for axis, name in zip(axes[:, 0], names, strict=True):
        for against, color, marker, shift in ((IN_PICTURE, "#D55E00", "o", -0.12), (AT_VERTICES, "#0072B2", "s", 0.12)):
            errors = [e for e in ladder if e.environment == name and e.against == against and e.error > 0.0]
            places = [stages.index(e.stage) + shift for e in errors]
            axis.plot([e.error for e in errors], places, marker, color=color, markersize=7, label=f"against {against}")
            for e, place in zip(errors, places, strict=True):
                if e.noise > 0.0:
                    axis.plot([e.noise, e.error], [place, place], "-", color=color, linewidth=1.0, alpha=0.6)
        plots.scale_abscissa(axis, 100.0, " %")
        axis.tick_params(labelbottom=True)
        axis.set_yticks(range(len(stages)), [textwrap.fill(stage, 22) for stage in stages])
        axis.set_ylim(len(stages) - 0.5, -0.5)
        axis.set_xlabel(f"relative RMS error under {name}")
        axis.grid(True, axis="x", which="major", color="#dddddd", linewidth=0.6)
        axis.set_axisbelow(True)
    shown = [value for error in ladder for value in (error.error, error.noise) if value > 0.0 and error.error > 0.0]
    if shown:
        margin = max(1.1, (_NARROWEST * min(shown) / max(shown)) ** 0.5)
        axes[0, 0].set_xlim(min(shown) / margin, max(shown) * margin)  # that of all
    figure.tight_layout()
    axes[0, 0].legend(frameon=False, fontsize=10, ncols=2, loc="lower right", bbox_to_anchor=(1.0, 1.0))
    return plots.encode_figure(figure)
