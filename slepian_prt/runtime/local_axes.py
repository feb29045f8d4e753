"""Clusters of vectors, each near a plane of few dimensions of its own: clustered principal component analysis.

Sloan, Hall, Hart and Snyder, "Clustered Principal Components for Precomputed Radiance Transfer", SIGGRAPH 2003.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

# Rounds of assigning vectors to planes, after as many of assigning them to means; those that change no more than this
# part of the clusters end it.
_ROUNDS = 8
_FEW = 0.01

# Coordinates that the first rounds look at.
_COARSE = 8


@dataclass(frozen=True, eq=False)
class LocalAxes:
    """A plane of few dimensions.

    Attributes
    ----------
    mean : (r,)
    axes : (r, k)
        Orthonormal, those of largest variance first.
    """

    mean: NDArray[np.float32]
    axes: NDArray[np.float32]

    @classmethod
    def of(cls, vectors: NDArray[np.float32], count: int) -> LocalAxes:
        """The principal axes of vectors (n, r), at most ``count`` of them."""
        mean = vectors.mean(axis=0, dtype=np.float64).astype(np.float32)
        centered = vectors - mean
        axes = np.linalg.eigh((centered.T @ centered).astype(np.float64))[1][:, ::-1]
        return cls(mean, axes[:, : min(count, len(vectors) - 1)].astype(np.float32))

    def residuals(self, vectors: NDArray[np.float32]) -> NDArray[np.float32]:
        """(n,) squared distances of vectors from the plane."""
        centered = vectors - self.mean
        along = centered @ self.axes
        squares = np.einsum("nr,nr->n", centered, centered) - np.einsum("nk,nk->n", along, along)
        return np.asarray(np.maximum(squares, 0.0), dtype=np.float32)


def variance_left(vectors: NDArray[np.float32], count: int, rounding: float = 0.0) -> float:
    """Sum of the squared distances of vectors (n, r) from their plane of ``count`` dimensions, and of their rounding.

    ``rounding`` is what part of the squares along the plane the rounding of coefficients loses.
    """
    if len(vectors) < 2:
        return 0.0
    centered = vectors - vectors.mean(axis=0, dtype=np.float64).astype(np.float32)
    values = np.linalg.eigvalsh((centered.T @ centered).astype(np.float64))
    values = np.maximum(values, 0.0)
    beyond = max(0, values.size - count)
    return float(values[:beyond].sum() + rounding * values[beyond:].sum())


def cluster_counts(left: NDArray[np.float64], sizes: NDArray[np.integer], total: int, least: int) -> NDArray[np.int64]:
    """How many clusters each of some groups is split in, so that together there are at most ``total``.

    Parameters
    ----------
    left : (G,)
        What `variance_left` says of each group; it is taken to fall as one over the number of clusters.
    sizes : (G,)
        How many vectors each holds.
    total : int
        At least G.
    least : int
        Vectors of a cluster that is worth having.
    """
    counts = np.ones(left.size, dtype=np.int64)
    most = np.maximum(sizes // max(least, 1), 1)
    for _ in range(total - left.size):
        gains = np.where(counts < most, left / (counts * (counts + 1)), 0.0)
        best = int(gains.argmax())
        if not gains[best] > 0.0:
            break
        counts[best] += 1
    return counts


def split_by_axes(
    vectors: NDArray[np.float32], clusters: int, count: int, rng: np.random.Generator
) -> NDArray[np.intp]:
    """(n,) the cluster of each vector, such that all are near the planes of theirs of ``count`` dimensions.

    Parameters
    ----------
    vectors : (n, r)
        The first coordinates are those of largest variance.
    clusters : int
        Some may end up empty.
    count : int
    rng : numpy.random.Generator
    """
    if clusters == 1 or len(vectors) <= clusters:
        return np.zeros(len(vectors), dtype=np.intp)
    coarse = vectors[:, :_COARSE]
    centers = coarse[rng.choice(len(vectors), clusters, replace=False)]
    labels = np.zeros(len(vectors), dtype=np.intp)
    for _ in range(_ROUNDS):
        labels = (np.sum(centers * centers, axis=1) - 2.0 * (coarse @ centers.T)).argmin(axis=1)
        kept = [coarse[labels == c] for c in range(clusters)]
        centers = np.stack([own.mean(axis=0) if len(own) else old for own, old in zip(kept, centers, strict=True)])
    for _ in range(_ROUNDS):
        planes = [LocalAxes.of(vectors[labels == c], count) for c in np.unique(labels)]
        nearest = np.stack([plane.residuals(vectors) for plane in planes], axis=1).argmin(axis=1)
        changed = np.mean(nearest != labels) if len(planes) == clusters else 1.0
        labels = nearest
        if changed <= _FEW:
            break
    return labels
