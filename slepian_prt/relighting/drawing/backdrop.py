"""What a camera sees behind a model: the environment itself."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slepian_prt.lighting.environment import Environment

# Looks per pixel along each side: small suns are not missed between the middles of pixels.
_LOOKS = 3


def look_up(environment: Environment, directions: NDArray) -> NDArray[np.float32]:
    """Radiance from some directions, interpolated between texels as Mitsuba's ``envmap`` does.

    Columns are centred at u = (c + 0.5)/W and wrap around; rows stand at v = r/(H-1), the outer ones on the poles.

    Parameters
    ----------
    environment : Environment
    directions : (..., 3)
        World space, of any length but zero.

    Returns
    -------
    (..., 3) float32
    """
    local = directions @ environment.to_world  # the inverse rotation
    local = local / np.linalg.norm(local, axis=-1, keepdims=True)
    height, width = environment.texels.shape[:2]
    u = np.arctan2(local[..., 0], -local[..., 2]) / (2.0 * np.pi)
    v = np.arccos(np.clip(local[..., 1], -1.0, 1.0)) / np.pi
    x, y = (u % 1.0) * width - 0.5, v * (height - 1)
    column, row = np.floor(x).astype(np.int64), np.minimum(y.astype(np.int64), max(height - 2, 0))
    right, down = (x - column)[..., None], (y - row)[..., None]
    rows, columns = (row, np.minimum(row + 1, height - 1)), (column % width, (column + 1) % width)
    upper, lower = (
        (1.0 - right) * environment.texels[one, columns[0]] + right * environment.texels[one, columns[1]]
        for one in rows
    )
    return ((1.0 - down) * upper + down * lower).astype(np.float32)


def draw_backdrop(environment: Environment, directions: NDArray[np.float32]) -> NDArray[np.float32]:
    """Mean radiance of each pixel, given the directions (H, W, 3) of their middles."""
    down, across = (
        np.gradient(directions, axis=axis) if directions.shape[axis] > 1 else np.zeros_like(directions)
        for axis in (0, 1)
    )
    steps = (np.arange(_LOOKS) + 0.5) / _LOOKS - 0.5
    total = np.zeros(directions.shape, dtype=np.float32)
    for a in steps:
        for b in steps:
            total += look_up(environment, directions + a * down + b * across)
    return total / np.float32(_LOOKS**2)
