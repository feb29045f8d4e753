"""What the plots of reports share."""

from __future__ import annotations

import io
from typing import Any

import matplotlib
import matplotlib.ticker
import numpy as np
from matplotlib.figure import Figure

# An error below this is rounding of float64.
_NOTHING = 1e-9

# Of figures in reports; those of a user's own plots stay as they are, and so does the backend.
_STYLE = {"font.size": 11, "axes.spines.top": False, "axes.spines.right": False}


def make_figure(columns: int = 1, rows: int = 1, size: tuple[float, float] | None = None) -> tuple[Any, Any]:
    """Plots side by side, by default in the size of a page: a Matplotlib figure, and its axes (rows, columns)."""
    with matplotlib.rc_context(_STYLE):
        figure = Figure(figsize=size or (7.2 if columns == 1 else 5.4 * columns, 4.6))
        return figure, figure.subplots(rows, columns, squeeze=False, sharex="col")


def encode_figure(figure: Any) -> bytes:
    """The figure as a PNG."""
    buffer = io.BytesIO()
    with matplotlib.rc_context(_STYLE):
        figure.savefig(buffer, format="png", dpi=150, bbox_inches="tight")
    return buffer.getvalue()


def finish_axis(axis: Any, abscissa: str, ordinate: str) -> None:
    """Name the axes of a plot of errors; the ordinate is logarithmic unless all are zero, in per cent, with a grid."""
    if any(np.any(np.asarray(curve.get_ydata()) > 0.0) for curve in axis.get_lines()):
        axis.set_yscale("log")
    axis.set_xlabel(abscissa)
    axis.set_ylabel(ordinate)
    axis.grid(True, which="both", color="#dddddd", linewidth=0.6)
    axis.set_axisbelow(True)
    formatter = matplotlib.ticker.FuncFormatter(lambda v, _: f"{100 * v:g} %")
    axis.yaxis.set_major_formatter(formatter)
    low, high = axis.get_ylim()
    if axis.get_yscale() == "log" and high / max(low, 1e-300) < 300.0:  # few decades: label between them too
        between = (1.0, 1.5, 2.0, 3.0, 5.0, 7.0) if high / max(low, 1e-300) < 12.0 else (1.0, 2.0, 5.0)
        axis.yaxis.set_major_locator(matplotlib.ticker.LogLocator(subs=between))
        axis.yaxis.set_minor_formatter(matplotlib.ticker.NullFormatter())


def scale_abscissa(axis: Any, factor: float = 1.0, unit: str = "") -> None:
    """A logarithmic abscissa with plain numbers, times ``factor``, at 1, 2 and 5 of each decade."""
    axis.set_xscale("log")
    axis.xaxis.set_major_locator(matplotlib.ticker.LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.xaxis.set_major_formatter(matplotlib.ticker.FuncFormatter(lambda v, _: f"{factor * v:g}{unit}"))
    axis.xaxis.set_minor_formatter(matplotlib.ticker.NullFormatter())


def add_legend(axis: Any) -> None:
    """Beside the plot."""
    axis.legend(frameon=False, fontsize=10, loc="upper left", bbox_to_anchor=(1.01, 1.0))


def add_legend_below(axis: Any, inches: float = 0.6) -> None:
    """Under the plot, so many inches below it: beside it, it would leave the plot half of a narrow screen."""
    height = axis.figure.get_size_inches()[1] * axis.get_position().height
    axis.legend(
        frameon=False,
        fontsize=10,
        ncols=3,
        loc="upper center",
        bbox_to_anchor=(0.5, -inches / height),
        columnspacing=1.2,
    )


def percent(value: float | None) -> str:
    """An error for readers, with two digits."""
    if value is None:
        return "–"
    number = "0" if value < _NOTHING else f"{100 * value:.2g}" if value < 0.1 else f"{100 * value:.0f}"
    return f"{number}\N{NO-BREAK SPACE}%"


def seconds(value: float) -> str:
    """A time for readers, in milliseconds or seconds."""
    return f"{1000 * value:.2g} ms" if value < 0.1 else f"{value:.2g} s" if value < 10 else f"{value:.0f} s"
