"""What all caps of a file are coded with: step, prediction gains and contexts, fitted to some of the caps."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.codec.axes import round_axes
from slepian_prt.compression.codec.caps import CodingAttempt, Tuning, cheaper, round_frugally
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
from slepian_prt.compression.codec.models import LADDER, TOKENS, frequencies, mean_magnitudes, plain_tokens, token_bits
from slepian_prt.compression.codec.prediction import (
    GAIN_PARTS,
    LARGEST_GAIN,
    LARGEST_MULTIPLE,
    PARTS,
    SHRINK_PARTS,
    Differences,
    Predictor,
    predict_and_round,
    round_with_dead_zone,
    usual_steps,
)
from slepian_prt.compression.codec.surface import WEIGHT, CapRows
from slepian_prt.compression.codec.telling import Telling, tell

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
    width = max(part.shape[1] for part in samples)
    x = np.zeros((len(rows), width))
    for part, rows_of_cap in zip(samples, rows.by_member, strict=True):
        x[rows_of_cap, : part.shape[1]] = part
    predictor = fit_predictor(x, rows)

    def attempt(step: float) -> tuple[Differences, Telling]:
        scaled = x * (PARTS / step)
        first = predict_and_round(scaled, rows, predictor, round_with_dead_zone).values
        return round_frugally(scaled, rows, predictor, fit_contexts(first, tell(first, rows)))

    def rounding(step: float) -> float:
        return float(np.sum((attempt(step)[0].multiples * (step / PARTS) - x) ** 2))

    count = sum(part.size for part in samples)
    step = max(_search_step(rounding, distortion, x, count), smallest_step)
    found, telling = attempt(step)
    contexts = fit_contexts(found.values, telling)
    return Tuning(step, predictor, _choice_of_axes(samples, rows, Tuning(step, predictor, contexts), principal_axes))


def _choice_of_axes(samples: Sequence[NDArray], rows: CapRows, tuning: Tuning, principal_axes: bool | None) -> Contexts:
    """Contexts fitted to caps that are coded along their principal axes, or to those for which that pays."""
    plain = CodingAttempt(samples, [None] * len(samples), rows, tuning)
    axes = [round_axes(part, tuning.step) if len(part) else None for part in samples]
    if principal_axes is False or all(own is None for own in axes):
        return tuning.contexts
    along = plain.along(axes)
    # By contexts of its own: those of the others have not seen such widths.
    along = along.with_contexts(fit_contexts(along.differences.values, along.telling))
    chosen = along if principal_axes else cheaper(along, plain)
    return fit_contexts(chosen.differences.values, chosen.telling)


def _search_step(rounding: Callable[[float], float], distortion: float, x: NDArray, count: int) -> float:
    """The step whose rounding adds up to ``distortion``, nearly; what is coded with it is measured anyway."""
    everything = float(np.sum(x**2))
    largest = float(np.abs(x).max(initial=0.0))
    if largest == 0.0 or distortion >= everything:
        return max(4.0 * largest, 1e-30)  # nothing needs to be kept
    finest = largest / LARGEST_MULTIPLE
    step = max(math.sqrt(12.0 * distortion / count), finest)
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
