"""Direct shadowed diffuse transport.

t_lm(x) = (1/π) ∫ V(x,ω) (n·ω)₊ y_lm(ω) dω  =  A_l y_lm(n) - (1/π) ∫ (1 - V) (n·ω)₊ y_lm dω

The first part is exact; rays measure only what is blocked. All vertices share one cosine-distributed direction set
in their own frames, each turned by its own angle about the normal, so the projection on spherical harmonics is one
matrix product per block of vertices, followed by a rotation of each short vector into the world.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from slepian_prt.scene.meshes import morton
from slepian_prt.scene.scenes import RAY_OFFSET, Scene, mitsuba_scene
from slepian_prt.slepian.kernels import cosine_lobe
from slepian_prt.sphere.harmonics import degrees, num_coefficients, real_sh
from slepian_prt.sphere.quadrature import hemisphere_fibonacci
from slepian_prt.sphere.rotation import rotate_sh, rotation_to

# Rays in flight at a time: enough to fill the cores, little enough to stay in memory beside the mesh.
_RAYS_PER_BLOCK = 1 << 21

Progress = Callable[[int], None]


def unoccluded_transfer(bandlimit: int, normals: NDArray) -> NDArray[np.float32]:
    """A_l y_lm(n), shape (V, (L+1)²); zero where the normal is zero."""
    vectors = np.zeros((len(normals), num_coefficients(bandlimit)), dtype=np.float32)
    lit = np.any(normals != 0.0, axis=1)
    if lit.any():
        vectors[lit] = real_sh(bandlimit, normals[lit]) * cosine_lobe(bandlimit)[degrees(bandlimit)]
    return vectors


def shadowed_vertices(scene: Scene) -> NDArray[np.bool_]:
    """(V,) True where something may block light: a part of the scene reaches above the vertex's tangent plane.

    Exact (supporting planes of the convex hull of everything), so a convex scene traces no ray.
    """
    positions, normals = scene.traced_positions, scene.mesh.normals
    corners = _hull_corners(scene)
    diagonal = float(np.linalg.norm(np.ptp(corners, axis=0)))
    heights = np.empty(len(positions))
    for begin in range(0, len(positions), 4096):
        block = slice(begin, begin + 4096)
        reach = (normals[block] @ corners.T).max(axis=1)
        heights[block] = reach - np.einsum("ij,ij->i", normals[block], positions[block])
    # A vertex normal of a convex mesh is the mean over its faces; half the ray offset is far below what a ray sees.
    return scene.mesh.receivers & (heights > 0.5 * RAY_OFFSET * diagonal)


def _hull_corners(scene: Scene) -> NDArray[np.float64]:
    """Vertices of the convex hull of the receivers, and the boxes of what else is there."""
    points = scene.traced_positions[scene.mesh.receivers]
    for shape in scene.shapes[len(scene.parts) :]:
        box = shape.bbox()
        low, high = np.array(box.min, dtype=np.float64), np.array(box.max, dtype=np.float64)
        corners = [[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])]
        points = np.concatenate([points, corners])
    try:
        return points[ConvexHull(points).vertices]
    except QhullError:
        return points  # flat or smaller: every point may count


def shadowed_transfer(
    mi: Any, scene: Scene, bandlimit: int, samples: int, seed: int, advance: Progress = lambda _: None
) -> tuple[NDArray[np.float32], int]:
    """Transfer vectors of all vertices for direct, shadowed, diffuse light of unit albedo.

    Parameters
    ----------
    mi : Mitsuba, as yielded by `open_scene`
    scene : Scene
    bandlimit : int
    samples : int
        Rays per vertex, over the hemisphere.
    seed : int
        Of the turns about the normals. The same seed gives the same bits.
    advance : callable
        Told the number of vertices finished since its last call.

    Returns
    -------
    (V, (L+1)²) float32, and the number of rays traced.
    """
    vectors = unoccluded_transfer(bandlimit, scene.mesh.normals)
    todo = np.flatnonzero(shadowed_vertices(scene))
    advance(len(vectors) - todo.size)
    if todo.size == 0:
        return vectors, 0
    tracer = _Tracer(mi, scene, bandlimit, samples, seed)
    block = max(1, _RAYS_PER_BLOCK // samples)
    # Neighbours in space share the tracer's caches.
    todo = todo[np.argsort(morton(scene.traced_positions[todo]), kind="stable")]
    for begin in range(0, todo.size, block):
        chosen = todo[begin : begin + block]
        vectors[chosen] -= tracer.blocked(chosen)
        advance(chosen.size)
    return vectors, int(todo.size) * samples


def blocked_fraction(mi: Any, scene: Scene, vertices: NDArray, samples: int, seed: int) -> NDArray[np.float64]:
    """Cosine-weighted part of the hemisphere that is blocked at each of the given vertices, (n,)."""
    tracer = _Tracer(mi, scene, 0, samples, seed)
    return tracer.blocked(vertices)[:, 0].astype(np.float64) * math.sqrt(4.0 * math.pi)


class _Tracer:
    """Everything that blocks of vertices share: the scene in Mitsuba, the direction set and its harmonics."""

    def __init__(self, mi: Any, scene: Scene, bandlimit: int, samples: int, seed: int) -> None:
        self.mi = mi
        self.geometry = mitsuba_scene(mi, scene)
        low, high = scene.traced_bounds
        self.offset = RAY_OFFSET * float(np.linalg.norm(high - low))
        self.positions, self.normals = scene.traced_positions, scene.mesh.normals
        self.samples = samples
        directions = hemisphere_fibonacci(samples)
        # Rays that are traced together should run together: a fifth more rays per second than along the spiral.
        directions = directions[np.argsort(morton(directions * [1.0, 1.0, 0.0]), kind="stable")]
        self.directions = mi.Vector3f(directions.T.astype(np.float32))
        self.table = np.ascontiguousarray(real_sh(bandlimit, directions) / samples, dtype=np.float32)
        turns = np.random.default_rng(seed).random(len(self.positions)) * 2.0 * math.pi
        self.turns = turns

    def blocked(self, vertices: NDArray) -> NDArray[np.float32]:
        """(1/π) ∫ (1 - V) (n·ω)₊ y_lm dω at the given vertices, in the world frame."""
        frames = self._frames(vertices)
        hit = self._trace(vertices, frames).reshape(vertices.size, self.samples)
        return rotate_sh(hit.astype(np.float32) @ self.table, frames).astype(np.float32)

    def _frames(self, vertices: NDArray) -> NDArray[np.float64]:
        """(n, 3, 3) rotations that take z to the normal, after a turn about z."""
        frames = rotation_to(self.normals[vertices])
        c, s = np.cos(self.turns[vertices])[:, None], np.sin(self.turns[vertices])[:, None]
        x, y = frames[:, :, 0].copy(), frames[:, :, 1].copy()
        frames[:, :, 0], frames[:, :, 1] = c * x + s * y, c * y - s * x
        return frames

    def _trace(self, vertices: NDArray, frames: NDArray) -> NDArray[np.bool_]:
        """(n samples,) True where a ray is blocked; the directions of one vertex are next to each other."""
        import drjit as dr

        mi = self.mi
        origins = self.positions[vertices] + self.offset * self.normals[vertices]
        origin = mi.Point3f(origins.T.astype(np.float32))
        s, t, n = (mi.Vector3f(frames[:, :, axis].T.astype(np.float32)) for axis in range(3))
        lane = dr.arange(mi.UInt32, vertices.size * self.samples)
        vertex = lane // dr.opaque(mi.UInt32, self.samples)
        local = dr.gather(mi.Vector3f, self.directions, lane - vertex * dr.opaque(mi.UInt32, self.samples))
        direction = (
            dr.gather(mi.Vector3f, s, vertex) * local.x
            + dr.gather(mi.Vector3f, t, vertex) * local.y
            + dr.gather(mi.Vector3f, n, vertex) * local.z
        )
        return np.array(self.geometry.ray_test(mi.Ray3f(dr.gather(mi.Point3f, origin, vertex), direction)))
