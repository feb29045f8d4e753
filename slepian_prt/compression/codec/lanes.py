"""Interleaved entropy coding: each cap has lanes of its own, and all lanes of all caps make their steps together.

A lane is a range coder of asymmetric numeral systems (Duda 2013; interleaved as by Giesen 2014): a state of 32 bits,
words of 16 bits, probabilities of 12 bits, a model for each symbol. The i-th symbol of a cap in a call goes to its
lane i modulo the number of its lanes. Only integers take part. A cap decodes alone, and its lanes could be read by as
many threads.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.codec.models import PRECISION, WHOLE

# States are at least this between two symbols; it is where encoders begin and decoders have to end.
_START = 1 << 16

# Lanes make their steps together if these are so many times as many as the symbols at most, and so many more; else caps
# of similar numbers of steps do, so that files that make some lanes long and others many take no more time or memory.
_SPARE, _MORE = 8, 1 << 20

# Entries of decoding tables: what a slot says of frequency, place among those of its symbol, and symbol.
_FREQUENCY_SHIFT, _OFFSET_SHIFT = np.uint32(19), np.uint32(7)
_PRECISION, _WORD = np.uint32(PRECISION), np.uint32(16)
_SYMBOL_MASK = (1 << 7) - 1


class ModelTable:
    """Distributions that symbols may have.

    Parameters
    ----------
    frequencies : (models, symbols) integers
        Each row adds up to 2¹². At most 128 symbols.
    """

    def __init__(self, frequencies: NDArray) -> None:
        # The last row is that of lanes which have nothing to do: whatever their state, it stays.
        idle = np.zeros((1, frequencies.shape[1]), dtype=np.int64)
        idle[0, 0] = WHOLE
        parts = np.concatenate([frequencies.astype(np.int64), idle])
        self.idle = len(frequencies)
        self.frequencies = parts.astype(np.uint32)
        self.starts = (np.cumsum(parts, axis=1) - parts).astype(np.uint32)
        symbols = np.tile(np.arange(parts.shape[1]), len(parts))
        rows = np.repeat(symbols, parts.ravel())
        flat = np.repeat(np.arange(parts.size), parts.ravel())
        offsets = np.arange(WHOLE * len(parts)) % WHOLE - self.starts.ravel()[flat]
        entries = parts.ravel()[flat] << int(_FREQUENCY_SHIFT) | offsets << int(_OFFSET_SHIFT) | rows
        self.entries = entries.astype(np.uint32)

    @cached_property
    def bits(self) -> NDArray[np.float64]:
        """(models + 1, symbols) that each symbol costs; of those that a model lacks, as many as the rarest."""
        return np.asarray(PRECISION - np.log2(np.maximum(self.frequencies, 1)))


@dataclass(frozen=True)
class LaneWords:
    """What the lanes of one cap hold.

    Attributes
    ----------
    lengths : (lanes,) uint16
        Words of each lane.
    words : (n,) uint16
        Those of one lane after those of another, in the order of reading.
    """

    lengths: NDArray[np.uint16]
    words: NDArray[np.uint16]


@dataclass(frozen=True)
class Symbols:
    """Symbols of several caps that are coded in one call, those of one cap after those of another.

    Attributes
    ----------
    counts : (caps,)
        How many each cap has.
    models : (n,)
    symbols : (n,)
    """

    counts: NDArray[np.int64]
    models: NDArray[np.int64]
    symbols: NDArray[np.int64]


class _Grid:
    """Which symbol each lane has at each step of a call."""

    def __init__(self, lanes: NDArray[np.int64], counts: NDArray[np.int64]) -> None:
        starts = np.cumsum(counts) - counts
        per_lane = np.repeat(lanes, lanes)
        first = np.arange(per_lane.size) - np.repeat(np.cumsum(lanes) - lanes, lanes)
        held = np.repeat(counts, lanes)
        steps = int((-(-counts // np.maximum(lanes, 1))).max(initial=0))
        if np.any((lanes == 0) & (counts > 0)):
            raise ValueError("a cap with symbols and no lanes")
        places = first + per_lane * np.arange(steps)[:, None]
        self.used = places < held
        self.places = (places + np.repeat(starts, lanes))[self.used]

    def spread(self, values: NDArray, idle: int) -> NDArray:
        """(steps, lanes) values of the symbols, or ``idle``."""
        grid = np.full(self.used.shape, idle, dtype=values.dtype)
        grid[self.used] = values[self.places]
        return grid


def encode_lanes(calls: Sequence[Symbols], lanes: NDArray[np.int64], table: ModelTable) -> list[LaneWords]:
    """Words of each cap that `LaneReader` reads the same symbols from, call by call.

    Parameters
    ----------
    calls : sequence of Symbols
    lanes : (caps,)
        How many lanes each cap has: at least one where it has symbols.
    table : ModelTable
    """
    total = int(lanes.sum())
    state = np.full(total, _START, dtype=np.uint32)
    emitted: list[tuple[NDArray, NDArray]] = []
    for call in reversed(calls):  # a stack: what is read first is written last
        grid = _Grid(lanes, call.counts)
        models = grid.spread(call.models, table.idle)
        symbols = grid.spread(call.symbols, 0)
        frequencies = table.frequencies[models, symbols]
        starts = table.starts[models, symbols]
        for step in range(len(models) - 1, -1, -1):
            frequency = frequencies[step]
            full = np.flatnonzero((state >> (32 - PRECISION)) >= frequency)
            if full.size:
                emitted.append((full, (state[full] & 0xFFFF).astype(np.uint16)))
                state[full] >>= 16
            quotient = state // frequency
            state = (quotient << PRECISION) + (state - quotient * frequency) + starts[step]
    emitted.append((np.arange(total), (state & 0xFFFF).astype(np.uint16)))
    emitted.append((np.arange(total), (state >> 16).astype(np.uint16)))
    lane = np.concatenate([lane for lane, _ in reversed(emitted)])
    words = np.concatenate([word for _, word in reversed(emitted)])
    lengths = np.bincount(lane, minlength=total)
    if lengths.max(initial=0) >= 1 << 16:
        raise ValueError("a lane of more than 65,535 words")
    words = words[np.argsort(lane, kind="stable")]
    ends = np.cumsum(lanes)
    lengths_of = np.split(lengths.astype(np.uint16), ends[:-1])
    words_of = np.split(words, np.append(0, np.cumsum(lengths))[ends[:-1]])
    return [LaneWords(mine, held) for mine, held in zip(lengths_of, words_of, strict=True)]


class LaneReader:
    """Reads symbols of several caps, call by call.

    Parameters
    ----------
    caps : sequence of LaneWords
    table : ModelTable
    """

    def __init__(self, caps: Sequence[LaneWords], table: ModelTable) -> None:
        self._table = table
        self._lanes = np.array([cap.lengths.size for cap in caps], dtype=np.int64)
        lengths = np.concatenate([np.zeros(0, dtype=np.uint16), *(cap.lengths for cap in caps)]).astype(np.int64)
        # Reading beyond the end is found at the end: no state is where encoders begin then.
        self._words = np.concatenate([*(cap.words for cap in caps), np.zeros(2, dtype=np.uint16)]).astype(np.uint32)
        self._ends = np.cumsum(lengths)
        if self._ends.size and (lengths.min() < 2 or self._ends[-1] != self._words.size - 2):
            raise ValueError("number of words")
        first = self._ends - lengths
        self._state = (self._words[first] << _WORD) | self._words[first + 1]
        self._next = first + 2

    def read(self, counts: NDArray[np.int64], models: NDArray) -> NDArray[np.int64]:
        """(n,) symbols, ``counts`` (caps,) of each cap, by ``models`` (n,)."""
        steps = -(-counts // np.maximum(self._lanes, 1))
        if int(steps.max(initial=0)) * self._state.size <= _SPARE * int(counts.sum()) + _MORE:
            return self._read(self._lanes, counts, models, self._state, self._next)
        symbols = np.empty(models.size, dtype=np.int64)
        octaves, owners = np.frexp(steps)[1], np.repeat(np.arange(counts.size), counts)
        for octave in np.unique(octaves[counts > 0]):
            caps = octaves == octave
            mine, rows = np.repeat(caps, self._lanes), caps[owners]
            state, following = self._state[mine], self._next[mine]
            symbols[rows] = self._read(self._lanes[caps], counts[caps], models[rows], state, following)
            self._state[mine], self._next[mine] = state, following
        return symbols

    def _read(
        self, lanes: NDArray[np.int64], counts: NDArray[np.int64], models: NDArray, state: NDArray, following: NDArray
    ) -> NDArray[np.int64]:
        """As `read`, of some caps with their states and next words, which go on; all lanes make all steps."""
        grid = _Grid(lanes, counts)
        bases = grid.spread(models.astype(np.uint32), self._table.idle) << np.uint32(PRECISION)
        found = np.empty(bases.shape, dtype=np.uint32)
        words = self._words
        # Methods instead of functions: with so small arrays a call costs as much as its work.
        look_up, low = self._table.entries.take, np.uint32(WHOLE - 1)
        slots, offsets = np.empty((2, state.size), dtype=np.uint32)
        for base, entry in zip(bases, found, strict=True):
            np.bitwise_and(state, low, out=slots)
            slots += base
            look_up(slots, out=entry, mode="wrap")
            np.right_shift(entry, _OFFSET_SHIFT, out=offsets)
            offsets &= low
            state >>= _PRECISION
            np.right_shift(entry, _FREQUENCY_SHIFT, out=slots)
            state *= slots
            state += offsets
            empty = (state < _START).nonzero()[0]
            if empty.size:
                at = following[empty]
                state[empty] = (state[empty] << _WORD) | words.take(at, mode="clip")
                at += 1
                following[empty] = at
        symbols = np.empty(grid.places.size, dtype=np.int64)
        symbols[grid.places] = (found & np.uint32(_SYMBOL_MASK))[grid.used]
        return symbols

    def check_end(self) -> None:
        """Raise ValueError unless all words are read, and every lane is where its encoder began."""
        if np.any(self._next != self._ends) or np.any(self._state != _START):
            raise ValueError("words that do not end as they should")
