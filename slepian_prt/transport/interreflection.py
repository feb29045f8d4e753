"""Light that surfaces reflect onto each other, as a sparse operator over the vertices.

Rays from each vertex gather what the surfaces they meet reflect: T_{b+1} = R diag(ρ) T_b, where row x of R holds, for
each blocked direction, the barycentric weights of the point it meets. Every bounce costs a sparse product; summed to
convergence they are the Neumann series (1 - R diag(ρ))⁻¹ T_0.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from slepian_prt.scene.receivers import morton
from slepian_prt.scene.scene import Scene
from slepian_prt.transport.directions import DirectionSet, direction_set
from slepian_prt.transport.visibility import HemisphereRays

_RAYS_PER_BLOCK = 1 << 20
# What all bounces that are left out may add, relative to the mean radiance.
_REMAINDER = 1e-3
_MOST_BOUNCES = 1000
# Columns of the transfer vectors that are bounced together: bounds the memory beside the result.
_COLUMNS = 16

# Indirect light varies slowly: it is gathered with this part of the rays that visibility gets.
GATHER_SHARE = 0.25


@dataclass(frozen=True)
class Gather:
    """The operator R without the albedo of what reflects.

    Attributes
    ----------
    rows : (n,)
        Vertices that see surfaces; all others gather nothing.
    weights : sparse (n, V)
        How much of the hemisphere of each of ``rows``, cosine-weighted, shows what vertex.
    backs : float
        Mean part of the hemisphere that shows the back of a receiver, on which no light is known.
    others : float
        Mean part that shows shapes which only cast shadows.
    rays : int
    """

    rows: NDArray[np.int64]
    weights: csr_array
    backs: float
    others: float
    rays: int

    def reflected(self, albedo: NDArray, values: NDArray) -> NDArray[np.float32]:
        """(V, k) light received from surfaces of one channel's ``albedo`` (V,) that shine by ``values`` (V, k)."""
        result = np.zeros_like(values)
        result[self.rows] = self.weights @ (albedo[:, None] * values)
        return result


