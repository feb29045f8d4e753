"""Coefficients of a cap as bits: predicted along the surface, rounded, entropy-coded.

Coefficients of an orthonormal basis are rounded with one step: reverse water-filling, because components whose
variance is below the distortion round to zero and cost next to nothing, and all others get the same distortion. A cap's
vertices are coded coarse to fine (`surface`): each coefficient is predicted from those of neighbours *as decoded*, in
sixteenths of a step and in integer arithmetic, and what differs is rounded, small differences to zero, and
entropy-coded (asymmetric numeral systems, by the library `constriction`). The model of a difference is chosen by the
size usual for its component and by how much its neighbours differed. Decoding is exact on any machine, and each cap
decodes by itself.

Optionally a cap's coefficients are first turned to their principal axes, which are then coded too.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.codec.entropy import (
    DEAD_ZONE,
    ESCAPE,
    LARGEST,
    MODELS,
    Reader,
    Writer,
    bit_costs,
    probabilities,
    symbols_of,
)
from slepian_prt.compression.codec.surface import CapSurface

# Predictions and decoded values are multiples of a step over this.
PARTS = 16

# The coarsest and finest values that fit the integers: multiples of the step.
LARGEST_MULTIPLE = 1 << 24

# Belief in a prediction is stored in 1/32.
_SHRINK = 32
_USUAL_SHRINK = 29

# Sizes of components: class c stands for a mean difference of 2^((c - 20) / 2); 0 for no difference at all.
_CLASSES = 34
# A row's differences against what is usual: thresholds in quarter octaves.
_ROWS = 20
CONTEXTS = 2 * _CLASSES + _ROWS
# What is usual counts this much beside what the neighbours had.
_USUAL = 0.3

# Entropy model of the steps between the classes of successive components.
_STEPS_OF_CLASSES = 20

# A context's nominal model counts as this many differences seen.
_BELIEF = 4.0

# Principal axes are kept down to this standard deviation in steps, to within this part of a step of what they carry,
# and stored in multiples of 2^-e.
_AXIS_COUNTS = 0.25
_AXIS_ERROR = 0.15
_COARSEST_AXES, _FINEST_AXES = 4, 15

# What a bit buys in distortion, in squared steps, when the step is changed a little: measured on two scans, 0.4 at 3 %
# and 1.1 at 15 % error. (Far above the 0.12 of a quantiser by itself: what is coded also predicts what follows.)
_DISTORTION_PER_BIT = 0.6

# Steps are tried until rounding makes at least this part of the distortion that it may make, or so many times.
_ENOUGH = 0.93
_SEARCHES = 8


@dataclass(frozen=True)
class Tuning:
    """What all caps of a file are coded with.

    Attributes
    ----------
    step : float
    shrink : (2, K) uint8
        How much of a prediction is believed for each component, in 1/32: from mesh neighbours, and from the curve.
    models : (CONTEXTS,) uint8
        Entropy model for each context.
    """

    step: float
    shrink: NDArray[np.uint8]
    models: NDArray[np.uint8]


@dataclass(frozen=True)
class DecodedCap:
    """Attributes
    ----------
    multiples : (N, A) int32
        Sixteenths of a step, in surface order.
    axes : (A, K) or None
        Orthonormal rows that turn them back into the K coefficients; None if they are the coefficients.
    """

    multiples: NDArray[np.int32]
    axes: NDArray[np.float64] | None


@dataclass(frozen=True)
class EncodedCap:
    """Attributes
    ----------
    words : (n,) uint32
    used : int
        Components that are not zero throughout.
    turned : bool
    distortion : float
        Sum of squares of what rounding (and turning) changed, in the units of the coefficients.
    errors : (K, K)
        Sum over the vertices of products of the coefficients' errors.
    decoded : DecodedCap or None
        What `decode_cap` would give, if it was wanted.
    """

    words: NDArray[np.uint32]
    used: int
    turned: bool
    distortion: float
    errors: NDArray[np.float64]
    decoded: DecodedCap | None = None

    def cost(self, step: float) -> float:
        """In bits, distortion counted as the bits that it would take to mend it."""
        return 32.0 * self.words.size + self.distortion / (_DISTORTION_PER_BIT * step**2)


# --- Prediction ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Differences:
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


def _passed(coefficients: NDArray, surface: CapSurface, tuning: Tuning) -> _Differences:
    """Predict and round along the surface; ``coefficients`` (N, A) in surface order."""
    x = coefficients / tuning.step
    count, width = x.shape
    values = np.zeros((count, width), dtype=np.int32)
    multiples = np.zeros((count, width), dtype=np.int64)
    sizes = np.zeros(count, dtype=np.int64)
    around = np.zeros(count)
    shrink = _widened(tuning.shrink, width)

    def code(rows: NDArray | slice, predicted: NDArray) -> None:
        apart = x[rows] - predicted / PARTS
        size = np.abs(apart)
        values[rows] = np.sign(apart) * np.where(size < DEAD_ZONE, 0.0, np.maximum(np.rint(size), 1.0))
        multiples[rows] = predicted + PARTS * values[rows].astype(np.int64)
        sizes[rows] = np.abs(values[rows].astype(np.int64)).sum(axis=1)

    code(slice(0, 1), np.zeros((1, width), dtype=np.int64))
    for level in surface.levels:
        around[level.rows] = _around(level, sizes)
        code(level.rows, _predicted(level, multiples, shrink))
    classes = _classes(values)
    return _Differences(values, multiples, _row_contexts(around, classes), classes)


def _predicted(level: Any, multiples: NDArray[np.int64], shrink: NDArray[np.int64]) -> NDArray[np.int64]:
    """Shrunken weighted means of what is known, rounded half up."""
    believed = shrink[level.on_curve.astype(np.intp)]
    divisor = (_SHRINK * level.totals)[:, None]
    sums = np.asarray(level.sources @ multiples)
    return np.asarray((2 * sums * believed + divisor) // (2 * divisor))


def _around(level: Any, sizes: NDArray[np.int64]) -> NDArray[np.float64]:
    """Weighted mean of how much the known neighbours differed from their predictions, over all components."""
    return np.asarray(level.sources @ sizes) / level.totals


def _widened(shrink: NDArray[np.uint8], width: int) -> NDArray[np.int64]:
    full = np.full((2, width), _USUAL_SHRINK, dtype=np.int64)
    known = min(width, shrink.shape[1])
    full[:, :known] = shrink[:, :known]
    return full


def _classes(values: NDArray[np.int32]) -> NDArray[np.uint8]:
    """Size class of each component."""
    mean = np.abs(values).mean(axis=0)
    with np.errstate(divide="ignore"):
        kind = np.clip(np.rint(2.0 * np.log2(mean)) + 20.0, 1, _CLASSES - 1)
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


_CLASS_MEANS = np.concatenate([[0.0], octave_parts(1 - 20, _CLASSES - 1, 2)])
_ROW_EDGES = octave_parts(-8, _ROWS - 1, 4)


def _row_contexts(around: NDArray[np.float64], classes: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """How active each vertex's neighbours are against the cap's mean, 0 to _ROWS - 1."""
    usual = math.fsum(_CLASS_MEANS[classes])  # rounded once: the same on every machine
    if usual == 0.0:
        return np.zeros(around.size, dtype=np.uint8)
    ratio = (around + _USUAL * usual) / ((1.0 + _USUAL) * usual)
    return np.searchsorted(_ROW_EDGES, ratio).astype(np.uint8)


def _grouped(contexts: NDArray[np.int64], models: NDArray[np.uint8]) -> list[tuple[int, NDArray[np.int64]]]:
    """Places of a level's symbols, (n, A) flattened, by the entropy model that codes them."""
    if contexts.size == 0:
        return []
    chosen = models[contexts.ravel()]
    order = np.argsort(chosen, kind="stable")
    numbers, starts = np.unique(chosen[order], return_index=True)
    return [(int(number), places) for number, places in zip(numbers, np.split(order, starts[1:]), strict=True)]


