"""Magnitudes as tokens, and how probable each token is: a ladder of fixed models in integers.

A token is a magnitude, or a range of magnitudes whose lowest bits follow as they are. The models are Laplace
distributions with a dead zone, mixed as measured, computed in exact decimals and rounded to parts of 2¹², so that every
machine has the same.
"""

from __future__ import annotations

import decimal
import functools
import math

import numpy as np
from numpy.typing import NDArray

# Probabilities are parts of 2^12: their tables stay in the cache of a processor.
PRECISION = 12
WHOLE = 1 << PRECISION

# Values below this part of a step are coded as zero. Rounding up to a half would be closer, but costs more bits than
# it is worth: best at low and high rate on two scans.
DEAD_ZONE = 0.64

# Magnitudes below this are tokens of their own. Token DIRECT + j stands for the 2^(j+1) magnitudes from
# DIRECT - 2 + 2^(j+1) on; then follows the escape, of any magnitude.
DIRECT = 16
RANGES = 16
ESCAPE = DIRECT + RANGES
TOKENS = ESCAPE + 1
ESCAPE_BITS = 32

# Decay λ = 16 · 2^(-i/4) of the i-th of a ladder, and what is mixed. There are three ladders: the odds of zero are the
# distribution's own, half and twice them.
LADDER = 56
_ODDS = ("1", "0.5", "2")
MODELS = len(_ODDS) * LADDER
_MIXTURE = (("0.6", "0.4"), ("1", "0.4"), ("2", "0.2"))  # (size relative to the model's, part)

_LOWEST = np.array([*range(DIRECT), *(DIRECT - 2 + (2 << j) for j in range(RANGES)), 0], dtype=np.int64)
_EXTRA_BITS = np.array([0] * DIRECT + [j + 1 for j in range(RANGES)] + [ESCAPE_BITS], dtype=np.int64)
_BEYOND = DIRECT - 2 + (2 << RANGES)


@functools.cache
def frequencies() -> NDArray[np.uint32]:
    """(MODELS, TOKENS) parts of `WHOLE`.

    Zero where a token is rarer than half a part: such magnitudes are escaped.
    """
    with decimal.localcontext() as context:
        context.prec = 40
        fourth_root = decimal.Decimal(2).sqrt().sqrt()
        ladder = [_tails(16 / fourth_root**i) for i in range(LADDER)]
        return np.array([_frequencies(ends, decimal.Decimal(o)) for o in _ODDS for ends in ladder], dtype=np.uint32)


def _tails(decay: decimal.Decimal) -> list[decimal.Decimal]:
    """Of each token, how probable its magnitudes or larger ones are."""
    ends = [decimal.Decimal(0)] * (ESCAPE + 1)
    for size, part in _MIXTURE:
        own, weight = decay / decimal.Decimal(size), decimal.Decimal(part)
        ends[0] += weight
        ends[1] += weight * (-own * decimal.Decimal(str(DEAD_ZONE))).exp()
        # Beyond: e^(-own (m - 1/2)) for the smallest magnitude m of the token.
        tail, ratio = weight * (-own * decimal.Decimal("1.5")).exp(), (-own).exp()
        for token in range(2, ESCAPE + 1):
            ends[token] += tail
            if token >= DIRECT:
                ratio *= ratio
            tail *= ratio
    return ends


def _frequencies(ends: list[decimal.Decimal], odds: decimal.Decimal) -> list[int]:
    """Parts of each token, the odds of zero changed by a factor."""
    others = 1 / (1 + odds * (1 - ends[1]) / ends[1])
    parts = [(1 - others) * WHOLE]
    parts += [(ends[token] - ends[token + 1]) / ends[1] * others * WHOLE for token in range(1, ESCAPE)]
    half = decimal.Decimal("0.5")
    found = [int(part + half) if part >= half else 0 for part in parts]
    rarer = sum(part for part, whole in zip(parts, found, strict=True) if whole == 0)
    found.append(max(1, int(ends[ESCAPE] / ends[1] * others * WHOLE + rarer + half)))
    found[found.index(max(found))] += WHOLE - sum(found)
    return found


def tokens_of(magnitudes: NDArray, models: NDArray) -> NDArray[np.int64]:
    """The token of each magnitude by its model: the escape where the model has no other."""
    tokens = plain_tokens(magnitudes)
    return np.where(frequencies()[models, tokens] > 0, tokens, ESCAPE)


def plain_tokens(magnitudes: NDArray) -> NDArray[np.int64]:
    """The token of each magnitude where no model is too quiet for it."""
    magnitudes = np.asarray(magnitudes, dtype=np.int64)
    tokens = np.minimum(magnitudes, DIRECT)
    large = magnitudes >= DIRECT
    if large.any():
        exponents = np.frexp((magnitudes[large] - (DIRECT - 2)).astype(np.float64))[1] - 2
        tokens[large] = np.where(magnitudes[large] >= _BEYOND, ESCAPE, DIRECT + exponents)
    return tokens


def lowest_of(tokens: NDArray) -> NDArray[np.int64]:
    """The smallest magnitude of each token, 0 for the escape."""
    return _LOWEST[tokens]


def extra_bits_of(tokens: NDArray) -> NDArray[np.int64]:
    """How many bits of its own follow each token: what is added to the smallest magnitude."""
    return _EXTRA_BITS[tokens]


@functools.cache
def token_bits() -> NDArray[np.float64]:
    """(MODELS, TOKENS) bits that each plain token costs, with its sign and what follows it."""
    parts = frequencies().astype(np.float64)
    escaped = -np.log2(parts[:, ESCAPE:] / WHOLE) + ESCAPE_BITS
    with np.errstate(divide="ignore"):
        bits = np.where(parts > 0, -np.log2(parts / WHOLE) + _EXTRA_BITS, escaped)
    bits[:, 1:] += 1.0
    return bits


@functools.cache
def mean_magnitudes() -> NDArray[np.float64]:
    """(MODELS,) means of the distributions."""
    middles = lowest_of(np.arange(ESCAPE)) + 0.5 * ((1 << extra_bits_of(np.arange(ESCAPE))) - 1)
    parts = frequencies().astype(np.float64) / WHOLE
    return np.asarray(parts[:, :ESCAPE] @ middles)


def power_parts(first: int, count: int, per_octave: int) -> NDArray[np.float64]:
    """2^((first + i) / per_octave), the same on every machine: by integer roots, not by a library's power.

    ``per_octave`` is a power of two.
    """
    scale = 1 << 60
    found = []
    for i in range(first, first + count):
        whole, part = divmod(i, per_octave)
        root = 1 << (60 * per_octave + part)
        for _ in range(per_octave.bit_length() - 1):
            root = math.isqrt(root)
        found.append(root / scale * 2.0**whole)
    return np.array(found)
