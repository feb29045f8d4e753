"""What all caps of a file are coded with: step, prediction gains and contexts, fitted to some of the caps."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.codec.axes import RoundedAxes
from slepian_prt.compression.codec.caps import Tuning
from slepian_prt.compression.codec.contexts import (
    BASES,
    WIDTH_CONTEXTS,
    WIDTHS,
    Contexts,
    context_sizes,
    magnitude_bases,
    magnitude_contexts,
    stored_changes,
    stored_shares,
)
from slepian_prt.compression.codec.encoding import CapCoefficients, FirstPass, RoundedCaps
from slepian_prt.compression.codec.models import LADDER, TOKENS, frequencies, mean_magnitudes, plain_tokens, token_bits
from slepian_prt.compression.codec.prediction import (
    GAIN_PARTS,
    LARGEST_GAIN,
    LARGEST_MULTIPLE,
    PARTS,
    SHRINK_PARTS,
    Predictor,
    usual_steps,
)
from slepian_prt.compression.codec.surface import WEIGHT, CapRows
from slepian_prt.compression.codec.telling import Telling

# A context's nominal model counts as this many differences seen.
_NOMINAL_WEIGHT = 4.0

# Shrinkages that are tried, in 1/32.
_SHRINKAGES = (0, 2, 4, 8, 16, 32, 64)
_USUAL_GAIN = 29

# What a table of widths costs in a file, and at most so many of them.
_TABLE_BITS = 70.0
_MOST_TABLES = 32

# Steps are tried until rounding makes at least this part of the distortion that it may make, or so many times.
_ENOUGH = 0.93
_SEARCHES = 8


def tune(
    samples: Sequence[NDArray],
    rows: CapRows,
    distortion: float,
    smallest_step: float = 0.0,
    principal_axes: bool | None = False,
) -> Tuning:
    """Step, prediction gains and contexts for a wanted distortion, from some of the caps.

    Parameters
    ----------
    samples : sequence of (N, K)
        Coefficients of each cap, in the order of its members.
    rows : CapRows
        Of these caps.
    distortion : float
        Wanted sum of squares over the samples of what rounding changes.
    smallest_step : float
        So that multiples of the step stay within `LARGEST_MULTIPLE`.
    principal_axes : bool or None
        As of `encode_caps`, of all caps.
    """
    caps = CapCoefficients(samples, rows)
    nothing: list[RoundedAxes | None] = [None] * len(samples)
    x = caps.along(nothing, PARTS)
    predictor = fit_predictor(x, rows)

    def first_pass(step: float) -> FirstPass:
        return FirstPass(caps, nothing, Tuning(step, predictor, nominal_contexts()))

    def found(first: FirstPass) -> float:
        return float(np.sum((first.differences.multiples - first.x) ** 2)) * (first.tuning.step / PARTS) ** 2

    count = sum(part.size for part in samples)
    begin = max(math.sqrt(12.0 * distortion / max(count, 1)), smallest_step, 1e-30)
    coarse = first_pass(begin)
    # Rounding up less often loses more, by nearly the same factor at all steps.
    frugal = RoundedCaps(_with_fitted_contexts(coarse)).distortion / max(found(coarse), 1e-300)
    step = _search_step(lambda step: frugal * found(first_pass(step)), distortion, x, begin)
    plain = _with_fitted_contexts(first_pass(max(step, smallest_step)))
    chosen = RoundedCaps(_choice_of_axes(plain, principal_axes))
    return replace(plain.tuning, contexts=fit_contexts(chosen.differences.values, chosen.telling))


def _with_fitted_contexts(first: FirstPass) -> FirstPass:
    first.tuning = replace(first.tuning, contexts=fit_contexts(first.differences.values, first.telling))
    return first


def _choice_of_axes(plain: FirstPass, principal_axes: bool | None) -> FirstPass:
    """Caps along their principal axes, or those for which that pays."""
    axes = plain.caps.axes(plain.tuning)
    if principal_axes is False or all(own is None for own in axes):
        return plain
    # By contexts of its own: those of the others have not seen such widths.
    along = FirstPass(plain.caps, axes, plain.tuning)
    contexts = fit_contexts(along.differences.values, along.telling)
    return along if principal_axes else along.or_cheaper(plain, contexts)


def _search_step(rounding: Callable[[float], float], distortion: float, x: NDArray, step: float) -> float:
    """The step whose rounding adds up to ``distortion``, nearly; what is coded with it is measured anyway."""
    everything = float(np.sum(x**2))
    largest = float(np.abs(x).max(initial=0.0))
    if largest == 0.0 or distortion >= everything:
        return max(4.0 * largest, 1e-30)  # nothing needs to be kept
    finest = largest / LARGEST_MULTIPLE
    step = max(step, finest)
    for _ in range(_SEARCHES):
        found = rounding(step)
        if _ENOUGH * distortion <= found <= distortion:
            break
        step = max(next_step(step, found, 0.5 * (1.0 + _ENOUGH) * distortion), finest)
    return step


def next_step(step: float, found: float, wanted: float) -> float:
    """A step nearer to a wanted distortion, which grows with a power of the step between one and two."""
    return step * min(max((wanted / found) ** 0.65, 0.25), 4.0) if found > 0.0 else 4.0 * step


def fit_predictor(x: NDArray, rows: CapRows) -> Predictor:
    """Least squares over coefficients (n, width) in the order of the rows, for each component."""
    x = x if x.shape[1] else np.zeros((len(x), 1))  # other caps may have components
    tried, width = len(_SHRINKAGES), x.shape[1]
    products, squares = np.zeros((2, tried, width)), np.zeros((2, tried, width))
    for level in rows.levels:
        if level.sources is None:
            continue
        sums, own = np.asarray(level.sources @ x[: level.rows.start]), x[level.rows]
        for kind in (0, 1):
            some = level.on_curve == bool(kind)
            for i, shrinkage in enumerate(_SHRINKAGES):
                mean = sums[some] / (level.totals[some] + shrinkage * (WEIGHT // SHRINK_PARTS))[:, None]
                products[kind, i] += (mean * own[some]).sum(axis=0)
                squares[kind, i] += (mean**2).sum(axis=0)
    usual = np.full_like(products, _USUAL_GAIN / GAIN_PARTS)
    gains = np.divide(products, squares, out=usual, where=squares > 0)
    gains = np.clip(np.rint(gains * GAIN_PARTS), 0, LARGEST_GAIN) / GAIN_PARTS
    best = np.argmax(2.0 * gains * products - gains**2 * squares, axis=1)
    chosen = np.take_along_axis(gains, best[:, None], axis=1)[:, 0] * GAIN_PARTS
    return Predictor(chosen.astype(np.uint8), np.array(_SHRINKAGES, dtype=np.uint8)[best], usual_steps())


@functools.cache
def _nominal_models() -> NDArray[np.uint8]:
    """The model whose mean is what a context stands for."""
    return (
        np.abs(np.log2(mean_magnitudes()[:LADDER])[None, :] - np.log2(context_sizes())[:, None])
        .argmin(axis=1)
        .astype(np.uint8)
    )


@functools.cache
def nominal_contexts() -> Contexts:
    """Those of a file of which nothing is known yet."""
    tables = np.zeros((1, WIDTHS), dtype=np.uint8), np.zeros(WIDTH_CONTEXTS, dtype=np.uint8)
    return Contexts(_nominal_models(), stored_changes(np.zeros(BASES), np.zeros(BASES)), *tables)


def fit_contexts(values: NDArray[np.int32], telling: Telling) -> Contexts:
    """The models that code what was seen in each context with the fewest bits; nominal ones where little was."""
    shares = frequencies()[_nominal_models()].astype(np.float64)
    counts = _NOMINAL_WEIGHT * shares / shares.sum(axis=1, keepdims=True)
    places = telling.places
    tokens = plain_tokens(np.abs(values[places.rows, places.components]))
    key = magnitude_contexts(places.bases, places.octaves) * TOKENS + tokens
    counts += np.bincount(key, minlength=counts.size).reshape(counts.shape)
    models = np.argmin(counts @ token_bits().T, axis=1).astype(np.uint8)
    begun = Contexts(
        models,
        _fit_changes(values, telling),
        np.zeros((1, WIDTHS), dtype=np.uint8),
        np.zeros(WIDTH_CONTEXTS, dtype=np.uint8),
    )
    key = telling.width_contexts(begun) * WIDTHS + telling.widths
    seen = np.bincount(key, minlength=WIDTH_CONTEXTS * WIDTHS).reshape(-1, WIDTHS).astype(np.float64)
    groups = _merge(seen)
    tables = np.array([seen[groups == group].sum(axis=0) for group in range(groups.max() + 1)])
    return Contexts(models, begun.changes, stored_shares(tables), groups.astype(np.uint8))


def _fit_changes(values: NDArray[np.int32], telling: Telling) -> NDArray[np.uint8]:
    classes = telling.classes[telling.rows.caps]
    bases = magnitude_bases(telling.activities[:, None], classes)[classes > 0]
    changed = values[:, : classes.shape[1]][classes > 0] != 0
    return stored_changes(np.bincount(bases, minlength=BASES), np.bincount(bases, changed, minlength=BASES))


def _merge(counts: NDArray[np.float64]) -> NDArray[np.int64]:
    """(contexts,) groups of contexts (contexts, symbols) that are alike enough to share one table.

    The two whose union costs the fewest bits more are merged until what a table takes itself would be lost.
    """
    groups = np.zeros(len(counts), dtype=np.int64)
    held = np.flatnonzero(counts.sum(axis=1) > 0)
    if held.size == 0:
        return groups
    tables, members = counts[held].copy(), [[int(c)] for c in held]
    costs = _entropy(tables)
    while len(tables) > 1:
        extra = _entropy(tables[:, None] + tables[None]) - costs[:, None] - costs[None]
        np.fill_diagonal(extra, np.inf)
        a, b = np.unravel_index(int(extra.argmin()), extra.shape)
        if extra[a, b] >= _TABLE_BITS and len(tables) <= _MOST_TABLES:
            break
        tables[a] += tables[b]
        members[a] += members[b]
        tables = np.delete(tables, b, axis=0)
        del members[b]
        costs = _entropy(tables)
    for group, own in enumerate(members):
        groups[own] = group
    return groups


def _entropy(counts: NDArray[np.float64]) -> NDArray[np.float64]:
    """Bits of all that was counted, each row with its own distribution."""
    total = counts.sum(axis=-1)
    return np.asarray(
        total * np.log2(np.maximum(total, 1.0)) - (counts * np.log2(np.maximum(counts, 1.0))).sum(axis=-1)
    )