def gather_operator(
    scene: Scene,
    nodes: int,
    vertices: NDArray,
    blocked: NDArray | None,
    seed: int,
    advance: Callable[[int], None] = lambda _: None,
) -> Gather:
    """Trace what each of ``vertices`` sees of the other surfaces.

    Parameters
    ----------
    nodes : int
        Rays per vertex.
    vertices : (n,) indices
    blocked : (V,) or None
        Blocked part of each hemisphere, where it is known better than these few rays tell; rows are scaled to it.
    seed, advance : as in `shadowed_transfer`
    """
    tracer = _Gatherer(scene, direction_set(nodes), seed)
    block = max(1, _RAYS_PER_BLOCK // tracer.net.size)
    vertices = vertices[np.argsort(morton(scene.traced_positions[vertices]), kind="stable")]
    parts: list[csr_array] = []
    backs = others = 0.0
    for begin in range(0, vertices.size, block):
        chosen = vertices[begin : begin + block]
        weights, back, other = tracer.gather(chosen, None if blocked is None else blocked[chosen])
        parts.append(weights)
        backs, others = backs + back, others + other
        advance(chosen.size)
    joined = _stacked(parts, len(scene.mesh.positions))
    return Gather(vertices, joined, backs / vertices.size, others / vertices.size, tracer.rays)


def bounced(
    gather: Gather,
    albedo: NDArray,
    direct: NDArray,
    channels: int,
    bounces: int,
    advance: Callable[[int], None] = lambda _: None,
) -> NDArray[np.float32]:
    """Transfer vectors with the light of ``bounces`` bounces between surfaces added.

    Parameters
    ----------
    gather : Gather
    albedo : (V, 3)
    direct : (V, M) float32
        Direct transfer for unit albedo. With one channel its memory becomes the result's.
    channels : 1 (their mean stands for all) or 3
    bounces : int
    advance : callable
        Told the number of columns finished since its last call.

    Returns
    -------
    (V, channels, M) float32
    """
    # Columns do not depend on each other, so that one channel can be worked on where it is.
    total = direct[:, None, :] if channels == 1 else np.empty((len(direct), 3, direct.shape[1]), dtype=np.float32)

    def bounce(piece: tuple[int, slice]) -> int:
        channel, columns = piece
        reflectance = (albedo.mean(axis=1) if channels == 1 else albedo[:, channel]).astype(np.float32)
        light = np.ascontiguousarray(direct[:, columns])
        collected = light.copy()
        for _ in range(bounces):
            light = gather.reflected(reflectance, light)
            collected += light
        total[:, channel, columns] = collected
        return collected.shape[1]

    size = direct.shape[1]
    pieces = [
        (c, slice(begin, min(begin + _COLUMNS, size))) for c in range(channels) for begin in range(0, size, _COLUMNS)
    ]
    with ThreadPoolExecutor(os.cpu_count()) as pool:  # scipy's sparse product lets go of the interpreter
        for done in pool.map(bounce, pieces):
            advance(done)
    return total


def count_bounces(gather: Gather, albedo: NDArray, ambient: NDArray) -> tuple[int, float]:
    """Bounces after which what is left is less than a thousandth of the mean radiance, under any light.

    Light is never negative, so a constant environment bounds all others of the same peak: it alone is followed here.

    Parameters
    ----------
    gather : Gather
    albedo : (V, 3)
    ambient : (V,) direct part of a constant environment's light

    Returns
    -------
    The number of bounces, and the largest radiance that they leave out.
    """
    reflectance = albedo.max(axis=1).astype(np.float32)
    light = ambient.astype(np.float32)[:, None]
    collected, last = float(light.mean()), float(light.max(initial=0.0))
    left = 0.0
    for count in range(1, _MOST_BOUNCES + 1):
        light = gather.reflected(reflectance, light)
        largest = float(light.max(initial=0.0))
        if largest == 0.0:
            return count - 1, 0.0
        collected += float(light.mean())
        # The ratio of successive maxima tends to the spectral radius; the rest is a geometric series.
        ratio = min(largest / last, 1.0 - 1e-6)
        left = largest * ratio / (1.0 - ratio)
        if left <= _REMAINDER * collected:
            return count, left
        last = largest
    return _MOST_BOUNCES, left


def _stacked(parts: list[csr_array], columns: int) -> csr_array:
    """The parts below each other; empties the list, because there is not room for everything twice."""
    starts = np.concatenate([[0], np.cumsum(np.concatenate([np.diff(part.indptr) for part in parts]))])
    wide = starts[-1] > np.iinfo(np.int32).max
    indices = np.empty(starts[-1], dtype=np.int64 if wide else np.int32)
    data = np.empty(starts[-1], dtype=np.float32)
    first = 0
    while parts:
        part = parts.pop(0)
        indices[first : first + part.nnz], data[first : first + part.nnz] = part.indices, part.data
        first += part.nnz
    return csr_array((data, indices, starts.astype(indices.dtype)), shape=(starts.size - 1, columns))


class _Gatherer(HemisphereRays):
    """Closest hits along the nodes of a net, as weights of the vertices that they lie between."""

    def __init__(self, scene: Scene, net: DirectionSet, seed: int) -> None:
        mi = scene.mi
        import drjit as dr

        super().__init__(scene, net, seed)
        self._faces = scene.faces
        corners = scene.traced_positions[scene.faces]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        self._face_normals = mi.Vector3f(normals.T.astype(np.float32))
        # The first face of each receiver by Dr.Jit's number of the shape; -1 for what only casts shadows.
        numbers = [int(np.array(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(shape)))[0]) for shape in scene.shapes]
        first = np.full(max(numbers) + 1, -1, dtype=np.int32)
        for number, face in zip(numbers, scene.first_faces, strict=False):
            first[number] = face
        self._first_face = mi.Int32(first)

    def gather(self, vertices: NDArray, blocked: NDArray | None) -> tuple[csr_array, float, float]:
        """Weights (n, V) for a block of vertices, and the sums of what shows backs and what shows occluders."""
        import drjit as dr

        mi, net, count = self.mi, self.net, len(vertices)
        place, direction = self.to_nodes(count)
        ray = self.start(vertices, self.frames(vertices))(place, direction)
        met = self.geometry.ray_intersect_preliminary(ray)
        valid = met.is_valid()
        number: Any = dr.reinterpret_array(mi.UInt32, met.shape)
        first = dr.gather(mi.Int32, self._first_face, number, valid)
        receives = valid & (first >= 0)
        face = mi.UInt32(first) + met.prim_index
        front = receives & (dr.dot(dr.gather(mi.Vector3f, self._face_normals, face, receives), ray.d) < 0.0)
        u, v = met.prim_uv
        dr.eval(valid, receives, front, face, u, v)
        weight = np.tile(net.weights.astype(np.float32), count)
        hit, known, shown = (np.array(mask) for mask in (valid, receives, front))
        back, other = float(weight[known & ~shown].sum()), float(weight[hit & ~known].sum())
        scale = np.ones(count, dtype=np.float32)
        if blocked is not None:
            seen = np.add.reduceat(np.where(hit, weight, 0.0), np.arange(0, hit.size, net.size))
            scale = np.where(seen > 0.0, blocked / np.maximum(seen, 1e-9), 1.0).astype(np.float32)
        lane = np.flatnonzero(shown)
        row = lane // net.size
        share = weight[lane] * scale[row]
        second, third = np.array(u)[lane], np.array(v)[lane]
        values = np.stack([share * (1.0 - second - third), share * second, share * third], axis=1)
        corner = self._faces[np.array(face)[lane]]
        size = len(self._normals)
        weights = csr_array((values.ravel(), (np.repeat(row, 3).astype(np.int32), corner.ravel())), shape=(count, size))
        return weights, back, other
