"""Coding no finer than the noise of transfer: finer steps would spend bytes on keeping it."""

from __future__ import annotations

import logging
import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.prediction import by_degree
from slepian_prt.compression.settings import CompressionSettings
from slepian_prt.lighting.spectrum import LightPrior
from slepian_prt.sphere.harmonics import num_coefficients
from slepian_prt.transport.transfer import Transfer

log = logging.getLogger(__name__)

# What coding may lose, as a part of the noise. Measured on three scenes of 64 and 1,024 paths, smoothed: .3 adds 0 to
# 3 % to the error of the vectors and 1 to 16 % to that of radiance, in half of the bytes of .15; .5 adds 3 to 11 % and
# 12 to 38 %, in a third of them.
_PART_OF_NOISE = 1.0 / 3.0

_BLOCK = 1 << 14


def coded_within_noise(settings: CompressionSettings, transfer: Transfer) -> CompressionSettings:
    """The settings with the tolerance that the noise of a transfer leaves sensible, and a remark if that is coarser."""
    if transfer.noise is None or settings.by_number or settings.resolved_coding != "coded":
        return settings
    finest = finest_tolerance(transfer.noise, _energies(transfer.vectors), settings.light_prior)
    asked = settings.resolved_tolerance
    if finest <= asked:
        return settings
    log.info(
        "paths leave a noise of %.2g in the transfer, which is coded to a tolerance of %.2g: at %.2g the file would "
        "only hold more of the noise; more `samples` lessen it",
        transfer.noise,
        finest,
        asked,
    )
    return replace(settings, tolerance=finest)


def finest_tolerance(noise: float, energies: NDArray, prior: LightPrior | None = None) -> float:
    """The least tolerance that is worth its bytes, where errors count under a prior.

    Parameters
    ----------
    noise : float
        Relative RMS of the noise of vectors, which is taken to be alike in all coefficients: no path knows what it is
        multiplied with.
    energies : (L+1,)
        Of the vectors, in each degree.
    prior : LightPrior, optional
    """
    bandlimit = len(energies) - 1
    power = np.ones(bandlimit + 1) if prior is None else prior.weights**2
    white = (2.0 * np.arange(bandlimit + 1) + 1.0) / num_coefficients(bandlimit)
    counted, whole = float(power @ energies), float(np.sum(energies))
    relative = noise * math.sqrt(float(power @ white) * whole / counted) if counted > 0.0 else 0.0
    return min(_PART_OF_NOISE * relative, 0.5)


def _energies(vectors: NDArray[np.float32]) -> NDArray[np.float64]:
    """(L+1,) sums of squares."""
    squares = np.zeros(vectors.shape[2])
    for begin in range(0, len(vectors), _BLOCK):
        squares += np.square(vectors[begin : begin + _BLOCK], dtype=np.float64).sum(axis=(0, 1))
    return by_degree(squares)
