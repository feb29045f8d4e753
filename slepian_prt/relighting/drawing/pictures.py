"""Pictures: linear radiance with coverage, exposed, tone-mapped and written."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slepian_prt.errors import UserError
from slepian_prt.files import atomic_output
from slepian_prt.renderer.threads import two_threads

# What may stand behind a model beside a colour: nothing, or the environment.
TRANSPARENT = "transparent"
MAP = "map"

# More stops than these leave the range of float32.
_MOST_STOPS = 60.0


class Picture(NamedTuple):
    """Linear radiance (H, W, 3), premultiplied by ``alpha`` (H, W), the part of each pixel that receivers cover."""

    radiance: NDArray[np.float32]
    alpha: NDArray[np.float32]

    def over(self, background: ArrayLike) -> Picture:
        """The same before a background (3,) or (H, W, 3) of linear radiance; nothing is left uncovered."""
        behind = (1.0 - self.alpha[..., None]) * np.asarray(background, dtype=np.float32)
        return Picture((self.radiance + behind).astype(np.float32), np.ones_like(self.alpha))


@dataclass(frozen=True)
class Finish:
    """How a picture is shown.

    Attributes
    ----------
    background : str
        ``transparent``, ``map`` (the environment, behind the model), or a colour: a name of CSS or #rrggbb.
    exposure : float
        In stops, beside that of `exposure` where pictures are tone-mapped: each doubles what is shown.

    Raises
    ------
    UserError
        No such colour, or stops that are no number or too many.
    """

    background: str = TRANSPARENT
    exposure: float = 0.0

    def __post_init__(self) -> None:
        if self.background not in (TRANSPARENT, MAP):
            _parse_colour(self.background)
        try:
            stops = float(self.exposure)
        except (TypeError, ValueError):
            stops = math.nan
        if not abs(stops) <= _MOST_STOPS:
            raise UserError(
                f"exposure must be a number of stops between -{_MOST_STOPS:g} and {_MOST_STOPS:g}, "
                f"not {self.exposure!r}"
            )
        object.__setattr__(self, "exposure", stops)

    @cached_property
    def colour(self) -> NDArray[np.float64] | None:
        """(3,) linear radiance of a plain background, or None."""
        if self.background in (TRANSPARENT, MAP):
            return None
        return from_srgb(np.array(_parse_colour(self.background)) / 255.0)

    @property
    def shown(self) -> str:
        """The background, a colour as #rrggbb."""
        if self.background in (TRANSPARENT, MAP):
            return self.background
        return "#" + bytes(_parse_colour(self.background)).hex()

    @property
    def factor(self) -> float:
        """What the exposure multiplies radiance by."""
        return 2.0**self.exposure


def _parse_colour(name: Any) -> tuple[int, ...]:
    from PIL import ImageColor  # only for a colour, so that relighting starts without Pillow

    known = isinstance(name, str) and (name.startswith("#") or name.lower() in ImageColor.colormap)
    try:
        colour: tuple[int, ...] = ImageColor.getrgb(name) if known else ()
    except ValueError:
        colour = ()
    if len(colour) != 3:
        raise UserError(f"background must be transparent, map, a colour such as white, or #rrggbb; not {name!r}")
    return colour


def split_alpha(pixels: NDArray) -> Picture:
    """A `Picture` from Mitsuba's RGBA pixels; without an alpha channel everything counts as covered."""
    pixels = np.asarray(pixels, dtype=np.float32)
    if pixels.shape[2] == 4:
        return Picture(pixels[..., :3], np.clip(pixels[..., 3], 0.0, 1.0))
    return Picture(pixels[..., :3], np.ones(pixels.shape[:2], dtype=np.float32))


def exposure(picture: Picture, target: float = 0.85) -> float:
    """The factor that brings the 95th percentile of covered pixels to ``target``."""
    covered = picture.alpha > 0.5
    if not covered.any():
        return 1.0
    level = float(np.percentile(picture.radiance[covered].max(axis=1), 95.0))
    return target / level if level > 0.0 else 1.0


