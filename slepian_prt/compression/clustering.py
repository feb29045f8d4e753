"""Vertices grouped into clusters, each with the smallest cap that holds its axes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError, check_integer
from slepian_prt.scene.receivers import Receivers, morton
from slepian_prt.sphere.caps import Cap, minimal_enclosing_cap
from slepian_prt.sphere.quadrature import spherical_fibonacci

_ITERATIONS = 30
# Few enough for a core's own cache, and for BLAS not to start threads, which together took twice as long.
_AXES_AT_A_TIME = 1024
_PATCH_ITERATIONS = 6

# Sites are directions in 1/2^14, axes count in 1/2^20: products are whole numbers below 2^36, exact in float64.
_SITE = 1 << 14
_AXIS = 1 << 20


@dataclass(frozen=True)
class Clusters:
    """A partition of the vertices.

    Attributes
    ----------
    index : (V,) int32
        Cluster of each vertex.
    caps : tuple of Cap
    occlusion_classes : (n,) int32
        Which clusters share a second moment: classes of occlusion.
    sites : (n, 3) int16 or None
        If given, each vertex belongs to the site nearest to its normal, so that the index need not be stored.
    """

    index: NDArray[np.int32]
    caps: tuple[Cap, ...]
    occlusion_classes: NDArray[np.int32]
    sites: NDArray[np.int16] | None = None

    @classmethod
    def of_one_class(
        cls, index: NDArray[np.int32], caps: tuple[Cap, ...], sites: NDArray[np.int16] | None = None
    ) -> Clusters:
        """Clusters that share one second moment."""
        return cls(index, caps, np.zeros(len(caps), dtype=np.int32), sites)

    @cached_property
    def members(self) -> list[NDArray[np.int64]]:
        """Vertices of each cluster, ascending."""
        order = np.argsort(self.index, kind="stable")
        return np.split(order, np.cumsum(np.bincount(self.index, minlength=len(self.caps)))[:-1])

    @cached_property
    def sizes(self) -> NDArray[np.int64]:
        """Number of vertices of each cluster."""
        return np.bincount(self.index, minlength=len(self.caps))


def spread(center: NDArray, axes: NDArray) -> float:
    """Half-angle of the evenly filled cap whose axes are as far from its centre, in the mean of 1 - cos θ.

    Cells of k-means fill their caps less than evenly, and on the surface of things some directions are more common.
    For an evenly filled cap that mean is sin²(Θ/2).
    """
    lit = np.any(axes != 0.0, axis=1)
    if not lit.any():
        return 0.0
    away = 0.5 * float(np.mean(np.sum((axes[lit] - center) ** 2, axis=1)))  # 1 - cos θ, also of tiny angles
    return 2.0 * math.asin(min(1.0, math.sqrt(away)))


def cluster_axes(axes: NDArray, count: int) -> Clusters:
    """At most ``count`` clusters by spherical k-means (Dhillon & Modha, Machine Learning 2001), deterministic.

    Starts from near-uniform directions; a cluster that runs empty is started again at the axis that is farthest
    from its centre. Vertices without an axis go to cluster 0 and do not widen its cap. Axes count in float32, as files
    hold normals.

    Parameters
    ----------
    axes : (V, 3) unit vectors or zero
        Normals, bent normals, or reflection directions.
    count : int >= 1

    Raises
    ------
    ValueError
        ``count`` is not a positive integer, or no vertex has an axis.
    """
    wanted = check_integer(count, "clusters", 1)
    lit = np.flatnonzero(np.any(axes != 0.0, axis=1))
    if lit.size == 0:
        raise UserError("normals must hold at least one that is not zero")
    unit = axes[lit]
    centers = spherical_fibonacci(wanted)
    nearest, cosine = _nearest(unit, centers)
    centers = centers[np.unique(nearest)]
    while len(centers) < wanted:
        nearest, cosine = _nearest(unit, centers)
        farthest = int(np.argmin(cosine))
        if cosine[farthest] > 1.0 - 1e-12:
            break  # fewer distinct axes than clusters
        centers = np.concatenate([centers, unit[farthest : farthest + 1]])
    for _ in range(_ITERATIONS):
        nearest, cosine = _nearest(unit, centers)
        sums = np.stack([np.bincount(nearest, unit[:, axis], minlength=len(centers)) for axis in range(3)], axis=1)
        length = np.linalg.norm(sums, axis=1, keepdims=True)
        moved = np.where(length > 1e-9, sums / np.maximum(length, 1e-300), centers)
        if np.abs(moved - centers).max() < 1e-7:
            break
        centers = moved
    sites = np.rint(centers * _SITE).astype(np.int16)
    return clusters_of_sites(sites[np.unique(_assigned(unit, sites))], axes)


def clusters_of_sites(sites: NDArray[np.int16], axes: NDArray) -> Clusters:
    """The clusters of vertices nearest to each site, the same on every machine."""
    index = _assigned(axes, sites)
    return Clusters.of_one_class(index, _enclosing(index, len(sites), axes), sites)


def typical_half_angle(clusters: Clusters, active: NDArray[np.bool_]) -> float:
    """Median half-angle, in radians, of the caps that vertices with light belong to; 0 if there are none.

    Parameters
    ----------
    clusters : Clusters
    active : (V,)
        Where light is received.
    """
    counts = np.bincount(clusters.index[active], minlength=len(clusters.caps))
    lit = [cap.half_angle for cap, count in zip(clusters.caps, counts, strict=True) if count]
    return float(np.median(lit)) if lit else 0.0


def frames_of(clusters: Clusters) -> NDArray[np.float64]:
    """(n, 3) axes of the frames that coded bases stand in: the sites, which files hold, or else the caps' centres."""
    if clusters.sites is None:
        return np.array([cap.center for cap in clusters.caps])
    sites = clusters.sites.astype(np.float64)
    return np.asarray(sites / np.linalg.norm(sites, axis=1, keepdims=True))


