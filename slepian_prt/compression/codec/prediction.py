"""Coefficients of a cap predicted along the surface and rounded, in integer arithmetic.

Each coefficient is predicted from those of neighbours *as decoded*, in sixteenths of a step, times a gain; what differs
is rounded, small differences to zero. Which entropy model codes a difference, its *context*, is told by the size usual
for its component and by how much the neighbours of its vertex differed from their predictions. Decoders compute the
very same predictions and contexts on any machine.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.codec.entropy import DEAD_ZONE
from slepian_prt.compression.codec.surface import CapSurface, Level

# Predictions and decoded values are multiples of a step over this.
PARTS = 16

# The coarsest and finest values that fit the integers: multiples of the step.
LARGEST_MULTIPLE = 1 << 24

# Gains of predictions are stored in 1/32.
GAIN_PARTS = 32
USUAL_GAIN = 29

# Sizes of components: class c stands for a mean difference of 2^((c - 20) / 2); 0 for no difference at all.
CLASSES = 34
# A row's differences against what is usual: thresholds in quarter octaves.
_ROWS = 20
CONTEXTS = 2 * CLASSES + _ROWS
# What is usual counts this much beside what the neighbours had.
_USUAL = 0.3


@dataclass(frozen=True)
class Tuning:
    """What all caps of a file are coded with.

    Attributes
    ----------
    step : float
    gains : (2, K) uint8
        Prediction gain of each component, in 1/32: from neighbours on the surface, and from those on the curve.
    models : (CONTEXTS,) uint8
        Entropy model for each context.
    """

    step: float
    gains: NDArray[np.uint8]
    models: NDArray[np.uint8]


@dataclass(frozen=True)
class Coded:
    """Coefficients of all caps as they are in the file.

    Attributes
    ----------
    tuning : Tuning
    words : tuple of (n,) uint32
        Of each cap.
    """

    tuning: Tuning
    words: tuple[NDArray[np.uint32], ...]


@dataclass(frozen=True)
class Differences:
    """What one pass over a cap gives.

    Attributes
    ----------
    values : (N, A) int32, in surface order
    multiples : (N, A) int64
    rows : (N,) uint8
        Context of each row.
    classes : (A,) uint8
    """

    values: NDArray[np.int32]
    multiples: NDArray[np.int64]
    rows: NDArray[np.uint8]
    classes: NDArray[np.uint8]

    @property
    def contexts(self) -> NDArray[np.int64]:
        return self.rows[:, None].astype(np.int64) + 2 * self.classes.astype(np.int64)


def predict_and_round(coefficients: NDArray, surface: CapSurface, tuning: Tuning) -> Differences:
    """Predict and round along the surface; ``coefficients`` (N, A) in surface order."""
    x = coefficients / tuning.step
    count, width = x.shape
    values = np.zeros((count, width), dtype=np.int32)
    multiples = np.zeros((count, width), dtype=np.int64)
    sizes = np.zeros(count, dtype=np.int64)
    around = np.zeros(count)
    gains = gains_of(tuning.gains, width)

    def code(rows: NDArray | slice, predicted: NDArray) -> None:
        apart = x[rows] - predicted / PARTS
        size = np.abs(apart)
        values[rows] = np.sign(apart) * np.where(size < DEAD_ZONE, 0.0, np.maximum(np.rint(size), 1.0))
        multiples[rows] = predicted + PARTS * values[rows].astype(np.int64)
        sizes[rows] = np.abs(values[rows].astype(np.int64)).sum(axis=1)

    code(slice(0, 1), np.zeros((1, width), dtype=np.int64))
    for level in surface.levels:
        around[level.rows] = neighbour_activity(level, sizes)
        code(level.rows, predicted_multiples(level, multiples, gains))
    classes = _classes(values)
    return Differences(values, multiples, row_contexts(around, classes), classes)


def predicted_multiples(level: Level, multiples: NDArray[np.int64], gains: NDArray[np.int64]) -> NDArray[np.int64]:
    """Weighted means times their gains of what is known, rounded half up."""
    gain = gains[level.on_curve.astype(np.intp)]
    divisor = (GAIN_PARTS * level.totals)[:, None]
    sums = np.asarray(level.sources @ multiples)
    return np.asarray((2 * sums * gain + divisor) // (2 * divisor))


def neighbour_activity(level: Level, sizes: NDArray[np.int64]) -> NDArray[np.float64]:
    """Weighted mean of how much the known neighbours differed from their predictions, over all components."""
    return np.asarray(level.sources @ sizes) / level.totals


def gains_of(gains: NDArray[np.uint8], width: int) -> NDArray[np.int64]:
    full = np.full((2, width), USUAL_GAIN, dtype=np.int64)
    known = min(width, gains.shape[1])
    full[:, :known] = gains[:, :known]
    return full


def _classes(values: NDArray[np.int32]) -> NDArray[np.uint8]:
    """Size class of each component."""
    mean = np.abs(values).mean(axis=0)
    with np.errstate(divide="ignore"):
        kind = np.clip(np.rint(2.0 * np.log2(mean)) + 20.0, 1, CLASSES - 1)
    return np.where(mean > 0.0, kind, 0).astype(np.uint8)


def octave_parts(first: int, count: int, per_octave: int) -> NDArray[np.float64]:
    """2^((first + i) / per_octave), the same on every machine: by integer roots, not by a library's power."""
    scale = 1 << 60
    found = []
    for i in range(first, first + count):
        whole, part = divmod(i, per_octave)
        power = 1 << (60 * per_octave + part)
        root = power
        # per_octave is 2 or 4: square roots all the way
        for _ in range(per_octave.bit_length() - 1):
            root = math.isqrt(root)
        found.append(root / scale * 2.0**whole)
    return np.array(found)


_CLASS_MEANS = np.concatenate([[0.0], octave_parts(1 - 20, CLASSES - 1, 2)])
_ROW_EDGES = octave_parts(-8, _ROWS - 1, 4)


def row_contexts(around: NDArray[np.float64], classes: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """How active each vertex's neighbours are against the cap's mean, 0 to _ROWS - 1."""
    usual = math.fsum(_CLASS_MEANS[classes])  # rounded once: the same on every machine
    if usual == 0.0:
        return np.zeros(around.size, dtype=np.uint8)
    ratio = (around + _USUAL * usual) / ((1.0 + _USUAL) * usual)
    return np.searchsorted(_ROW_EDGES, ratio).astype(np.uint8)


def by_model(contexts: NDArray[np.int64], models: NDArray[np.uint8]) -> list[tuple[int, NDArray[np.int64]]]:
    """Places of a level's symbols, (n, A) flattened, by the entropy model that codes them."""
    if contexts.size == 0:
        return []
    chosen = models[contexts.ravel()]
    order = np.argsort(chosen, kind="stable")
    numbers, starts = np.unique(chosen[order], return_index=True)
    return [(int(number), places) for number, places in zip(numbers, np.split(order, starts[1:]), strict=True)]