def from_srgb(values: NDArray) -> NDArray[np.float64]:
    """Linear light from sRGB values in [0, 1] (IEC 61966-2-1)."""
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def roll_off(linear: NDArray) -> NDArray:
    """Linear values in [0, 1]: those above 0.8 approach 1, and those below zero are zero."""
    linear = np.maximum(linear, 0.0)
    knee = 0.8
    return np.where(linear > knee, knee + (1 - knee) * np.tanh((linear - knee) / (1 - knee)), linear)


def encode_srgb(linear: NDArray) -> NDArray[np.float64]:
    """sRGB values of linear light that is not negative (IEC 61966-2-1)."""
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-8) ** (1 / 2.4) - 0.055)


def tone_map(picture: Picture, scale: float = 1.0, background: ArrayLike = 1.0) -> NDArray[np.float64]:
    """sRGB in [0, 1] over a plain background; radiance times ``scale``, bright parts rolled off above 0.8."""
    linear = roll_off(picture.radiance * scale)
    linear = linear + (1.0 - picture.alpha[..., None]) * np.asarray(background)
    return np.clip(encode_srgb(linear), 0.0, 1.0)


def to_srgb(picture: Picture, scale: float = 1.0, background: ArrayLike = 1.0) -> NDArray[np.uint8]:
    """`tone_map` in 8 bits."""
    return (tone_map(picture, scale, background) * 255.0 + 0.5).astype(np.uint8)


def display(picture: Picture, scale: float, background: NDArray | None = None) -> NDArray[np.float64]:
    """(H, W, 4) in [0, 1] as screens show it: tone-mapped sRGB and opacity, which are not multiplied.

    Before a plain background (3,) of linear radiance, which is not tone-mapped, nothing is transparent.
    """
    if background is not None:
        return np.dstack([tone_map(picture, scale, background), np.ones_like(picture.alpha)])
    opaque = (picture.radiance / np.maximum(picture.alpha, 1e-4)[..., None]).astype(np.float32)
    return np.dstack([tone_map(Picture(opaque, np.ones_like(picture.alpha)), scale), picture.alpha])


def linear(picture: Picture, factor: float = 1.0, background: NDArray | None = None) -> NDArray[np.float32]:
    """(H, W, 4) linear radiance times a factor, and opacity that it is multiplied by, as ``.exr`` holds them."""
    exposed = Picture((picture.radiance * factor).astype(np.float32), picture.alpha)
    return np.dstack(exposed if background is None else exposed.over(background)).astype(np.float32)


def write_picture(path: str | Path, picture: Picture, scale: float | None = None, finish: Finish | None = None) -> None:
    """Write ``.exr`` (linear radiance and alpha, float32) or ``.png`` (tone-mapped).

    Parameters
    ----------
    path : path
    picture : Picture
        An environment behind it is already in it.
    scale : float, optional
        Exposure of a ``.png``, by default that of `exposure`.
    finish : Finish, optional

    Raises
    ------
    UserError
        Another suffix, or a folder that cannot be written to.
    """
    from slepian_prt.renderer.variants import bitmap_module  # only here: what is asked of pictures needs no renderer

    path, finish = Path(path), finish or Finish()
    mi = bitmap_module()
    if path.suffix.lower() == ".exr":
        bitmap = mi.Bitmap(linear(picture, finish.factor, finish.colour), pixel_format=_rgba(mi))
        encoded = mi.Bitmap.FileFormat.OpenEXR
    elif path.suffix.lower() == ".png":
        scale = exposure(picture) if scale is None else scale
        shown = display(picture, scale * finish.factor, finish.colour)
        bitmap = mi.Bitmap((shown * 255.0 + 0.5).astype(np.uint8), pixel_format=_rgba(mi))
        bitmap.set_srgb_gamma(True)
        encoded = mi.Bitmap.FileFormat.PNG
    else:
        raise UserError(f"{path}: pictures are written as .png or .exr, not '{path.suffix}'")
    stream = mi.MemoryStream()
    with two_threads():
        bitmap.write(stream, encoded)
    stream.seek(0)
    with atomic_output(path) as file:
        file.write(stream.raw_buffer())


def _rgba(mi: Any) -> Any:
    return mi.Bitmap.PixelFormat.RGBA
