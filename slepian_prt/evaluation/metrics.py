"""Measures of error: every relative error of this package is the one that `relative_square` defines."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slepian_prt.relighting.drawing.pictures import Picture, to_srgb

# Relative squared errors are not divided by less than this part of the mean square of the reference.
_DARK = 0.01

_LUMINANCE = np.array([0.212671, 0.715160, 0.072169])


def relative_square(square: ArrayLike, reference: float, noise: float = 0.0) -> NDArray[np.float64]:
    """Squared relative error: the mean square of a difference over that of the reference, less ``noise``².

    Parameters
    ----------
    square : float or array of floats
        Mean squares (or sums of squares) of differences from the reference.
    reference : float
        Mean square (or sum of squares, over the same things) of the reference.
    noise : float
        Relative RMS noise of the reference, which is taken off: ⟨‖v - r - n‖²⟩ = ⟨‖v - r‖²⟩ + ⟨‖n‖²⟩ for noise n that
        is independent of the difference. Zero leaves it in.

    Returns
    -------
    array like ``square``, never negative; where the reference vanishes, 0 if the difference does too and else infinite.
    """
    square = np.asarray(square, dtype=np.float64)
    if reference <= 0.0:
        return np.where(square > 0.0, np.inf, 0.0)
    return np.maximum(square / reference - noise**2, 0.0)


def relative_rms(values: NDArray, reference: NDArray, noise: float = 0.0) -> float:
    """‖values - reference‖ / ‖reference‖ in float64, the relative ``noise`` of the reference taken off."""
    reference = reference.astype(np.float64).ravel()
    difference = values.astype(np.float64).ravel() - reference
    return float(np.sqrt(relative_square(difference @ difference, float(reference @ reference), noise)))


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
    """Deviation of radiance at vertices, (V, 3)."""
    difference = np.linalg.norm(values.astype(np.float64) - reference.astype(np.float64), axis=-1)
    scale = np.mean(np.sum(reference.astype(np.float64) ** 2, axis=-1)) if len(reference) else 0.0
    place = int(np.argmax(difference))
    squares = [np.mean(difference**2), np.quantile(difference, 0.99) ** 2, difference[place] ** 2]
    error, percentile, worst = np.sqrt(relative_square(squares, float(scale))).tolist()
    return Deviation(error, percentile, worst, [place])


def picture_deviation(picture: Picture, reference: Picture) -> Deviation:
    """Deviation of pictures, over the pixels that the reference covers at least in part."""
    covered = np.flatnonzero(reference.alpha.ravel() > 0.0)
    if covered.size == 0:
        return Deviation(0.0, 0.0, 0.0, [])
    pixels = deviation(picture.radiance.reshape(-1, 3)[covered], reference.radiance.reshape(-1, 3)[covered])
    row, column = divmod(int(covered[pixels.worst_at[0]]), reference.alpha.shape[1])
    return pixels._replace(worst_at=[column, row])


def relative_mse(picture: Picture, reference: Picture) -> float:
    """Mean over covered pixels of squared differences relative to the square of the reference's pixel."""
    covered = reference.alpha > 0.0
    if not covered.any():
        return 0.0
    square = np.mean(reference.radiance[covered].astype(np.float64) ** 2, axis=1)
    difference = np.mean((picture.radiance - reference.radiance)[covered].astype(np.float64) ** 2, axis=1)
    return float(np.mean(difference / np.maximum(square + _DARK * square.mean(), 1e-300)))


def flip(picture: Picture, reference: Picture, scale: float) -> float:
    """Mean FLIP over covered pixels; see `flip_errors`."""
    errors = flip_errors(picture, reference, scale)
    return float(errors.mean()) if errors.size else 0.0


def flip_errors(picture: Picture, reference: Picture, scale: float) -> NDArray[np.float32]:
    """FLIP of the pixels that the reference covers, both pictures tone-mapped with exposure ``scale``, over white.

    P. Andersson et al., "FLIP: A Difference Evaluator for Alternating Images", 2020; at 67 pixels per degree.
    """
    import flip_evaluator

    images = [to_srgb(one, scale).astype(np.float32) / 255.0 for one in (reference, picture)]
    errors, _, _ = flip_evaluator.evaluate(*images, "LDR", applyMagma=False)
    return np.asarray(errors, dtype=np.float32)[..., 0][reference.alpha > 0.0]


def error_map(picture: Picture, reference: Picture) -> NDArray[np.float64]:
    """(H, W) difference in luminance relative to the reference's mean over covered pixels; NaN outside them."""
    covered = reference.alpha > 0.5
    scale = float((reference.radiance[covered] @ _LUMINANCE).mean()) if covered.any() else 1.0
    difference = np.abs((picture.radiance - reference.radiance) @ _LUMINANCE) / max(scale, 1e-30)
    return np.where(covered, difference, np.nan)


def seam(radiance: NDArray, reference: NDArray, faces: NDArray, cluster: NDArray) -> tuple[float, float]:
    """How much the error jumps along edges between clusters, and along edges within them.

    Root mean square over the edges of the difference of the error between the two ends, relative to that of the
    reference over all vertices; zero where there is no such edge. Without visible seams the two are alike.

    Parameters
    ----------
    radiance, reference : (V, 3)
    faces : (F, 3)
    cluster : (V,)
        Number of the cluster of each vertex.
    """
    error = radiance.astype(np.float64) - reference.astype(np.float64)
    a, b = (np.concatenate([faces[:, i] for i in order]) for order in ((0, 1, 2), (1, 2, 0)))
    jumps = np.sum((error[a] - error[b]) ** 2, axis=1)
    scale = float(np.mean(np.sum(reference.astype(np.float64) ** 2, axis=1)))
    between = cluster[a] != cluster[b]
    squares = [jumps[edges].mean() if edges.any() else 0.0 for edges in (between, ~between)]
    across, within = np.sqrt(relative_square(squares, scale)).tolist()
    return across, within
