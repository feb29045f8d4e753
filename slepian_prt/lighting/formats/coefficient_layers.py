"""Spherical harmonic coefficients of pixels as the channels of an OpenEXR file, for other tools to light."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError
from slepian_prt.files import atomic_output
from slepian_prt.renderer.threads import two_threads
from slepian_prt.renderer.variants import bitmap_module

# What part of the light right behind a pixel it shows.
BACKGROUND = tuple(f"background.{colour}" for colour in "RGB")


def channel_names(bandlimit: int) -> list[str]:
    """Names of the channels: ``l02.m-01.R`` is degree 2, order -1, red; degrees ascend, then orders, then R, G, B."""
    return [f"l{l:02d}.m{m:+03d}.{colour}" for l in range(bandlimit + 1) for m in range(-l, l + 1) for colour in "RGB"]


def write_coefficients(
    path: str | Path, vectors: NDArray[np.floating], background: NDArray[np.floating], width: int, height: int
) -> None:
    """Write transfer vectors as ``.exr``, float32: radiance of a pixel is the sum of channels times the light's.

    The channels ``background.R``, ``.G`` and ``.B`` say what part of the light right behind a pixel it shows beside.

    Parameters
    ----------
    path : path
    vectors : (V, 1 or 3, (L+1)²)
        Of the pixels, row by row.
    background : (V, 3)
    width, height : int

    Raises
    ------
    UserError
        Another suffix, a folder that cannot be written to, or a full disk.
    """
    if Path(path).suffix.lower() != ".exr":
        raise UserError(f"{path}: coefficients of pixels are written as .exr; name the file so")
    mi = bitmap_module()
    count, _, size = vectors.shape
    colours = np.broadcast_to(vectors, (count, 3, size))
    layers = np.concatenate([np.moveaxis(colours, 1, 2).reshape(count, 3 * size), background], axis=1)
    names = [*channel_names(round(size**0.5) - 1), *BACKGROUND]
    pixels = np.ascontiguousarray(layers.reshape(height, width, -1), dtype=np.float32)
    bitmap = mi.Bitmap(pixels, mi.Bitmap.PixelFormat.MultiChannel, names)
    stream = mi.MemoryStream()
    with two_threads():
        bitmap.write(stream, mi.Bitmap.FileFormat.OpenEXR)
    stream.seek(0)
    with atomic_output(path) as file:
        file.write(stream.raw_buffer())
