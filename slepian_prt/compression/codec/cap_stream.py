"""Whole numbers of several caps as words and bits: tokens by their models, then signs and the lowest bits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.codec.lanes import LaneReader, LaneWords, ModelTable, Symbols, encode_lanes
from slepian_prt.compression.codec.models import extra_bits_of, lowest_of, tokens_of
from slepian_prt.compression.codec.raw_bits import BitReader, BitWriter

# Bits that a lane holds at least: each lane takes some four bytes more.
_LANE_BITS = 8 * 400
_MOST_LANES = (1 << 16) - 1


@dataclass(frozen=True, eq=False)
class CapBytes:
    """What a file holds of one cap.

    Attributes
    ----------
    lanes : LaneWords
    bits : (n,) uint8
    width : int
        Components of which something is told; the others are zero throughout.
    principal_axes : bool
    """

    lanes: LaneWords
    bits: NDArray[np.uint8]
    width: int
    principal_axes: bool

    @property
    def size(self) -> int:
        """Bytes."""
        return 2 * (self.lanes.words.size + self.lanes.lengths.size) + self.bits.size


class CapsWriter:
    """Collects numbers of several caps in the order in which they will be read."""

    def __init__(self, caps: int, table: ModelTable) -> None:
        self._table = table
        self._calls: list[Symbols] = []
        self._bits = BitWriter(caps)
        self._caps = np.arange(caps)

    def symbols(self, counts: NDArray[np.int64], symbols: NDArray[np.int64], models: NDArray) -> None:
        """Symbols (n,) by models (n,), ``counts`` (caps,) of each cap."""
        self._calls.append(Symbols(counts, models.astype(np.int64), symbols))

    def numbers(self, counts: NDArray[np.int64], numbers: NDArray[np.int64], models: NDArray) -> None:
        """Numbers from 0 on."""
        tokens = tokens_of(numbers, models)
        self.symbols(counts, tokens, models)
        self._extra_bits(counts, tokens, numbers)

    def values(self, counts: NDArray[np.int64], values: NDArray[np.integer], models: NDArray) -> None:
        """Numbers with a sign."""
        values = values.astype(np.int64)
        tokens = tokens_of(np.abs(values), models)
        self.symbols(counts, tokens, models)
        signed = np.flatnonzero(values)
        self._bits.write(np.repeat(self._caps, counts)[signed], values[signed] < 0)
        self._extra_bits(counts, tokens, np.abs(values))

    def _extra_bits(self, counts: NDArray[np.int64], tokens: NDArray[np.int64], numbers: NDArray[np.int64]) -> None:
        lengths = extra_bits_of(tokens)
        longer = np.flatnonzero(lengths)
        rest = numbers[longer] - lowest_of(tokens[longer])
        self._bits.write_numbers(np.repeat(self._caps, counts)[longer], rest, lengths[longer])

    def finish(self) -> list[tuple[LaneWords, NDArray[np.uint8]]]:
        """Words and bits of each cap."""
        counts = np.zeros(self._caps.size, dtype=np.int64)
        costs = np.zeros(self._caps.size)
        for call in self._calls:
            counts += call.counts
            costs += np.bincount(
                np.repeat(self._caps, call.counts),
                self._table.bits[call.models, call.symbols],
                minlength=self._caps.size,
            )
        # Lanes in proportion to symbols, so that all end at about the same step.
        wanted = counts * (costs.sum() / _LANE_BITS / max(1, int(counts.sum())))
        lanes = np.where(counts > 0, np.clip(np.rint(wanted), 1, _MOST_LANES), 0).astype(np.int64)
        return list(zip(encode_lanes(self._calls, lanes, self._table), self._bits.finish(), strict=True))


class CapsReader:
    """Reads what `CapsWriter` collected.

    Parameters
    ----------
    caps : sequence of CapBytes
    table : ModelTable
    """

    def __init__(self, caps: Sequence[CapBytes], table: ModelTable) -> None:
        self._lanes = LaneReader([cap.lanes for cap in caps], table)
        self._bits = BitReader([cap.bits for cap in caps])
        self._caps = np.arange(len(caps))

    def symbols(self, counts: NDArray[np.int64], models: NDArray) -> NDArray[np.int64]:
        """(n,) symbols by models (n,), ``counts`` (caps,) of each cap."""
        return self._lanes.read(counts, models)

    def numbers(self, counts: NDArray[np.int64], models: NDArray) -> NDArray[np.int64]:
        """(n,) numbers from 0 on."""
        return self._numbers(counts, self.symbols(counts, models))

    def values(self, counts: NDArray[np.int64], models: NDArray) -> NDArray[np.int64]:
        """(n,) numbers with a sign."""
        tokens = self.symbols(counts, models)
        signed = np.flatnonzero(tokens)
        owners = np.repeat(self._caps, counts)[signed]
        negative = self._bits.read(np.bincount(owners, minlength=self._caps.size))
        numbers = self._numbers(counts, tokens)
        numbers[signed] *= 1 - 2 * negative.astype(np.int64)
        return numbers

    def _numbers(self, counts: NDArray[np.int64], tokens: NDArray[np.int64]) -> NDArray[np.int64]:
        numbers = lowest_of(tokens)
        lengths = extra_bits_of(tokens)
        longer = np.flatnonzero(lengths)
        if longer.size:
            numbers[longer] += self._bits.read_numbers(np.repeat(self._caps, counts)[longer], lengths[longer])
        return numbers

    def check_end(self) -> None:
        """Raise ValueError unless all was read."""
        self._lanes.check_end()
        self._bits.check_end()


def zigzag(values: NDArray[np.int64]) -> NDArray[np.int64]:
    """0, -1, 1, -2, ... as 0, 1, 2, 3, ..."""
    return np.where(values < 0, -2 * values - 1, 2 * values)


def from_zigzag(numbers: NDArray[np.int64]) -> NDArray[np.int64]:
    """The inverse of `zigzag`."""
    return np.where(numbers % 2 == 1, -(numbers + 1) // 2, numbers // 2)
