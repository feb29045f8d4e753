"""Principal components of transfer vectors, and clusters iterated for them (Sloan et al., SIGGRAPH 2003).

Bases of this kind must see all vectors and are stored with them.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.bases import Candidate
from slepian_prt.compression.clustering import Clusters, enclose_clusters
from slepian_prt.compression.linear_basis import LinearBasis
from slepian_prt.compression.pilot import decorrelate
from slepian_prt.compression.prediction import by_degree

_ITERATIONS = 12
_SETTLED = 1e-3
_CANDIDATES = 16
_BLOCK = 4096

# Terms that clusters are iterated for when their number is not given.
USUAL_TERMS = 16


def pca_candidates(bandlimit: int, clusters: Clusters, vectors: NDArray) -> list[Candidate]:
    """Mean and principal components of each cluster (Sloan et al., SIGGRAPH 2003).

    The first of K terms is the mean, whose coefficient is one and is not stored.

    Parameters
    ----------
    bandlimit : int
    clusters : Clusters
    vectors : (V, channels, (L+1)²)
    """
    return [_pca(bandlimit, clusters.caps[c].center, decorrelate(vectors[m])) for c, m in enumerate(clusters.members)]


def _pca(bandlimit: int, center: NDArray, vectors: NDArray) -> Candidate:
    mean, components, variances = principal(vectors)
    of_mean = float(np.mean(np.sum(mean * mean, axis=1)))

    def cut(k: int) -> LinearBasis:
        return LinearBasis(
            center, bandlimit, k - 1, dense=components[: k - 1].astype(np.float32), mean=mean.astype(np.float32)
        )

    def lost(k: int) -> NDArray[np.float64]:
        rest = variances[max(k - 1, 0) :] @ components[max(k - 1, 0) :] ** 2
        return by_degree(rest if k > 0 else rest + np.mean(mean * mean, axis=0))

    return Candidate(np.concatenate([[of_mean], variances]), of_mean + float(variances.sum()), cut, lost)


def principal(vectors: NDArray) -> tuple[NDArray, NDArray, NDArray]:
    """Mean (channels, M), components (M, M) strongest first, and variances (M,) of (n, channels, M) vectors."""
    size = vectors.shape[2]
    vectors = vectors.astype(np.float64)
    mean = vectors.mean(axis=0) if len(vectors) else np.zeros(vectors.shape[1:])
    centred = (vectors - mean).reshape(-1, size)
    variances, components = np.linalg.eigh(centred.T @ centred / max(len(centred), 1))
    return mean, components[:, ::-1].T, np.maximum(variances[::-1], 0.0)


def iterate_clusters(
    clusters: Clusters, axes: NDArray, vectors: NDArray, terms: int, report: Callable[[str], None] = lambda _: None
) -> Clusters:
    """Clusters by reconstruction error (Sloan et al. 2003, Sec. 5): assign, fit mean and components, and again.

    Parameters
    ----------
    clusters : Clusters
        To start from.
    axes : (V, 3)
    vectors : (V, channels, (L+1)²)
    terms : int
        Of the bases that will be used, the mean counted.
    """
    mixed = decorrelate(vectors)
    count, _, size = mixed.shape
    index = clusters.index.astype(np.int64)
    last = math.inf
    for iteration in range(_ITERATIONS):
        report(f"clustered PCA, {terms} terms: clustering, pass {iteration + 1}")
        fits = [principal(mixed[index == c]) for c in np.unique(index)]
        near = _nearest_means(mixed, np.array([mean for mean, _, _ in fits], dtype=np.float32))
        error = np.full(count, np.inf)
        nearest = np.zeros(count, dtype=np.int64)
        for c, (mean, components, _) in enumerate(fits):
            kept, offset = components[: terms - 1].T.astype(np.float32), mean.astype(np.float32)
            rows = np.flatnonzero(near[:, c])
            for begin in range(0, rows.size, _BLOCK):
                block = rows[begin : begin + _BLOCK]
                centred = mixed[block] - offset
                along = centred.reshape(-1, size) @ kept
                held = (along**2).reshape(block.size, -1).sum(axis=1)
                missing = np.einsum("ncm,ncm->n", centred, centred) - held
                better = block[missing < error[block]]
                error[better] = missing[missing < error[block]]
                nearest[better] = c
        total = float(np.maximum(error, 0.0).sum())
        index = nearest
        if total > (1.0 - _SETTLED) * last:
            break
        last = total
    used, index = np.unique(index, return_inverse=True)
    return enclose_clusters(index.astype(np.int32), used.size, axes)


def _nearest_means(vectors: NDArray, means: NDArray) -> NDArray[np.bool_]:
    """(V, clusters): the few clusters that a vertex may join, those whose means are nearest."""
    flat, centers = vectors.reshape(len(vectors), -1), means.reshape(len(means), -1)
    if len(centers) <= _CANDIDATES:
        return np.ones((len(flat), len(centers)), dtype=bool)
    near = np.zeros((len(flat), len(centers)), dtype=bool)
    half_squares = 0.5 * np.einsum("cm,cm->c", centers, centers)
    for begin in range(0, len(flat), _BLOCK):
        block = slice(begin, begin + _BLOCK)
        away = half_squares - flat[block] @ centers.T
        np.put_along_axis(near[block], np.argpartition(away, _CANDIDATES, axis=1)[:, :_CANDIDATES], True, axis=1)
    return near
