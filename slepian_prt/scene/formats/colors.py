"""Colours of vertices as formats store them."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray


def decode_srgb(values: ArrayLike) -> NDArray[np.float32]:
    """Linear values of display values in [0, 1] (IEC 61966-2-1)."""
    v = np.clip(np.asarray(values, dtype=np.float64), 0.0, 1.0)
    return np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4).astype(np.float32)
