"""Noise of captured pixels: how large it is, and taken out where neighbours tell it from light."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slepian_prt.transport.capturing.guides import Guides
from slepian_prt.transport.smoothing import mean_over_neighbours, smooth, variance_of_paths

# Differences across which little is averaged, beside those of normals: of reflectance, of the logarithm of distance,
# of the part of a pixel that is covered. Between shapes nothing is averaged in any band: their numbers are in the order
# in which threads of Mitsuba loaded them, and must not count.
_NORMALS, _ALBEDO, _DEPTH, _COVERAGE = 0.15, 0.1, 0.1, 0.25
_APART = 100.0

# The size of the noise is told by how much passes differ, over so many rings of pixels; where it is, by second moments,
# over fewer.
_WIDE, _NEAR = 8, 2


@dataclass(frozen=True, eq=False)
class Pixels:
    """What the paths of V pixels brought.

    Attributes
    ----------
    vectors : (V, 3, (L+1)²) float32
    variance : (V, 3, L+1) float32
        Of a coefficient of each degree.
    background : (V, 3) float32
        As of `Film`.
    moments : (V, 3) float32
        Mean square of the throughput of paths.
    rays : int
        Traced in all.
    removed : float
        Relative RMS of what smoothing took out.
    """

    vectors: NDArray[np.float32]
    variance: NDArray[np.float32]
    background: NDArray[np.float32]
    moments: NDArray[np.float32]
    rays: int
    removed: float = 0.0


def smoothed(pixels: Pixels, neighbours: NDArray[np.integer], guides: NDArray, paths: int) -> Pixels:
    """The same with less noise.

    Parameters
    ----------
    pixels : Pixels
    neighbours : (E, 2)
    guides : (V, k)
        As of `smooth`: those of `guide_table`.
    paths : int
        Of each pixel.
    """
    foreseen = variance_of_paths(pixels.moments, pixels.vectors, paths)
    variance = calibrated(foreseen, pixels.variance, neighbours)
    result = smooth(pixels.vectors, variance, neighbours, guides)
    result.vectors[~pixels.vectors.any(axis=(1, 2))] = 0.0  # what shows nothing stays dark
    return Pixels(result.vectors, result.variance, pixels.background, pixels.moments, pixels.rays, result.removed)


def calibrated(foreseen: NDArray, measured: NDArray, neighbours: NDArray[np.integer]) -> NDArray[np.float32]:
    """(V, 3, L+1) a variance that is foreseen from second moments, as large as it was measured.

    Stratified paths vary less than independent ones, several times so. But a few passes tell the variance of a pixel
    with much noise of its own, and of light that hardly any path brings, not at all.
    """
    near = pooled(foreseen, neighbours, _NEAR)
    around, wide = pooled(near, neighbours), pooled(measured, neighbours)
    ratio = np.divide(wide, around, out=np.ones_like(wide), where=around > 0.0)
    return np.asarray(near * ratio, dtype=np.float32)


def pooled(values: NDArray, neighbours: NDArray[np.integer], rings: int = _WIDE) -> NDArray[np.float32]:
    """(V, …) means of values over rings of pixels."""
    mean = mean_over_neighbours(neighbours, len(values))
    table = np.asarray(values, dtype=np.float32).reshape(len(values), -1)
    for _ in range(rings):
        table = mean @ table
    return np.asarray(table, dtype=np.float32).reshape(values.shape)


def guide_table(guides: Guides, background: NDArray) -> NDArray[np.float64]:
    """(V, k) guides of `smooth`: what a pixel shows, in units of a difference across which little is averaged."""
    shapes = np.unique(guides.shapes, return_inverse=True)[1].astype(np.float64)
    depth = np.log(np.where(guides.depth > 0.0, guides.depth, 1.0))
    return np.column_stack([
        guides.normals / _NORMALS,
        guides.albedo / _ALBEDO,
        depth / _DEPTH,
        background.mean(axis=1) / _COVERAGE,
        _APART * shapes,
    ])  # fmt: skip
