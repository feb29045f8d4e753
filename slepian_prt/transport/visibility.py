"""Direct shadowed diffuse transport.

t_lm(x) = (1/π) ∫ V(x,ω) (n·ω)₊ y_lm(ω) dω  =  A_l y_lm(n) - (1/π) ∫ (1 - V) (n·ω)₊ y_lm dω

The first part is exact; rays measure only what is blocked. All vertices share one net of directions in their own
frames, each turned by its own angle about the normal so that the error does not band. Where the ends of an edge of
the net disagree, visibility is bisected along it (`directions`). What a vertex then is the sum of are rows of tables,
one matrix product and one sparse product per block of vertices, followed by a rotation of each vector into the world.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.spatial import ConvexHull, QhullError
from threadpoolctl import threadpool_limits

from slepian_prt.scene.receivers import morton
from slepian_prt.scene.scene import Scene
from slepian_prt.slepian.kernels import cosine_lobe, zonal_vectors
from slepian_prt.sphere.harmonics import degrees, num_coefficients
from slepian_prt.sphere.rotation import rotate_sh, rotation_to
from slepian_prt.transport.directions import QUARTERS, SMALLEST_SET, DirectionSet, direction_set

# Rays in flight at a time: enough to fill the cores, little enough to stay in memory beside the mesh.
_RAYS_PER_BLOCK = 1 << 20

# Products of normals and corners of the hull at a time.
_PRODUCTS = 1 << 22

# Numbers in the transfer vectors of a block, and vertices if they have no shadows.
_NUMBERS_PER_BLOCK = 1 << 22
_UNOCCLUDED_PER_BLOCK = 8192

# Open directions of a vertex that are few enough to be leaks, and how far beside them to look again, in radians.
_LEAKS = 3
_BESIDE = 1e-3

# The constant harmonic's coefficient times this is the part of the hemisphere.
_MEAN = np.float32(math.sqrt(4.0 * math.pi))

# Blocks that may wait to be projected.
_BLOCKS_WAITING = 3

Progress = Callable[[int], None]
Deliver = Callable[[int, NDArray, NDArray, NDArray, int], None]
Found = TypeVar("Found")


def unoccluded_transfer(bandlimit: int, normals: NDArray) -> NDArray[np.float32]:
    """A_l y_lm(n), shape (V, (L+1)²); zero where the normal is zero."""
    return zonal_vectors(cosine_lobe(bandlimit), normals)


def shadowed_vertices(scene: Scene) -> NDArray[np.bool_]:
    """(V,) True where something may block light: a part of the scene reaches above the vertex's tangent plane.

    Exact (supporting planes of the convex hull of everything), so a convex scene traces no ray.
    """
    positions, normals = scene.traced_positions, scene.mesh.normals
    corners = _hull_corners(scene)
    heights = np.empty(len(positions))
    size = max(1, _PRODUCTS // len(corners))
    for begin in range(0, len(positions), size):
        block = slice(begin, begin + size)
        reach = (normals[block] @ corners.T).max(axis=1)
        heights[block] = reach - np.einsum("ij,ij->i", normals[block], positions[block])
    # A vertex normal of a convex mesh is the mean over its faces; half the ray offset is far below what a ray sees.
    return scene.mesh.receivers.active & (heights > 0.5 * scene.ray_offsets)


def _hull_corners(scene: Scene) -> NDArray[np.float64]:
    """Vertices of the convex hull of the receivers, and the boxes of what else is there."""
    points = scene.traced_positions[scene.mesh.receivers.active]
    for shape in scene.occluders:
        box = shape.bbox()
        low, high = np.array(box.min, dtype=np.float64), np.array(box.max, dtype=np.float64)
        corners = [[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])]
        points = np.concatenate([points, corners])
    try:
        return points[ConvexHull(points).vertices]
    except QhullError:
        return points  # flat or smaller: every point may count


class DirectTransfer:
    """Direct, shadowed, diffuse transfer of unit albedo, block by block.

    Parameters
    ----------
    scene : Scene
    bandlimit : int
    nodes : int
        Directions that every traced vertex looks in; see `nodes_for`.
    shadowed : indices of the vertices to trace; the others are taken to see all of their hemisphere
    seed : int
        Of the turns about the normals. The same seed gives the same bits.
    """

    def __init__(self, scene: Scene, bandlimit: int, nodes: int, shadowed: NDArray, seed: int) -> None:
        self.bandlimit = bandlimit
        self._made_of = (nodes, shadowed)
        self._scene = scene
        self._traced = np.zeros(len(scene.mesh.positions), dtype=bool)
        self._traced[shadowed] = True
        self._block = max(1, min(_RAYS_PER_BLOCK // nodes, _NUMBERS_PER_BLOCK // num_coefficients(bandlimit)))
        self._tracer = VisibilityTracer(scene, bandlimit, direction_set(nodes), seed) if shadowed.size else None

    def other(self, seed: int, bandlimit: int) -> DirectTransfer:
        """The same with other turns about the normals, so that its errors are independent, and another bandlimit."""
        nodes, shadowed = self._made_of
        return DirectTransfer(self._scene, bandlimit, nodes, shadowed, seed)

    @property
    def rays(self) -> int:
        """Number traced so far."""
        return 0 if self._tracer is None else self._tracer.rays

    @property
    def blocks(self) -> list[NDArray[np.int64]]:
        """All vertices, in pieces of about as many rays; neighbours in space share the tracer's caches."""
        order = np.argsort(morton(self._scene.traced_positions), kind="stable")
        work = np.cumsum(np.where(self._traced[order], 1.0 / self._block, 1.0 / _UNOCCLUDED_PER_BLOCK))
        cuts = np.searchsorted(work, np.arange(1, int(work[-1]) + 1), side="right")
        return [block for block in np.split(order, cuts) if block.size]

    def of(self, vertices: NDArray) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Transfer vectors (n, (L+1)²) and blocked parts (n,) of any vertices."""
        vectors = np.empty((vertices.size, num_coefficients(self.bandlimit)), dtype=np.float32)
        blocked = np.empty(vertices.size, dtype=np.float32)
        starts = range(0, vertices.size, self._block)
        places = {begin: slice(begin, begin + self._block) for begin in starts}

        def deliver(number: int, _: NDArray, found: NDArray, parts: NDArray, _rays: int) -> None:
            place = places[number * self._block]
            vectors[place], blocked[place] = found, parts

        self.run([vertices[place] for place in places.values()], deliver)
        return vectors, blocked

    def run(self, blocks: Sequence[NDArray], deliver: Deliver, advance: Progress = lambda _: None) -> None:
        """Compute block after block.

        Parameters
        ----------
        blocks : sequence of vertex indices
        deliver : callable
            Given (number of the block, its vertices, their transfer vectors, the blocked part of each hemisphere, rays
            traced), in order, in another thread.
        advance : callable
            Told the number of vertices finished since its last call.
        """

        def look(vertices: NDArray) -> tuple[Seen | None, int]:
            before, traced = self.rays, vertices[self._traced[vertices]]
            seen = self._tracer.look(traced) if self._tracer is not None and traced.size else None
            return seen, self.rays - before

        def project(number: int, vertices: NDArray, found: tuple[Seen | None, int]) -> None:
            seen, rays = found
            vectors = unoccluded_transfer(self.bandlimit, self._scene.mesh.normals[vertices])
            blocked = np.zeros(vertices.size, dtype=np.float32)
            if self._tracer is not None and seen is not None:
                traced = np.flatnonzero(self._traced[vertices])
                lost, closed = self._tracer.blocked(seen)
                vectors[traced] -= lost
                vectors[traced[closed]] = 0.0  # exactly, where nothing is seen but surfaces
                blocked[traced] = np.where(closed, 1.0, lost[:, 0] * _MEAN)
            deliver(number, vertices, vectors, blocked, rays)

        in_blocks(blocks, look, project, advance)


def shadowed_transfer(
    scene: Scene,
    bandlimit: int,
    nodes: int,
    vertices: NDArray,
    seed: int,
    advance: Progress = lambda _: None,
) -> tuple[NDArray[np.float32], NDArray[np.float32], int]:
    """Direct transfer of all vertices at once; parameters as of `DirectTransfer`.

    Returns
    -------
    (V, (L+1)²) float32 transfer vectors, (V,) float32 cosine-weighted blocked part of each hemisphere, and the
    number of rays traced.
    """
    source = DirectTransfer(scene, bandlimit, nodes, vertices, seed)
    vectors = np.empty((len(scene.mesh.positions), num_coefficients(bandlimit)), dtype=np.float32)
    blocked = np.empty(len(vectors), dtype=np.float32)

    def deliver(_: int, chosen: NDArray, found: NDArray, parts: NDArray, _rays: int) -> None:
        vectors[chosen], blocked[chosen] = found, parts

    source.run(source.blocks, deliver, advance)
    return vectors, blocked, source.rays


def in_blocks(
    blocks: Sequence[NDArray],
    trace: Callable[[NDArray], Found],
    project: Callable[[int, NDArray, Found], None],
    advance: Progress,
) -> None:
    """Trace block after block of vertices and project what was found, each block while the next is traced.

    BLAS gets one thread meanwhile, because those that it keeps spinning after a product would take the cores from the
    tracer: that alone cost a quarter of the time.
    """
    with threadpool_limits(1, "blas"), ThreadPoolExecutor(1) as worker:
        pending: deque[Future[None]] = deque()
        for number, chosen in enumerate(blocks):
            pending.append(worker.submit(project, number, chosen, trace(chosen)))
            if len(pending) > _BLOCKS_WAITING:
                pending.popleft().result()
            advance(chosen.size)
        for last in pending:
            last.result()


def turned_frames(axes: NDArray, turns: NDArray) -> NDArray[np.float64]:
    """(n, 3, 3) rotations that take z to each axis, after a turn about z by the angles given."""
    frames = rotation_to(axes)
    c, s = np.cos(turns)[:, None], np.sin(turns)[:, None]
    x, y = frames[:, :, 0].copy(), frames[:, :, 1].copy()
    frames[:, :, 0], frames[:, :, 1] = c * x + s * y, c * y - s * x
    return frames


def nodes_for(samples: float, changes: float) -> int:
    """Size of the net with which a vertex gets ``samples`` rays on average.

    ``changes`` is the number of edges along which visibility changes, measured on a net, over the root of its size:
    the boundary of visibility is a curve. Each costs two rays.
    """
    root = -changes + math.sqrt(changes * changes + samples)
    return max(SMALLEST_SET, int(root * root))


class HemisphereRays:
    """Rays from vertices along the directions of a net, each vertex in its own frame.

    Attributes
    ----------
    rays : int
        Number traced so far.
    """

    def __init__(self, scene: Scene, net: DirectionSet, seed: int) -> None:
        mi = scene.mi
        self.mi, self.net, self.rays = mi, net, 0
        self.geometry = scene.geometry
        self._normals = scene.mesh.normals
        self._origins = scene.ray_origins
        self._turns = np.random.default_rng(seed).random(len(self._normals)) * 2.0 * math.pi
        self._directions = mi.Vector3f(net.directions.T.astype(np.float32))

    def frames(self, vertices: NDArray) -> NDArray[np.float64]:
        """(n, 3, 3) rotations that take z to the normal, after a turn about z."""
        return turned_frames(self._normals[vertices], self._turns[vertices])

    def start(self, vertices: NDArray, frames: NDArray) -> Callable[[Any, Any], Any]:
        """Upload a block of vertices; returns what makes Mitsuba rays of (place in the block, direction of the net)."""
        import drjit as dr

        mi = self.mi
        origin = mi.Point3f(self._origins[vertices].T.astype(np.float32))
        x, y, z = (mi.Vector3f(frames[:, :, axis].T.astype(np.float32)) for axis in range(3))

        def rays(place: Any, direction: Any) -> Any:
            self.rays += dr.width(place)
            local = dr.gather(mi.Vector3f, self._directions, direction)
            towards = (
                dr.gather(mi.Vector3f, x, place) * local.x
                + dr.gather(mi.Vector3f, y, place) * local.y
                + dr.gather(mi.Vector3f, z, place) * local.z
            )
            return mi.Ray3f(dr.gather(mi.Point3f, origin, place), towards)

        return rays

    def to_nodes(self, count: int) -> tuple[Any, Any]:
        """Places and directions of all nodes for a block of ``count`` vertices, those of one vertex side by side."""
        import drjit as dr

        size = dr.opaque(self.mi.UInt32, self.net.size)
        lane = dr.arange(self.mi.UInt32, count * self.net.size)
        place = lane // size
        return place, lane - place * size


class Seen(NamedTuple):
    """What a block of n vertices sees.

    Nodes and edges of the net come first so that picking the same one for all vertices copies contiguous memory.

    Attributes
    ----------
    frames : (n, 3, 3)
    hit : (nodes, n)
        True where a node is blocked.
    quarter : (edges, n)
        In which quarter of an edge visibility changes, where it does.
    """

    frames: NDArray[np.float64]
    hit: NDArray[np.bool_]
    quarter: NDArray[np.uint8]


class VisibilityTracer(HemisphereRays):
    """What is blocked, by adaptive visibility: nodes of the net, then bisection where they disagree."""

    def __init__(self, scene: Scene, bandlimit: int, net: DirectionSet, seed: int) -> None:
        super().__init__(scene, net, seed)
        self.node_table, self.corner_table = net.tables(bandlimit)
        self.changes = 0  # edges along which visibility changed, so far
        sides, corners = net.triangle_edges, net.triangles
        # For corner k of triangle t, at 3 t + k: its edges to corners k + 1 and k + 2, and whether they run towards it.
        self._edge = [sides.ravel(), np.roll(sides, 1, axis=1).ravel()]
        self._towards = [net.edges[edge, 0] != corners.ravel() for edge in self._edge]

    def blocked(self, seen: Seen) -> tuple[NDArray[np.floating], NDArray[np.bool_]]:
        """(1/π) ∫ (1 - V) (n·ω)₊ y_lm dω of what was seen, (n, (L+1)²) in the world frame.

        Also (n,) True where every node is blocked.
        """
        return rotate_sh(self._projected(seen), seen.frames), np.all(seen.hit, axis=0)

    def surveyed(self, seen: Seen) -> tuple[NDArray[np.floating], float, NDArray[np.float64]]:
        """Blocked part of each hemisphere, (n,), and over all vertices the energy of transfer in all degrees, and in
        each that the tables reach: ∫ (V (n·ω)₊ / π)² dω and Σ_m t_lm². The tables must reach degree 1."""
        lost = self._projected(seen)
        kept = (self.node_table.sum(axis=0) - lost).astype(np.float64)
        # t_10 in the vertex's frame is (1/π) ∫ V (n·ω)₊² dω times the √(3/4π) of y_10.
        energy = float(kept[:, 2].sum()) / math.sqrt(3.0 / (4.0 * math.pi)) / math.pi
        bandlimit = math.isqrt(kept.shape[1]) - 1
        by_degree = np.bincount(degrees(bandlimit), np.sum(kept**2, axis=0)).astype(np.float64)
        return lost[:, 0] * float(_MEAN), energy, by_degree

    def look(self, vertices: NDArray) -> Seen:
        """Trace from the given vertices."""
        mi, net, count = self.mi, self.net, len(vertices)
        frames = self.frames(vertices)
        rays = self.start(vertices, frames)

        def test(place: Any, direction: Any) -> NDArray[np.bool_]:
            return np.array(self.geometry.ray_test(rays(place, direction)))

        hit = np.ascontiguousarray(test(*self.to_nodes(count)).reshape(count, net.size).T)
        self._close_leaks(vertices, frames, hit)
        quarter = np.zeros((len(net.edges), count), dtype=np.uint8)
        changed = np.flatnonzero(hit[net.edges[:, 0]] != hit[net.edges[:, 1]])
        if changed.size:
            edge, place = np.divmod(changed, count)
            by_vertex = np.argsort(place.astype(np.uint16 if count <= 1 << 16 else np.uint32), kind="stable")
            edge, place = edge[by_vertex], place[by_vertex]
            begin, lane = hit[net.edges[edge, 0], place], mi.UInt32(place.astype(np.uint32))
            second_half = test(lane, mi.UInt32(net.along_edge(edge, 2).astype(np.uint32))) == begin
            next_point = net.along_edge(edge, np.where(second_half, 3, 1))
            last_quarter = test(lane, mi.UInt32(next_point.astype(np.uint32))) == begin
            quarter[edge, place] = 2 * second_half + last_quarter
            self.changes += edge.size
        return Seen(frames, hit, quarter)

    def _close_leaks(self, vertices: NDArray, frames: NDArray, hit: NDArray[np.bool_]) -> None:
        """Look again, beside them, at the last open directions of vertices that see almost nothing of the sky.

        A ray can slip through where walls meet without sharing vertices; a closed room must be exactly dark all the
        same.
        """
        few_open = np.flatnonzero(self.net.size - hit.sum(axis=0) <= _LEAKS)
        node, which = np.nonzero(~hit[:, few_open])
        if node.size == 0:
            return
        place = few_open[which]
        rays = self.start(vertices, frames @ turned_frames(np.array([[0.0, 0.0, 1.0]]), np.array([_BESIDE]))[0])
        lane = self.mi.UInt32(place.astype(np.uint32))
        ray = rays(lane, self.mi.UInt32(node.astype(np.uint32)))
        hit[node, place] = np.array(self.geometry.ray_test(ray))

    def _projected(self, seen: Seen) -> NDArray[np.float32]:
        """What was seen as spherical harmonics in the vertices' frames."""
        local = seen.hit.T.astype(np.float32) @ self.node_table
        local += self._cut_triangles(seen.hit, seen.quarter) @ self.corner_table
        return local

    def _cut_triangles(self, hit: NDArray[np.bool_], quarter: NDArray[np.uint8]) -> csr_array:
        """Rows of the corner table that each vertex adds or subtracts: (n, 48 T), entries 1 and -1."""
        a, b, c = (hit[self.net.triangles[:, k]] for k in range(3))
        triangle, place = np.divmod(np.flatnonzero((a != b) | (b != c)), hit.shape[1])
        a, b, c = a[triangle, place], b[triangle, place], c[triangle, place]
        lone = np.where(b == c, 0, np.where(a == c, 1, 2))  # the corner that disagrees with the other two
        corner = 3 * triangle + lone
        row = corner
        for edge, towards in zip(self._edge, self._towards, strict=True):
            # Quarters count from the edge's first node; here from the corner.
            counted = quarter[edge[corner], place] ^ np.where(towards[corner], QUARTERS - 1, 0)
            row = row * QUARTERS + counted
        lone_is_blocked = np.where(lone == 0, a, np.where(lone == 1, b, c))
        sign = np.where(lone_is_blocked, np.float32(1.0), np.float32(-1.0))
        return csr_array((sign, (place, row)), shape=(hit.shape[1], len(self.corner_table)))
