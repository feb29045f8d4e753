"""A picture of the effective dimension on a model, with the scale of its colours."""

from __future__ import annotations

import io
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib import colormaps, rc_context
from matplotlib.figure import Figure
from numpy.typing import NDArray

from slepian_prt.evaluation.dimension.estimate import EffectiveDimension
from slepian_prt.relighting.drawing.camera import Camera
from slepian_prt.relighting.drawing.pictures import Finish, encode_srgb

# Even steps look even, and those who do not tell red from green see the same order.
_COLOURS = "viridis"

# What of a colour is left where a surface turns away from the camera: form is seen, and colours are still told apart.
_DARKEST = 0.55

# sRGB of what no light reaches, which has no dimension.
_DARK = 0.5

# Of the surface, at either end, whose colours are those of the ends of the scale.
_BEYOND = 0.01

# The least range of a scale, so that no difference is made of rounding.
_LEAST_RANGE = 1.5

_TICKS = (1, 2, 3, 5, 7, 10, 15, 20, 30, 50, 70, 100, 150, 200, 300, 500, 700, 1000, 1500, 2000, 2601)

# Pixels of the strip below a model, and of letters, for each of its width: text keeps within it at any width.
_STRIP, _TITLE, _TEXT = 0.16, 0.029, 0.0225


@dataclass(frozen=True)
class ColourScale:
    """Colours of dimensions, by their logarithm.

    Attributes
    ----------
    low, high : float
    """

    low: float
    high: float

    @classmethod
    def of(cls, *results: EffectiveDimension) -> ColourScale:
        """From what all but the last hundredth of the surface has at either end."""
        low = max(1.0, min(result.quantile(_BEYOND) for result in results))
        high = max(result.quantile(1.0 - _BEYOND) for result in results)
        return cls(low, max(high, _LEAST_RANGE * low))

    def colours(self, dimension: NDArray) -> NDArray[np.float64]:
        """sRGB in [0, 1], (..., 3); grey where the dimension is zero, as no light arrives."""
        place = np.log(np.maximum(dimension, 1.0) / self.low) / math.log(self.high / self.low)
        colours = colormaps[_COLOURS](np.clip(place, 0.0, 1.0))[..., :3]
        return np.where(np.asarray(dimension)[..., None] > 0.0, colours, _DARK)

    @property
    def ticks(self) -> list[float]:
        """Round numbers on it, at least two, or else its ends to hundredths."""
        whole: list[float] = [tick for tick in _TICKS if self.low <= tick <= self.high]
        return whole if len(whole) > 1 else [round(self.low, 2), round(self.high, 2)]


def draw_dimension(
    camera: Camera, normals: NDArray, result: EffectiveDimension, scale: ColourScale
) -> NDArray[np.float64]:
    """(H, W, 4) sRGB and opacity in [0, 1]: colours of the scale, darker where the surface turns away.

    The dimension is interpolated, not its colours, and from vertices that light reaches only; what is nearer to those
    that it does not reach is grey.
    """
    lit = (result.dimension > 0.0).astype(np.float64)
    seen = camera.picture(np.stack([result.dimension, lit, lit], axis=1))
    reached = seen.radiance[..., 1]
    dimension = seen.radiance[..., 0] / np.maximum(reached, 1e-4)
    colours = scale.colours(np.where(reached > 0.5 * seen.alpha, dimension, 0.0))
    turned = camera.picture(normals).radiance
    turned /= np.maximum(np.linalg.norm(turned, axis=2, keepdims=True), 1e-6)
    facing = np.clip(-np.sum(turned * camera.directions, axis=2, keepdims=True), 0.0, 1.0)
    return np.dstack([colours * (_DARKEST + (1.0 - _DARKEST) * facing), seen.alpha])


def encode_picture(pixels: NDArray, result: EffectiveDimension, scale: ColourScale, finish: Finish) -> bytes:
    """A .png of what `draw_dimension` drew, the scale below it."""
    height, width = pixels.shape[:2]
    strip = math.ceil(_STRIP * width)
    dpi = 100.0
    with rc_context({"font.family": "sans-serif"}):
        # A little more than whole pixels, which are cut to whole ones: n / 100 · 100 is less than n for some n.
        figure = Figure(figsize=((width + 1e-3) / dpi, (height + strip + 1e-3) / dpi), dpi=dpi)
        colour = finish.colour
        background = (1.0, 1.0, 1.0, 0.0) if colour is None else tuple(encode_srgb(colour))
        ink = "black" if colour is None or float(colour.mean()) > 0.2 else "white"
        figure.set_facecolor(background)
        figure.figimage(pixels, 0, strip, origin="upper")
        bar = figure.add_axes((0.1, 0.5 * strip / (height + strip), 0.8, 0.15 * strip / (height + strip)))
        draw_scale(bar, result, scale, ink, points=72.0 / dpi * width)
        buffer = io.BytesIO()
        figure.savefig(buffer, format="png", dpi=dpi, facecolor=background)
    return buffer.getvalue()


def draw_scale(axis: Any, result: EffectiveDimension, scale: ColourScale, ink: str, points: float) -> None:
    """Colours with their dimensions, and what they say; ``points`` is the width that text keeps within."""
    steps = np.geomspace(scale.low, scale.high, 256)
    axis.pcolormesh(np.geomspace(scale.low, scale.high, 257), [0.0, 1.0], scale.colours(steps)[None], rasterized=True)
    axis.set_xscale("log")
    axis.set_xlim(scale.low, scale.high)
    axis.set_yticks([])
    axis.set_xticks(scale.ticks, [f"{tick:.4g}" for tick in scale.ticks])
    axis.set_xticks([], minor=True)
    axis.tick_params(labelsize=_TEXT * points, colors=ink, length=0.006 * points, width=0.0015 * points)
    for spine in axis.spines.values():
        spine.set_visible(False)
    axis.set_title("effective dimension of light transport", fontsize=_TITLE * points, color=ink)
    axis.set_xlabel(describe_scale(result), fontsize=_TEXT * points, color=ink)


def describe_scale(result: EffectiveDimension) -> str:
    """What is counted, in a line."""
    return (
        f"functions of {result.functions}, error {100.0 * result.error:.3g} %, "
        f"over radii of {100.0 * result.neighbourhood:.3g} % of the model's size"
    )
