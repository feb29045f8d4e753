"""Compressed transfer as the matrix that lighting is multiplied with, kept in the factors it is compressed to.

Within a cap, T ≈ C F with few functions F and coefficients C, so that radiance is C (F e): F e is small, and what takes
time is to read C once. Its speed is that of the memory.
"""

from __future__ import annotations

from collections.abc import Sequence
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.compression.decoder import forget
from slepian_prt.relighting.factors import Factors, all_factors

# From so many functions, and for one light, products of a matrix that is stored by columns with each of three vectors
# are up to twice as fast as one with all three (OpenBLAS, measured).
_LONG = 100


class TransferOperator:
    """Radiance from lighting, and gradients of lighting from those of radiance.

    Parameters
    ----------
    parts : Factors of each cap
    members : vertices of each cap
    """

    def __init__(self, parts: Sequence[Factors], members: Sequence[NDArray]) -> None:
        self._blocks = [
            np.asarray(part.coefficients, order="F" if len(part.functions) >= _LONG else "C") for part in parts
        ]
        self._functions = np.concatenate([part.functions for part in parts]).astype(np.float32)
        self._ranks = np.concatenate([[0], np.cumsum([part.functions.shape[0] for part in parts])])
        self._members = list(members)

    @property
    def size(self) -> int:
        """Numbers that are read for each light: coefficients and functions."""
        return sum(block.size for block in self._blocks) + self._functions.size

    def apply(self, lighting: NDArray) -> NDArray[np.float32]:
        """(B, V, 3) radiance for unit albedo under B lightings (B, 3, (L+1)²)."""
        count = len(lighting)
        lit = self._lit(lighting)
        # Rows of whole 16 bytes go to their vertices at the speed of a copy; others take several times as long.
        width = -(-3 * count // 4) * 4
        lit = np.pad(lit, ((0, 0), (0, width - 3 * count)))
        rows = np.empty((sum(members.size for members in self._members), width), dtype=np.float32)
        wide = rows.view(np.complex128).reshape(len(rows), *(() if width == 4 else (width // 4,)))
        for c, (block, members) in enumerate(zip(self._blocks, self._members, strict=True)):
            product = _product(block, lit[self._ranks[c] : self._ranks[c + 1]], 3 * count)
            wide[members] = product.view(np.complex128).reshape(len(product), *wide.shape[1:])
        return np.moveaxis(rows[:, : 3 * count].reshape(-1, count, 3), 1, 0)

    def adjoint(self, gradient: NDArray) -> NDArray[np.float64]:
        """(B, 3, (L+1)²) from gradients (B, V, 3) of radiance: the transpose of `apply`."""
        count = len(gradient)
        given = np.moveaxis(np.asarray(gradient, dtype=np.float32), 0, 1).reshape(-1, 3 * count)
        lit = np.empty((int(self._ranks[-1]), 3 * count), dtype=np.float32)
        for c, (block, members) in enumerate(zip(self._blocks, self._members, strict=True)):
            lit[self._ranks[c] : self._ranks[c + 1]] = block.T @ given[members]
        by_light = lit.reshape(-1, count, 3).astype(np.float64)
        channels, size = self._functions.shape[1:]
        result = np.empty((count, 3, size))
        for c in range(3):
            result[:, c] = by_light[:, :, c].T @ self._functions[:, c if channels == 3 else 0]
        return result

    def _lit(self, lighting: NDArray) -> NDArray[np.float32]:
        """(all functions, 3 B): what each function makes of each light in each colour."""
        lights = np.asarray(lighting, dtype=np.float32)
        channels, size = self._functions.shape[1:]
        if channels == 1:
            return self._functions[:, 0] @ lights.reshape(-1, size).T
        lit = np.empty((len(self._functions), len(lights), 3), dtype=np.float32)
        for c in range(3):
            lit[:, :, c] = self._functions[:, c] @ lights[:, c].T
        return lit.reshape(len(self._functions), -1)


def _product(block: NDArray[np.float32], lit: NDArray[np.float32], columns: int) -> NDArray[np.float32]:
    """(n, r) times (r, k), of which only the first ``columns`` matter."""
    if block.shape[1] < _LONG or columns > 3:
        return np.asarray(block @ lit)
    product = np.empty((len(block), lit.shape[1]), dtype=np.float32)
    for column in range(columns):
        product[:, column] = block @ np.ascontiguousarray(lit[:, column])
    return product


# --- From compressed transfer ----------------------------------------------------------------------------------------


def transfer_operator(packed: CompressedTransfer) -> TransferOperator:
    """What lighting is multiplied with for unit albedo; made at the first use, kept as long as the transfer is.

    Of coded transfer, functions are left out that hold less than a hundredth of its error.
    """
    known = _operators.get(packed)
    if known is None:
        known = _operators[packed] = TransferOperator(all_factors(packed), packed.clusters.members)
        forget(packed)  # what was decoded is as large as what was made of it
    return known


_operators: WeakKeyDictionary[CompressedTransfer, TransferOperator] = WeakKeyDictionary()
