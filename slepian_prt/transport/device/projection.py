"""Blocked directions as spherical harmonics, on Mitsuba's arrays: what `OcclusionTables` does, where hits are.

Each entry of a vector is a lane of its own, four to a packet, and adds up its rows of the tables in the order of the
triangles: the same bits every time, without atomic sums. What depends on the scene is opaque to the kernels, so that
they are compiled once. Processors would need 1.3 times as long for it as NumPy at L = 10, and 2.4 times at L = 20.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.slepian.kernels import cosine_lobe, zonal_vectors
from slepian_prt.sphere.harmonics import num_coefficients
from slepian_prt.transport.device.rotation import PACKET, DeviceRotation, padded, padded_rows
from slepian_prt.transport.device.visibility import DeviceVisibility
from slepian_prt.transport.estimator import TransferBlock
from slepian_prt.transport.hemisphere import divided, pairs
from slepian_prt.transport.occlusion import LEAST, MEAN, MOST, OcclusionTables


@dataclass(frozen=True, eq=False)
class DeviceVectors:
    """Transfer vectors of n receivers on Mitsuba's arrays.

    Attributes
    ----------
    mi : Mitsuba
        In the variant of the arrays.
    count, size : int
        n, and (L+1)².
    columns : int
        Of ``values``: ``size`` and zeros behind, in whole packets of four.
    values : Float (n columns)
        Receiver after receiver.
    blocked : Float (n)
        Part of each hemisphere that shows no sky, as of `TransferBlock`.
    """

    mi: Any
    count: int
    size: int
    columns: int
    values: Any
    blocked: Any

    def numpy(self) -> NDArray[np.float32]:
        """(n, 1, (L+1)²) copied from the device."""
        rows = np.array(self.values).reshape(self.count, self.columns)
        return np.ascontiguousarray(rows[:, None, : self.size])


class DeviceBlock(TransferBlock):
    """Transfer of some receivers, whose vectors are copied from the device when they are asked for.

    Attributes
    ----------
    on_device : DeviceVectors
    """

    def __init__(self, vertices: NDArray[np.int64], on_device: DeviceVectors, rays: int) -> None:
        vars(self).update(vertices=vertices, on_device=on_device, rays=rays, blocked=np.array(on_device.blocked))

    on_device: DeviceVectors

    @cached_property
    def vectors(self) -> NDArray[np.float32]:
        """(n, 1, (L+1)²) on the host."""
        return self.on_device.numpy()


@dataclass(frozen=True, eq=False)
class _Corners:
    """Corners that are cut off triangles, on Mitsuba's arrays, receiver after receiver.

    Attributes
    ----------
    rows : UInt32
        Of the table.
    signs : Float
    begin, end : UInt32 (n)
        Those of each receiver.
    """

    rows: Any
    signs: Any
    begin: Any
    end: Any


class DeviceTables:
    """Projects what was found blocked on spherical harmonics.

    Parameters
    ----------
    mi : Mitsuba
    tables : OcclusionTables
    bandlimit : int
    """

    def __init__(self, mi: Any, tables: OcclusionTables, bandlimit: int) -> None:
        self._mi, self._size = mi, num_coefficients(bandlimit)
        self._columns = padded(self._size)
        self._rotation = DeviceRotation(mi, bandlimit)
        # Behind the columns of the harmonics, one packet whose first number is how often outlines turn. Matrices of
        # whole packets are multiplied by tiles eight times as wide on CUDA.
        self._size_of_set = len(tables.nodes)
        nodes = np.zeros((padded(self._size_of_set), self._columns + PACKET), dtype=np.float32)
        nodes[: self._size_of_set, : self._size] = tables.nodes
        nodes[: self._size_of_set, self._columns] = tables.turns
        self._nodes = mi.TensorXf(nodes)
        self._corners = mi.Float(padded_rows(tables.corners, self._columns).ravel())
        self._sky = _packets(mi, tables.sky, self._columns)
        self._unshadowed = _packets(mi, _zonal(bandlimit), self._columns)
        self._triangles = _columns_of(mi, tables.triangles)
        self._edges = [mi.UInt32(edge.astype(np.uint32)) for edge in tables.edges]
        self._run_towards = [mi.Bool(towards) for towards in tables.run_towards]
        self._edge_count = 1 + max(int(edge.max()) for edge in tables.edges)

    def open(
        self,
        found: DeviceVisibility | None,
        slots: NDArray,
        dark: NDArray[np.bool_],
        closed: NDArray[np.bool_],
        angles: NDArray[np.float64],
    ) -> DeviceVectors:
        """(1/π) ∫ V (n·ω)₊ y_lm dω in the world frame, of n receivers.

        Parameters
        ----------
        found : DeviceVisibility or None
            Of those that were traced.
        slots : (n,) int
            Their places in it; -1 for the others, which see all of their hemisphere.
        dark : (n,) bool
            Those of the others that receive nothing.
        closed : (n,) bool
            Those of them that see nothing of the sky.
        angles : (3, n)
            Of their frames; see `angles_of`.
        """
        import drjit as dr

        mi, count = self._mi, len(slots)
        packets = self._columns // PACKET
        receiver, packet = pairs(mi, count, packets)
        slot = dr.gather(mi.Int32, mi.Int32(slots.astype(np.int32)), receiver)
        traced, lit = slot >= 0, ~dr.gather(mi.Bool, mi.Bool(dark), receiver)
        value = dr.gather(mi.Vector4f, self._unshadowed, packet, lit & ~traced)
        blocked = mi.Float(closed.astype(np.float32))
        if found is not None:
            seen, part = self._seen(found, mi.UInt32(slot), packet, traced)
            value = dr.select(traced, seen, value)
            dr.eval(value)
            dr.scatter(blocked, part, receiver, traced & (packet == 0), mode=dr.ReduceMode.NoConflicts)
        local = dr.zeros(mi.Float, count * self._columns)
        dr.scatter(local, value, dr.arange(mi.UInt32, count * packets), mode=dr.ReduceMode.NoConflicts)
        world = self._rotation.into_world(local, angles)
        dr.eval(world, blocked)
        return DeviceVectors(mi, count, self._size, self._columns, world, blocked)

    def _seen(self, found: DeviceVisibility, slot: Any, packet: Any, active: Any) -> tuple[Any, Any]:
        """Packets of vectors in the receivers' own frames, and the part of the hemisphere that is blocked.

        The latter is right where ``packet`` is 0, in which degrees 0 and 1 are.
        """
        import drjit as dr

        mi, size = self._mi, self._size_of_set
        sums = self._sums_at_nodes(found)
        closed = dr.block_sum(dr.select(found.blocked, mi.UInt32(1), 0), size) == dr.opaque(mi.UInt32, size)
        corners = self._cut_triangles(found)
        dr.eval(sums, closed)
        packets = self._columns // PACKET
        stride, row = dr.opaque(mi.UInt32, packets), slot * dr.opaque(mi.UInt32, packets + 1)
        value = dr.gather(mi.Vector4f, sums, row + packet, active)
        turns = dr.gather(mi.Float, sums, (row + packets) * PACKET, active)
        entry, end = (dr.gather(mi.UInt32, ends, slot, active) for ends in (corners.begin, corners.end))

        def add(entry: Any, value: Any, turns: Any) -> tuple[Any, ...]:
            sign = dr.gather(mi.Float, corners.signs, entry)
            place = dr.gather(mi.UInt32, corners.rows, entry) * stride + packet
            value = dr.fma(mi.Vector4f(sign), dr.gather(mi.Vector4f, self._corners, place), value)
            return entry + 1, value, dr.fma(sign, 1.0 / 6.0, turns)

        _, value, turns = dr.while_loop(
            (entry, value, turns), lambda entry, *_: active & (entry < end), add, label="slepian_prt: corners"
        )
        value = self._with_bulges(value, turns, packet)
        is_closed = dr.gather(mi.Bool, closed, slot, active)
        part = dr.select(is_closed, 1.0, value.x * MEAN)
        seen = dr.gather(mi.Vector4f, self._sky, packet) - value
        return dr.select(is_closed, 0.0, seen), part

    def _sums_at_nodes(self, found: DeviceVisibility) -> Any:
        """Float (n (columns + 4)), rows of the table at blocked nodes added up."""
        import drjit as dr

        mi, size, columns = self._mi, self._size_of_set, self._nodes.shape[0]
        place, node = pairs(mi, found.count, columns)
        inside = node < dr.opaque(mi.UInt32, size)
        blocked = dr.gather(mi.Bool, found.blocked, place * dr.opaque(mi.UInt32, size) + node, inside)
        product: Any = dr.matmul(mi.TensorXf(dr.select(blocked, 1.0, 0.0), (found.count, columns)), self._nodes)
        return product.array

    def _with_bulges(self, value: Any, turns: Any, packet: Any) -> Any:
        """What chords cut off, given back: see `OcclusionTables`; degrees 0 and 1 are the first packet."""
        import drjit as dr

        lost = turns / dr.opaque(self._mi.Float, 2.0 * dr.width(self._triangles[0]))
        closed = value.x * MEAN
        wider = dr.clip(lost / dr.maximum(closed, LEAST), 0.0, MOST)
        narrower = dr.clip(-lost / dr.maximum(1.0 - closed, LEAST), 0.0, MOST)
        sky = dr.gather(self._mi.Vector4f, self._sky, self._mi.UInt32(0))
        return dr.select(packet == 0, value * (1.0 + wider + narrower) - narrower * sky, value)

    def _cut_triangles(self, found: DeviceVisibility) -> _Corners:
        """Rows of the table of corners that each receiver adds or subtracts."""
        import drjit as dr

        mi, size, count = self._mi, self._size_of_set, dr.width(self._triangles[0])
        place, triangle = pairs(mi, found.count, count)
        a, b, c = self._at_corners(found.blocked, place, triangle, size)
        cut = (a ^ b) | (b ^ c)
        dr.eval(cut)
        entries = dr.compress(cut)
        each = dr.block_sum(dr.select(cut, mi.UInt32(1), 0), count)
        begin = dr.prefix_sum(each)  # of those before
        if dr.width(entries) == 0:
            return _Corners(mi.UInt32(0), mi.Float(0.0), begin, begin)
        place, triangle = divided(mi, entries, count)
        a, b, c = self._at_corners(found.blocked, place, triangle, size)
        lone = dr.select(b == c, mi.UInt32(0), dr.select(a == c, mi.UInt32(1), mi.UInt32(2)))
        row = corner = 3 * triangle + lone
        for edges, run_towards in zip(self._edges, self._run_towards, strict=True):
            edge, towards = dr.gather(mi.UInt32, edges, corner), dr.gather(mi.Bool, run_towards, corner)
            quarter = dr.gather(mi.UInt32, found.quarter, place * dr.opaque(mi.UInt32, self._edge_count) + edge)
            row = 4 * row + dr.select(towards, 3 - quarter, quarter)
        lone_is_blocked = dr.select(lone == 0, a, dr.select(lone == 1, b, c))
        signs = dr.select(lone_is_blocked, mi.Float(1.0), -1.0)
        dr.eval(row, signs, begin, each)
        return _Corners(row, signs, begin, begin + each)

    def _at_corners(self, blocked: Any, place: Any, triangle: Any, size: int) -> list[Any]:
        """Whether the three corners of triangles are blocked."""
        import drjit as dr

        mi = self._mi
        first = place * dr.opaque(mi.UInt32, size)
        return [
            dr.gather(mi.Bool, blocked, first + dr.gather(mi.UInt32, corner, triangle)) for corner in self._triangles
        ]


def _zonal(bandlimit: int) -> NDArray[np.float32]:
    """((L+1)²,) transfer of a receiver that nothing shadows, in its own frame."""
    return zonal_vectors(cosine_lobe(bandlimit), np.array([[0.0, 0.0, 1.0]]))[0]


def _packets(mi: Any, values: NDArray, columns: int) -> Any:
    """Float (columns) of one vector, padded."""
    return mi.Float(padded_rows(values[None], columns).ravel())


def _columns_of(mi: Any, table: NDArray) -> list[Any]:
    """The columns of whole numbers as UInt32 arrays."""
    return [mi.UInt32(np.ascontiguousarray(column, dtype=np.uint32)) for column in table.T]
