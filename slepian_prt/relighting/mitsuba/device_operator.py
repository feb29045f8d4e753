"""Compressed transfer as a matrix on Mitsuba's arrays: radiance where it is drawn, followed by gradients.

As `TransferOperator`, by Dr.Jit's matrix products: those of one light read the coefficients once, at the speed of the
device's memory.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from slepian_prt.relighting.operator import TransferOperator
from slepian_prt.transport.hemisphere import pairs

# Tiles that CUDA multiplies by one call.
_MOST_TILES = 65535


class DeviceOperator:
    """Radiance of receivers from lighting, as operations of Dr.Jit.

    Parameters
    ----------
    mi : Mitsuba
    operator : TransferOperator
        Whose numbers are copied to the device.
    """

    def __init__(self, mi: Any, operator: TransferOperator) -> None:
        self._mi = mi
        channels, self._size = operator.functions.shape[1:]
        self._functions = [
            mi.TensorXf(np.ascontiguousarray(operator.functions[:, c], dtype=np.float32)) for c in range(channels)
        ]
        self._tiles: list[tuple[Any, Any]] = []  # coefficients (T, n, r) and which functions those of each are, (T r)
        for group in operator.groups:
            for begin in range(0, len(group.functions), _MOST_TILES):
                some = slice(begin, begin + _MOST_TILES)
                coefficients = np.concatenate([strip[some] for strip in group.strips], axis=2)
                functions = mi.UInt32(group.functions[some].astype(np.uint32).ravel())
                self._tiles.append((mi.TensorXf(coefficients), functions))
        self._places = mi.UInt32(operator.places.astype(np.uint32))

    @property
    def count(self) -> int:
        """V, the number of receivers."""
        import drjit as dr

        return int(dr.width(self._places))

    def radiance(self, lighting: Any) -> Any:
        """Radiance for unit albedo under B lights: Float (V B 3), of one receiver after the other.

        Parameters
        ----------
        lighting : Float (B 3 (L+1)²)
            Light after light: red, green, blue.
        """
        import drjit as dr

        mi = self._mi
        lights = mi.TensorXf(lighting, (dr.width(lighting) // self._size, self._size))
        columns = lights.shape[0]
        lit, products = self._lit(lights), []
        for coefficients, functions in self._tiles:
            tiles, _, rank = coefficients.shape
            row, column = pairs(mi, tiles * rank, columns)
            number = dr.gather(mi.UInt32, functions, row) * columns + column
            factors = mi.TensorXf(dr.gather(mi.Float, lit, number), (tiles, rank, columns))
            product: Any = dr.matmul(coefficients, factors)
            products.append(product.array)
        receiver, column = pairs(mi, self.count, columns)
        place = dr.gather(mi.UInt32, self._places, receiver) * columns + column
        # No number is asked for twice: gradients go back without being added up.
        return dr.gather(mi.Float, dr.concat(products), place, mode=dr.ReduceMode.Permute)

    def _lit(self, lights: Any) -> Any:
        """Float (R columns): functions times lights (columns, (L+1)²)."""
        import drjit as dr

        if len(self._functions) == 1:
            product: Any = dr.matmul(self._functions[0], lights, Bt=True)
            return product.array
        mi, lit = self._mi, None
        for c, functions in enumerate(self._functions):
            # Of each light the channel that these functions are of.
            own = np.repeat((np.arange(lights.shape[0]) % 3 == c).astype(np.float32), self._size)
            part: Any = dr.matmul(functions, mi.TensorXf(lights.array * mi.Float(own), lights.shape), Bt=True)
            lit = part.array if lit is None else lit + part.array
        return lit
