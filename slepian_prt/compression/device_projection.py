"""Blocks of vectors that are on a device, projected there on the functions of each cap: coefficients alone come back.

What `Projection.block` does by NumPy, for receivers of one channel.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.checkpoint import Block, BlockStatistics
from slepian_prt.paths.harmonics import sh_values
from slepian_prt.sphere.harmonics import degrees
from slepian_prt.transport.device.projection import DeviceBlock, DeviceVectors
from slepian_prt.transport.device.rotation import PACKET, padded, padded_rows
from slepian_prt.transport.hemisphere import pairs

if TYPE_CHECKING:
    from slepian_prt.compression.projection import Projection


def can_project_on_device(projection: Projection) -> bool:
    """Whether `project_on_device` can: one channel, and no cap has a mean of its own."""
    return projection.learned.channels == 1 and all(basis.mean is None for basis in projection.bases)


def project_on_device(projection: Projection, traced: DeviceBlock) -> Block:
    """As `Projection.block`, of vectors that are on a device.

    Parameters
    ----------
    projection : Projection
        That `can_project_on_device`.
    traced : DeviceBlock
    """
    known = _functions.get(projection)
    mi = traced.on_device.mi
    if known is None or known.mi is not mi or known.variant != mi.variant():
        known = _functions[projection] = DeviceFunctions(mi, projection)
    return known.project(traced)


class DeviceFunctions:
    """The functions of all caps, and what normals alone tell, on Mitsuba's arrays.

    Parameters
    ----------
    mi : Mitsuba
    projection : Projection

    Attributes
    ----------
    variant : str
        Of the arrays.
    """

    def __init__(self, mi: Any, projection: Projection) -> None:
        learned = projection.learned
        self.mi, self.variant = mi, mi.variant()
        self._bandlimit, self._normals = learned.bandlimit, learned.normals
        self._index, self._classes = learned.clusters.index, learned.clusters.occlusion_classes
        self._counts = np.array([basis.count for basis in projection.bases], dtype=np.int64)
        self._rows = np.cumsum(self._counts) - self._counts
        columns = padded(len(degrees(self._bandlimit)))
        functions = np.concatenate([basis.analysis for basis in projection.bases])
        self._functions = mi.Float(padded_rows(functions, columns).ravel())
        weights = np.ones(self._bandlimit + 1) if learned.weights is None else learned.weights
        self._weights = mi.Float(padded_rows(weights[degrees(self._bandlimit)][None], columns).ravel())
        mean = None if learned.pilot is None else learned.pilot.mean
        self._zonal = None if mean is None else mi.Float(mean.zonal.astype(np.float32).ravel())

    def project(self, traced: DeviceBlock) -> Block:
        """Coefficients of a block of receivers, and what is known of them, on the host."""
        import drjit as dr

        mi, found = self.mi, traced.on_device
        order = np.argsort(self._index[traced.vertices], kind="stable")
        vertices = traced.vertices[order]
        caps = self._index[vertices]
        counts = self._counts[caps]
        row, column = pairs(mi, len(order), found.columns)
        rows = dr.gather(mi.UInt32, mi.UInt32(order.astype(np.uint32)), row)
        vectors = dr.gather(mi.Float, found.values, rows * dr.opaque(mi.UInt32, found.columns) + column)
        dr.eval(vectors)
        energy = self._energies(vectors, column, found.columns)
        if self._zonal is not None:
            vectors = vectors - self._means(vertices, found)
        coefficients, held = self._coefficients(vectors, caps, counts, found.columns)
        missed = self._energies(vectors, column, found.columns) - held
        dr.eval(energy, missed)
        statistics = BlockStatistics(traced.blocked[order], np.array(energy), np.maximum(np.array(missed), 0.0))
        return Block(vertices.astype(np.int32), statistics, np.array(coefficients), traced.rays)

    def _energies(self, vectors: Any, column: Any, columns: int) -> Any:
        """Float (n) squared norms, weighted by the light prior."""
        import drjit as dr

        return dr.block_sum(dr.square(vectors * dr.gather(self.mi.Float, self._weights, column)), columns)

    def _means(self, vertices: NDArray, found: DeviceVectors) -> Any:
        """Float (n columns) of the mean transfer about each normal."""
        import drjit as dr

        mi, bandlimit = self.mi, self._bandlimit
        assert self._zonal is not None
        normals = self._normals[vertices]
        lit = mi.Bool(np.any(normals != 0.0, axis=1))
        number = self._classes[self._index[vertices]] * (bandlimit + 1)
        first, row = mi.UInt32(number.astype(np.uint32)), dr.arange(mi.UInt32, len(vertices)) * found.columns
        values = sh_values(mi, bandlimit, mi.Vector3f(normals.T.astype(np.float32)))
        means = dr.zeros(mi.Float, len(vertices) * found.columns)
        for l in range(bandlimit + 1):
            kernel = dr.gather(mi.Float, self._zonal, first + l)
            for i in range(l * l, (l + 1) ** 2):
                dr.scatter(means, kernel * values[i], row + i, lit, mode=dr.ReduceMode.NoConflicts)
        return means

    def _coefficients(
        self, vectors: Any, caps: NDArray[np.int32], counts: NDArray[np.int64], columns: int
    ) -> tuple[Any, Any]:
        """Float (m), of one receiver after the other as many as its cap has; and Float (n) of their squares' sums."""
        import drjit as dr

        mi, most, packets = self.mi, int(counts.max(initial=1)), columns // PACKET
        dr.eval(vectors)
        receiver, number = pairs(mi, len(caps), most)
        first = mi.UInt32(self._rows[caps].astype(np.uint32))
        count, begin = (mi.UInt32(part.astype(np.uint32)) for part in (counts, np.cumsum(counts) - counts))
        active = number < dr.gather(mi.UInt32, count, receiver)
        vector = receiver * dr.opaque(mi.UInt32, packets)
        function = (dr.gather(mi.UInt32, first, receiver) + number) * dr.opaque(mi.UInt32, packets)

        def add(packet: Any, total: Any) -> tuple[Any, Any]:
            along = dr.gather(mi.Vector4f, self._functions, function + packet)
            return packet + 1, total + dr.dot(along, dr.gather(mi.Vector4f, vectors, vector + packet))

        packet, total = dr.zeros(mi.UInt32, len(caps) * most), dr.zeros(mi.Float, len(caps) * most)
        _, total = dr.while_loop(
            (packet, total), lambda packet, _: active & (packet < packets), add, label="slepian_prt: coefficients"
        )
        dr.eval(total)
        coefficients = dr.zeros(mi.Float, int(counts.sum()))
        place = dr.gather(mi.UInt32, begin, receiver) + number
        dr.scatter(coefficients, total, place, active, mode=dr.ReduceMode.NoConflicts)
        return coefficients, dr.block_sum(dr.square(total), most)


_functions: WeakKeyDictionary[Projection, DeviceFunctions] = WeakKeyDictionary()
