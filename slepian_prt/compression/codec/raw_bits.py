"""Bits that nothing can be foretold of, as they are: signs, and the lowest bits of large magnitudes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

# Numbers whose bits are apart at the same time: 32 of them take a kilobyte.
_AT_A_TIME = 1 << 16


class BitWriter:
    """Collects bits of several caps, call by call."""

    def __init__(self, caps: int) -> None:
        self._caps = caps
        self._bits: list[NDArray[np.uint8]] = []
        self._owners: list[NDArray[np.int64]] = []

    def write(self, owners: NDArray[np.int64], bits: NDArray) -> None:
        """Bits (n,) of the caps ``owners`` (n,), ascending."""
        self._owners.append(owners)
        self._bits.append(bits.astype(np.uint8))

    def write_numbers(self, owners: NDArray[np.int64], numbers: NDArray[np.int64], lengths: NDArray[np.int64]) -> None:
        """Numbers of so many bits each, the highest first."""
        shifts = _countdown(lengths)
        self.write(np.repeat(owners, lengths), np.repeat(numbers, lengths) >> shifts & 1)

    def finish(self) -> list[NDArray[np.uint8]]:
        """Bytes of each cap; the first bit is the highest, what is left of the last byte is zero."""
        owners = np.concatenate([np.zeros(0, dtype=np.int64), *self._owners])
        bits = np.concatenate([np.zeros(0, dtype=np.uint8), *self._bits])[np.argsort(owners, kind="stable")]
        counts = np.bincount(owners, minlength=self._caps)
        return [np.packbits(part) for part in np.split(bits, np.cumsum(counts)[:-1])]


class BitReader:
    """Reads bits of several caps, call by call."""

    def __init__(self, caps: Sequence[NDArray[np.uint8]]) -> None:
        sizes = 8 * np.array([part.size for part in caps], dtype=np.int64)
        self._bits = np.unpackbits(np.concatenate([np.zeros(0, dtype=np.uint8), *caps]))
        self._ends = np.cumsum(sizes)
        self._next = self._ends - sizes

    def read(self, counts: NDArray[np.int64]) -> NDArray[np.uint8]:
        """(n,) bits, ``counts`` (caps,) of each cap."""
        first, self._next = self._next, self._next + counts
        if np.any(self._next > self._ends):
            raise ValueError("bits cut short")
        starts = np.cumsum(counts) - counts
        return np.asarray(self._bits[np.arange(int(counts.sum())) + np.repeat(first - starts, counts)])

    def read_numbers(self, owners: NDArray[np.int64], lengths: NDArray[np.int64]) -> NDArray[np.int64]:
        """(n,) numbers of ``lengths`` (n,) bits of the caps ``owners`` (n,), ascending."""
        if lengths.size > _AT_A_TIME:
            parts = range(0, lengths.size, _AT_A_TIME)
            each = [self.read_numbers(owners[i : i + _AT_A_TIME], lengths[i : i + _AT_A_TIME]) for i in parts]
            return np.concatenate(each)
        counts = np.bincount(owners, lengths, minlength=self._ends.size).astype(np.int64)
        bits = self.read(counts).astype(np.int64) << _countdown(lengths)
        numbers = np.zeros(lengths.size, dtype=np.int64)
        np.add.at(numbers, np.repeat(np.arange(lengths.size), lengths), bits)
        return numbers

    def check_end(self) -> None:
        """Raise ValueError unless all is read but for the rest of the last byte, which has to be zero."""
        left = self._ends - self._next
        if np.any(left >= 8) or self.read(left).any():
            raise ValueError("bits left over")


def _countdown(lengths: NDArray[np.int64]) -> NDArray[np.int64]:
    """length-1 ... 0 for each length."""
    ends = np.cumsum(lengths)
    return np.repeat(ends, lengths) - 1 - np.arange(int(lengths.sum()))
