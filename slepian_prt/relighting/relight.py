"""Radiance of the receivers under distant light, and that of the lamps of their scene."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.errors import UserError, check_transfer
from slepian_prt.lighting.environment import Environment
from slepian_prt.lighting.fixed_lights import lamp_scales
from slepian_prt.lighting.projection import lighting_at, project_checked, rotation_matrix
from slepian_prt.machine.memory import check_estimate, held_memory
from slepian_prt.machine.threads import one_blas_thread
from slepian_prt.relighting.operator import transfer_operator
from slepian_prt.scene.view import up_rotation
from slepian_prt.sphere.harmonics import num_coefficients
from slepian_prt.sphere.rotation import rotate_sh
from slepian_prt.transport.checks import check_finite

if TYPE_CHECKING:
    from slepian_prt.transport.transfer import Transfer

# Sampling noise, relative to the largest radiance: what is negative by less does not count.
NOISE = 0.01

# Bytes of radiance from which on it is asked whether they are there: asking takes as long as to relight a small model.
_LARGE = 1 << 26


@one_blas_thread()  # so that bits do not depend on what other threads do meanwhile
def relight(
    transfer: Transfer | CompressedTransfer,
    lighting: str | Path | Environment | ArrayLike | None,
    *,
    up: str = "y",
    fixed_lights: float | Mapping[str, float] = 1.0,
    turn_directional: float | ArrayLike | None = None,
) -> NDArray[np.float32]:
    """B(x) = ρ(x) (Σ e_lm t_lm(x) + Σ s_k F_k(x)), with F_k the light of a lamp that is not distant and s_k its scale.

    The first call of a compressed transfer prepares it; each further one takes about as long as reading its
    coefficients from memory.

    Parameters
    ----------
    transfer : Transfer (full SH) or CompressedTransfer
    lighting : path of a map, Environment, coefficients (3, n²), or (B, 3, n²) for B lights at once, or None
        Coefficients are those of `project_environment`; of another bandlimit than that of the transfer they are cut, or
        zero in the degrees that they have not, with a remark. With None the scene's lamps shine alone.
    up : "y" or "z"
        The axis of the model that what is above in the lighting (y) shines from: of a scan that lies on its back where
        y is up, z.
    fixed_lights : number, or mapping of names to numbers
        What the light of the scene's lamps is multiplied by: 0 turns them off. Those that a mapping does not name keep
        1, or what it has for ``*``.
    turn_directional : float or (3, 3), optional
        Turn ``directional`` lamps, by degrees about y or a rotation, as the map was: their light then goes through the
        transfer, with shadows as soft as the bandlimit makes them, instead of standing where it was computed.

    Returns
    -------
    (V, 3) or (B, V, 3) float32 RGB radiance. Ringing of bright small lights can make it slightly negative.

    Raises
    ------
    UserError
        Lighting of no such shape, or not finite; a map that cannot be used; no light at all; a lamp that is not there;
        transfer vectors that are not finite.
    """
    check_transfer(transfer)
    fixed = transfer.fixed
    scales = lamp_scales(fixed, fixed_lights)
    if lighting is None:
        if fixed is None:
            raise UserError("the transfer has no lamps; give lighting: a map or its coefficients")
        lights = np.zeros((3, num_coefficients(transfer.bandlimit)))
    else:
        lights = stand_lighting(lighting, transfer.bandlimit, up)
    if isinstance(turn_directional, bool):
        raise UserError("`turn_directional` must be what the map was turned by: degrees, or a rotation matrix")
    if fixed is not None and turn_directional is not None:
        lights = lights + fixed.turned(scales, rotation_matrix(turn_directional), transfer.bandlimit)
        scales = np.where(fixed.can_turn, 0.0, scales)
    several = lights.reshape(-1, *lights.shape[-2:])
    _check_memory(len(several), len(transfer.mesh.receivers))
    if isinstance(transfer, CompressedTransfer):
        radiance = transfer_operator(transfer).apply(several)
    else:
        with np.errstate(over="ignore", invalid="ignore"):  # told below
            radiance = _apply_vectors(transfer.vectors, several.astype(np.float32))
        if not np.isfinite(radiance).all():  # of far fewer numbers than the vectors have
            check_finite(transfer.vectors)
            raise UserError("the radiance is beyond what float32 holds; scale the lighting down")
    if fixed is not None and scales.any():
        radiance += fixed.radiance(scales)
    albedo = transfer.mesh.receivers.albedo
    if not np.all(albedo == 1.0):
        radiance *= albedo
    return radiance if lights.ndim == 3 else radiance[0]


@one_blas_thread()
def white_radiance(
    transfer: Transfer | CompressedTransfer,
    lighting: NDArray[np.float64],
    fixed_lights: float | Mapping[str, float] = 1.0,
) -> NDArray[np.float32]:
    """(B, V, 3) radiance that receivers of unit albedo would send back, under lights (B, 3, (L+1)²) and the lamps."""
    if not isinstance(transfer, CompressedTransfer):
        white = replace(transfer.mesh, albedo=np.ones_like(transfer.mesh.albedo))
        return relight(replace(transfer, mesh=white), lighting, fixed_lights=fixed_lights)
    radiance = transfer_operator(transfer).apply(lighting)
    if transfer.fixed is not None:
        radiance += transfer.fixed.radiance(lamp_scales(transfer.fixed, fixed_lights))
    return radiance


def stand_lighting(
    lighting: str | Path | Environment | ArrayLike, bandlimit: int, up: str = "y"
) -> NDArray[np.float64]:
    """Coefficients (3, (L+1)²) or (B, 3, (L+1)²) of what `relight` takes for lighting, where ``up`` is up."""
    if isinstance(lighting, str | Path | Environment) or hasattr(lighting, "is_environment"):
        return project_checked(lighting, bandlimit, rotate=up_rotation(up), fitted_to="the transfer")[0]
    lights = lighting_at(lighting, bandlimit)
    turn = up_rotation(up)
    return lights if up == "y" else rotate_sh(lights, turn)


def _check_memory(lights: int, receivers: int) -> None:
    """Raise UserError for radiance that does not fit in the memory that is allowed; twice of it may be needed."""
    size = 4 * 3 * lights * receivers
    if size < _LARGE:
        return
    held = held_memory()
    work = f"relighting {receivers} receivers under {lights} light{'s' if lights > 1 else ''} at once"
    check_estimate(held + 2 * size, work, "relight under fewer at a time", least=0.8 * held + size)


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
    return float(np.mean(radiance.min(axis=1) < -NOISE * float(radiance.max(initial=0.0))))
