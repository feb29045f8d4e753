"""Radiance of the receivers under distant light."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.lighting.environment import Environment
from slepian_prt.lighting.projection import lighting_at, project_environment
from slepian_prt.relighting.operator import transfer_operator
from slepian_prt.scene.view import up_rotation
from slepian_prt.sphere.rotation import rotate_sh
from slepian_prt.transport.transfer import Transfer

# Sampling noise, relative to the largest radiance: what is negative by less does not count.
_NOISE = 0.01


def relight(
    transfer: Transfer | CompressedTransfer, lighting: str | Path | Environment | ArrayLike, *, up: str = "y"
) -> NDArray[np.float32]:
    """B(x) = ρ(x) Σ e_lm t_lm(x).

    The first call of a compressed transfer prepares it; each further one takes about as long as reading its
    coefficients from memory.

    Parameters
    ----------
    transfer : Transfer (full SH) or CompressedTransfer
    lighting : path of a map, Environment, coefficients (3, (L+1)²), or (B, 3, (L+1)²) for B lights at once
        Coefficients are those of `project_environment`, at the bandlimit of the transfer.
    up : "y" or "z"
        The axis of the model that what is above in the lighting (y) shines from: of a scan that lies on its back where
        y is up, z.

    Returns
    -------
    (V, 3) or (B, V, 3) float32 RGB radiance. Ringing of bright small lights can make it slightly negative.

    Raises
    ------
    UserError
        Lighting of another shape, or not finite; a map that cannot be used.
    """
    lights = stand_lighting(lighting, transfer.bandlimit, up)
    several = lights.reshape(-1, *lights.shape[-2:])
    if isinstance(transfer, CompressedTransfer):
        radiance = transfer_operator(transfer).apply(several)
    else:
        radiance = _apply_vectors(transfer.vectors, several.astype(np.float32))
    albedo = transfer.mesh.receivers.albedo
    if not np.all(albedo == 1.0):
        radiance *= albedo
    return radiance if lights.ndim == 3 else radiance[0]


def stand_lighting(
    lighting: str | Path | Environment | ArrayLike, bandlimit: int, up: str = "y"
) -> NDArray[np.float64]:
    """Coefficients (3, (L+1)²) or (B, 3, (L+1)²) of what `relight` takes for lighting, where ``up`` is up."""
    if isinstance(lighting, str | Path | Environment) or hasattr(lighting, "is_environment"):
        return project_environment(lighting, bandlimit, rotate=up_rotation(up))
    lights = lighting_at(lighting, bandlimit)
    turn = up_rotation(up)
    return lights if up == "y" else rotate_sh(lights, turn)


def _apply_vectors(vectors: NDArray[np.float32], lights: NDArray[np.float32]) -> NDArray[np.float32]:
    """(B, V, 3) from vectors (V, channels, (L+1)²) and lights (B, 3, (L+1)²)."""
    count, channels, size = vectors.shape
    if channels == 1:
        radiance = (vectors[:, 0] @ lights.reshape(-1, size).T).reshape(count, len(lights), 3)
    else:
        radiance = np.einsum("vcm,bcm->vbc", vectors, lights, optimize=True)
    return np.moveaxis(radiance, 1, 0)


def negative_fraction(radiance: NDArray) -> float:
    """Fraction of the receivers whose radiance (V, 3) is below zero in a channel, by more than sampling noise."""
    return float(np.mean(radiance.min(axis=1) < -_NOISE * float(radiance.max(initial=0.0))))
