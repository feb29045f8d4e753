"""What all caps of a file are coded with: step, prediction gains and entropy models, fitted to some of the caps."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.codec.entropy import ESCAPE, LARGEST, bit_costs, probabilities, symbols_of
from slepian_prt.compression.codec.prediction import (
    CONTEXTS,
    GAIN_PARTS,
    LARGEST_MULTIPLE,
    PARTS,
    USUAL_GAIN,
    Differences,
    Tuning,
    predict_and_round,
)
from slepian_prt.compression.codec.surface import CapSurface

# A context's nominal model counts as this many differences seen.
_NOMINAL_WEIGHT = 4.0

# Steps are tried until rounding makes at least this part of the distortion that it may make, or so many times.
_ENOUGH = 0.93
_SEARCHES = 8


def tune(samples: Sequence[tuple[NDArray, CapSurface]], distortion: float, smallest_step: float = 0.0) -> Tuning:
    """Step, prediction gains and models for a wanted distortion, from some of the caps.

    Parameters
    ----------
    samples : sequence of ((N, K) coefficients in surface order, CapSurface)
    distortion : float
        Wanted sum of squares over the samples of what rounding changes.
    smallest_step : float
        So that multiples of the step stay within `LARGEST_MULTIPLE`.
    """
    samples = [(np.asarray(x, dtype=np.float64), surface) for x, surface in samples]
    gains = _fit_gains(samples)
    nominal = _nominal_models()

    def rounding(step: float) -> float:
        tuning = Tuning(step, gains, nominal)
        return sum(
            float(np.sum((predict_and_round(x, surface, tuning).multiples * (step / PARTS) - x) ** 2))
            for x, surface in samples
        )

    step = max(_search_step(rounding, distortion, samples), smallest_step)
    tuning = Tuning(step, gains, nominal)
    return Tuning(step, gains, _fit_models([predict_and_round(x, surface, tuning) for x, surface in samples]))


def _search_step(
    rounding: Callable[[float], float], distortion: float, samples: Sequence[tuple[NDArray, CapSurface]]
) -> float:
    """The step whose rounding adds up to ``distortion``, nearly; what is coded with it is measured anyway."""
    everything = sum(float(np.sum(x**2)) for x, _ in samples)
    largest = max((float(np.abs(x).max(initial=0.0)) for x, _ in samples), default=0.0)
    if largest == 0.0 or distortion >= everything:
        return max(4.0 * largest, 1e-30)  # nothing needs to be kept
    finest = largest / LARGEST_MULTIPLE
    step = max(math.sqrt(12.0 * distortion / sum(x.size for x, _ in samples)), finest)
    for _ in range(_SEARCHES):
        found = rounding(step)
        if _ENOUGH * distortion <= found <= distortion:
            break
        step = max(next_step(step, found, 0.5 * (1.0 + _ENOUGH) * distortion), finest)
    return step


def next_step(step: float, found: float, wanted: float) -> float:
    """A step nearer to a wanted distortion, which grows with a power of the step between one and two."""
    return step * min(max((wanted / found) ** 0.65, 0.25), 4.0) if found > 0.0 else 4.0 * step


def _fit_gains(samples: Sequence[tuple[NDArray, CapSurface]]) -> NDArray[np.uint8]:
    """Least squares over the samples: how much of the mean of neighbours predicts a component."""
    widest = max(x.shape[1] for x, _ in samples)
    products, squares = np.zeros((2, widest)), np.zeros((2, widest))
    for x, surface in samples:
        width = x.shape[1]
        for level in surface.levels:
            mean = np.asarray(level.sources @ x) / level.totals[:, None]
            for kind in (0, 1):
                rows = level.on_curve == bool(kind)
                products[kind, :width] += (mean[rows] * x[level.rows[rows]]).sum(axis=0)
                squares[kind, :width] += (mean[rows] ** 2).sum(axis=0)
    ratio = np.divide(products, squares, out=np.full_like(products, USUAL_GAIN / GAIN_PARTS), where=squares > 0)
    return np.clip(np.rint(ratio * GAIN_PARTS), 0, GAIN_PARTS).astype(np.uint8)


@functools.cache
def _nominal_models() -> NDArray[np.uint8]:
    """The model whose mean size is what a context stands for, 2^((c - 48) / 4)."""
    sizes = np.abs(np.concatenate([np.arange(-LARGEST, LARGEST + 1), [LARGEST + 1]]))
    means = probabilities() @ sizes
    wanted = 0.25 * (np.arange(CONTEXTS) - 48)
    return np.abs(np.log2(means)[None, :] - wanted[:, None]).argmin(axis=1).astype(np.uint8)


def _fit_models(passes: Sequence[Differences]) -> NDArray[np.uint8]:
    """The model that codes what was seen in each context with the fewest bits; the nominal one where little was."""
    counts = _NOMINAL_WEIGHT * probabilities()[_nominal_models()]
    for found in passes:
        active = np.flatnonzero(found.classes)
        key = found.contexts[:, active] * (ESCAPE + 1) + symbols_of(found.values[:, active])
        counts += np.bincount(key.ravel(), minlength=counts.size).reshape(counts.shape)
    return np.asarray(np.argmin(counts @ bit_costs().T, axis=1), dtype=np.uint8)
