"""Measures of error."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slepian_prt.relighting.picture import Picture

_LUMINANCE = np.array([0.212671, 0.715160, 0.072169])


def relative_rms(values: NDArray, reference: NDArray) -> float:
    """‖values - reference‖ / ‖reference‖ in float64; 0 where both vanish."""
    difference = np.linalg.norm((values.astype(np.float64) - reference.astype(np.float64)).ravel())
    scale = np.linalg.norm(reference.astype(np.float64).ravel())
    if scale == 0.0:
        return 0.0 if difference == 0.0 else float("inf")
    return float(difference / scale)


def error_map(picture: Picture, reference: Picture) -> NDArray[np.float64]:
    """(H, W) difference in luminance relative to the reference's mean over covered pixels; NaN outside them."""
    covered = reference.alpha > 0.5
    scale = float((reference.radiance[covered] @ _LUMINANCE).mean()) if covered.any() else 1.0
    difference = np.abs((picture.radiance - reference.radiance) @ _LUMINANCE) / max(scale, 1e-30)
    return np.where(covered, difference, np.nan)
