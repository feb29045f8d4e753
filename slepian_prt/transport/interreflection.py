"""Light that surfaces reflect onto each other, as a sparse operator over the vertices.

Rays from each vertex gather what the surfaces they hit reflect: T_{b+1} = R diag(ρ) T_b, where row x of R holds, for
each blocked direction, the barycentric weights of the point it hits. Every bounce costs a sparse product; summed to
convergence they are the Neumann series (1 - R diag(ρ))⁻¹ T_0.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from slepian_prt.machine.threads import run_in_threads
from slepian_prt.scene.receivers import morton
from slepian_prt.scene.scene import Scene
from slepian_prt.transport.directions import direction_set
from slepian_prt.transport.hemisphere import HemisphereRays

_RAYS_PER_BLOCK = 1 << 20
# What all bounces that are left out may add, relative to the mean radiance.
_REMAINDER = 1e-3
_MOST_BOUNCES = 1000
# Columns of the transfer vectors that are bounced together: bounds the memory beside the result.
_COLUMNS = 16

# Indirect light varies slowly: it is gathered with this part of the rays that visibility gets.
GATHER_SHARE = 0.25


# Gives what comes to the vertices by itself: (V, k), of a channel and some of the columns.
Source = Callable[[int, slice], NDArray]


def gathering_nodes(samples: float) -> int:
    """Rays of a receiver that gather, where visibility gets ``samples``."""
    return max(1, round(GATHER_SHARE * samples))


class Exchange(Protocol):
    """Light that receivers get from each other: R, or more."""

    def reflected(self, albedo: NDArray, values: NDArray, channel: int = 0) -> NDArray[np.float32]:
        """(V, k) light received from surfaces of one channel's ``albedo`` (V,) that shine by ``values`` (V, k)."""
        ...


class Bounces(Protocol):
    """The series of an exchange, wherever it is summed."""

    def add(
        self, albedo: NDArray, direct: NDArray, channels: int, bounces: int, source: Source | None = None
    ) -> NDArray[np.float32]:
        """As `add_bounces`."""
        ...

    def count(self, albedo: NDArray, ambient: NDArray, channel: int = 0) -> int:
        """As `count_bounces`."""
        ...

    def follow(
        self, reflectance: NDArray, light: NDArray, collected: NDArray, bounces: int, channel: int
    ) -> NDArray[np.float32]:
        """As `follow_bounces`."""
        ...


