"""Latitude-longitude maps by blocks of rows, and what their texels must be, wherever they come from."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slepian_prt.errors import UserError

# More negative energy than this part of the positive is no rounding of an encoder but a broken map.
NEGATIVE_TOLERANCE = 1e-3

# Brighter than any light, and low enough that radiance of receivers stays far below the end of float32, 3.4e38.
BRIGHTEST = 1e30

# More is no map but a damaged header: 65536 x 32768, and the longest side of a larger window that holds it.
_MOST_TEXELS = 1 << 31
_LONGEST_SIDE = 1 << 17

# Texels of a block of rows, and rows that compressed blocks of OpenEXR end at.
_BLOCK = 1 << 21
_EXR_ROWS = 256


@dataclass(frozen=True)
class Rows:
    """A latitude-longitude map of radiance, by blocks of rows.

    Attributes
    ----------
    name, origin : str
        For users: the map, and where it is from.
    height, width : int
    read : callable
        Gives rows ``begin : end`` as (end - begin, W, 3) float32.
    any_shape : bool
        Whether it need not be twice as wide as high: Mitsuba's ``envmap`` takes what it is given.
    """

    name: str
    origin: str
    height: int
    width: int
    read: Callable[[int, int], NDArray[np.float32]]
    any_shape: bool = False

    def __post_init__(self) -> None:
        (check_size if self.any_shape else check_shape)(self.origin, self.height, self.width)

    def blocks(self) -> Iterator[NDArray[np.float32]]:
        """All rows from the top, a block at a time."""
        rows = max(1, _BLOCK // self.width)
        if rows >= _EXR_ROWS:
            rows -= rows % _EXR_ROWS
        for begin in range(0, self.height, rows):
            yield self.read(begin, min(begin + rows, self.height))


def check_shape(origin: str, height: int, width: int) -> None:
    """Raise UserError unless a map is twice as wide as high, and of a size that maps have."""
    check_size(origin, height, width)
    if width != 2 * height:
        raise UserError(
            f"{origin}: is {width} x {height} texels; a latitude-longitude map is twice as wide as "
            "high, so convert it (a cube map or light probe needs to be resampled) or crop it"
        )


def check_size(origin: str, height: int, width: int) -> None:
    """Raise UserError for a picture without texels, or with more than any map has; before memory is taken for it."""
    if height <= 0 or width <= 0:
        raise UserError(f"{origin}: is {width} x {height} texels, so there is no light in it; write it again")
    if height * width > _MOST_TEXELS or max(height, width) > _LONGEST_SIDE:
        raise UserError(
            f"{origin}: says it is {width} x {height} texels, and at most 65536 x 32768 are read; make it smaller"
        )


class Checked:
    """The blocks of a map without negative texels; says at the end whether what was negative matters.

    This is the one rule on what texels may be, for files, arrays and Mitsuba's emitters alike, so that a map gets the
    same answer whichever way it comes in:

    - NaN, infinite, or brighter than `BRIGHTEST`: refused.
    - Negative texels that together amount to at most `NEGATIVE_TOLERANCE` of the light (by solid angle, summed over
      the colours), which resampling and encoders leave: set to zero and counted; callers say how many.
    - Negative texels that amount to more: refused, unless ``clamp_negative`` asks for zeros there too.

    Attributes
    ----------
    clamped : int
        Texels that were set to zero so far.
    """

    def __init__(self, rows: Rows, clamp_negative: bool) -> None:
        self.rows = rows
        self.clamp_negative = clamp_negative
        self.clamped = 0

    def __iter__(self) -> Iterator[NDArray[np.float32]]:
        """
        Raises
        ------
        UserError
            NaN, infinite or absurdly bright texels, or (unless ``clamp_negative``) negative ones that matter.
        """
        rows = self.rows
        lost = kept = lowest = 0.0
        first = 0
        for block in rows.blocks():
            self._check_finite(block, first)
            if (least := float(block.min(initial=0.0))) < 0.0:
                lowest = min(lowest, least)
                self.clamped += int((block < 0.0).any(axis=2).sum())
                sine = _sines(first, block, rows.height)
                lost -= float(np.sum(np.minimum(block, 0.0) * sine))
                block = np.maximum(block, 0.0)
            kept += float(np.einsum("rwc,r->", block, _sines(first, block, rows.height)[:, 0, 0], optimize=True))
            first += len(block)
            yield block
        if lost > NEGATIVE_TOLERANCE * kept and not self.clamp_negative:
            share = f"amount to {lost / kept:.1%} of the light" if lost < kept else "outweigh all light in the map"
            raise UserError(
                f"{rows.origin}: {self.clamped} texels are negative (down to {lowest:.4g}) and {share}; repair the "
                "map, or pass `clamp_negative` to set them to zero"
            )

    def _check_finite(self, block: NDArray[np.float32], first: int) -> None:
        """Raise UserError for texels of a block, which begins at row ``first``, that no calculation can follow."""
        peak = max(float(block.max(initial=0.0)), -float(block.min(initial=0.0)))
        if peak <= np.float32(BRIGHTEST):  # as it compares below; false for NaN
            return
        finite = np.isfinite(block).all(axis=2)
        wrong = ~finite if not finite.all() else (np.abs(block) > BRIGHTEST).any(axis=2)
        row, column = np.argwhere(wrong)[0]
        place = f"the first in row {first + row}, column {column}"
        if not finite.all():
            raise UserError(f"{self.rows.origin}: texels are NaN or infinite, {place}; repair the map")
        raise UserError(
            f"{self.rows.origin}: texels are beyond {BRIGHTEST:.0e}, more than can be calculated with, {place}; "
            "scale the map down"
        )


def _sines(first: int, block: NDArray, height: int) -> NDArray[np.float64]:
    """(rows, 1, 1) solid angle of the texels of a block, but for a factor."""
    return np.asarray(np.sin((first + np.arange(len(block)) + 0.5) * np.pi / height)[:, None, None])


def array_rows(texels: ArrayLike, name: str, origin: str) -> Rows:
    """An array (H, W), (H, W, 1) or (H, W, 3) of linear radiance, in floating point of any precision, or of booleans.

    Raises
    ------
    UserError
        Another shape, not twice as wide as high, or another type. Integers are refused: those of a decoded picture
        are encoded for a screen, 255 times radiance and not proportional to it.
    """
    if np.ma.is_masked(texels):
        raise UserError(f"{origin}: texels are masked; fill them, as with .filled(0)")
    image = np.asarray(texels)
    if image.ndim == 2:
        image = image[..., None]
    if image.ndim != 3 or image.shape[2] not in (1, 3) or image.shape[0] == 0:
        raise UserError(f"{origin}: an environment map has shape (H, 2H, 3), not {np.shape(texels)}")
    if image.dtype.kind in "iu":
        raise UserError(
            f"{origin}: texels are integers ({image.dtype}), and radiance is linear and in floating point; decode a "
            "picture first (sRGB: v = texels / 255, then ((v + 0.055) / 1.055)**2.4) or give its path; if they are "
            "radiance, convert them with .astype(float)"
        )
    if image.dtype.kind not in "fb":
        raise UserError(f"{origin}: texels must be real numbers, not {image.dtype}")

    def read(begin: int, end: int) -> NDArray[np.float32]:
        part = image[begin:end]
        if part.dtype.itemsize > 4:  # what float32 cannot hold must not become infinite, nor warn
            part = np.where(np.isfinite(part), np.clip(part, -2.0 * BRIGHTEST, 2.0 * BRIGHTEST), part)
        return np.broadcast_to(part.astype(np.float32), (*part.shape[:2], 3))

    return Rows(name, origin, image.shape[0], image.shape[1], read)
