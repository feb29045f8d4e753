"""Windowed lighting that leaves little radiance negative, for a blur whose error is told; see `lighting.windowing`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.lighting.windowing import windowed
from slepian_prt.relighting.relight import negative_part, relight
from slepian_prt.transport.transfer import Transfer

# Widths that are tried for one that leaves hardly anything negative: from one degree to this many times the bandlimit.
_WIDEST = 16.0
_TRIED = 12

# Part of the vertices that may stay negative: to leave none costs several times the change.
_LEFT_NEGATIVE = 1e-3


class Damped(NamedTuple):
    """What a window did.

    Attributes
    ----------
    lighting : (3, (L+1)²)
    width : float
    change : float
        Relative RMS difference that it makes to the radiance of the vertices.
    before, after : float
        Part of the vertices that are negative without and with it.
    """

    lighting: NDArray[np.float64]
    width: float
    change: float
    before: float
    after: float


def damp(transfer: Transfer | CompressedTransfer, lighting: NDArray, name: str, width: float | None = None) -> Damped:
    """Window lighting for a transfer.

    Parameters
    ----------
    transfer : Transfer or CompressedTransfer
    lighting : (3, (L+1)²)
    name : one of `windowing.WINDOWS`
    width : float, optional
        By default as wide as leaves 0.1 % of the vertices negative (beyond sampling noise, as `negative_part`).

    Raises
    ------
    UserError
    """
    lighting = np.asarray(lighting, dtype=np.float64)
    plain = relight(transfer, lighting)
    before = negative_part(plain)
    if width is None:
        if before <= _LEFT_NEGATIVE:
            return Damped(lighting, np.inf, 0.0, before, before)
        width = _widest(transfer, lighting, name)
    light = windowed(lighting, name, width)
    radiance = relight(transfer, light)
    scale = float(np.linalg.norm(plain))
    change = float(np.linalg.norm(radiance - plain)) / scale if scale > 0.0 else 0.0
    return Damped(light, width, change, before, negative_part(radiance))


def _widest(transfer: Transfer | CompressedTransfer, lighting: NDArray, name: str) -> float:
    """The widest window that leaves hardly anything negative, to 1 %: each round many at once."""
    low, high = 0.5, _WIDEST * (transfer.bandlimit + 1)
    while high > 1.01 * low:
        widths = np.geomspace(low, high, _TRIED)
        lights = np.stack([windowed(lighting, name, float(w)) for w in widths])
        positive = [negative_part(radiance) <= _LEFT_NEGATIVE for radiance in relight(transfer, lights)]
        if positive[-1]:
            return float(high)
        if not any(positive):  # not even degree 0 alone, which only a broken transfer does
            return float(low)
        # The last that will do: narrower ones may fail again, since few degrees alone are negative somewhere too.
        last = len(positive) - 1 - positive[::-1].index(True)
        low, high = float(widths[last]), float(widths[last + 1])
    return low
