"""Integers as bits: a ladder of fixed entropy models for asymmetric numeral systems.

The coder is that of the library `constriction`. The models are Laplace distributions with a dead zone, mixed as
measured, computed in exact decimals so that every machine has the same.
"""

from __future__ import annotations

import decimal
import functools
import math
from typing import Any

import constriction
import numpy as np
from numpy.typing import NDArray

_ANS = constriction.stream.stack.AnsCoder
_Categorical = constriction.stream.model.Categorical
_Uniform = constriction.stream.model.Uniform

# Values below this part of a step are coded as zero. Rounding up to a half would be closer, but costs more bits than
# it is worth: best at low and high rate on two scans.
DEAD_ZONE = 0.64

# Values beyond this are rare; they are coded as an escape, and then by themselves.
LARGEST = 96
ESCAPE = 2 * LARGEST + 1

# Decay λ = 16 · 2^(-i/4) of model i, and what is mixed.
MODELS = 56
_MIXTURE = (("0.6", "0.4"), ("1", "0.4"), ("2", "0.2"))  # (size relative to the model's, part)


@functools.cache
def probabilities() -> NDArray[np.float64]:
    """(MODELS, ESCAPE + 1) of the differences -LARGEST..LARGEST and of an escape; exact decimals, then rounded."""
    table = np.empty((MODELS, ESCAPE + 1))
    with decimal.localcontext() as context:
        context.prec = 40
        one, half = decimal.Decimal(1), decimal.Decimal("0.5")
        fourth_root = decimal.Decimal(2).sqrt().sqrt()
        for i in range(MODELS):
            row = [decimal.Decimal(0)] * (LARGEST + 2)
            for size, part in _MIXTURE:
                decay = 16 / fourth_root**i / decimal.Decimal(size)
                weight = decimal.Decimal(part)
                quiet, coded = (-decay * decimal.Decimal(str(DEAD_ZONE))).exp(), (-decay * decimal.Decimal("1.5")).exp()
                ratio = (-decay).exp()
                row[0] += weight * (one - quiet)
                row[1] += weight * half * (quiet - coded)
                tail = coded
                for k in range(2, LARGEST + 1):
                    row[k] += weight * half * tail * (one - ratio)
                    tail *= ratio
                row[-1] += weight * tail
            floor = decimal.Decimal(2) ** -22
            both = [*row[LARGEST:0:-1], *row[: LARGEST + 1], row[-1]]
            table[i] = [float(p + floor) for p in both]
    table /= np.array([math.fsum(row) for row in table])[:, None]
    return table


@functools.cache
def _model(number: int) -> Any:
    return _Categorical(probabilities()[number], perfect=False)


@functools.cache
def bit_costs() -> NDArray[np.float64]:
    """(MODELS, ESCAPE + 1) bits that each symbol costs."""
    bits = -np.log2(probabilities())
    bits[:, ESCAPE] += 32.0
    return bits


def symbols_of(values: NDArray[np.int32]) -> NDArray[np.int32]:
    return np.where(np.abs(values) > LARGEST, ESCAPE, values + LARGEST).astype(np.int32)


class Writer:
    """Collects symbols in the order in which they will be read."""

    def __init__(self) -> None:
        self._pieces: list[tuple[Any, NDArray[np.int32]]] = []

    def number(self, value: int, size: int) -> None:
        """One of 0..size-1, all alike."""
        if size > 1:
            self._pieces.append((_Uniform(size), np.array([value], dtype=np.int32)))

    def values(self, values: NDArray[np.int32], model: int) -> None:
        """Signed integers by an entropy model."""
        symbols = symbols_of(values)
        self._pieces.append((_model(model), symbols))
        for value in values[symbols == ESCAPE].tolist():
            zigzag = 2 * value if value >= 0 else -2 * value - 1
            self.number(zigzag >> 16, 1 << 16)
            self.number(zigzag & 0xFFFF, 1 << 16)

    def words(self) -> NDArray[np.uint32]:
        coder = _ANS()
        for model, symbols in reversed(self._pieces):  # a stack: the last in is the first out
            coder.encode_reverse(symbols, model)
        return np.asarray(coder.get_compressed(), dtype=np.uint32)


class Reader:
    def __init__(self, words: NDArray[np.uint32]) -> None:
        self._coder = _ANS(np.ascontiguousarray(words))

    def number(self, size: int) -> int:
        return int(self._coder.decode(_Uniform(size), 1)[0]) if size > 1 else 0

    def values(self, count: int, model: int) -> NDArray[np.int32]:
        symbols = np.asarray(self._coder.decode(_model(model), count))
        values = (symbols - LARGEST).astype(np.int32)
        for place in np.flatnonzero(symbols == ESCAPE):
            zigzag = (self.number(1 << 16) << 16) | self.number(1 << 16)
            values[place] = zigzag // 2 if zigzag % 2 == 0 else -(zigzag + 1) // 2
        return values

    def at_end(self) -> bool:
        return bool(self._coder.is_empty())
