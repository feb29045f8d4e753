"""Coefficients of a cap as bits: predicted along the surface, rounded, entropy-coded.

Coefficients of an orthonormal basis are rounded with one step: reverse water-filling, because components whose
variance is below the distortion round to zero and cost next to nothing, and all others get the same distortion. A cap's
receivers are coded coarse to fine (`surface`): each coefficient is predicted from those of neighbours *as decoded*, in
sixteenths of a step and in integer arithmetic, and what differs is rounded, small differences to zero, and
entropy-coded (asymmetric numeral systems, by the library `constriction`). The model of a difference is chosen by the
size usual for its component and by how much its neighbours differed. Decoding is exact on any machine, and each cap
decodes by itself.

Optionally a cap's coefficients are first brought into their principal axes, which are then coded too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.codec.axes import RoundedAxes, round_axes
from slepian_prt.compression.codec.entropy import Reader, Writer
from slepian_prt.compression.codec.prediction import (
    CLASSES,
    PARTS,
    Tuning,
    by_model,
    gains_of,
    neighbour_activity,
    predict_and_round,
    predicted_multiples,
    row_contexts,
)
from slepian_prt.compression.codec.surface import CapSurface

# Entropy model of the steps between the classes of successive components.
_CLASS_STEPS = 20

# What a bit buys in distortion, in squared steps, when the step is changed a little: measured on two scans, 0.4 at 3 %
# and 1.1 at 15 % error. (Far above the 0.12 of a quantiser by itself: what is coded also predicts what follows.)
_DISTORTION_PER_BIT = 0.6


@dataclass(frozen=True)
class DecodedCap:
    """One cap as its words tell it.

    Attributes
    ----------
    multiples : (N, A) int32
        Sixteenths of a step, in surface order.
    axes : (A, K) or None
        Orthonormal principal axes; None if the multiples are those of the coefficients themselves.
    """

    multiples: NDArray[np.int32]
    axes: NDArray[np.float64] | None

    def values(self, step: float) -> NDArray[np.float64]:
        """(N, A) numbers, in surface order."""
        return np.asarray(self.multiples * (step / PARTS))

    def coefficients(self, step: float) -> NDArray[np.float64]:
        """(N, K) coefficients, in surface order."""
        values = self.values(step)
        return values if self.axes is None else values @ self.axes


@dataclass(frozen=True)
class EncodedCap:
    """One cap as words, and what coding it changed.

    Attributes
    ----------
    words : (n,) uint32
    used : int
        Components that are not zero throughout.
    principal_axes : bool
        Whether it is coded along its principal axes.
    errors : (K, K)
        Sum over the receivers of products of the coefficients' errors.
    decoded : DecodedCap or None
        What `decode_cap` would give, if it was wanted.
    """

    words: NDArray[np.uint32]
    used: int
    principal_axes: bool
    errors: NDArray[np.float64]
    decoded: DecodedCap | None = None

    @property
    def distortion(self) -> float:
        """Sum of squares of what rounding changed, in the units of the coefficients."""
        return float(np.trace(self.errors))

    def cost(self, step: float) -> float:
        """In bits, distortion counted as the bits that it would take to remove it."""
        return 32.0 * self.words.size + self.distortion / (_DISTORTION_PER_BIT * step**2)


def encode_cap(
    coefficients: NDArray, surface: CapSurface, tuning: Tuning, *, principal_axes: bool | None, keep: bool = False
) -> EncodedCap:
    """Code the coefficients of one cap.

    Parameters
    ----------
    coefficients : (N, K), in surface order, orthonormal
    surface : CapSurface
    tuning : Tuning
    principal_axes : bool or None
        Code them along their principal axes; None where that pays, the axes themselves counted.
    keep : bool
        Whether what will be decoded is wanted too.
    """
    x = np.asarray(coefficients, dtype=np.float64)
    rounded = round_axes(x, tuning.step) if principal_axes is not False else None
    choices = [None, rounded] if principal_axes is None and rounded is not None else [rounded]
    return min((_encode(x, surface, tuning, axes, keep) for axes in choices), key=lambda e: e.cost(tuning.step))


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
        rounded = RoundedAxes.read(reader, components)
        axes, components = rounded.rows, len(rounded.multiples)
    classes = _read_classes(reader, components)
    active = np.flatnonzero(classes)
    count = len(surface.order)
    values = np.zeros((count, active.size), dtype=np.int64)
    multiples = np.zeros((count, active.size), dtype=np.int64)
    sizes = np.zeros(count, dtype=np.int64)
    gains = gains_of(tuning.gains, components)[:, active]

    def read(rows: NDArray[np.int64], around: NDArray, predicted: NDArray[np.int64]) -> None:
        contexts = row_contexts(around, classes)[:, None].astype(np.int64) + 2 * classes[active].astype(np.int64)
        found = np.empty(contexts.size, dtype=np.int64)
        for number, places in by_model(contexts, tuning.models):
            found[places] = reader.values(places.size, number)
        values[rows] = found.reshape(contexts.shape)
        multiples[rows] = predicted + PARTS * values[rows]
        sizes[rows] = np.abs(values[rows]).sum(axis=1)

    read(np.array([0]), np.zeros(1), np.zeros((1, active.size), dtype=np.int64))
    for level in surface.levels:
        read(level.rows, neighbour_activity(level, sizes), predicted_multiples(level, multiples, gains))
    if not reader.at_end():
        raise ValueError("words left over")
    full = np.zeros((count, components), dtype=np.int32)
    full[:, active] = multiples
    return DecodedCap(full, axes)


def _encode(x: NDArray, surface: CapSurface, tuning: Tuning, axes: RoundedAxes | None, keep: bool) -> EncodedCap:
    """The cap's words, along the axes given, if any."""
    found = predict_and_round(x if axes is None else x @ axes.rows.T, surface, tuning)
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
        for number, places in by_model(contexts[rows], tuning.models):
            writer.values(values[rows].ravel()[places], number)
    missed = decoded - x
    kept = None
    if keep and axes is None:
        kept = DecodedCap(found.multiples.astype(np.int32), None)
    elif keep and axes is not None:
        kept = DecodedCap(found.multiples[:, :width].astype(np.int32), axes.first(width).rows)
    return EncodedCap(writer.words(), used.size, axes is not None, missed.T @ missed, kept)


def _write_classes(writer: Writer, classes: NDArray[np.uint8], components: int) -> None:
    """How many components are used, and the steps from the class of each to that of the next."""
    writer.number(classes.size, components + 1)
    if classes.size:
        writer.number(int(classes[0]), CLASSES)
        writer.values(classes[1:].astype(np.int32) - classes[:-1].astype(np.int32), _CLASS_STEPS)


def _read_classes(reader: Reader, components: int) -> NDArray[np.uint8]:
    classes = np.zeros(components, dtype=np.uint8)
    width = reader.number(components + 1)
    if width:
        first = reader.number(CLASSES)
        found = np.cumsum(np.concatenate([[first], reader.values(width - 1, _CLASS_STEPS)]))
        if found.min() < 0 or found.max() >= CLASSES:
            raise ValueError("class of a component")
        classes[:width] = found
    return classes