# --- Caps ------------------------------------------------------------------------------------------------------------


def encode_cap(
    coefficients: NDArray, surface: CapSurface, tuning: Tuning, *, turn: bool | None, keep: bool = False
) -> EncodedCap:
    """Code the coefficients of one cap.

    Parameters
    ----------
    coefficients : (N, K), in surface order, orthonormal
    surface : CapSurface
    tuning : Tuning
    turn : bool or None
        Turn them to their principal axes; None where that pays, the axes themselves counted.
    keep : bool
        Whether what will be decoded is wanted too.
    """
    x = np.asarray(coefficients, dtype=np.float64)
    rounded = _rounded_axes(x, tuning.step) if turn is not False else None
    choices = [None, rounded] if turn is None and rounded is not None else [rounded]
    return min((_encoded(x, surface, tuning, axes, keep) for axes in choices), key=lambda e: e.cost(tuning.step))


def decode_cap(words: NDArray[np.uint32], components: int, surface: CapSurface, tuning: Tuning) -> DecodedCap:
    """The inverse of `encode_cap`, exactly.

    Parameters
    ----------
    words : (n,) uint32
    components : int
        K.

    Raises
    ------
    ValueError
        The words are not those of such a cap.
    """
    reader = Reader(words)
    axes = None
    if reader.number(2) == 1:
        rounded = _Axes.read(reader, components)
        axes, components = rounded.rows, len(rounded.multiples)
    classes = _read_classes(reader, components)
    active = np.flatnonzero(classes)
    count = len(surface.order)
    values = np.zeros((count, active.size), dtype=np.int64)
    multiples = np.zeros((count, active.size), dtype=np.int64)
    sizes = np.zeros(count, dtype=np.int64)
    shrink = _widened(tuning.shrink, components)[:, active]

    def read(rows: NDArray[np.int64], around: NDArray, predicted: NDArray[np.int64]) -> None:
        contexts = _row_contexts(around, classes)[:, None].astype(np.int64) + 2 * classes[active].astype(np.int64)
        found = np.empty(contexts.size, dtype=np.int64)
        for number, places in _grouped(contexts, tuning.models):
            found[places] = reader.values(places.size, number)
        values[rows] = found.reshape(contexts.shape)
        multiples[rows] = predicted + PARTS * values[rows]
        sizes[rows] = np.abs(values[rows]).sum(axis=1)

    read(np.array([0]), np.zeros(1), np.zeros((1, active.size), dtype=np.int64))
    for level in surface.levels:
        read(level.rows, _around(level, sizes), _predicted(level, multiples, shrink))
    if not reader.at_end():
        raise ValueError("words left over")
    full = np.zeros((count, components), dtype=np.int32)
    full[:, active] = multiples
    return DecodedCap(full, axes)


