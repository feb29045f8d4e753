"""Direct shadowed diffuse transport.

t_lm(x) = (1/π) ∫ V(x,ω) (n·ω)₊ y_lm(ω) dω  =  A_l y_lm(n) - (1/π) ∫ (1 - V) (n·ω)₊ y_lm dω

The first part is exact; rays measure only what is blocked. All receivers share one set of directions in their own
frames, each turned by its own angle about the normal so that the error does not band (`hemisphere`). Where the ends of
an edge of the set disagree, visibility is bisected along it (`visibility`). What a receiver then is the sum of are rows
of tables (`occlusion`), followed by a rotation of each vector into the world.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slepian_prt.renderer import variants
from slepian_prt.scene.scene import Scene
from slepian_prt.slepian.kernels import cosine_lobe, zonal_vectors
from slepian_prt.sphere.harmonics import num_coefficients
from slepian_prt.transport.device.projection import DeviceBlock, DeviceTables
from slepian_prt.transport.device.rotation import angles_of
from slepian_prt.transport.device.visibility import DeviceTracer, DeviceVisibility
from slepian_prt.transport.directions import direction_set
from slepian_prt.transport.effects import Plan
from slepian_prt.transport.estimator import Estimator, TransferBlock, cut_pieces, receivers_per_block
from slepian_prt.transport.occlusion import OcclusionTables
from slepian_prt.transport.settings import TransportSettings
from slepian_prt.transport.visibility import VisibilitySamples, VisibilityTracer

# Rays in flight at a time: enough to fill the cores, little enough to stay in memory beside the mesh.
_RAYS_PER_BLOCK = 1 << 21

# The same for a graphics card, where each block waits some ten times for sizes that the next kernel needs: some 400 MB.
_ON_DEVICE = 1 << 24


def unoccluded_transfer(bandlimit: int, normals: NDArray) -> NDArray[np.float32]:
    """A_l y_lm(n), shape (V, (L+1)²); zero where the normal is zero."""
    return zonal_vectors(cosine_lobe(bandlimit), normals)


class _TracedBlock(NamedTuple):
    """Receivers; places among them of the hidden and of the traced ones; what was found there, and its rays."""

    vertices: NDArray[np.int64]
    hidden: NDArray[np.int64]
    traced: NDArray[np.int64]
    visibility: VisibilitySamples | DeviceVisibility | None
    rays: int


@dataclass(frozen=True, eq=False)
class DirectTransfer(Estimator[_TracedBlock]):
    """Direct, shadowed, diffuse transfer of unit albedo.

    Attributes
    ----------
    scene : Scene
    bandlimit : int
    nodes : int
        Directions that every traced receiver looks in at first; see `nodes_for`.
    shadowed : (n,)
        Receivers to trace; the others are taken to see all of their hemisphere.
    seed : int
        Of the turns about the normals. The same seed gives the same bits.
    on_device : bool or None
        Whether what rays find stays on Mitsuba's arrays until it is vectors; by default under CUDA, where hits of rays
        would else take the most of the time on their way to the host.
    """

    scene: Scene
    bandlimit: int
    nodes: int
    shadowed: NDArray[np.int64]
    seed: int
    on_device: bool | None = None

    channels: ClassVar[int] = 1

    @classmethod
    def planned(cls, scene: Scene, settings: TransportSettings, plan: Plan) -> DirectTransfer:
        """As a plan wants it."""
        return cls(scene, settings.bandlimit, plan.nodes, plan.shadowed, settings.seed)

    @property
    def axes(self) -> NDArray[np.float64]:
        """(V, 3) normals."""
        return self.scene.receivers.normals

    @property
    def rays(self) -> int:
        """Number traced so far."""
        return self._instruments[0].rays if self.shadowed.size else 0

    @property
    def block_size(self) -> int:
        """Receivers that are traced at a time."""
        numbers = num_coefficients(self.bandlimit)
        if self.stays_on_device:
            return max(1, min(_ON_DEVICE // self.nodes, _ON_DEVICE // numbers))
        return receivers_per_block(self.nodes, _RAYS_PER_BLOCK, numbers)

    @property
    def stays_on_device(self) -> bool:
        """Whether blocks are `DeviceBlock`, and are traced and projected in one thread: a device works on by itself."""
        return variants.is_on_device(self.scene.mi) if self.on_device is None else self.on_device

    @cached_property
    def _is_traced(self) -> NDArray[np.bool_]:
        traced = np.zeros(len(self.scene.receivers), dtype=bool)
        traced[self.shadowed] = True
        return traced

    @cached_property
    def _is_hidden(self) -> NDArray[np.bool_]:
        """Behind a surface that an edge goes through: such receivers take what their neighbours before it receive."""
        return self.scene.is_hidden if self.shadowed.size else np.zeros(len(self.scene.receivers), dtype=bool)

    @cached_property
    def _instruments(self) -> tuple[VisibilityTracer | DeviceTracer, OcclusionTables]:
        """What traces and what projects: made together, since tables made while traced blocks wait take 10 % more."""
        directions = direction_set(self.nodes)
        tables = OcclusionTables(directions, self.bandlimit)
        kind = DeviceTracer if self.stays_on_device else VisibilityTracer
        return kind(self.scene, directions, self.seed), tables

    @cached_property
    def _device_tables(self) -> DeviceTables:
        return DeviceTables(self.scene.mi, self._instruments[1], self.bandlimit)

    def pieces(self, receivers: NDArray[np.int64] | None = None) -> list[NDArray[np.int64]]:
        """All receivers, or some, in pieces of about as many rays."""
        return cut_pieces(self.scene, self._is_traced, self.block_size, receivers)

    def trace(self, vertices: NDArray) -> _TracedBlock:
        """Find what is blocked for those of the receivers that can be shadowed."""
        hidden = np.flatnonzero(self._is_hidden[vertices])
        traced = np.flatnonzero(self._is_traced[vertices] & ~self._is_hidden[vertices])
        if traced.size == 0:
            return _TracedBlock(vertices, hidden, traced, None, 0)
        tracer, _ = self._instruments
        before = tracer.rays
        visibility = tracer.trace(vertices[traced])
        return _TracedBlock(vertices, hidden, traced, visibility, tracer.rays - before)

    def project(self, samples: _TracedBlock) -> TransferBlock:
        """What is not blocked, as transfer vectors."""
        if self.stays_on_device:
            return self._project_on_device(samples)
        vertices, hidden, traced, visibility, rays = samples
        vectors = np.zeros((vertices.size, num_coefficients(self.bandlimit)), dtype=np.float32)
        blocked = np.zeros(vertices.size, dtype=np.float32)
        unshadowed = np.ones(vertices.size, dtype=bool)
        unshadowed[hidden] = unshadowed[traced] = False
        vectors[unshadowed] = unoccluded_transfer(self.bandlimit, self.scene.receivers.normals[vertices[unshadowed]])
        blocked[hidden] = 1.0
        if isinstance(visibility, VisibilitySamples):
            _, tables = self._instruments
            vectors[traced], blocked[traced] = tables.open(visibility)
        return TransferBlock(vertices, vectors[:, None, :], blocked, rays)

    def _project_on_device(self, samples: _TracedBlock) -> DeviceBlock:
        """The same, left on the device."""
        vertices, hidden, traced, visibility, rays = samples
        normals = self.scene.receivers.normals[vertices]
        slots = np.full(vertices.size, -1)
        slots[traced] = np.arange(traced.size)
        dark = ~np.any(normals != 0.0, axis=1)  # no side, no light, though nothing of it is known to be blocked
        closed = np.zeros(vertices.size, dtype=bool)
        dark[hidden] = closed[hidden] = True
        turns = self._instruments[0].turns[vertices] if traced.size else np.zeros(vertices.size)
        found = visibility if isinstance(visibility, DeviceVisibility) else None
        vectors = self._device_tables.open(found, slots, dark, closed, angles_of(normals, turns))
        return DeviceBlock(vertices, vectors, rays)