@dataclass(frozen=True, eq=False)
class BouncesHere:
    """The series, summed in this process."""

    exchange: Exchange

    def add(
        self, albedo: NDArray, direct: NDArray, channels: int, bounces: int, source: Source | None = None
    ) -> NDArray[np.float32]:
        """As `add_bounces`."""
        return add_bounces(self.exchange, albedo, direct, channels, bounces, source)

    def count(self, albedo: NDArray, ambient: NDArray, channel: int = 0) -> int:
        """As `count_bounces`."""
        return count_bounces(self.exchange, albedo, ambient, channel)

    def follow(
        self, reflectance: NDArray, light: NDArray, collected: NDArray, bounces: int, channel: int
    ) -> NDArray[np.float32]:
        """As `follow_bounces`."""
        return follow_bounces(self.exchange, reflectance, light, collected, bounces, channel)


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
        Mean part of the hemisphere that shows backs of receivers that reflect, on which no light is known.
    others : float
        Mean part that shows shapes which only cast shadows.
    rays : int
    """

    rows: NDArray[np.int64]
    weights: csr_array
    backs: float
    others: float
    rays: int

    def reflected(self, albedo: NDArray, values: NDArray, channel: int = 0) -> NDArray[np.float32]:
        """(V, k) light received from surfaces of one channel's ``albedo`` (V,) that shine by ``values`` (V, k)."""
        del channel  # all are alike
        result = np.zeros_like(values)
        result[self.rows] = self._product(albedo[:, None] * values)
        return result

    @cached_property
    def _product(self) -> Callable[[NDArray], NDArray]:
        """What multiplies ``weights``."""
        from slepian_prt.transport.device.sparse import product_with  # only here: few scenes have bounces

        return product_with(self.weights)

    def __getstate__(self) -> dict[str, object]:
        return {name: value for name, value in vars(self).items() if name != "_product"}  # another's card has it not


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
    scene : Scene
    nodes : int
        Rays per vertex.
    vertices : (n,) indices
    blocked : (V,) or None
        Blocked part of each hemisphere, where it is known better than these few rays tell; rows are scaled to it.
    seed : int
        Of the turns about the normals.
    advance : callable
        Given the number of vertices finished since its last call.
    """
    tracer = Gatherer(scene, nodes, seed)
    vertices, pieces = cut_gathering(scene, nodes, vertices)
    parts: list[csr_array] = []
    backs = others = 0.0
    for chosen in pieces:
        block = tracer.gather(chosen, None if blocked is None else blocked[chosen])
        parts.append(block.weights)
        backs, others = backs + block.backs, others + block.others
        advance(chosen.size)
    joined = _stack(parts, len(scene.receivers))
    return Gather(vertices, joined, backs / vertices.size, others / vertices.size, tracer.rays)


def cut_gathering(
    scene: Scene, nodes: int, vertices: NDArray, rays_per_piece: int = _RAYS_PER_BLOCK
) -> tuple[NDArray[np.int64], list[NDArray[np.int64]]]:
    """Receivers in the order of the rows of `Gather`, and in pieces to trace, which do not change what is found."""
    size = max(1, rays_per_piece // direction_set(nodes).size)
    order = vertices[np.argsort(morton(scene.traced_positions[vertices]), kind="stable")]
    return order, [order[begin : begin + size] for begin in range(0, order.size, size)]


def add_bounces(
    gather: Exchange,
    albedo: NDArray,
    direct: NDArray,
    channels: int,
    bounces: int,
    source: Source | None = None,
) -> NDArray[np.float32]:
    """Transfer vectors with the light of ``bounces`` bounces between surfaces added.

    Parameters
    ----------
    gather : Gather, or another exchange of light
    albedo : (V, 3)
    direct : (V, M) float32
        Direct transfer for unit albedo. With one channel its memory becomes the result's.
    channels : 1 (their mean stands for all) or 3
    bounces : int
    source : callable, optional
        What comes to the vertices beside ``direct``.

    Returns
    -------
    (V, channels, M) float32
    """
    # Columns do not depend on each other, so that one channel can be worked on where it is.
    total = direct[:, None, :] if channels == 1 else np.empty((len(direct), 3, direct.shape[1]), dtype=np.float32)

    def bounce(channel: int, columns: slice) -> None:
        light = np.ascontiguousarray(direct[:, columns])
        if source is not None:
            light = light + source(channel, columns)
        reflectance = reflectance_of(albedo, channels, channel)
        total[:, channel, columns] = follow_bounces(gather, reflectance, light, light.copy(), bounces, channel)

    # scipy's sparse product lets go of the interpreter
    run_in_threads(lambda piece: bounce(*piece), product(range(channels), cut_columns(direct.shape[1])))
    return total


def follow_bounces(
    gather: Exchange, reflectance: NDArray, light: NDArray, collected: NDArray, bounces: int, channel: int
) -> NDArray[np.float32]:
    """Add the light (V, k) of each of ``bounces`` bounces, that begin with ``light``, to ``collected``, in place."""
    for _ in range(bounces):
        light = gather.reflected(reflectance, light, channel)
        collected += light
    return collected


def reflectance_of(albedo: NDArray, channels: int, channel: int) -> NDArray[np.float32]:
    """(V,) of a channel; of one channel the mean of all."""
    return (albedo.mean(axis=1) if channels == 1 else albedo[:, channel]).astype(np.float32)


def cut_columns(size: int, width: int = _COLUMNS) -> list[slice]:
    """Columns in pieces that are bounced together."""
    return [slice(begin, min(begin + width, size)) for begin in range(0, size, width)]


def count_bounces(gather: Exchange, albedo: NDArray, ambient: NDArray, channel: int = 0) -> int:
    """Bounces after which what is left is less than a thousandth of the mean radiance, under any light.

    Light is never negative, so a constant environment bounds all others of the same peak: it alone is followed here.

    Parameters
    ----------
    gather : Gather, or another exchange of light
    albedo : (V, 3)
    ambient : (V,) direct part of a constant environment's light
    channel : int
        Of the exchange.
    """
    reflectance = albedo.max(axis=1).astype(np.float32)
    light = ambient.astype(np.float32)[:, None]
    collected, last = float(light.mean()), float(light.max(initial=0.0))
    for count in range(1, _MOST_BOUNCES + 1):
        light = gather.reflected(reflectance, light, channel)
        largest = float(light.max(initial=0.0))
        if largest == 0.0:
            return count - 1
        collected += float(light.mean())
        # The ratio of successive maxima tends to the spectral radius; the rest is a geometric series.
        ratio = min(largest / last, 1.0 - 1e-6)
        left = largest * ratio / (1.0 - ratio)
        if left <= _REMAINDER * collected:
            return count
        last = largest
    return _MOST_BOUNCES


def _stack(parts: list[csr_array], columns: int) -> csr_array:
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


class GatherBlock(NamedTuple):
    """What a block of n receivers sees.

    Attributes
    ----------
    weights : sparse (n, V)
    backs, others : float
        Sums over the block of what shows backs that reflect and hold no light, and shapes that only cast shadows.
    """

    weights: csr_array
    backs: float
    others: float


class Gatherer(HemisphereRays):
    """Closest hits along so many nodes, as weights of the vertices that they lie between."""

    def __init__(self, scene: Scene, nodes: int, seed: int) -> None:
        super().__init__(scene, direction_set(nodes), seed)
        self._faces, self._behind = scene.faces, scene.faces_behind
        self._reflects_behind = np.repeat(np.array(scene.two_sided), np.diff([*scene.first_faces, len(scene.faces)]))
        self._scene = scene

    def gather(self, vertices: NDArray, blocked: NDArray | None) -> GatherBlock:
        """Trace a block of receivers; rows are scaled to the blocked part of each hemisphere where that is known."""
        import drjit as dr

        directions, count = self.directions, len(vertices)
        ray = self.rays_from(vertices, self.frames(vertices))(*self.to_nodes(count))
        hit = self.geometry.ray_intersect_preliminary(ray)
        valid = hit.is_valid()
        face = self._scene.hit_faces(hit)
        receives = face >= 0
        front = receives & (dr.dot(self._scene.face_table.normals(face), ray.d) < 0.0)
        u, v = hit.prim_uv
        dr.eval(valid, receives, front, face, u, v)
        weight = np.tile(directions.weights.astype(np.float32), count)
        is_hit, is_receiver, is_front, met = (np.array(values) for values in (valid, receives, front, face))
        met = np.maximum(met, 0)
        holds_light = is_front | (is_receiver & (self._behind[met, 0] >= 0))
        scale = np.ones(count, dtype=np.float32)
        if blocked is not None:
            measured = np.add.reduceat(np.where(is_hit, weight, 0.0), np.arange(0, is_hit.size, directions.size))
            scale = np.where(measured > 0.0, blocked / np.maximum(measured, 1e-9), 1.0).astype(np.float32)
        lane = np.flatnonzero(holds_light)
        row = lane // directions.size
        share = weight[lane] * scale[row]
        second, third = np.array(u)[lane], np.array(v)[lane]
        values = np.stack([share * (1.0 - second - third), share * second, share * third], axis=1)
        corner = np.where(is_front[lane, None], self._faces[met[lane]], self._behind[met[lane]])
        places = (np.repeat(row, 3).astype(np.int32), corner.ravel())
        return GatherBlock(
            csr_array((values.ravel(), places), shape=(count, len(self._normals))),
            float(weight[is_receiver & ~holds_light & self._reflects_behind[met]].sum()),
            float(weight[is_hit & ~is_receiver].sum()),
        )
