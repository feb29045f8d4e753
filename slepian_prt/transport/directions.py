"""Shared direction sets over the hemisphere, with exact tables for the shapes that adaptive visibility finds.

Directions about the normal are points of the unit disk (x, y of the unit vector): the cosine-weighted measure of the
hemisphere, (n·ω)₊ dω/π, is the uniform one on the disk (the Nusselt analogue). The nodes are triangulated there.
Visibility is constant on most triangles. On an edge whose ends disagree, two bisections bracket where visibility
changes to a quarter of the edge, and within a triangle the boundary is taken as straight (marching triangles). That
leaves few distinct shapes, and the integrals of all spherical harmonics over them are tabulated once, so that the
projection of any vertex is a sum of table rows.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property, lru_cache
from threading import Lock
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from slepian_prt.machine.threads import one_blas_thread, run_in_threads, thread_count
from slepian_prt.scene.mesh import half_edges
from slepian_prt.scene.receivers import morton
from slepian_prt.slepian.kernels import cosine_lobe
from slepian_prt.sphere.harmonics import degrees, num_coefficients, real_sh

if TYPE_CHECKING:
    from scipy.spatial import Delaunay

SMALLEST_SET = 8

# Where on an edge visibility can be found to change, in parts of its length.
QUARTERS = 4
# Outermost nodes, as a radius in the disk: 5.7 degrees above the horizon. Visibility further out is taken to be that
# of the triangle next to it, so that rays do not graze the vertex's own faces.
_RIM = 0.995
_RELAXATIONS = 24
_POINTS_PER_NODE = 64
_LARGEST_RULE = 1 << 16

# Corners that may be cut off a triangle.
_SHAPES = 3 * QUARTERS * QUARTERS

_TRIANGLES_AT_ONCE = 48

# Sets that are kept, and bytes of tables (the last two are kept whatever their size): a set and its tables take a
# quarter of a second for the next scene of a thousand.
_MOST_SETS = 16
_MOST_BYTES = 1 << 28

Tables: TypeAlias = tuple[NDArray[np.float32], NDArray[np.float32]]


@dataclass(frozen=True, eq=False)
class DirectionSet:
    """A triangulated set of directions about z.

    Attributes
    ----------
    triangulation : scipy.spatial.Delaunay
        Of the nodes, which follow a Z-order curve: rays traced together should run together.
    edges : (E, 2)
        Nodes of each edge, the smaller index first.
    triangle_edges : (T, 3)
        Edge j of a triangle runs between its corners j and j+1.
    """

    triangulation: Delaunay
    edges: NDArray[np.int64]
    triangle_edges: NDArray[np.int64]

    @property
    def points(self) -> NDArray[np.float64]:
        """(n, 2) nodes in the unit disk."""
        return self.triangulation.points

    @property
    def triangles(self) -> NDArray[np.int32]:
        """(T, 3) nodes of each triangle."""
        return self.triangulation.simplices

    @property
    def size(self) -> int:
        """Number of nodes."""
        return len(self.points)

    @cached_property
    def vectors(self) -> NDArray[np.float64]:
        """(n + 3 E, 3) unit vectors: the nodes, then a quarter, half and three quarters along each edge."""
        begin, end = self.points[self.edges[:, 0]], self.points[self.edges[:, 1]]
        along = np.array([0.25, 0.5, 0.75])[None, :, None]
        inner = (begin[:, None] * (1.0 - along) + end[:, None] * along).reshape(-1, 2)
        return raise_to_sphere(np.concatenate([self.points, inner]))

    @cached_property
    def weights(self) -> NDArray[np.float64]:
        """(n,) part of the disk that belongs to each node; they sum to one."""
        rule, triangle, _ = self._rule
        share = np.bincount(triangle, minlength=len(self.triangles)) / len(rule)
        weights = np.bincount(self.triangles.ravel(), np.repeat(share / 3.0, 3), minlength=self.size)
        return np.asarray(weights, dtype=np.float64)

    def along_edge(self, edge: NDArray, quarter: NDArray | int) -> NDArray:
        """Index into ``vectors`` of the point that is 1, 2 or 3 quarters along an edge."""
        return self.size + 3 * edge + quarter - 1

    @cached_property
    def _rule(self) -> tuple[NDArray, NDArray, NDArray]:
        """Points of an equal-weight rule on the disk, the triangle of each, and its barycentric coordinates.

        What lies between the outermost nodes and the circle is given to the nearest triangle.
        """
        rule = _spiral(min(_LARGEST_RULE, _POINTS_PER_NODE * self.size))
        pulled = rule.copy()
        # Its first call solves a tiny system for each triangle, for which threads of BLAS would wait for each other: up
        # to seconds for milliseconds of work.
        with one_blas_thread():
            triangle = self.triangulation.find_simplex(pulled)
            while (outside := triangle < 0).any():
                pulled[outside] *= 0.996
                triangle[outside] = self.triangulation.find_simplex(pulled[outside])
        a, b, c = (self.points[self.triangles[triangle, k]] for k in range(3))
        area = _cross(b - a, c - a)
        first = _cross(b - pulled, c - pulled) / area
        second = _cross(c - pulled, a - pulled) / area
        return rule, triangle, np.column_stack([first, second, 1.0 - first - second])

    def tables(self, bandlimit: int) -> Tables:
        """Integrals of the harmonics over the shapes that blocked regions are put together from, kept for reuse.

        Returns
        -------
        nodes : (n, (L+1)²)
            (1/π) ∫ (ω_z)₊ y_lm dω over a third of each triangle about a node.
        corners : (48 T, (L+1)²)
            Row ((3 t + k) 4 + i) 4 + j: what to add to a third of triangle t to get its corner at its vertex k, cut
            off in quarter i of the edge to vertex k+1 and quarter j of the edge to vertex k+2.
        """
        with _LOCK:
            found = _KEPT.pop((self, bandlimit), None) or _tables(self, bandlimit)
            _KEPT[self, bandlimit] = found
            while len(_KEPT) > 2 and sum(table.nbytes for kept in _KEPT.values() for table in kept) > _MOST_BYTES:
                _KEPT.popitem(last=False)
        return found


# Tables that were asked for last stand last.
_KEPT: OrderedDict[tuple[DirectionSet, int], Tables] = OrderedDict()
_LOCK = Lock()


@lru_cache(maxsize=_MOST_SETS)
def direction_set(nodes: int) -> DirectionSet:
    """A set of ``nodes`` directions about z, distributed evenly under the cosine."""
    from scipy.spatial import Delaunay  # only here, so that what needs no ray starts without it

    points = _relaxed(max(nodes, SMALLEST_SET))
    points = points[np.argsort(morton(points), kind="stable")]
    triangulation = Delaunay(points)
    sides = np.sort(half_edges(triangulation.simplices), axis=1)
    edges, which = np.unique(sides, axis=0, return_inverse=True)
    return DirectionSet(triangulation, edges, which.reshape(3, -1).T.copy())


def raise_to_sphere(points: NDArray) -> NDArray[np.float64]:
    """Unit vectors, (n, 3), above points of the unit disk, (n, 2)."""
    return np.column_stack([points, np.sqrt(np.maximum(0.0, 1.0 - np.sum(points * points, axis=1)))])


def _tables(directions: DirectionSet, bandlimit: int) -> Tables:
    size, count = num_coefficients(bandlimit), len(directions.triangles)
    corners = np.empty((count, _SHAPES, size), dtype=np.float32)
    triangles = np.empty((count, size))
    rule, triangle, barycentric = directions._rule
    along = np.argsort(triangle, kind="stable")
    ends = np.searchsorted(triangle[along], np.arange(count + 1))
    points, to_corners = raise_to_sphere(rule[along]), barycentric[along]

    def fill(begin: int) -> None:
        """Rows of some triangles, whose points are few enough for the caches."""
        end = min(count, begin + _TRIANGLES_AT_ONCE)
        chosen = slice(ends[begin], ends[end])
        harmonics = np.ascontiguousarray(real_sh(bandlimit, points[chosen], np.float32))
        harmonics /= len(rule)
        within = triangle[along[chosen]] - begin
        triangles[begin:end] = _sums(within, np.arange(within.size), end - begin, within.size) @ harmonics
        cut = _cut_off(to_corners[chosen], within, end - begin)
        corners[begin:end] = (cut @ harmonics).reshape(-1, _SHAPES, size)

    run_in_threads(fill, range(0, count, _TRIANGLES_AT_ONCE))  # NumPy and SciPy let go of the interpreter
    # The rule is good to about 1e-4; what all triangles together make is known exactly.
    exact = (real_sh(bandlimit, np.array([[0.0, 0.0, 1.0]])) * cosine_lobe(bandlimit)[degrees(bandlimit)])[0]
    share = np.bincount(triangle, minlength=count)[:, None] / len(rule)
    triangles += share * (exact - triangles.sum(axis=0))
    corners -= (triangles / 3.0).astype(np.float32)[:, None]
    corner, whose = directions.triangles.T.ravel(), np.tile(np.arange(count), 3)
    nodes = _sums(corner, whose, directions.size, count) @ (triangles / 3.0)
    return nodes.astype(np.float32), corners.reshape(-1, size)


def _cut_off(barycentric: NDArray[np.float64], triangle: NDArray[np.int64], count: int) -> csr_array:
    """Which points lie in which corners of their triangles: (48 count, n), ones."""
    middles = (np.arange(QUARTERS) + 0.5) / QUARTERS
    rows, columns = [], []
    for k in range(3):
        to_next = barycentric[:, (k + 1) % 3, None] / middles
        to_last = barycentric[:, (k + 2) % 3, None] / middles
        point, i, j = np.nonzero(to_next[:, :, None] + to_last[:, None] < 1.0)
        rows.append(triangle[point] * _SHAPES + (k * QUARTERS + i) * QUARTERS + j)
        columns.append(point)
    return _sums(np.concatenate(rows), np.concatenate(columns), count * _SHAPES, len(barycentric), np.float32)


def _sums(row: NDArray, column: NDArray, rows: int, columns: int, dtype: type = np.float64) -> csr_array:
    """The matrix that adds up what is in the columns of each row."""
    return csr_array((np.ones(row.size, dtype), (row, column)), shape=(rows, columns))


def _relaxed(n: int) -> NDArray[np.float64]:
    """n points that fill the disk evenly: a golden spiral after Lloyd's relaxation, stretched to the rim."""
    from scipy.spatial import cKDTree

    points, rule = _spiral(n), _spiral(32 * n)
    parts = np.array_split(rule, thread_count())
    # Threads of our own, which are waited for: those of SciPy go on after an interrupt, on memory that is freed then.
    with ThreadPoolExecutor(len(parts)) as pool:
        for _ in range(_RELAXATIONS):
            tree = cKDTree(points)
            cell = np.concatenate([nearest for _, nearest in pool.map(tree.query, parts)])
            count = np.bincount(cell, minlength=n)
            sums = np.column_stack([np.bincount(cell, rule[:, axis], minlength=n) for axis in (0, 1)])
            points = sums / count[:, None]
    return points * (_RIM / np.linalg.norm(points, axis=1).max())


def _spiral(n: int) -> NDArray[np.float64]:
    """Golden spiral in the unit disk (Vogel 1979), (n, 2)."""
    index = np.arange(n)
    radius, angle = np.sqrt((index + 0.5) / n), math.pi * (3.0 - math.sqrt(5.0)) * index
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])


def _cross(u: NDArray, v: NDArray) -> NDArray:
    return u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
