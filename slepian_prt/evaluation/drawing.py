"""Plots for notebooks: each draws on Matplotlib axes that are given, or on new ones, and returns them."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.errors import UserError, check_choice
from slepian_prt.evaluation.plots import finish_axis, scale_abscissa
from slepian_prt.lighting.environment import Environment
from slepian_prt.relighting.drawing.render import render_picture
from slepian_prt.slepian.concentration import CapBasis
from slepian_prt.slepian.region_concentration import RegionBasis
from slepian_prt.transport.transfer import Transfer

_ABSCISSAS = {"bytes": "bytes per vertex", "terms": "functions per vertex"}


def plot_spectrum(basis: CapBasis | RegionBasis, ax: Any = None, **line: Any) -> Any:
    """Eigenvalues against their index from one on.

    Parameters
    ----------
    basis : CapBasis or RegionBasis
    ax : matplotlib Axes, optional
    **line
        Of the curve, as of ``Axes.plot``: ``label``, ``color``, …

    Returns
    -------
    matplotlib Axes
    """
    ax = _axes(ax)
    ax.plot(np.arange(1, len(basis) + 1), basis.eigenvalues, **{"marker": "o", "markersize": 3, **line})
    ax.set_xlabel("index")
    ax.set_ylabel("eigenvalue")
    return ax


def plot_errors(
    results: Mapping[str, Any] | str | Path,
    ax: Any = None,
    *,
    against: Literal["bytes", "terms"] = "bytes",
    environment: str | None = None,
) -> Any:
    """Error of relit radiance of the methods that ``slepian-prt compare`` measured.

    Parameters
    ----------
    results : path of a results.json, or what is in it
    ax : matplotlib Axes, optional
    against : "bytes" or "terms"
        Size, coded methods as curves of their own; or number of functions, without them.
    environment : str, optional
        By default the mean over all of them.

    Returns
    -------
    matplotlib Axes

    Raises
    ------
    UserError
        A file that holds no such results, or an environment that is not in it.
    """
    check_choice(against, "against", _ABSCISSAS)
    measured = _read_results(results) if isinstance(results, str | Path) else results
    try:
        names, methods = list(measured["environments"]), list(measured["methods"])
        wanted = names if environment is None else [environment]
        if environment is not None:
            check_choice(environment, "environment", names)
        curves: dict[str, list[tuple[float, float]]] = {}
        for method in methods:
            coded = method["coding"] == "coded"
            if coded and against == "terms":
                continue
            error = float(np.mean([method["relit_error"][name] for name in wanted]))
            place = float(method["terms" if against == "terms" else "bytes_per_vertex"])
            curves.setdefault(f"{method['basis']}, coded" if coded else method["basis"], []).append((place, error))
    except (KeyError, TypeError) as error:
        raise UserError(f"these are no results of a comparison ({error!r}); give its results.json") from None
    ax = _axes(ax)
    for label, points in curves.items():
        ax.plot(*np.array(sorted(points)).T, marker="o", markersize=4, label=label)
    if against == "bytes":
        scale_abscissa(ax)
    finish_axis(ax, _ABSCISSAS[against], "relative error of relit radiance")
    ax.legend(frameon=False)
    return ax


def plot_picture(
    transfer: Transfer | CompressedTransfer,
    lighting: str | Path | Environment | ArrayLike | None = None,
    ax: Any = None,
    **options: Any,
) -> Any:
    """A relit model.

    Parameters
    ----------
    transfer, lighting, **options
        As of `render_picture`.
    ax : matplotlib Axes, optional

    Returns
    -------
    matplotlib Axes
    """
    pixels = render_picture(transfer, lighting, **options)
    ax = _axes(ax)
    ax.imshow(pixels)
    ax.set_axis_off()
    return ax


def _axes(ax: Any) -> Any:
    if ax is not None:
        return ax
    import matplotlib.pyplot as plt  # not before, because it chooses how figures are shown

    return plt.subplots()[1]


def _read_results(path: str | Path) -> Any:
    try:
        return json.loads(Path(path).read_text())
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror or error}); check the path") from None
    except ValueError:
        raise UserError(f"{path}: is not JSON; give the results.json of a comparison") from None