def enclose_clusters(index: NDArray[np.int32], count: int, axes: NDArray) -> Clusters:
    """The given partition into 0..count-1 with its caps."""
    return Clusters.of_one_class(index, _enclosing(index, count, axes))


def cluster_surface(receivers: Receivers, axes: NDArray, count: int) -> Clusters:
    """Neighbourhoods on the surface: geodesic Voronoi cells, the paper's other choice (Sec. 4, exponential map).

    Seeds start evenly along a space-filling curve and move to the middle of their cells. Distances run along edges.

    Parameters
    ----------
    receivers : Receivers
    axes : (V, 3)
        Whose caps are taken.
    count : int >= 1
    """
    # Only here, so that relighting starts without SciPy.
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import dijkstra
    from scipy.spatial import cKDTree

    lit = np.flatnonzero(np.any(axes != 0.0, axis=1))
    everywhere = receivers.positions
    positions = everywhere[lit]
    along = np.argsort(morton(positions), kind="stable")
    seeds = lit[along[((np.arange(count) + 0.5) * lit.size / count).astype(np.int64)]]
    a, b = receivers.neighbours.T
    lengths = np.linalg.norm(everywhere[a] - everywhere[b], axis=1)
    edges = csr_array((np.maximum(lengths, 1e-300), (a, b)), shape=(len(axes), len(axes)))
    index = np.zeros(len(axes), dtype=np.int64)
    for iteration in range(_PATCH_ITERATIONS):
        seeds = np.unique(seeds)
        distance, _, source = dijkstra(edges, directed=False, indices=seeds, min_only=True, return_predecessors=True)
        index = np.searchsorted(seeds, np.maximum(source, seeds[0]))
        apart = ~np.isfinite(distance)  # pieces without a seed
        index[apart] = cKDTree(everywhere[seeds]).query(everywhere[apart])[1]
        if iteration < _PATCH_ITERATIONS - 1:
            seeds = _middles(everywhere, index, lit, len(seeds))
    dark = np.ones(len(axes), dtype=bool)
    dark[lit] = False
    index[dark] = index[lit[0]]
    used, index = np.unique(index, return_inverse=True)
    return enclose_clusters(index.astype(np.int32), used.size, axes)


def cluster_by_occlusion(axes: NDArray, openness: NDArray, classes: int, count: int) -> Clusters:
    """Clusters of axes within classes of equally many vertices, from the most occluded to the most open.

    Parameters
    ----------
    axes : (V, 3)
    openness : (V,)
        Unblocked part of the hemisphere.
    classes : int >= 1
    count : int
        Clusters of each class.
    """
    lit = np.flatnonzero(np.any(axes != 0.0, axis=1))
    edges = np.unique(np.quantile(openness[lit], np.linspace(0.0, 1.0, classes + 1)[1:-1]))
    class_of = np.searchsorted(edges, openness[lit], side="left")
    found, class_of = np.unique(class_of, return_inverse=True)
    index = np.zeros(len(axes), dtype=np.int32)
    caps: list[Cap] = []
    classes_of: list[int] = []
    for number in range(found.size):
        chosen = lit[class_of == number]
        part = cluster_axes(axes[chosen], count)
        index[chosen] = part.index + len(caps)
        caps += part.caps
        classes_of += [number] * len(part.caps)
    return Clusters(index, tuple(caps), np.array(classes_of, dtype=np.int32))


def _middles(positions: NDArray, index: NDArray, lit: NDArray, count: int) -> NDArray[np.int64]:
    """The vertex of each cell that is nearest to the mean of the cell's vertices."""
    of = index[lit]
    sizes = np.maximum(np.bincount(of, minlength=count), 1)
    means = np.stack([np.bincount(of, positions[lit, k], minlength=count) / sizes for k in range(3)], axis=1)
    away = np.linalg.norm(positions[lit] - means[of], axis=1)
    order = np.lexsort((away, of))
    first = np.unique(of[order], return_index=True)[1]
    return np.asarray(lit[order[first]])


def _enclosing(index: NDArray, count: int, axes: NDArray) -> tuple[Cap, ...]:
    """The smallest cap of each cluster's axes, which count in float32; a cap of no size if none has one."""
    axes = axes.astype(np.float32).astype(np.float64)
    lit = np.any(axes != 0.0, axis=1)
    order = np.flatnonzero(lit)[np.argsort(index[lit], kind="stable")]
    parts = np.split(axes[order], np.cumsum(np.bincount(index[lit], minlength=count))[:-1])
    return tuple(minimal_enclosing_cap(part) if len(part) else Cap(np.array([0.0, 0.0, 1.0]), 0.0) for part in parts)


def _assigned(axes: NDArray, sites: NDArray[np.int16]) -> NDArray[np.int32]:
    """Nearest site of each axis, in whole numbers; 0 for axes that are zero."""
    whole = np.rint(axes.astype(np.float32).astype(np.float64) * _AXIS)
    return _nearest(whole, sites.astype(np.float64))[0].astype(np.int32)


def _nearest(unit: NDArray, centers: NDArray) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Nearest centre of each axis, and the product with it."""
    nearest = np.empty(len(unit), dtype=np.int64)
    product = np.empty(len(unit))
    for begin in range(0, len(unit), _AXES_AT_A_TIME):
        rows = slice(begin, begin + _AXES_AT_A_TIME)
        products = unit[rows] @ centers.T
        best = products.argmax(axis=1)
        nearest[rows] = best
        product[rows] = products[np.arange(best.size), best]
    return nearest, product
