"""Pictures: linear radiance with coverage, exposed, tone-mapped and written."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError
from slepian_prt.files import atomic_output
from slepian_prt.renderer.variants import bitmap_module


class Picture(NamedTuple):
    """Linear radiance (H, W, 3), premultiplied by ``alpha`` (H, W), the part of each pixel that receivers cover."""

    radiance: NDArray[np.float32]
    alpha: NDArray[np.float32]


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


def to_srgb(picture: Picture, scale: float = 1.0, background: float = 1.0) -> NDArray[np.uint8]:
    """8-bit sRGB over a plain background; radiance times ``scale``, bright parts rolled off above 0.8."""
    linear = np.maximum(picture.radiance * scale, 0.0)
    knee = 0.8
    linear = np.where(linear > knee, knee + (1 - knee) * np.tanh((linear - knee) / (1 - knee)), linear)
    linear = linear + (1.0 - picture.alpha[..., None]) * background
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-8) ** (1 / 2.4) - 0.055)
    return (np.clip(encoded, 0.0, 1.0) * 255.0 + 0.5).astype(np.uint8)


def write_picture(path: str | Path, picture: Picture, scale: float | None = None) -> None:
    """Write ``.exr`` (linear radiance and alpha, float32) or ``.png`` (tone-mapped, transparent background).

    ``scale`` is the exposure of a ``.png``, by default that of `exposure`.

    Raises
    ------
    UserError
        Another suffix, or a folder that cannot be written to.
    """
    path = Path(path)
    mi = bitmap_module()
    if path.suffix.lower() == ".exr":
        bitmap = mi.Bitmap(np.dstack([picture.radiance, picture.alpha]).astype(np.float32), pixel_format=_rgba(mi))
        encoded = mi.Bitmap.FileFormat.OpenEXR
    elif path.suffix.lower() == ".png":
        colour = to_srgb(
            Picture(
                (picture.radiance / np.maximum(picture.alpha, 1e-4)[..., None]).astype(np.float32),
                np.ones_like(picture.alpha),
            ),
            exposure(picture) if scale is None else scale,
        )
        opacity = (picture.alpha * 255.0 + 0.5).astype(np.uint8)
        bitmap = mi.Bitmap(np.dstack([colour, opacity]), pixel_format=_rgba(mi))
        bitmap.set_srgb_gamma(True)
        encoded = mi.Bitmap.FileFormat.PNG
    else:
        raise UserError(f"{path}: pictures are written as .png or .exr, not '{path.suffix}'")
    stream = mi.MemoryStream()
    bitmap.write(stream, encoded)
    stream.seek(0)
    with atomic_output(path) as file:
        file.write(stream.raw_buffer())


def _rgba(mi: Any) -> Any:
    return mi.Bitmap.PixelFormat.RGBA
