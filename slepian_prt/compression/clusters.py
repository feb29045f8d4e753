"""Vertices grouped by normal into caps."""

from __future__ import annotations

import operator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError
from slepian_prt.sphere.caps import Cap, minimal_enclosing_cap
from slepian_prt.sphere.quadrature import spherical_fibonacci

_ITERATIONS = 30


@dataclass(frozen=True)
class Clusters:
    """A partition of the vertices, each part with the smallest cap that holds its axes.

    Attributes
    ----------
    index : (V,) int32
        Cluster of each vertex.
    caps : tuple of Cap
    """

    index: NDArray[np.int32]
    caps: tuple[Cap, ...]

    @cached_property
    def members(self) -> list[NDArray[np.int64]]:
        """Vertices of each cluster, ascending."""
        order = np.argsort(self.index, kind="stable")
        return np.split(order, np.cumsum(np.bincount(self.index, minlength=len(self.caps)))[:-1])


def cluster_normals(normals: NDArray, count: int) -> Clusters:
    """At most ``count`` clusters by spherical k-means (Dhillon & Modha, Machine Learning 2001), deterministic.

    Starts from near-uniform directions; a cluster that runs empty is started again at the normal that is farthest
    from its centre. Vertices without a normal go to cluster 0 and do not widen its cap.

    Parameters
    ----------
    normals : (V, 3) unit vectors or zero
    count : int >= 1

    Raises
    ------
    ValueError
        ``count`` is not a positive integer, or no vertex has a normal.
    """
    try:
        wanted = operator.index(count)
    except TypeError:
        raise UserError(f"clusters must be a positive integer, not {count!r}") from None
    lit = np.flatnonzero(np.any(normals != 0.0, axis=1))
    if wanted < 1:
        raise UserError(f"clusters must be a positive integer, not {count!r}")
    if lit.size == 0:
        raise UserError("normals must hold at least one that is not zero")
    unit = normals[lit]
    centers = spherical_fibonacci(wanted)
    nearest, cosine = _assign(unit, centers)
    centers = centers[np.unique(nearest)]
    while len(centers) < wanted:
        nearest, cosine = _assign(unit, centers)
        farthest = int(np.argmin(cosine))
        if cosine[farthest] > 1.0 - 1e-12:
            break  # fewer distinct normals than clusters
        centers = np.concatenate([centers, unit[farthest : farthest + 1]])
    for _ in range(_ITERATIONS):
        nearest, cosine = _assign(unit, centers)
        sums = np.stack([np.bincount(nearest, unit[:, axis], minlength=len(centers)) for axis in range(3)], axis=1)
        length = np.linalg.norm(sums, axis=1, keepdims=True)
        moved = np.where(length > 1e-9, sums / np.maximum(length, 1e-300), centers)
        if np.abs(moved - centers).max() < 1e-7:
            break
        centers = moved
    nearest, _ = _assign(unit, centers)
    used, nearest = np.unique(nearest, return_inverse=True)
    index = np.zeros(len(normals), dtype=np.int32)
    index[lit] = nearest
    caps = tuple(minimal_enclosing_cap(unit[nearest == c]) for c in range(used.size))
    return Clusters(index, caps)


def _assign(unit: NDArray, centers: NDArray) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Nearest centre of each normal, and the cosine to it."""
    nearest = np.empty(len(unit), dtype=np.int64)
    cosine = np.empty(len(unit))
    for begin in range(0, len(unit), 65536):
        products = unit[begin : begin + 65536] @ centers.T
        best = products.argmax(axis=1)
        nearest[begin : begin + 65536] = best
        cosine[begin : begin + 65536] = products[np.arange(best.size), best]
    return nearest, cosine
