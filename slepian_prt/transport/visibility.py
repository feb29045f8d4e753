"""Which directions of a receiver are blocked: those that may be at all, and rays with bisection where they disagree."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slepian_prt.scene.scene import Scene
from slepian_prt.transport.directions import SMALLEST_SET
from slepian_prt.transport.hemisphere import HemisphereRays, turned_frames

# Products of normals and corners of the hull at a time: few enough for a core's own cache, and for BLAS not to start
# threads, which took three and ten times as long.
_PRODUCTS = 1 << 17

# Open directions of a receiver that are few enough to be leaks, and how far beside them to look again, in radians.
_LEAKS = 3
_BESIDE = 1e-3


def shadowed_vertices(scene: Scene) -> NDArray[np.bool_]:
    """(V,) True where something may block light: a part of the scene reaches above the receiver's tangent plane.

    Exact (supporting planes of the convex hull of everything), so a convex scene traces no ray.
    """
    positions, normals = scene.traced_positions, scene.receivers.normals
    corners = _hull_corners(scene)
    heights = np.empty(len(positions))
    size = max(1, _PRODUCTS // len(corners))
    for begin in range(0, len(positions), size):
        block = slice(begin, begin + size)
        reach = (normals[block] @ corners.T).max(axis=1)
        heights[block] = reach - np.einsum("ij,ij->i", normals[block], positions[block])
    # A vertex normal of a convex mesh is the mean over its faces; half the height of a ray's start is
    # far below what a ray sees.
    shadowed = scene.receivers.active & (heights > 0.5 * scene.ray_heights)
    if shadowed.any():
        # What a vertex stands on lies in its tangent plane, and above it for rays that start beside a contact.
        below = np.einsum("ij,ij->i", normals, scene.ray_origins.front - positions)
        shadowed |= scene.receivers.active & (heights - below > 0.5 * scene.ray_heights)
    return shadowed


def _hull_corners(scene: Scene) -> NDArray[np.float64]:
    """Vertices of the convex hull of the receivers, and the boxes of what else is there."""
    points = scene.traced_positions[scene.receivers.active]
    for shape in scene.occluders:
        box = shape.bbox()
        low, high = np.array(box.min, dtype=np.float64), np.array(box.max, dtype=np.float64)
        corners = [[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])]
        points = np.concatenate([points, corners])
    from scipy.spatial import ConvexHull, QhullError  # only here, so that what needs no ray starts without it

    try:
        return points[ConvexHull(points).vertices]
    except QhullError:
        return points  # flat or smaller: every point may count


def nodes_for(samples: float, changes: float) -> int:
    """Size of the set of directions with which a receiver gets ``samples`` rays on average.

    ``changes`` is the number of edges along which visibility changes, measured on a set, over the root of its size:
    the boundary of visibility is a curve. Each costs two rays.
    """
    root = -changes + math.sqrt(changes * changes + samples)
    return max(SMALLEST_SET, int(root * root))


class VisibilitySamples(NamedTuple):
    """What is blocked for n receivers.

    Nodes and edges of the direction set come first so that picking the same one for all receivers copies contiguous
    memory.

    Attributes
    ----------
    frames : (n, 3, 3)
        Rotations that take the directions to each receiver's hemisphere.
    blocked : (nodes, n)
        True where a node is blocked.
    quarter : (edges, n)
        In which quarter of an edge visibility changes, where it does.
    """

    frames: NDArray[np.float64]
    blocked: NDArray[np.bool_]
    quarter: NDArray[np.uint8]


def disagreements(blocked: NDArray[np.bool_], groups: NDArray) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Groups of nodes that are not all alike for a receiver: rows of ``groups``, and receivers, by row.

    Eight receivers to a byte, most of which are zero: a third of the time of comparing one by one.

    Parameters
    ----------
    blocked : (nodes, n)
    groups : (m, k)
        Nodes.
    """
    packed = np.packbits(blocked, axis=1)
    first, *others = (packed[groups[:, k]] for k in range(groups.shape[1]))
    differ = np.bitwise_or.reduce([first ^ other for other in others])
    byte = np.flatnonzero(differ.ravel() != 0)
    bit = np.flatnonzero(np.unpackbits(differ.ravel()[byte]).view(bool))
    row, place = np.divmod(byte[bit >> 3], packed.shape[1])
    return row, 8 * place + (bit & 7)