def _encoded(x: NDArray, surface: CapSurface, tuning: Tuning, axes: _Axes | None, keep: bool) -> EncodedCap:
    """The cap's words, with or without turning."""
    found = _passed(x if axes is None else x @ axes.rows.T, surface, tuning)
    used = np.flatnonzero(found.classes)
    width = int(used[-1]) + 1 if used.size else 0
    writer = Writer()
    writer.number(int(axes is not None), 2)
    decoded = found.multiples * (tuning.step / PARTS)
    if axes is not None:
        # Axes after the last that is used need not be known.
        decoded = decoded[:, :width] @ axes.rows[:width]
        axes.first(width).write(writer)
    _write_classes(writer, found.classes[:width], width if axes is not None else x.shape[1])
    active = used
    contexts, values = found.contexts[:, active], found.values[:, active]
    for rows in (np.array([0]), *(level.rows for level in surface.levels)):
        for number, places in _grouped(contexts[rows], tuning.models):
            writer.values(values[rows].ravel()[places], number)
    missed = decoded - x
    kept = None
    if keep and axes is None:
        kept = DecodedCap(found.multiples.astype(np.int32), None)
    elif keep and axes is not None:
        kept = DecodedCap(found.multiples[:, :width].astype(np.int32), axes.first(width).rows)
    return EncodedCap(writer.words(), used.size, axes is not None, float(np.sum(missed**2)), missed.T @ missed, kept)


def _write_classes(writer: Writer, classes: NDArray[np.uint8], components: int) -> None:
    """How many components are used, and the steps from the class of each to that of the next."""
    writer.number(classes.size, components + 1)
    if classes.size:
        writer.number(int(classes[0]), _CLASSES)
        writer.values(classes[1:].astype(np.int32) - classes[:-1].astype(np.int32), _STEPS_OF_CLASSES)


def _read_classes(reader: Reader, components: int) -> NDArray[np.uint8]:
    classes = np.zeros(components, dtype=np.uint8)
    width = reader.number(components + 1)
    if width:
        first = reader.number(_CLASSES)
        found = np.cumsum(np.concatenate([[first], reader.values(width - 1, _STEPS_OF_CLASSES)]))
        if found.min() < 0 or found.max() >= _CLASSES:
            raise ValueError("class of a component")
        classes[:width] = found
    return classes


# --- Principal axes --------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Axes:
    """Rows that turn coefficients, in multiples of 2^-exponent.

    An axis needs no more digits than keep its part of the signal within a fraction of the step.

    Attributes
    ----------
    multiples : (A, K) int32
    exponents : (A,) int
    rows : (A, K)
        The same made orthonormal, in order.
    """

    multiples: NDArray[np.int32]
    exponents: NDArray[np.int64]
    rows: NDArray[np.float64]

    def first(self, count: int) -> _Axes:
        return _Axes(self.multiples[:count], self.exponents[:count], self.rows[:count])

    def write(self, writer: Writer) -> None:
        writer.number(len(self.multiples), self.multiples.shape[1] + 1)
        for row, exponent in zip(self.multiples, self.exponents.tolist(), strict=True):
            cost = bit_costs()[:, symbols_of(row)].sum(axis=1)
            model = int(np.argmin(cost))
            writer.number(exponent, _FINEST_AXES + 1)
            writer.number(model, MODELS)
            writer.values(row, model)

    @staticmethod
    def read(reader: Reader, components: int) -> _Axes:
        count = reader.number(components + 1)
        multiples = np.zeros((count, components), dtype=np.int32)
        exponents = np.zeros(count, dtype=np.int64)
        for i in range(count):
            exponents[i] = reader.number(_FINEST_AXES + 1)
            multiples[i] = reader.values(components, reader.number(MODELS))
        return _Axes(multiples, exponents, _orthonormal(multiples, exponents)[0])


