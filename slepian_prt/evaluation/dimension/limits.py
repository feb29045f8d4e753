"""Down to which error a dimension is that of transport, instead of what coding and tracing did to its vectors."""

from __future__ import annotations

import math

import numpy as np

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.transport.transfer import Transfer

# An error that is twice that of the vectors keeps three quarters of what it may leave for transport itself.
_MARGIN = 2.0


def error_of_vectors(transfer: Transfer | CompressedTransfer) -> float:
    """Relative RMS error of transfer vectors, as far as it is known: of coding, of paths, and of a film's noise.

    What shadow rays lose is not known; 0 if nothing is.
    """
    if isinstance(transfer, Transfer):
        return transfer.noise or 0.0
    errors, film = [transfer.predicted_error, transfer.path_noise or 0.0], transfer.film_outline
    if film is not None:
        energy = transfer.channels * transfer.expected.total
        errors.append(film.relative_noise(energy, np.ones(transfer.bandlimit + 1)))
    return math.hypot(*errors)


def remark_on_error(transfer: Transfer | CompressedTransfer, error: float) -> str | None:
    """What to say of a dimension at an error that vectors have themselves, or nearly; None if they are good enough."""
    least = error_of_vectors(transfer)
    if error >= _MARGIN * least:
        return None
    enough = math.ceil(100.0 * _MARGIN * least) / 100.0
    larger = f"an `error` of {enough:g} or more, or " if enough < 1.0 else ""
    return (
        f"transfer vectors have an error of {least:.2g} themselves, which counts as dimension at an `error` of "
        f"{error:g}: give {larger}transfer of a smaller `tolerance` and more `samples`"
    )