class VisibilityTracer(HemisphereRays):
    """Adaptive visibility: the nodes of the direction set, then bisection along edges whose ends disagree.

    Attributes
    ----------
    changes : int
        Edges along which visibility changed, so far.
    """

    changes = 0

    def trace(self, vertices: NDArray) -> VisibilitySamples:
        """Find what is blocked for the receivers given."""
        directions, count = self.directions, len(vertices)
        frames = self.frames(vertices)
        rays = self.rays_from(vertices, frames)
        hit = np.array(self.geometry.ray_test(rays(*self.to_nodes(count))))
        blocked = np.ascontiguousarray(hit.reshape(count, directions.size).T)
        self._close_leaks(vertices, frames, blocked)
        quarter = np.zeros((len(directions.edges), count), dtype=np.uint8)
        edge, place = disagreements(blocked, directions.edges)
        if edge.size:
            by_vertex = np.argsort(place.astype(np.uint16 if count <= 1 << 16 else np.uint32), kind="stable")
            edge, place = edge[by_vertex], place[by_vertex]
            quarter[edge, place] = self._bisect(rays, edge, place, blocked[directions.edges[edge, 0], place])
            self.changes += edge.size
        return VisibilitySamples(frames, blocked, quarter)

    def _bisect(
        self, rays: Callable[[Any, Any], Any], edge: NDArray, place: NDArray, begin: NDArray[np.bool_]
    ) -> NDArray[np.integer]:
        """In which quarters of edges of receivers visibility changes, if it is ``begin`` at their first nodes."""
        mi = self.mi
        lane, first = (
            mi.UInt32(place.astype(np.uint32)),
            mi.UInt32(self.directions.along_edge(edge, 1).astype(np.uint32)),
        )
        return np.array(bisected(mi, self.geometry, rays, lane, first, mi.Bool(begin)))

    def _close_leaks(self, vertices: NDArray, frames: NDArray, blocked: NDArray[np.bool_]) -> None:
        """Look again, beside them, at the last open directions of receivers that see almost nothing of the sky.

        A ray can slip through where walls meet without sharing vertices; a closed room must be exactly dark all the
        same.
        """
        closed = blocked.view(np.uint8).sum(axis=0, dtype=np.uint32)
        few_open = np.flatnonzero(may_leak(closed, self.directions.size))
        node, which = np.nonzero(~blocked[:, few_open])
        if node.size == 0:
            return
        place = few_open[which]
        rays = self.rays_from(vertices, turned_aside(frames))
        ray = rays(self.mi.UInt32(place.astype(np.uint32)), self.mi.UInt32(node.astype(np.uint32)))
        blocked[node, place] = np.array(self.geometry.ray_test(ray))


def may_leak(closed: Any, nodes: Any) -> Any:
    """Whether so few of the ``nodes`` are open that they may be leaks, by how many are closed (any kind of array)."""
    return closed + _LEAKS >= nodes


def turned_aside(frames: NDArray[np.float64]) -> NDArray[np.float64]:
    """Frames in which the directions lie right beside those in frames (n, 3, 3)."""
    return frames @ turned_frames(np.array([[0.0, 0.0, 1.0]]), np.array([_BESIDE]))[0]


def bisected(mi: Any, geometry: Any, rays: Callable[[Any, Any], Any], place: Any, first: Any, as_at_begin: Any) -> Any:
    """UInt32, in which quarters of edges visibility changes.

    Parameters
    ----------
    mi : Mitsuba
    geometry : Mitsuba scene
    rays : callable
        Gives rays for places of receivers and directions of the set.
    place : UInt32
        Of the receivers.
    first : UInt32
        The directions a quarter along their edges; those of half and three quarters follow.
    as_at_begin : Bool
        Whether the first ends are blocked.
    """
    import drjit as dr

    # Both halvings in one kernel: what the second needs is in registers.
    second_half = geometry.ray_test(rays(place, first + 1)) == as_at_begin
    last_quarter = geometry.ray_test(rays(place, dr.select(second_half, first + 2, first))) == as_at_begin
    return dr.select(second_half, mi.UInt32(2), 0) + dr.select(last_quarter, mi.UInt32(1), 0)
