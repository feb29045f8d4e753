"""The report of a comparison: one HTML file that needs nothing else, and its figures as files."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from slepian_prt.errors import UserError
from slepian_prt.evaluation import pages
from slepian_prt.evaluation.comparison import Comparison, MethodResult, View
from slepian_prt.evaluation.ladder import AT_VERTICES, IN_PICTURE
from slepian_prt.evaluation.methods import FULL_SH, METHODS
from slepian_prt.evaluation.plots import percent
from slepian_prt.evaluation.report_pictures import ERROR_SCALE, draw_view, encode_error_map
from slepian_prt.evaluation.report_plots import plot_by_bytes, plot_by_terms, plot_ladder, plot_relit
from slepian_prt.evaluation.sweep.report import front_context
from slepian_prt.evaluation.sweep.results import Sweep
from slepian_prt.files import check_folder, write_all
from slepian_prt.scene.named_files import check_output_files
from slepian_prt.viewer.page_file import make_page
from slepian_prt.viewer.pages import PageWish, page_content
from slepian_prt.viewer.payload import make_payload

# The page beside the report, where one is wanted.
VIEWER = "viewer.html"

_GROUPED_BY = {
    "normal": "their normals",
    "bent": "the mean direction of the light that reaches them",
    "surface": "neighbourhoods on the surface",
    "view": "their reflection directions",
}


def check_report(
    folder: str,
    inputs: Sequence[str | Path],
    environments: Sequence[str],
    parameters: Mapping[str, Any] | None = None,
) -> None:
    """Raise UserError unless a report can be written there, and none of its files in the place of an input."""
    check_folder(folder)
    plots = ("transfer_error", "relit_error", "error_by_bytes", "ladder")
    names = {"report.html", "results.json", VIEWER, *(f"{name}.png" for name in plots)}

    def is_written(name: str) -> bool:
        return name in names or (name.endswith(".png") and name.startswith(tuple(f"{view}_" for view in environments)))

    check_output_files(folder, is_written, *inputs, parameters=parameters)


def write_report(
    comparison: Comparison,
    folder: str | Path,
    command: str,
    sweep: Sweep | None = None,
    viewer: PageWish | None = None,
) -> Path:
    """Write report.html, results.json and the figures; return the path of the report.

    Everything is made before the first byte is written. The report shows the Pareto fronts of a ``sweep`` too, and
    links to a page of the model, as of ``viewer``, with full SH behind a slider.

    Raises
    ------
    UserError
        The folder cannot be written to; the first method is none whose files can be viewed.
    """
    folder = Path(folder)
    figures = {
        "transfer_error": plot_by_terms(comparison),
        "relit_error": plot_relit(comparison),
        "error_by_bytes": plot_by_bytes(comparison),
        "ladder": plot_ladder(comparison.ladder),
    }
    views = [draw_view(comparison, view) for view in comparison.views]
    files = {f"{name}.png": content for name, content in figures.items()}
    for view in views:
        for panel in view["panels"]:
            files[f"{view['environment']}_{panel['file']}.png"] = panel["png"]
            files[f"{view['environment']}_{panel['error_file']}.png"] = panel["error_png"]
    files["results.json"] = (json.dumps(comparison.results(), indent=1) + "\n").encode()
    if viewer is not None:
        files[VIEWER] = _viewer_page(comparison, viewer)
    files["report.html"] = _render(comparison, figures, views, command, sweep, VIEWER if viewer else None).encode()
    write_all(folder, files)
    return folder / "report.html"


def _viewer_page(comparison: Comparison, wish: PageWish) -> bytes:
    if comparison.compressed is None:
        raise UserError(f"{comparison.methods[0].basis} is no basis whose files can be viewed; name another one first")
    maps = tuple(view.environment for view in comparison.views)
    content = page_content(comparison.compressed, replace(wish, maps=maps), comparison.transfer)
    return make_page(content.title, make_payload(content))


def _render(
    comparison: Comparison,
    figures: dict[str, bytes],
    views: list[dict[str, Any]],
    command: str,
    sweep: Sweep | None,
    viewer: str | None,
) -> str:
    results = comparison.results()
    fronts = {} if sweep is None else front_context(sweep)
    methods = {**METHODS, "none": FULL_SH}
    return pages.load_template("report.html.j2").render(
        **{name: value for name, value in fronts.items() if name != "figures"},
        results=results,
        findings=_findings(comparison),
        half_angles=[math.degrees(angle) for angle in comparison.half_angles],
        grouped_by=_GROUPED_BY["view" if results["toward_camera"] else results["group_by"]],
        figures={**figures, **fronts.get("figures", {})},
        views=views,
        descriptions={name: method.description for name, method in methods.items()},
        error_scale=ERROR_SCALE,
        scale_bar=encode_error_map(np.linspace(0.0, ERROR_SCALE, 256)[None].repeat(12, axis=0)),
        command=command,
        viewer=viewer,
        name=Path(results["scene"]).name,
    )


def _findings(comparison: Comparison) -> list[str]:
    """The few sentences that a reader takes away, each with its numbers."""
    at_terms = {m.basis: m for m in comparison.methods if m.terms == comparison.pictured_terms and m.coding != "coded"}
    adapted, components = at_terms.get("adapted"), at_terms.get("cpca") or at_terms.get("pca")
    sentences = []
    if adapted and "sh" in at_terms:
        sentences.append(
            f"With {comparison.pictured_terms} of {(comparison.transfer.bandlimit + 1) ** 2} functions per vertex, "
            f"relit radiance is off by {_mean_error(adapted)} with the adapted basis, by "
            f"{_mean_error(at_terms['sh'])} with spherical harmonics."
        )
    if adapted and components:
        sentences.append(
            f"Principal components of each cluster reach {_mean_error(components)}; they need all vectors at once, and "
            f"{components.bytes_per_vertex:.0f} instead of {adapted.bytes_per_vertex:.0f} bytes per vertex."
        )
    if adapted:
        sentences.append(
            f"The error of the transfer vectors was predicted as {percent(adapted.predicted_error)} and measured as "
            f"{percent(adapted.transfer_error)}."
        )
    coded = [m for m in comparison.methods if m.basis == "adapted" and m.coding == "coded"]
    if coded:
        middle, full = coded[len(coded) // 2], comparison.methods[-1]
        sentences.append(
            f"Rounded, predicted from neighbours and entropy-coded, the adapted basis takes "
            f"{middle.bytes_per_vertex:.1f} bytes per vertex at a relit error of {_mean_error(middle)}; full SH in "
            f"float16 takes {full.bytes_per_vertex:.0f}."
        )
    return [*sentences, *(_ladder_finding(comparison, view) for view in comparison.views)]


def _mean_error(result: MethodResult) -> str:
    """Of relit radiance, over the environments."""
    return percent(float(np.mean(list(result.relit_error.values()))))


def _ladder_finding(comparison: Comparison, view: View) -> str:
    """What interpolation and the bandlimit each lose under one environment."""
    name = view.environment.name
    stages = [e for e in comparison.ladder if e.environment == name]
    reference, interpolated, full = [e for e in stages if e.against == IN_PICTURE][:3]
    _, full_at_vertices = [e for e in stages if e.against == AT_VERTICES][:2]
    return (
        f"Under {name}, full SH differs from the path-traced picture by {percent(full.error)} (noise of the "
        f"reference {percent(reference.noise)}): {percent(interpolated.error)} is there without any bandlimit, from "
        f"interpolating between vertices, and the bandlimit changes the radiance at the vertices by "
        f"{percent(full_at_vertices.error)}."
    )
