"""What the plots of reports share."""

from __future__ import annotations

import io
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np


def figure(columns: int = 1) -> tuple[Any, Any]:
    """A row of plots in the size of a page."""
    plt.rcParams.update({"font.size": 11, "axes.spines.top": False, "axes.spines.right": False})
    return plt.subplots(1, columns, figsize=(7.2 if columns == 1 else 5.4 * columns, 4.6), squeeze=False)


def finish(figure: Any) -> bytes:
    """The figure as a PNG."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=150, bbox_inches="tight")
    plt.close(figure)
    return buffer.getvalue()


def logarithmic(axis: Any) -> None:
    """A logarithmic ordinate, unless all errors are zero."""
    if any(np.any(np.asarray(curve.get_ydata()) > 0.0) for curve in axis.get_lines()):
        axis.set_yscale("log")


def legend(axis: Any) -> None:
    """Beside the plot."""
    axis.legend(frameon=False, fontsize=10, loc="upper left", bbox_to_anchor=(1.01, 1.0))


def decorate(axis: Any) -> None:
    """Grid, and errors in per cent."""
    axis.grid(True, which="both", color="#dddddd", linewidth=0.6)
    axis.set_axisbelow(True)
    formatter = matplotlib.ticker.FuncFormatter(lambda v, _: f"{100 * v:g} %")
    axis.yaxis.set_major_formatter(formatter)
    low, high = axis.get_ylim()
    if axis.get_yscale() == "log" and high / max(low, 1e-300) < 300.0:  # few decades: label between them too
        between = (1.0, 1.5, 2.0, 3.0, 5.0, 7.0) if high / max(low, 1e-300) < 12.0 else (1.0, 2.0, 5.0)
        axis.yaxis.set_major_locator(matplotlib.ticker.LogLocator(subs=between))
        axis.yaxis.set_minor_formatter(matplotlib.ticker.NullFormatter())


def percent(value: float | None) -> str:
    """For readers, with two digits."""
    if value is None:
        return "–"
    if value == 0.0:
        return "0 %"
    return f"{100 * value:.2g} %" if value < 0.1 else f"{100 * value:.0f} %"


def seconds(value: float) -> str:
    """For readers, in milliseconds or seconds."""
    return f"{1000 * value:.2g} ms" if value < 0.1 else f"{value:.2g} s" if value < 10 else f"{value:.0f} s"
