"""Vertices inside other geometry, whose neighbours outside are seen.

Where a block stands on a floor, a vertex of the floor under the block is rightly dark, but light is interpolated on
triangles: the darkness would show as teeth around the block. Such vertices are filled with the mean of their neighbours
that are outside. As light mappers do, they are told from dark corners by what they see: the backs of surfaces. So are
vertices just behind a surface that an edge of theirs goes through (`slepian_prt.scene.piercing`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from slepian_prt.scene.scene import Scene
from slepian_prt.transport.directions import direction_set
from slepian_prt.transport.hemisphere import HemisphereRays

_NODES = 48
_RAYS_PER_BLOCK = 1 << 19


class InteriorVertices(NamedTuple):
    """Vertices whose values are the means of others.

    Attributes
    ----------
    vertices : (n,)
        Those inside other geometry with neighbours outside.
    weights : sparse (n, V)
        Their means over those neighbours.
    """

    vertices: NDArray[np.int64]
    weights: csr_array

    def fill(self, values: NDArray) -> None:
        """Replace the values, (V, …), of ``vertices``, in place."""
        if self.vertices.size:
            flat = values.reshape(len(values), -1)
            values[self.vertices] = (self.weights @ flat).reshape(-1, *values.shape[1:])


def find_interior(scene: Scene, dark: NDArray) -> InteriorVertices:
    """Which of the vertices ``dark``, that see nothing of the sky, are inside something, and what fills them.

    Hidden vertices (`Scene.is_hidden`) are dark to transport; where nothing is, no ray is traced.
    """
    count = len(scene.receivers)
    if dark.size == 0:
        return InteriorVertices(np.zeros(0, dtype=np.int64), csr_array((0, count), dtype=np.float32))
    inside = np.zeros(count, dtype=bool)
    dark = dark[~scene.is_hidden[dark]]
    inside[dark[sees_backs(scene, dark)]] = True
    pairs = scene.receivers.neighbours
    pairs = np.concatenate([pairs, pairs[:, ::-1]])
    pairs = np.concatenate([pairs[inside[pairs[:, 0]]], scene.pierced])
    inside |= scene.is_hidden
    near, far = pairs[~inside[pairs[:, 1]]].T
    vertices, row = np.unique(near, return_inverse=True)
    weights = csr_array((np.ones(row.size, dtype=np.float32), (row, far)), shape=(vertices.size, count))
    weights.data /= np.repeat(weights.sum(axis=1), np.diff(weights.indptr))
    return InteriorVertices(vertices, weights)


def sees_backs(scene: Scene, vertices: NDArray) -> NDArray[np.bool_]:
    """(n,) True where most of what is around a vertex turns its back to it: where it is inside something."""
    if vertices.size == 0:
        return np.zeros(0, dtype=bool)
    directions = direction_set(_NODES)
    tracer = HemisphereRays(scene, directions, 0)
    result = np.zeros(vertices.size, dtype=bool)
    size = _RAYS_PER_BLOCK // directions.size
    for begin in range(0, vertices.size, size):
        block = vertices[begin : begin + size]
        ray = tracer.rays_from(block, tracer.frames(block))(*tracer.to_nodes(block.size))
        back = scene.meets_dark_back(ray, tracer.geometry.ray_intersect_preliminary(ray))
        result[begin : begin + size] = np.array(back).reshape(block.size, directions.size).mean(axis=1) > 0.5
    return result
