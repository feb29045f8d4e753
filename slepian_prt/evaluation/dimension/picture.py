"""A picture of the effective dimension on a model, with the scale of its colours."""

from __future__ import annotations

import io
import math
from dataclasses import dataclass
from textwrap import wrap
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

_NAME = "effective dimension of light transport"

# Pixels for each of the width, and the least that can be read: letters of the title, letters below it, the bar.
_TITLE, _TEXT, _BAR = 0.029, 0.0225, 0.024
_LEAST_TITLE, _LEAST_TEXT, _LEAST_BAR = 10.0, 9.0, 8.0

# Narrower pictures have no scale: its words would be broken.
LEAST_WIDTH = 100

# Lines are so many letters high, letters so wide, for their size; lines take this part of the width, numbers at ticks
# are so many times their own width apart.
_LINE, _LETTER, _KEPT, _APART = 1.35, 0.55, 0.96, 0.95

_DPI = 100.0
_POINT = 72.0 / _DPI


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

    def ticks(self, letter: float = 0.0) -> list[float]:
        """Round numbers on it that do not touch each other where letters are of that size, as a part of its width.

        The ends, if those are not two.
        """
        ticks: list[float] = []
        last = -math.inf
        for tick in _TICKS:
            place = math.log(tick / self.low) / math.log(self.high / self.low)
            if 0.0 <= place <= 1.0 and place - last >= _APART * letter * len(str(tick)):
                ticks.append(tick)
                last = place
        return ticks if len(ticks) > 1 else [self.low, self.high]


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
    """A .png of what `draw_dimension` drew, the scale below it if that can be read at this width."""
    height, width = pixels.shape[:2]
    legend = _Legend.of(result, width) if width >= LEAST_WIDTH else None
    strip = 0 if legend is None else legend.height
    with rc_context({"font.family": "sans-serif"}):
        # A little more than whole pixels, which are cut to whole ones: n / 100 · 100 is less than n for some n.
        figure = Figure(figsize=((width + 1e-3) / _DPI, (height + strip + 1e-3) / _DPI), dpi=_DPI)
        colour = finish.colour
        background = (1.0, 1.0, 1.0, 0.0) if colour is None else tuple(encode_srgb(colour))
        figure.set_facecolor(background)
        figure.figimage(pixels, 0, strip, origin="upper")
        if legend is not None:
            ink = "black" if colour is None or float(colour.mean()) > 0.2 else "white"
            _draw_legend(figure, legend, width, scale, ink)
        buffer = io.BytesIO()
        figure.savefig(buffer, format="png", dpi=_DPI, facecolor=background)
    return buffer.getvalue()


@dataclass(frozen=True)
class _Legend:
    """What stands below a model, from top to bottom with space between: title, bar, ticks and caption; in pixels.

    Attributes
    ----------
    title, caption : list of str
        Lines.
    title_size, text_size : float
        Of letters.
    bar : float
        Height of the bar.
    """

    title: list[str]
    caption: list[str]
    title_size: float
    text_size: float
    bar: float

    @classmethod
    def of(cls, result: EffectiveDimension, width: int) -> _Legend:
        title_size, text_size = max(_TITLE * width, _LEAST_TITLE), max(_TEXT * width, _LEAST_TEXT)
        title, caption = (
            wrap(text, max(1, int(_KEPT * width / (_LETTER * size))), break_long_words=False)
            for text, size in ((_NAME, title_size), (describe_scale(result), text_size))
        )
        return cls(title, caption, title_size, text_size, max(_BAR * width, _LEAST_BAR))

    @property
    def top_of_bar(self) -> float:
        """From the top of the strip."""
        return 0.5 * self.title_size + _LINE * self.title_size * len(self.title)

    @property
    def top_of_caption(self) -> float:
        """From the top of the strip; ticks and their numbers are above."""
        return self.top_of_bar + self.bar + 2.0 * self.text_size

    @property
    def height(self) -> int:
        return math.ceil(self.top_of_caption + _LINE * self.text_size * len(self.caption) + 0.5 * self.text_size)


def _draw_legend(figure: Figure, legend: _Legend, width: int, scale: ColourScale, ink: str) -> None:
    whole = figure.get_figheight() * _DPI

    def write(lines: list[str], top: float, size: float) -> None:
        for number, line in enumerate(lines):
            place = (legend.height - top - _LINE * size * number) / whole
            figure.text(0.5, place, line, ha="center", va="top", fontsize=size * _POINT, color=ink)

    write(legend.title, 0.3 * legend.title_size, legend.title_size)
    write(legend.caption, legend.top_of_caption, legend.text_size)
    bottom = (legend.height - legend.top_of_bar - legend.bar) / whole
    bar = figure.add_axes((0.1, bottom, 0.8, legend.bar / whole))
    draw_bar(bar, scale, ink, legend.text_size * _POINT, 0.8 * width * _POINT)


def draw_bar(axis: Any, scale: ColourScale, ink: str, text: float, width: float) -> None:
    """Colours with their dimensions; letters and the width of the bar in points."""
    steps = np.geomspace(scale.low, scale.high, 256)
    axis.pcolormesh(np.geomspace(scale.low, scale.high, 257), [0.0, 1.0], scale.colours(steps)[None], rasterized=True)
    axis.set_xscale("log")
    axis.set_xlim(scale.low, scale.high)
    axis.set_yticks([])
    ticks = scale.ticks(text / width)
    axis.set_xticks(ticks, [f"{tick:.3g}" if tick < 1000 else f"{tick:.0f}" for tick in ticks])
    axis.set_xticks([], minor=True)
    axis.tick_params(labelsize=text, colors=ink, length=0.27 * text, width=0.07 * text, pad=0.2 * text)
    for spine in axis.spines.values():
        spine.set_visible(False)


def describe_scale(result: EffectiveDimension) -> str:
    """What is counted, in a line, and what grey is where there is some."""
    dark = bool(np.any((result.dimension == 0.0) & (result.areas > 0.0)))
    return (
        f"functions of {result.functions}, error {100.0 * result.error:.3g} %, "
        f"over radii of {100.0 * result.neighbourhood:.3g} % of the model's size{'; grey: no light' if dark else ''}"
    )
