"""Coded numbers of a .prt file, as docs/file-format.md has them under "Lanes" and "Tokens"; without our code."""

from __future__ import annotations

import bisect
import decimal
import itertools
import math
from collections.abc import Sequence

import numpy as np

TOKEN_MODELS = 168


class Lanes:
    """The numbers of a cap: symbols from its lanes and bits from its bytes; ``models`` are lists of frequencies."""

    def __init__(self, counts: list[int], words: list[int], raw: bytes, models: list[list[int]]) -> None:
        self.frequencies = models
        self.starts = [list(itertools.accumulate(model, initial=0)) for model in models]
        ends = itertools.accumulate(counts, initial=0)
        self.words = [words[begin:end] for begin, end in itertools.pairwise(ends)]
        self.taken = [2] * len(counts)
        self.states = [own[0] * 2**16 + own[1] for own in self.words]
        self.raw, self.used = raw, 0

    def _symbol(self, lane: int, model: int) -> int:
        state = self.states[lane]
        slot = state % 2**12
        symbol = bisect.bisect_right(self.starts[model], slot) - 1
        state = state // 2**12 * self.frequencies[model][symbol] + slot - self.starts[model][symbol]
        if state < 2**16:
            state = state * 2**16 + self.words[lane][self.taken[lane]]
            self.taken[lane] += 1
        self.states[lane] = state
        return symbol

    def symbols(self, models: Sequence[int]) -> list[int]:
        return [self._symbol(i % len(self.states), model) for i, model in enumerate(models)]

    def bits(self, count: int) -> int:
        """A number whose highest bit comes first."""
        number = 0
        for _ in range(count):
            number = 2 * number + (self.raw[self.used // 8] >> (7 - self.used % 8) & 1)
            self.used += 1
        return number

    def _sizes(self, tokens: list[int]) -> list[int]:
        return [smallest(token) + self.bits(extra_bits(token)) for token in tokens]

    def numbers(self, models: Sequence[int]) -> list[int]:
        return self._sizes(self.symbols(models))

    def values(self, models: Sequence[int]) -> list[int]:
        tokens = self.symbols(models)
        signs = [-1 if token and self.bits(1) else 1 for token in tokens]
        return [sign * size for sign, size in zip(signs, self._sizes(tokens), strict=True)]

    def check_end(self) -> None:
        assert all(state == 2**16 for state in self.states)
        assert self.taken == [len(own) for own in self.words]
        assert (self.used + 7) // 8 == len(self.raw)
        assert self.bits(8 * len(self.raw) - self.used) == 0


def zigzag(number: int) -> int:
    return number // 2 if number % 2 == 0 else -(number + 1) // 2


def extra_bits(token: int) -> int:
    if token < 16:
        return 0
    return 32 if token == 32 else token - 15


def smallest(token: int) -> int:
    """The smallest number of a token; of the last, which holds all numbers, none."""
    if token < 16:
        return token
    return 0 if token == 32 else 14 + 2 ** (token - 15)


# --- Frequencies -----------------------------------------------------------------------------------------------------


def filled(frequencies: list[int]) -> list[int]:
    """What is lacking of 2¹² goes to the largest, the first of several."""
    frequencies[frequencies.index(max(frequencies))] += 2**12 - sum(frequencies)
    return frequencies


def token_frequencies() -> list[list[int]]:
    """Of each of the 168 models, the 33 frequencies, which add up to 2¹²."""
    with decimal.localcontext() as context:
        context.prec = 40
        tails = [tails_of_size(i) for i in range(56)]
        return [row_of_tokens(tail, decimal.Decimal(odds)) for odds in ("1", "0.5", "2") for tail in tails]


def tails_of_size(i: int) -> list[decimal.Decimal]:
    """T(m) for the smallest number m of each token, 0 … 32."""
    D = decimal.Decimal
    tails = [D(1)] + [D(0)] * 32
    for size, part in (("0.6", "0.4"), ("1", "0.4"), ("2", "0.2")):
        decay = 16 / D(2).sqrt().sqrt() ** i / D(size)
        tails[1] += D(part) * (-D("0.64") * decay).exp()
        for token in range(2, 33):
            m = smallest(token) if token < 32 else 131086
            tails[token] += D(part) * (-decay * (m - D("0.5"))).exp()
    return tails


def row_of_tokens(tails: list[decimal.Decimal], odds: decimal.Decimal) -> list[int]:
    half = decimal.Decimal("0.5")
    not_zero = 1 / (1 + odds * (1 - tails[1]) / tails[1])
    shares = [1 - not_zero]
    shares += [(tails[t] - tails[t + 1]) / tails[1] * not_zero for t in range(1, 32)]
    row = [math.floor(2**12 * p + half) for p in shares]
    rare = sum(p for p, frequency in zip(shares, row, strict=True) if frequency == 0)
    last = math.floor(2**12 * (tails[32] / tails[1] * not_zero + rare) + half)
    return filled([*row, max(last, 1)])


def width_frequencies(widths: np.ndarray) -> list[list[int]]:
    """(T, 16) codes of shares; the frequencies of each table."""
    rows = []
    for codes in widths.tolist():
        shares = [share(q) for q in codes]
        rows.append(filled([1 + 4080 * s // sum(shares) for s in shares]))
    return rows


def share(q: int) -> int:
    return round(2**20 * power_of_two(-q, 8))


def power_of_two(numerator: int, denominator: int) -> float:
    """2^(numerator / denominator) as the format has it, by integer square roots."""
    whole, part = divmod(numerator, denominator)
    root = 1 << (60 * denominator + part)
    for _ in range(denominator.bit_length() - 1):
        root = math.isqrt(root)
    return root / 2**60 * 2.0**whole
