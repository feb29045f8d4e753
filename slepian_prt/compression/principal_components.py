"""Principal components of transfer vectors, and clusters iterated for them (Sloan et al., SIGGRAPH 2003).

Bases of this kind must see all vectors and are stored with them.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

from slepian_prt.compression.bases import Candidate
from slepian_prt.compression.clustering import Clusters, enclose_clusters
from slepian_prt.compression.linear_basis import LinearBasis
from slepian_prt.compression.pilot import decorrelate
from slepian_prt.compression.prediction import by_degree
from slepian_prt.machine.threads import map_in_threads

_ITERATIONS = 12

# Passes end where one makes the squared error less by no more than this part.
_SETTLED = 1e-3
_CANDIDATES = 16

# Up to this part of all components they are found faster by themselves.
_FEW = 0.125
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
    count = len(mixed)
    index = clusters.index.astype(np.int64)
    last = math.inf
    for iteration in range(_ITERATIONS):
        report(f"clustered PCA, {terms} terms: clustering, pass {iteration + 1}")
        # Each cluster by itself in a thread of ours: with threads of BLAS, which wait for each other in every step of
        # every decomposition, the passes took minutes on a busy machine.
        members = [np.flatnonzero(index == c) for c in np.unique(index)]
        fits = list(map_in_threads(lambda own: _strongest(mixed[own], terms - 1), members))
        near = _nearest_means(mixed, np.array([mean for mean, _ in fits]))
        error = np.full(count, np.inf)
        nearest = np.zeros(count, dtype=np.int64)
        candidates = [np.flatnonzero(near[:, c]) for c in range(len(fits))]
        missing_of = map_in_threads(lambda given: _missing(mixed, *given), zip(candidates, fits, strict=True))
        for c, (rows, missing) in enumerate(zip(candidates, missing_of, strict=True)):
            better = missing < error[rows]
            error[rows[better]] = missing[better]
            nearest[rows[better]] = c
        total = float(np.maximum(error, 0.0).sum())
        settled = total > (1.0 - _SETTLED) * last or np.array_equal(nearest, index)
        index, last = nearest, total
        # With many terms the error is all rounding, and this ends early: 64 terms then have an error of 0.132 % after 4
        # passes, and would have 0.126 % after 12.
        if settled:
            break
    used, index = np.unique(index, return_inverse=True)
    return enclose_clusters(index.astype(np.int32), used.size, axes)


def _strongest(vectors: NDArray, count: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Mean (channels, M) and the strongest components (M, count), as of `principal`; the others are not computed."""
    size = vectors.shape[2]
    vectors = vectors.astype(np.float64)
    mean = vectors.mean(axis=0)
    centred = (vectors - mean).reshape(-1, size)
    moment = centred.T @ centred / len(centred)
    if count == 0:
        return mean.astype(np.float32), np.zeros((size, 0), dtype=np.float32)
    if count > _FEW * size:
        components = np.linalg.eigh(moment)[1][:, size - count :]
    else:
        _, components = eigh(moment, subset_by_index=(size - count, size - 1), overwrite_a=True, check_finite=False)
    return mean.astype(np.float32), components.astype(np.float32)


def _missing(
    vectors: NDArray, rows: NDArray[np.int64], fit: tuple[NDArray[np.float32], NDArray[np.float32]]
) -> NDArray[np.float32]:
    """Squared error (n,) of some vectors in a cluster's mean and components."""
    mean, components = fit
    missing = np.empty(rows.size, dtype=np.float32)
    for begin in range(0, rows.size, _BLOCK):
        block = slice(begin, begin + _BLOCK)
        centred = vectors[rows[block]] - mean
        held = ((centred.reshape(-1, len(components)) @ components) ** 2).reshape(len(centred), -1).sum(axis=1)
        missing[block] = np.einsum("ncm,ncm->n", centred, centred) - held
    return missing


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
