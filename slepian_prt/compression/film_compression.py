"""Captured pictures, compressed as suits them: to an error below their noise, for light that falls as skies do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.compression.prediction import by_degree
from slepian_prt.compression.settings import DEFAULT_CLUSTERS, CompressionSettings
from slepian_prt.compression.stream import compress
from slepian_prt.errors import UserError, check_transfer
from slepian_prt.lighting.spectrum import falling_prior
from slepian_prt.scene.film import Film
from slepian_prt.transport.transfer import Transfer

# The error of coding, as a part of the noise: together they are a twentieth more than the noise alone.
_PART_OF_NOISE = 1.0 / 3.0
_FINEST, _COARSEST = 0.005, 0.2

# Pixels that a cap has at least: each adds its own functions to the file.
_LEAST_PIXELS = 1024

_BLOCK = 1 << 14


def check_tolerance(tolerance: float | None, bandlimit: int = 0) -> None:
    """Raise UserError for a tolerance that `compress` does not take."""
    CompressionSettings(tolerance=tolerance).check(bandlimit)


def film_of(transfer: Transfer) -> Film:
    """The film whose pixels are the receivers; raise UserError if they are those of a mesh."""
    if transfer.film is None:
        raise UserError("the transfer holds no pixels of a camera; capture a scene for that")
    return transfer.film


def noise_of(transfer: Transfer, power: NDArray[np.float64] | None = None) -> float:
    """Relative RMS noise of a captured picture under light of a power per harmonic, or that falls as 1/(l+1)²."""
    film = film_of(transfer)
    energy = np.zeros(transfer.bandlimit + 1)
    for begin in range(0, len(transfer.vectors), _BLOCK):
        energy += by_degree(
            np.asarray(np.sum(transfer.vectors[begin : begin + _BLOCK] ** 2, axis=(0, 1), dtype=np.float64))
        )
    power = falling_prior(transfer.bandlimit).weights ** 2 if power is None else power
    return film.relative_noise(energy / len(transfer.vectors), power)


def compress_film(transfer: Transfer, tolerance: float | None = None) -> CompressedTransfer:
    """Compress what `capture` gives: functions adapted to the light of pixels, errors counted under falling light.

    Parameters
    ----------
    transfer : Transfer
    tolerance : float in (0, 1), optional
        As of `compress`; by default a third of the noise.

    Raises
    ------
    UserError
        Transfer of a mesh; a tolerance that is none.
    """
    check_transfer(transfer)
    film_of(transfer)
    if not transfer.vectors.any():  # nothing to find functions for
        return compress(transfer, "none", coding="float16")
    seen = int(np.count_nonzero(transfer.mesh.receivers.active))
    clusters = int(np.clip(seen // _LEAST_PIXELS, 1, DEFAULT_CLUSTERS))
    prior = falling_prior(transfer.bandlimit)
    if tolerance is not None:
        return compress(transfer, tolerance=tolerance, clusters=clusters, light_prior=prior)
    # The noise of a film is known in each degree, which says more than the one number that `compress` goes by.
    tolerance = float(np.clip(_PART_OF_NOISE * noise_of(transfer), _FINEST, _COARSEST))
    packed = compress(replace(transfer, noise=None), tolerance=tolerance, clusters=clusters, light_prior=prior)
    return replace(packed, path_noise=transfer.noise)
