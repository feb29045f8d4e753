"""Neighbourhoods on a surface: what of it lies around a vertex and hangs together there, with areas."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slepian_prt.evaluation.dimension.cells import Cells
from slepian_prt.scene.mesh import Mesh
from slepian_prt.scene.receivers import Receivers, morton

# Copies of a vertex at hard edges and seams are one place of a surface, unless their normals are further apart than
# 120 degrees: then they are the two sides of a sheet.
_OPPOSITE = -0.5

# Vertices count by what of their cells is within the radius, unless they are further outside of it than so many radii.
_OUTSIDE = 0.5

# A smaller part of the radius squared is no area but rounding.
_NOTHING = 1e-12

# Copies of a vertex are held against so many that come after them; where there are more, as at the tip of a cone, those
# that come after one another are next to one another.
_COPIES = 32


class Neighbourhood(NamedTuple):
    """Vertices about one of them.

    Attributes
    ----------
    members : (n,) int
    distances : (n,)
        From the vertex in the middle, in a straight line.
    areas : (n,)
        Of the part of the surface about each that is within the radius.
    """

    members: NDArray[np.int64]
    distances: NDArray[np.float64]
    areas: NDArray[np.float64]


class Surface:
    """A surface whose neighbourhoods of one radius are asked for.

    A neighbourhood is what of the surface lies within the radius of a vertex, in a straight line, and hangs together
    with it there: the other side of a sheet or of a gap does not belong to it. So it is, unlike what is within reach
    along edges, the same for every tessellation; on a sphere it is a cap whose chord is the radius.

    Parameters
    ----------
    mesh : Mesh
    radius : float
        In units of the model.

    Attributes
    ----------
    radius : float
    areas : (V,)
        A third of the area of the faces about each vertex.
    """

    def __init__(self, mesh: Mesh, radius: float) -> None:
        # Only here, so that what is told of files starts without SciPy.
        from scipy.spatial import cKDTree

        self.areas = vertex_areas(mesh)
        self._positions, self.radius = mesh.positions, radius
        self._active = np.flatnonzero(mesh.receivers.active)
        self._tree = cKDTree(mesh.positions[self._active])
        self._cells = Cells(mesh)
        self._reach = radius + min(float(self._cells.extents.max()), _OUTSIDE * radius)
        pairs = np.concatenate([mesh.receivers.neighbours, copies_at_one_place(mesh.receivers)])
        pairs = np.concatenate([pairs, pairs[:, ::-1]])
        self._next = pairs[np.argsort(pairs[:, 0], kind="stable"), 1]
        self._first = np.concatenate([[0], np.cumsum(np.bincount(pairs[:, 0], minlength=len(mesh.positions)))])
        self._number = np.full(len(mesh.positions), -1, dtype=np.int64)

    def spread_order(self) -> Iterator[int]:
        """All vertices that some face uses, first few far apart, then more and more between, however they are numbered.

        They are taken along a space-filling curve, at the places of van der Corput's sequence.
        """
        count = self._active.size
        along = self._active[np.lexsort((self._active, morton(self._positions[self._active])))]
        bits = max(count - 1, 0).bit_length()
        places = np.zeros(1, dtype=np.int64)
        for bit in range(bits):
            places = np.concatenate([places, places + (1 << (bits - 1 - bit))])
        yield from along[places[places < count]].tolist()

    def about(self, vertex: int) -> Neighbourhood:
        """The neighbourhood of a vertex that some face uses."""
        near = self._active[self._tree.query_ball_point(self._positions[vertex], self._reach)]
        distances = np.linalg.norm(self._positions[near] - self._positions[vertex], axis=1)
        over = (distances - self.radius) / np.maximum(self._cells.extents[near], 1e-300)
        areas = np.where(over < 0.0, self.areas[near], 0.0)
        rim = np.abs(over) < 1.0
        areas[rim] = self._cells.areas_within(near[rim], self._positions[vertex], self.radius)
        # What has no part in the neighbourhood must not join what has: one large face would widen the reach everywhere.
        counted = (areas > _NOTHING * self.radius**2) | (distances <= self.radius)
        near, distances, areas = near[counted], distances[counted], areas[counted]
        together = self._together(near, vertex)
        return Neighbourhood(near[together], distances[together], areas[together])

    def _together(self, near: NDArray[np.int64], vertex: int) -> NDArray[np.bool_]:
        """(n,) which of ``near`` edges among them join with the vertex."""
        from scipy.sparse import csr_array
        from scipy.sparse.csgraph import connected_components

        self._number[near] = np.arange(near.size)
        counts = self._first[near + 1] - self._first[near]
        ends = np.cumsum(counts)
        places = np.arange(ends[-1]) + np.repeat(self._first[near] - (ends - counts), counts)
        theirs = self._number[self._next[places]]
        inside = theirs >= 0
        starts = np.concatenate([[0], np.cumsum(inside)])[np.concatenate([[0], ends])]
        links = (np.ones(int(starts[-1])), theirs[inside], starts)
        # Each link is there in both directions, so that pieces are strong ones, which are found without turning it.
        graph = csr_array(links, shape=(near.size, near.size))
        pieces = connected_components(graph, connection="strong")[1]
        together = pieces == pieces[self._number[vertex]]
        self._number[near] = -1
        return np.asarray(together)


def vertex_areas(mesh: Mesh) -> NDArray[np.float64]:
    """(V,) a third of the area of the faces about each vertex."""
    a, b, c = (mesh.positions[mesh.faces[:, corner]] for corner in range(3))
    thirds = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 6.0
    return np.bincount(mesh.faces.ravel(), np.repeat(thirds, 3), minlength=len(mesh.positions)).astype(np.float64)


def copies_at_one_place(receivers: Receivers) -> NDArray[np.int64]:
    """(n, 2) vertices that stand at the same place of a surface: each with its copies there that face the same side.

    Of a sheet with two sides copies alternate as the file has them, so that all pairs are looked at.
    """
    positions, normals = receivers.positions, receivers.normals
    used = np.flatnonzero(receivers.active)
    order = used[np.lexsort((used, *positions[used].T))]
    pairs, places = [], np.arange(max(order.size - 1, 0))
    for step in range(1, _COPIES + 1):
        places = places[places < order.size - step]
        first, second = order[places], order[places + step]
        same = np.all(positions[first] == positions[second], axis=1)
        places, first, second = places[same], first[same], second[same]
        facing = np.sum(normals[first] * normals[second], axis=1) > _OPPOSITE
        pairs.append(np.stack([first[facing], second[facing]], axis=1))
    return np.concatenate(pairs)