def _rounded_axes(x: NDArray, step: float) -> _Axes | None:
    """Principal axes of coefficients (N, K), rounded; None where there is nothing to turn."""
    variances, vectors = np.linalg.eigh(x.T @ x / max(len(x), 1))
    sizes, vectors = np.sqrt(np.maximum(variances[::-1], 0.0)), vectors[:, ::-1].T
    kept = int(np.sum(sizes > _AXIS_COUNTS * step))
    if kept == 0:
        return None
    digits = np.ceil(np.log2(sizes[:kept] / (_AXIS_ERROR * step)))
    exponents = np.clip(digits, _COARSEST_AXES, _FINEST_AXES).astype(np.int64)
    multiples = np.rint(np.ldexp(vectors[:kept], exponents[:, None].astype(np.intc))).astype(np.int32)
    rows, lengths = _orthonormal(multiples, exponents)
    return _Axes(multiples, exponents, rows) if lengths.min() > 0.5 else None


def _orthonormal(multiples: NDArray, exponents: NDArray) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Gram-Schmidt of the rows in order, and how long each was beside those before it."""
    rows = np.ldexp(multiples.astype(np.float64), -exponents[:, None].astype(np.intc))
    q, r = np.linalg.qr(rows.T)
    lengths = np.diag(r)
    return (q * np.where(lengths < 0.0, -1.0, 1.0)).T, np.abs(lengths)


# --- Tuning ----------------------------------------------------------------------------------------------------------


def tune(samples: Sequence[tuple[NDArray, CapSurface]], distortion: float, smallest_step: float = 0.0) -> Tuning:
    """Step, beliefs and models for a wanted distortion, from some of the caps.

    Parameters
    ----------
    samples : sequence of ((N, K) coefficients in surface order, CapSurface)
    distortion : float
        Wanted sum of squares over the samples of what rounding changes.
    smallest_step : float
        So that multiples of the step stay within `LARGEST_MULTIPLE`.
    """
    samples = [(np.asarray(x, dtype=np.float64), surface) for x, surface in samples]
    shrink = _fit_shrinkage(samples)
    nominal = _nominal_models()

    def rounding(step: float) -> float:
        tuning = Tuning(step, shrink, nominal)
        return sum(
            float(np.sum((_passed(x, surface, tuning).multiples * (step / PARTS) - x) ** 2)) for x, surface in samples
        )

    step = max(_step_for(rounding, distortion, samples), smallest_step)
    tuning = Tuning(step, shrink, nominal)
    return Tuning(step, shrink, _fit_models([_passed(x, surface, tuning) for x, surface in samples]))


def _step_for(rounding: Any, distortion: float, samples: Sequence[tuple[NDArray, CapSurface]]) -> float:
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


def _fit_shrinkage(samples: Sequence[tuple[NDArray, CapSurface]]) -> NDArray[np.uint8]:
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
    ratio = np.divide(products, squares, out=np.full_like(products, _USUAL_SHRINK / _SHRINK), where=squares > 0)
    return np.clip(np.rint(ratio * _SHRINK), 0, _SHRINK).astype(np.uint8)


@functools.cache
def _nominal_models() -> NDArray[np.uint8]:
    """The model whose mean size is what a context stands for, 2^((c - 48) / 4)."""
    sizes = np.abs(np.concatenate([np.arange(-LARGEST, LARGEST + 1), [LARGEST + 1]]))
    means = probabilities() @ sizes
    wanted = 0.25 * (np.arange(CONTEXTS) - 48)
    return np.abs(np.log2(means)[None, :] - wanted[:, None]).argmin(axis=1).astype(np.uint8)


def _fit_models(passes: Sequence[_Differences]) -> NDArray[np.uint8]:
    """The model that codes what was seen in each context with the fewest bits; the nominal one where little was."""
    counts = _BELIEF * probabilities()[_nominal_models()]
    for found in passes:
        active = np.flatnonzero(found.classes)
        key = found.contexts[:, active] * (ESCAPE + 1) + symbols_of(found.values[:, active])
        counts += np.bincount(key.ravel(), minlength=counts.size).reshape(counts.shape)
    return np.asarray(np.argmin(counts @ bit_costs().T, axis=1), dtype=np.uint8)
