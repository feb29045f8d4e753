"""Compressed transfer as the matrix that lighting is multiplied with, kept in the factors it is compressed to.

Within a cap, T ≈ C F with few functions F and coefficients C, so that radiance is C (F e): F e is small, and what takes
time is to read C once. Its speed is that of the memory, if all caps are multiplied by few calls, which need no threads.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.compression.decoder import forget
from slepian_prt.machine.kept import Kept
from slepian_prt.machine.threads import one_blas_thread
from slepian_prt.relighting.factors import Factors, all_factors

# OpenBLAS multiplies by one thread where rows, columns and what is summed multiply to no more than this. Threads that
# wait for each other made one light of a skull take 17 ms instead of 1 on a busy machine.
_ALONE = 1 << 18

# One light in three colours takes four columns: rows of whole 16 bytes are moved at the speed of a copy.
_COLUMNS = 4

# Rows of a tile, and columns of a strip: less costs calls, more falls out of the nearest cache (140 columns took 1.7 ms
# in strips of 48, and 3.9 in one piece). A tile of a fourth of a cap leaves an eighth of its rows empty.
_TILE = 128
_STRIP = 64
_TILES_PER_CAP = 4

# Caps whose numbers of functions are equal when rounded up to a multiple of this are multiplied together.
_ALIKE = 4


@dataclass(frozen=True)
class TileGroup:
    """Caps with equally many functions, in tiles of equally many rows, so that one call multiplies all of them.

    Attributes
    ----------
    strips : tuple of (T, n, w) float32
        Coefficients, by strips of w functions; the last rows of a cap's last tile are zero.
    functions : (T, r)
        Which functions those of each tile are.
    rows : slice
        Of the products of all groups.
    """

    strips: tuple[NDArray[np.float32], ...]
    functions: NDArray[np.intp]
    rows: slice

    def multiply(self, lit: NDArray[np.float32], product: NDArray[np.float32]) -> None:
        """Fill its rows of ``product`` (rows, 4); ``lit`` (all functions, 4)."""
        if not len(self.functions):  # caps that hold no vertex
            return
        lit = lit.view(np.complex128)[:, 0].take(self.functions).view(np.float32)
        lit = lit.reshape(*self.functions.shape, _COLUMNS)
        result = product[self.rows].reshape(len(lit), -1, _COLUMNS)
        first = 0
        for strip in self.strips:
            part = lit[:, first : first + strip.shape[2]]
            if first == 0:
                np.matmul(strip, part, out=result)
            else:
                result += strip @ part
            first += strip.shape[2]


class TransferOperator:
    """Radiance from lighting, and gradients of lighting from those of radiance.

    Parameters
    ----------
    parts : Factors of each cap
    members : vertices of each cap

    Attributes
    ----------
    functions : (R, channels, (L+1)²) float32
        Those of all caps, and zeros.
    groups : list of TileGroup
    rows : int
        Of the products of all groups.
    places : (V,)
        Which of them are the vertices'.
    """

    def __init__(self, parts: Sequence[Factors], members: Sequence[NDArray]) -> None:
        self._members = list(members)
        ranks = np.array([max(1, -(-len(part.functions) // _ALIKE)) * _ALIKE for part in parts])
        ends = np.cumsum(ranks)
        self._functions_of = [slice(int(end - rank), int(end)) for end, rank in zip(ends, ranks, strict=True)]
        self.functions = _stacked([part.functions for part in parts], self._functions_of)
        self._blocks: list[tuple[NDArray[np.float32], ...]] = [()] * len(parts)
        self.places = np.empty(sum(m.size for m in self._members), dtype=np.intp)
        self.groups: list[TileGroup] = []
        self.rows = 0
        for rank in np.unique(ranks):
            self._add_group(np.flatnonzero(ranks == rank).tolist(), [part.coefficients for part in parts], int(rank))

    def _add_group(self, caps: Sequence[int], coefficients: Sequence[NDArray], rank: int) -> None:
        """Lay the coefficients of caps with ``rank`` functions out in tiles."""
        sizes = [self._members[c].size for c in caps]
        height = int(np.clip(sum(sizes) // (len(caps) * _TILES_PER_CAP), 8, _TILE))
        counts = [-(-size // height) for size in sizes]
        width = -(-rank // -(-rank // _STRIP))
        strips = tuple(
            np.zeros((sum(counts), height, min(width, rank - first)), dtype=np.float32)
            for first in range(0, rank, width)
        )
        functions = np.empty((sum(counts), rank), dtype=np.intp)
        begin = 0
        for c, size, count in zip(caps, sizes, counts, strict=True):
            tiles = slice(begin, begin + count)
            block = tuple(strip[tiles].reshape(-1, strip.shape[2])[:size] for strip in strips)
            given = coefficients[c].shape[1]
            for i, strip in enumerate(block):
                end = min(i * width + strip.shape[1], given)
                strip[:, : max(0, end - i * width)] = coefficients[c][:, i * width : end]
            self._blocks[c] = block
            functions[tiles] = np.arange(self._functions_of[c].start, self._functions_of[c].stop)
            self.places[self._members[c]] = self.rows + begin * height + np.arange(size)
            begin += count
        rows = slice(self.rows, self.rows + begin * height)
        self.groups.append(TileGroup(strips, functions, rows))
        self.rows = rows.stop

    @property
    def size(self) -> int:
        """Numbers that are read for each light: coefficients and functions."""
        return sum(strip.size for group in self.groups for strip in group.strips) + self.functions.size

    @one_blas_thread()
    def apply(self, lighting: NDArray) -> NDArray[np.float32]:
        """(B, V, 3) radiance for unit albedo under B lightings (B, 3, (L+1)²)."""
        lights = np.asarray(lighting, dtype=np.float32)
        if len(lights) == 1:
            return self._apply_one(lights[0])[None]
        return self._apply_many(lights)

    @one_blas_thread()
    def adjoint(self, gradient: NDArray) -> NDArray[np.float64]:
        """(B, 3, (L+1)²) from gradients (B, V, 3) of radiance: the transpose of `apply`."""
        count = len(gradient)
        given = np.moveaxis(np.asarray(gradient, dtype=np.float32), 0, 1).reshape(-1, 3 * count)
        lit = np.zeros((len(self.functions), 3 * count), dtype=np.float32)
        for block, members, functions in zip(self._blocks, self._members, self._functions_of, strict=True):
            here = given[members]
            np.concatenate([strip.T @ here for strip in block], out=lit[functions])
        by_light = lit.reshape(-1, count, 3).astype(np.float64)
        channels, size = self.functions.shape[1:]
        result = np.empty((count, 3, size))
        for c in range(3):
            result[:, c] = by_light[:, :, c].T @ self.functions[:, c if channels == 3 else 0]
        return result

    def _apply_one(self, light: NDArray[np.float32]) -> NDArray[np.float32]:
        """(V, 3) from (3, (L+1)²)."""
        channels, size = self.functions.shape[1:]
        columns = np.zeros((channels, size, _COLUMNS), dtype=np.float32)
        for c in range(3):
            columns[c if channels == 3 else 0, :, c] = light[c]
        summed = channels * size
        pieces = self.functions.reshape(-1, _piece(summed), summed)
        lit = (pieces @ columns.reshape(summed, _COLUMNS)).reshape(-1, _COLUMNS)
        product = np.empty((self.rows, _COLUMNS), dtype=np.float32)
        for group in self.groups:
            group.multiply(lit, product)
        radiance = product.view(np.complex128)[:, 0].take(self.places)
        return radiance.view(np.float32).reshape(-1, _COLUMNS)[:, :3]

    def _apply_many(self, lights: NDArray[np.float32]) -> NDArray[np.float32]:
        """(B, V, 3) from (B, 3, (L+1)²), cap by cap: the product of all would be as large as what is asked for."""
        count = len(lights)
        channels, size = self.functions.shape[1:]
        width = -(-3 * count // _COLUMNS) * _COLUMNS
        lit = np.zeros((len(self.functions), width), dtype=np.float32)
        if channels == 1:
            lit[:, : 3 * count] = self.functions[:, 0] @ lights.reshape(-1, size).T
        else:
            for c in range(3):
                lit[:, c : 3 * count : 3] = self.functions[:, c] @ lights[:, c].T
        rows = np.empty((len(self.places), width // _COLUMNS), dtype=np.complex128)
        for block, members, functions in zip(self._blocks, self._members, self._functions_of, strict=True):
            here, first = lit[functions], block[0].shape[1]
            product = block[0] @ here[:first]
            for strip in block[1:]:
                product += strip @ here[first : first + strip.shape[1]]
                first += strip.shape[1]
            rows[members] = product.view(np.complex128)
        return np.moveaxis(rows.view(np.float32)[:, : 3 * count].reshape(-1, count, 3), 1, 0)


def _stacked(functions: Sequence[NDArray], places: Sequence[slice]) -> NDArray[np.float32]:
    """All functions, each cap's at its place, zero between; as many as make whole pieces."""
    channels, size = functions[0].shape[1:]
    piece = _piece(channels * size)
    stacked = np.zeros((-(-places[-1].stop // piece) * piece, channels, size), dtype=np.float32)
    for part, place in zip(functions, places, strict=True):
        stacked[place.start : place.start + len(part)] = part
    return stacked


def _piece(summed: int) -> int:
    """Rows that one thread multiplies by the columns of one light, where so many products are summed."""
    return max(1, _ALONE // (_COLUMNS * summed))


# --- From compressed transfer ----------------------------------------------------------------------------------------


def transfer_operator(packed: CompressedTransfer) -> TransferOperator:
    """What lighting is multiplied with for unit albedo; made at the first use, kept as long as the transfer is.

    Of coded transfer, functions are left out that hold less than a hundredth of its error.
    """

    def make() -> TransferOperator:
        pairs = zip(all_factors(packed), packed.clusters.members, strict=True)
        parts, members = zip(*((part, own) for part, own in pairs if own.size), strict=True)
        made = TransferOperator(parts, members)
        forget(packed)  # what was decoded is as large as what was made of it
        return made

    return _operators.of(packed, make)


_operators: Kept[CompressedTransfer, TransferOperator] = Kept()
