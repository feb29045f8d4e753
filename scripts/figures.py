"""Makes the figures and tables of the README and of docs/; see ``scripts/figures``."""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

import slepian_prt as sp
from slepian_prt.evaluation.errors import relative_rms
from slepian_prt.evaluation.reference import render_reference
from slepian_prt.relighting.picture import exposure, to_srgb, trace_camera
from slepian_prt.scene.scenes import open_scene

ROOT = Path(__file__).parent.parent
FIGURES = ROOT / "docs" / "figures"

plt.rcParams.update({"font.size": 11, "axes.spines.top": False, "axes.spines.right": False})


def save(figure: plt.Figure, name: str) -> None:
    FIGURES.mkdir(parents=True, exist_ok=True)
    figure.savefig(FIGURES / f"{name}.png", dpi=150, bbox_inches="tight")
    plt.close(figure)
    print(f"docs/figures/{name}.png")


def teaser() -> None:
    """The shipped scene: path-traced, full SH, and 16 functions per vertex of three bases."""
    path = ROOT / "scenes" / "knot.ply"
    sky = sp.read_environment(ROOT / "scenes" / "sky.exr")
    lighting = sp.project_environment(sky, 10)
    transfer = sp.precompute(path, bandlimit=10, samples=1024)
    full = sp.relight(transfer, lighting)
    with open_scene(path) as (mi, scene):
        camera = trace_camera(mi, scene, 420)
        reference = render_reference(mi, scene, sky, width=420, noise=0.01)
    pictures = [("path-traced reference", reference.picture), ("full SH, 121 functions", camera.picture(full))]
    for basis in ("adapted", "slepian", "sh"):
        radiance = sp.relight(sp.compress(transfer, basis, terms=16), lighting)
        title = f"{basis}, 16 functions\n{relative_rms(radiance, full):.0%} off full SH"
        pictures.append((title, camera.picture(radiance)))
    scale = exposure(reference.picture)
    figure, axes = plt.subplots(1, len(pictures), figsize=(15, 3.2))
    for axis, (title, picture) in zip(axes, pictures, strict=True):
        axis.imshow(to_srgb(picture, scale))
        axis.set_title(title, fontsize=11)
        axis.axis("off")
    figure.subplots_adjust(wspace=0.02)
    save(figure, "teaser")


FIGURE_MAKERS = {"teaser": teaser}


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
