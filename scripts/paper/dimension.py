"""What the paper is about, on a model: the effective dimension of light transport over neighbourhoods of a surface."""

from __future__ import annotations

import math

import matplotlib.pyplot as plt
import numpy as np
from drawing import ROOT, save

import slepian_prt as sp
from slepian_prt.evaluation.dimension.picture import ColourScale, describe_scale, draw_bar, draw_dimension
from slepian_prt.relighting.drawing.camera import relit_camera
from slepian_prt.renderer.variants import mitsuba

_WIDTH = 600


def dimension() -> None:
    """The shipped knot in colours of the dimension at L = 10: by its normals alone, as in the paper, and with shadows.

    Without shadows transport is the cosine lobe about the normals, for which Eq. 8 holds.
    """
    knot = ROOT / "scenes" / "knot.ply"
    shadowed, open_ = sp.precompute(knot), sp.precompute(knot, effects="none")
    results = sp.effective_dimension(open_), sp.effective_dimension(shadowed)
    scale = ColourScale.of(*results)
    with mitsuba():
        camera = relit_camera(shadowed, _WIDTH)
    height = camera.alpha.shape[0]
    names = ("normals alone", "with shadows")
    figure, axes = plt.subplots(1, 2, figsize=(8.0, 8.0 * height / _WIDTH / 2.0 + 1.85))
    figure.subplots_adjust(left=0.0, right=1.0, bottom=0.25, top=0.87, wspace=0.0)
    for axis, result, name in zip(axes, results, names, strict=True):
        axis.imshow(draw_dimension(camera, shadowed.normals, result, scale))
        axis.set_title(f"{name}\nmedian {_in_words(result)}", fontsize=12)
        axis.axis("off")
        print(f"knot, {name}: median {_in_words(result)}; 5 % of the surface {_ends(result)}")
    bar = figure.add_axes((0.1, 0.135, 0.8, 0.035))
    draw_bar(bar, scale, "black", text=11.0, width=0.8 * 8.0 * 72.0)
    bar.set_title("effective dimension of light transport around each point", fontsize=12)
    bar.set_xlabel(describe_scale(results[1]), fontsize=11)
    save(figure, "dimension")


def _in_words(result: sp.EffectiveDimension) -> str:
    middle = math.ceil(result.quantile(0.5))
    return f"{middle} of {result.functions}, coherence {1.0 - middle / result.functions:.2f}"


def _ends(result: sp.EffectiveDimension) -> str:
    low, high = np.ceil([result.quantile(0.05), result.quantile(0.95)])
    return f"at most {low:.0f}, at least {high:.0f}"
