"""Vertices inside other geometry, whose neighbours outside are seen.

Where a block stands on a floor, a vertex of the floor under the block is rightly dark, but light is interpolated on
triangles: the darkness would show as teeth around the block. Such vertices borrow the transfer of their neighbours
that are outside. As light mappers do, they are told from dark corners by what they see: the backs of surfaces.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from slepian_prt.scene.scene import Scene
from slepian_prt.transport.directions import direction_set
from slepian_prt.transport.visibility import HemisphereRays

_NODES = 48
_RAYS_PER_BLOCK = 1 << 19


class Borrowed(NamedTuple):
    """Vertices whose values are those of others.

    Attributes
    ----------
    rows : (n,)
        Vertices inside other geometry with neighbours outside.
    weights : sparse (n, V)
        Their means over those neighbours.
    """

    rows: NDArray[np.int64]
    weights: csr_array

    def fill(self, values: NDArray) -> None:
        """Replace the values, (V, …), of ``rows``, in place."""
        if self.rows.size:
            flat = values.reshape(len(values), -1)
            values[self.rows] = (self.weights @ flat).reshape(-1, *values.shape[1:])


def borrow(scene: Scene, dark: NDArray) -> Borrowed:
    """Which of the vertices ``dark``, that see nothing of the sky, are inside something, and what they borrow from."""
    count = len(scene.mesh.positions)
    inside = np.zeros(count, dtype=bool)
    inside[dark[_sees_backs(scene, dark)]] = True
    faces = scene.mesh.faces
    a, b = (np.concatenate([faces[:, i] for i in order]) for order in ((0, 1, 2), (1, 2, 0)))
    a, b = np.concatenate([a, b]), np.concatenate([b, a])
    chosen = inside[a] & ~inside[b]
    rows, number = np.unique(a[chosen], return_inverse=True)
    weights = csr_array((np.ones(number.size, dtype=np.float32), (number, b[chosen])), shape=(rows.size, count))
    weights.data /= np.repeat(weights.sum(axis=1), np.diff(weights.indptr))
    return Borrowed(rows.astype(np.int64), weights)


def _sees_backs(scene: Scene, vertices: NDArray) -> NDArray[np.bool_]:
    """(n,) True where most of what is around a vertex turns its back to it."""
    mi = scene.mi
    import drjit as dr

    if vertices.size == 0:
        return np.zeros(0, dtype=bool)
    net = direction_set(_NODES)
    tracer = HemisphereRays(scene, net, 0)
    found = []
    block = _RAYS_PER_BLOCK // net.size
    for begin in range(0, vertices.size, block):
        chosen = vertices[begin : begin + block]
        place, direction = tracer.to_nodes(chosen.size)
        ray = tracer.start(chosen, tracer.frames(chosen))(place, direction)
        met = tracer.geometry.ray_intersect(ray, mi.RayFlags.Minimal, True)
        back = met.is_valid() & (dr.dot(met.n, ray.d) > 0.0)
        found.append(np.array(back).reshape(chosen.size, net.size).mean(axis=1) > 0.5)
    return np.concatenate(found)
