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


def seam(radiance: NDArray, reference: NDArray, faces: NDArray, index: NDArray) -> tuple[float, float]:
    """How much the error jumps along edges between clusters, and along edges within them.

    Root mean square over the edges of the difference of the error between the two ends, relative to that of the
    reference over all vertices; zero where there is no such edge. Without visible seams the two are alike.

    Parameters
    ----------
    radiance, reference : (V, 3)
    faces : (F, 3)
    index : (V,)
        Cluster of each vertex.
    """
    error = radiance.astype(np.float64) - reference.astype(np.float64)
    a, b = (np.concatenate([faces[:, i] for i in order]) for order in ((0, 1, 2), (1, 2, 0)))
    jumps = np.sum((error[a] - error[b]) ** 2, axis=1)
    scale = float(np.mean(np.sum(reference.astype(np.float64) ** 2, axis=1)))
    across = index[a] != index[b]
    found = [float(jumps[chosen].mean()) if chosen.any() else 0.0 for chosen in (across, ~across)]
    across_rms, within_rms = (float(np.sqrt(mean / scale)) if scale > 0.0 else 0.0 for mean in found)
    return across_rms, within_rms
