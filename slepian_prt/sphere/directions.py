"""Directions as users give them."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slepian_prt.arrays import real_numbers
from slepian_prt.errors import UserError


def check_directions(directions: ArrayLike, name: str = "directions") -> NDArray[np.float64]:
    """Return unit vectors, shape (n, 3), from finite non-zero ones; a single (3,) vector becomes (1, 3).

    Raises
    ------
    ValueError
        Wrong shape, or a direction that is zero or not finite (the first one is named).
    """
    vectors = np.atleast_2d(real_numbers(directions, name))
    if vectors.ndim != 2 or vectors.shape[1] != 3:
        raise UserError(f"{name} must have shape (n, 3), not {np.shape(directions)}")
    # Scaled by the largest component first, so that neither 1e-200 nor 1e200 leaves the range when squared.
    scale = np.abs(vectors).max(axis=1, keepdims=True, initial=0.0)
    bad = ~(np.isfinite(scale) & (scale > 0.0))[:, 0]
    if bad.any():
        first = int(np.argmax(bad))
        raise UserError(f"{name}[{first}] must be finite and not zero, not {vectors[first].tolist()}")
    scaled = vectors / scale
    return scaled / np.linalg.norm(scaled, axis=1, keepdims=True)
