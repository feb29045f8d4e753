"""What Slepian bases are held against, as their authors would tune it.

Clustered PCA must see all transfer vectors and store its bases; wavelets store which coefficients they kept.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from slepian_prt.compression.bases import Candidate, LinearBasis
from slepian_prt.compression.clustering import Clusters, enclosed
from slepian_prt.compression.pilot import decorrelated
from slepian_prt.compression.prediction import by_degree
from slepian_prt.sphere.harmonics import real_sh

_ITERATIONS = 12
_SETTLED = 1e-3
_CANDIDATES = 16
_BLOCK = 4096


def pca_candidates(bandlimit: int, clusters: Clusters, vectors: NDArray) -> list[Candidate]:
    """Mean and principal components of each cluster (Sloan et al., SIGGRAPH 2003).

    The first of K terms is the mean, whose coefficient is one and is not stored.

    Parameters
    ----------
    bandlimit : int
    clusters : Clusters
    vectors : (V, channels, (L+1)²)
    """
    return [_pca(bandlimit, clusters.caps[c].center, decorrelated(vectors[m])) for c, m in enumerate(clusters.members)]


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
    mixed = decorrelated(vectors)
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
    return enclosed(index.astype(np.int32), used.size, axes)


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


# --- Wavelets --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class HaarTransfer:
    """Transfer as its largest Haar coefficients on the faces of a cube (Ng, Ramamoorthi & Hanrahan, SIGGRAPH 2003).

    The functions Σ t_lm y_lm are sampled at the texels, scaled by the root of their solid angle so that coefficients
    are orthonormal; each vertex keeps its largest, in 8 bits each beside one float16, and their places in as few bits
    as tell them apart.

    Attributes
    ----------
    coefficients : sparse (V channels, 6 n²) float32
        Those that are kept.
    back : (6 n², (L+1)²) float32
        Onto spherical harmonics.
    albedo : (V, 3)
    terms, channels : int
    """

    coefficients: csr_array
    back: NDArray[np.float32]
    albedo: NDArray[np.float32]
    terms: int
    channels: int

    @property
    def bytes_per_vertex(self) -> float:
        """Values and their places; nothing else needs to be stored."""
        bits = self.terms * (8 + math.ceil(math.log2(self.coefficients.shape[1]))) + 16
        return self.channels * bits / 8.0

    def reconstruct(self) -> NDArray[np.float32]:
        """(V, (L+1)²) transfer vectors, or (V, 3, (L+1)²) with three channels."""
        vectors = np.asarray(self.coefficients @ self.back, dtype=np.float32)
        return vectors if self.channels == 1 else vectors.reshape(-1, self.channels, vectors.shape[1])

    def radiance(self, lighting: NDArray) -> NDArray[np.float32]:
        """(V, 3) outgoing radiance under lighting (3, (L+1)²)."""
        lit = np.asarray(self.coefficients @ (self.back @ lighting.T.astype(np.float32)), dtype=np.float32)
        if self.channels == 3:
            lit = np.einsum("vcc->vc", lit.reshape(-1, 3, 3))
        return lit * self.albedo


def haar_transfer(vectors: NDArray, terms: int, albedo: NDArray) -> HaarTransfer:
    """Keep the ``terms`` largest Haar coefficients of each of (V, channels, (L+1)²) transfer vectors."""
    channels, size = vectors.shape[1:]
    bandlimit = round(math.sqrt(size)) - 1
    side = 1 << max(2, math.ceil(math.log2(bandlimit + 1)))
    directions, solid_angles = cube_texels(side)
    samples = real_sh(bandlimit, directions) * np.sqrt(solid_angles)[:, None]
    forward = haar_faces(samples.reshape(6, side, side, size)).reshape(-1, size)
    # The texels are not quite a quadrature: least squares, so that all coefficients give all of the vector.
    back = np.linalg.pinv(forward).T.astype(np.float32)
    flat = vectors.reshape(-1, size)
    terms = min(terms, len(forward))
    values = np.empty((len(flat), terms), dtype=np.float32)
    places = np.empty((len(flat), terms), dtype=np.int32)
    for begin in range(0, len(flat), _BLOCK):
        block = slice(begin, begin + _BLOCK)
        rows = flat[block] @ forward.T.astype(np.float32)
        places[block] = np.argpartition(-np.abs(rows), terms - 1, axis=1)[:, :terms]
        chosen = np.take_along_axis(rows, places[block].astype(np.intp), axis=1)
        largest = np.abs(chosen).max(axis=1, keepdims=True)
        values[block] = np.rint(chosen / np.maximum(largest, 1e-30) * 127.0) * largest / 127.0
    starts = np.arange(len(flat) + 1) * terms
    kept = csr_array((values.ravel(), places.ravel(), starts), shape=(len(flat), len(forward)))
    return HaarTransfer(kept, back, albedo, terms, channels)


def cube_texels(side: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Centres (6 n², 3) and solid angles (6 n²,) of the texels of a cube map."""
    edges = np.linspace(-1.0, 1.0, side + 1)
    middle = 0.5 * (edges[1:] + edges[:-1])
    u, v = np.meshgrid(middle, middle, indexing="ij")
    corner = np.arctan2(edges[:, None] * edges[None, :], np.sqrt(edges[:, None] ** 2 + edges[None, :] ** 2 + 1.0))
    area = corner[1:, 1:] - corner[1:, :-1] - corner[:-1, 1:] + corner[:-1, :-1]
    directions = []
    for axis in range(3):
        for sign in (1.0, -1.0):
            face = np.empty((side, side, 3))
            face[..., axis], face[..., (axis + 1) % 3], face[..., (axis + 2) % 3] = sign, u, v
            directions.append(face.reshape(-1, 3))
    points = np.concatenate(directions)
    return points / np.linalg.norm(points, axis=1, keepdims=True), np.tile(area.ravel(), 6)


def haar_faces(faces: NDArray) -> NDArray:
    """Orthonormal two-dimensional Haar transform of (6, n, n, …), n a power of two, levels of both axes together."""
    result = np.array(faces, dtype=np.float64)
    side = result.shape[1]
    while side > 1:
        for axis in (1, 2):
            part = np.moveaxis(result[:, :side, :side], axis, 0)
            even, odd = part[0::2], part[1::2]
            low, high = (even + odd) * math.sqrt(0.5), (even - odd) * math.sqrt(0.5)
            part[...] = np.concatenate([low, high])
        side //= 2
    return result
