"""Products with a sparse matrix of numbers that are on a graphics card already, for bounces of light."""

from __future__ import annotations

from collections.abc import Callable
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from slepian_prt.renderer import variants
from slepian_prt.transport.device.rotation import PACKET, padded, padded_rows
from slepian_prt.transport.hemisphere import pairs

Product = Callable[[NDArray], NDArray[np.float32]]


def product_with(matrix: csr_array) -> Product:
    """What multiplies a matrix (n, V) by values (V, k): a graphics card if Mitsuba's variant is one of CUDA."""
    mi = variants.imported_mitsuba()
    if variants.is_on_device(mi):
        return DeviceSparse(mi, matrix).multiply
    return lambda values: matrix @ values


class DeviceSparse:
    """A sparse matrix on Mitsuba's arrays, whose rows are added up in the order of their entries.

    Parameters
    ----------
    mi : Mitsuba
    matrix : sparse (n, V) float32
    """

    def __init__(self, mi: Any, matrix: csr_array) -> None:
        self._mi, self._rows = mi, matrix.shape[0]
        self._ends = mi.UInt32(matrix.indptr.astype(np.uint32))
        self._columns, self._values = mi.UInt32(matrix.indices.astype(np.uint32)), mi.Float(matrix.data)
        self._lock = Lock()  # several threads multiply columns on processors, and one card serves them

    def multiply(self, values: NDArray) -> NDArray[np.float32]:
        """(n, k) products with values (V, k)."""
        import drjit as dr

        mi, count = self._mi, values.shape[1]
        if self._rows == 0 or dr.width(self._values) == 0:
            return np.zeros((self._rows, count), dtype=np.float32)
        packets = padded(count) // PACKET
        with self._lock:
            given = mi.Float(padded_rows(values, padded(count)).ravel())
            row, packet = pairs(mi, self._rows, packets)
            stride = dr.opaque(mi.UInt32, packets)
            entry, end = dr.gather(mi.UInt32, self._ends, row), dr.gather(mi.UInt32, self._ends, row + 1)

            def add(entry: Any, total: Any) -> tuple[Any, Any]:
                place = dr.gather(mi.UInt32, self._columns, entry) * stride + packet
                weight = mi.Vector4f(dr.gather(mi.Float, self._values, entry))
                return entry + 1, dr.fma(weight, dr.gather(mi.Vector4f, given, place), total)

            start = entry, dr.zeros(mi.Vector4f, self._rows * packets)
            _, total = dr.while_loop(start, lambda entry, _: entry < end, add, label="slepian_prt: sparse product")
            product = dr.zeros(mi.Float, self._rows * packets * PACKET)
            dr.scatter(product, total, row * packets + packet, mode=dr.ReduceMode.NoConflicts)
            return np.array(product).reshape(self._rows, -1)[:, :count]
