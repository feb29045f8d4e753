"""Radiance per vertex under an environment."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.errors import UserError
from slepian_prt.sphere.harmonics import num_coefficients
from slepian_prt.transport.transfer import Transfer


def relight(transfer: Transfer | CompressedTransfer, lighting: ArrayLike) -> NDArray[np.float32]:
    """B(x) = ρ(x) Σ e_lm t_lm(x).

    Parameters
    ----------
    transfer : Transfer (full SH) or CompressedTransfer
    lighting : (3, (L+1)²)
        From `project_environment`, at the bandlimit of the transfer.

    Returns
    -------
    (V, 3) float32 RGB radiance. Ringing of bright small lights can make it slightly negative.

    Raises
    ------
    ValueError
        Lighting of another shape.
    """
    light = np.asarray(lighting, dtype=np.float64)
    wanted = (3, num_coefficients(transfer.bandlimit))
    if light.shape != wanted:
        raise UserError(f"lighting must have shape {wanted} for bandlimit {transfer.bandlimit}, not {light.shape}")
    if isinstance(transfer, CompressedTransfer):
        return transfer.radiance(light)
    if transfer.vectors.shape[1] == 1:
        return (transfer.vectors[:, 0] @ light.T.astype(np.float32)) * transfer.mesh.albedo
    return np.einsum("vcm,cm->vc", transfer.vectors, light.astype(np.float32)) * transfer.mesh.albedo


def negative_part(radiance: NDArray) -> float:
    """Part of the vertices with a channel below zero by more than sampling noise, 1 % of the largest radiance."""
    return float(np.mean(radiance.min(axis=1) < -0.01 * float(radiance.max(initial=0.0))))
