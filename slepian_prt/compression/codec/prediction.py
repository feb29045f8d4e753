"""Coefficients predicted along the surface and rounded, in whole numbers.

Each coefficient is predicted from those of neighbours *as decoded*, in sixteenths of a step: their weighted mean,
shrunk where they are few or far, times a gain. What differs is rounded, to finer steps on coarser levels, from which
others are predicted. Decoders compute the very same predictions on any machine: the numbers are held in float64, and
are so small that all sums and products are exact and the quotient rounds down correctly.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.codec.models import DEAD_ZONE
from slepian_prt.compression.codec.surface import DEPTHS, WEIGHT, CapRows, Level

# Predictions and decoded values are multiples of a step over this.
PARTS = 16

# The largest value that fits, in steps: 2^28 parts. Weights add up to 64 times 5,120 at most, and are multiplied by
# twice a gain of at most 48: sums stay below 2^53. A quotient below 2^29 whose divisor is below 2^24.4 is further from
# the whole number above it than what float64 rounds, 2^-25.
LARGEST_MULTIPLE = 1 << 24

# Gains of predictions are stored in 1/32, and so is what is added to the sum of the weights, in those of two
# neighbours an edge apart.
GAIN_PARTS = 32
LARGEST_GAIN = 48
SHRINK_PARTS = 32

# Steps of the levels, in parts, from the finest level up; as of hierarchical pictures in video.
USUAL_STEPS = (16, 15, 14, 12, 11)

Rounding = Callable[[Level, NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]]


@dataclass(frozen=True, eq=False)
class Predictor:
    """How much of what neighbours have is foretold of each component.

    Attributes
    ----------
    gains : (2, K) uint8
        In 1/32: of neighbours on the surface, and of those on the curve.
    shrinkage : (2, K) uint8
        In 1/32 of the weight of a neighbour an edge away, added to the sum of the weights.
    steps : (DEPTHS,) uint8
        Of levels of each depth, in parts.
    """

    gains: NDArray[np.uint8]
    shrinkage: NDArray[np.uint8]
    steps: NDArray[np.uint8]

    def predict(self, level: Level, multiples: NDArray[np.float64]) -> NDArray[np.float64]:
        """(rows, width) of a level, in parts, from the ``multiples`` (n, width) of those before; zero for the first."""
        if level.sources is None:
            return np.zeros((level.rows.stop - level.rows.start, multiples.shape[1]))
        known = multiples[: level.rows.start]
        predicted = self._mean(level.sources @ known, level.totals, 0)
        if level.on_curve.any():  # few: once more with their own gains
            alone = np.flatnonzero(level.on_curve)
            predicted[alone] = self._mean(level.sources[alone] @ known, level.totals[alone], 1)
        return predicted

    def of_width(self, width: int) -> Predictor:
        """For so many components: those that no sample had are foretold as the last that one had."""
        wider = ((0, 0), (0, max(0, width - self.gains.shape[1])))
        gains, shrinkage = (np.pad(part, wider, "edge")[:, :width] for part in (self.gains, self.shrinkage))
        return replace(self, gains=gains, shrinkage=shrinkage)

    def _mean(self, sums: NDArray[np.float64], totals: NDArray[np.float64], kind: int) -> NDArray[np.float64]:
        """Sums over shrunk totals, times gains, rounded half up."""
        width = sums.shape[1]
        added = self.shrinkage[kind, :width].astype(np.float64) * (WEIGHT // SHRINK_PARTS)
        divisor = totals[:, None] + added
        divisor *= GAIN_PARTS
        sums *= 2.0 * self.gains[kind, :width].astype(np.float64)
        sums += divisor
        divisor *= 2.0
        sums /= divisor
        return np.floor(sums, out=sums)


@dataclass(frozen=True, eq=False)
class Differences:
    """What one pass over some caps gives.

    Attributes
    ----------
    values : (n, width) int32
        Rounded differences, in the order of the rows.
    multiples : (n, width) float64
        What decoders will have, in parts.
    """

    values: NDArray[np.int32]
    multiples: NDArray[np.float64]


def predict_and_round(x: NDArray[np.float64], rows: CapRows, predictor: Predictor, rounding: Rounding) -> Differences:
    """Predict and round along the surface.

    Parameters
    ----------
    x : (n, width)
        Coefficients in parts, in the order of the rows.
    rows : CapRows
    predictor : Predictor
    rounding : callable
        From a level, differences (rows, width) in steps of the level, and the sums of rounded magnitudes (n,) of the
        rows before: the differences rounded.
    """
    values = np.zeros(x.shape, dtype=np.int32)
    multiples, sizes = np.zeros(x.shape), np.zeros(len(x))
    for level in rows.levels:
        predicted = predictor.predict(level, multiples)
        step = float(predictor.steps[level.depth])
        apart = x[level.rows] - predicted
        apart /= step
        rounded = rounding(level, apart, sizes)
        sizes[level.rows] = np.abs(rounded).sum(axis=1)
        values[level.rows] = rounded
        rounded *= step
        predicted += rounded
        multiples[level.rows] = predicted
    return Differences(values, multiples)


def round_with_dead_zone(level: Level, apart: NDArray[np.float64], sizes: NDArray[np.float64]) -> NDArray[np.float64]:
    """To the nearest whole number, small ones to zero."""
    size = np.abs(apart)
    return np.copysign(np.where(size < DEAD_ZONE, 0.0, np.maximum(np.rint(size), 1.0)), apart)


def neighbour_activity(rows: CapRows, sizes: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n,) weighted means of how much the known neighbours of each row differed; see `level_activity`."""
    return np.concatenate([np.zeros(0), *(level_activity(level, sizes) for level in rows.levels)])


def level_activity(level: Level, sizes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Weighted means of ``sizes`` (n,) over what the rows of a level are predicted from; zero for what comes first."""
    if level.sources is None:
        return np.zeros(level.rows.stop - level.rows.start)
    return np.asarray(level.sources @ sizes[: level.rows.start]) / level.totals


def usual_steps() -> NDArray[np.uint8]:
    """(DEPTHS,) as of `Predictor`."""
    assert len(USUAL_STEPS) == DEPTHS
    return np.array(USUAL_STEPS, dtype=np.uint8)
