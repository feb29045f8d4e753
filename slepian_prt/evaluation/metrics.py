"""Measures of error."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slepian_prt.relighting.pictures import Picture, to_srgb

# Relative squared errors are not divided by less than this part of the mean square of the reference.
_DARK = 0.01

_LUMINANCE = np.array([0.212671, 0.715160, 0.072169])


def relative_rms(values: NDArray, reference: NDArray) -> float:
    """‖values - reference‖ / ‖reference‖ in float64; 0 where both vanish."""
    difference = np.linalg.norm((values.astype(np.float64) - reference.astype(np.float64)).ravel())
    scale = np.linalg.norm(reference.astype(np.float64).ravel())
    if scale == 0.0:
        return 0.0 if difference == 0.0 else float("inf")
    return float(difference / scale)


class Deviation(NamedTuple):
    """How far values are off a reference.

    Attributes
    ----------
    error : float
        Relative RMS.
    percentile_99, worst : float
        Of the differences of single vertices or pixels, relative to the RMS of the reference.
    worst_at : list of int
        The vertex, or column and row of the pixel.
    """

    error: float
    percentile_99: float
    worst: float
    worst_at: list[int]


def deviation(values: NDArray, reference: NDArray) -> Deviation:
    """Of radiance at vertices, (V, 3)."""
    difference = np.linalg.norm(values.astype(np.float64) - reference.astype(np.float64), axis=-1)
    scale = float(np.sqrt(np.mean(np.sum(reference.astype(np.float64) ** 2, axis=-1)))) if len(reference) else 0.0
    if scale == 0.0:
        scale = 1.0 if not difference.any() else 1e-300
    place = int(np.argmax(difference))
    return Deviation(
        float(np.sqrt(np.mean(difference**2))) / scale,
        float(np.quantile(difference, 0.99)) / scale,
        float(difference[place]) / scale,
        [place],
    )


def picture_deviation(picture: Picture, reference: Picture) -> Deviation:
    """Of pictures, over the pixels that the reference covers at least in part."""
    covered = np.flatnonzero(reference.alpha.ravel() > 0.0)
    if covered.size == 0:
        return Deviation(0.0, 0.0, 0.0, [])
    found = deviation(picture.radiance.reshape(-1, 3)[covered], reference.radiance.reshape(-1, 3)[covered])
    row, column = divmod(int(covered[found.worst_at[0]]), reference.alpha.shape[1])
    return found._replace(worst_at=[column, row])


def relative_mse(picture: Picture, reference: Picture) -> float:
    """Mean over covered pixels of squared differences relative to the square of the reference's pixel."""
    covered = reference.alpha > 0.0
    if not covered.any():
        return 0.0
    square = np.mean(reference.radiance[covered].astype(np.float64) ** 2, axis=1)
    difference = np.mean((picture.radiance - reference.radiance)[covered].astype(np.float64) ** 2, axis=1)
    return float(np.mean(difference / np.maximum(square + _DARK * square.mean(), 1e-300)))


def flip(picture: Picture, reference: Picture, scale: float) -> float:
    """Mean FLIP over covered pixels, of both pictures as they are shown: tone-mapped, over white.

    P. Andersson et al., "FLIP: A Difference Evaluator for Alternating Images", 2020; at 67 pixels per degree.
    """
    import flip_evaluator

    covered = reference.alpha > 0.0
    if not covered.any():
        return 0.0
    shown = [to_srgb(one, scale).astype(np.float32) / 255.0 for one in (reference, picture)]
    errors, _, _ = flip_evaluator.evaluate(*shown, "LDR", applyMagma=False)
    return float(np.asarray(errors)[..., 0][covered].mean())


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
