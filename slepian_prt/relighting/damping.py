"""Windowed lighting that leaves little radiance negative, for a blur whose error is told; see `lighting.windowing`."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.lighting.windowing import windowed
from slepian_prt.relighting.relight import negative_fraction, relight

if TYPE_CHECKING:
    from slepian_prt.transport.transfer import Transfer

# Widths that are searched for one that leaves hardly anything negative: up to this many times the bandlimit, so many
# of them in each round.
_WIDEST = 16.0
_WIDTHS = 12

# Fraction of the receivers that may stay negative: to leave none costs several times the change.
_LEFT_NEGATIVE = 1e-3


class DampedLighting(NamedTuple):
    """Lighting under a window, and what the window does to radiance.

    Attributes
    ----------
    lighting : (3, (L+1)²)
    width : float
    change : float
        Relative RMS difference that it makes to the radiance of the receivers.
    negative_before, negative_after : float
        Fraction of the receivers that are negative without and with it.
    """

    lighting: NDArray[np.float64]
    width: float
    change: float
    negative_before: float
    negative_after: float


def damp(
    transfer: Transfer | CompressedTransfer, lighting: NDArray, window: str, width: float | None = None
) -> DampedLighting:
    """Window lighting for a transfer; radiance is that of distant light alone, which lamps do not change.

    Parameters
    ----------
    transfer : Transfer or CompressedTransfer
    lighting : (3, (L+1)²)
    window : one of `windowing.WINDOWS`
    width : float, optional
        By default as wide as leaves 0.1 % of the receivers negative (beyond sampling noise, see `negative_fraction`).

    Raises
    ------
    UserError
        An unknown window, a width that is not positive, or lighting that `relight` refuses.
    """
    lighting = np.asarray(lighting, dtype=np.float64)
    plain = relight(transfer, lighting, fixed_lights=0.0)
    before = negative_fraction(plain)
    if width is None:
        if before <= _LEFT_NEGATIVE:
            return DampedLighting(lighting, np.inf, 0.0, before, before)
        width = _widest_window(transfer, lighting, window)
    damped = windowed(lighting, window, width)
    radiance = relight(transfer, damped, fixed_lights=0.0)
    scale = float(np.linalg.norm(plain))
    change = float(np.linalg.norm(radiance - plain)) / scale if scale > 0.0 else 0.0
    return DampedLighting(damped, width, change, before, negative_fraction(radiance))


def _widest_window(transfer: Transfer | CompressedTransfer, lighting: NDArray, window: str) -> float:
    """Width of the widest window that leaves hardly anything negative, to 1 %."""
    low, high = 0.5, _WIDEST * (transfer.bandlimit + 1)
    while high > 1.01 * low:
        widths = np.geomspace(low, high, _WIDTHS)
        lights = np.stack([windowed(lighting, window, float(width)) for width in widths])
        relit = relight(transfer, lights, fixed_lights=0.0)
        positive = [negative_fraction(radiance) <= _LEFT_NEGATIVE for radiance in relit]
        if positive[-1]:
            return float(high)
        if not any(positive):  # not even degree 0 alone, which only a broken transfer does
            return float(low)
        # The last that will do: narrower ones may fail again, since few degrees alone are negative somewhere too.
        last = len(positive) - 1 - positive[::-1].index(True)
        low, high = float(widths[last]), float(widths[last + 1])
    return low
