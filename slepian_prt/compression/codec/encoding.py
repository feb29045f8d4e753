"""Caps encoded: along their principal axes or not, predicted and rounded, told."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.codec.axes import RoundedAxes, round_axes, write_axes
from slepian_prt.compression.codec.cap_stream import CapBytes, CapsWriter, zigzag
from slepian_prt.compression.codec.caps import CLASS_STEPS, FIRST_CLASS, DecodedCap, Tuning
from slepian_prt.compression.codec.contexts import Contexts
from slepian_prt.compression.codec.prediction import PARTS, predict_and_round, round_with_dead_zone
from slepian_prt.compression.codec.rounding import FrugalRounding
from slepian_prt.compression.codec.surface import CapRows
from slepian_prt.compression.codec.telling import Telling, tell

# What a bit buys in distortion, in squared steps, when the step is changed a little: measured on two scans, 0.4 at 3 %
# and 1.1 at 15 % error. (Far above the 0.12 of a quantiser by itself: what is coded also predicts what follows.)
_DISTORTION_PER_BIT = 0.6

# Steps whose logarithms differ by less have the same classes of components, all but.
_NEARLY_THE_SAME = 0.15


Axes = Sequence[RoundedAxes | None]


@dataclass(frozen=True)
class EncodedCap:
    """One cap as bytes, and what coding it changed.

    Attributes
    ----------
    content : CapBytes
    used : int
        Components that are not zero throughout.
    errors : (K, K)
        Sum over the receivers of products of the coefficients' errors.
    decoded : DecodedCap or None
        What `caps.decode_caps` would give, if it was wanted.
    """

    content: CapBytes
    used: int
    errors: NDArray[np.float64]
    decoded: DecodedCap | None = None

    @property
    def distortion(self) -> float:
        """Sum of squares of what rounding changed, in the units of the coefficients."""
        return float(np.trace(self.errors))


def encode_caps(
    coefficients: Sequence[NDArray],
    rows: CapRows,
    tuning: Tuning,
    *,
    principal_axes: Sequence[bool | None],
    keep: bool = False,
) -> list[EncodedCap]:
    """Code the coefficients of some caps.

    Parameters
    ----------
    coefficients : sequence of (N, K)
        Of each cap, in the order of its members, orthonormal.
    rows : CapRows
        Of these caps.
    tuning : Tuning
    principal_axes : sequence of bool or None
        Code them along their principal axes; None where that pays, the axes themselves counted.
    keep : bool
        Whether what will be decoded is wanted too.
    """
    return round_caps(coefficients, rows, tuning, principal_axes).encode(keep)


def round_caps(
    coefficients: Sequence[NDArray], rows: CapRows, tuning: Tuning, principal_axes: Sequence[bool | None]
) -> RoundedCaps:
    """What `encode_caps` will encode, so that its distortion is known before."""
    caps = CapCoefficients(coefficients, rows)
    axes = [None if wanted is False else own for wanted, own in zip(principal_axes, caps.axes(tuning), strict=True)]
    first = FirstPass(caps, axes, tuning)
    if any(wanted is None and own is not None for wanted, own in zip(principal_axes, axes, strict=True)):
        plain = [None if wanted is None else own for wanted, own in zip(principal_axes, axes, strict=True)]
        first = first.or_cheaper(FirstPass(caps, plain, tuning))
    return RoundedCaps(first)


class CapCoefficients:
    """Coefficients of some caps.

    Parameters
    ----------
    parts : sequence of (N, K)
        Of each cap, in the order of its members.
    rows : CapRows
    """

    def __init__(self, parts: Sequence[NDArray], rows: CapRows) -> None:
        self.parts = [np.asarray(part, dtype=np.float64) for part in parts]
        self.rows = rows

    def axes(self, tuning: Tuning) -> list[RoundedAxes | None]:
        """Principal axes of each cap."""
        return [round_axes(part, tuning.step) if len(part) else None for part in self.parts]

    def along(self, axes: Axes, step: float) -> NDArray[np.float64]:
        """(n, width) by rows, in parts of a step, along the axes of each cap or as they are."""
        along = [part if own is None else part @ own.rows.T for part, own in zip(self.parts, axes, strict=True)]
        padded = np.zeros((len(self.rows), max((part.shape[1] for part in along), default=0)))
        for part, rows_of_cap in zip(along, self.rows.by_member, strict=True):
            padded[rows_of_cap, : part.shape[1]] = part
        padded *= PARTS / step
        return padded


class FirstPass:
    """Caps predicted and rounded to the nearest: what is usual for their components, and nearly what they cost.

    Parameters
    ----------
    caps : CapCoefficients
    axes : sequence of RoundedAxes or None
        Along which each cap is coded.
    tuning : Tuning
    classes : (caps, width) uint8, optional
        If they are known, nothing is predicted.
    """

    def __init__(
        self, caps: CapCoefficients, axes: Axes, tuning: Tuning, classes: NDArray[np.uint8] | None = None
    ) -> None:
        self.caps, self.axes, self.tuning = caps, axes, tuning
        if classes is None:
            self.x = caps.along(axes, tuning.step)
            self.differences = predict_and_round(self.x, caps.rows, tuning.predictor, round_with_dead_zone)
            self.telling = tell(self.differences.values, caps.rows)
            classes = self.telling.classes
        self.classes = classes

    def costs(self, contexts: Contexts) -> NDArray[np.float64]:
        """(caps,) in bits, distortion counted as the bits that it would take to remove it."""
        widths = self.telling.component_counts
        bits = self.telling.bits(self.differences.values, contexts)
        bits += [0.0 if own is None else own.first(w).bits for own, w in zip(self.axes, widths, strict=True)]
        missed = self.differences.multiples - self.x
        of_rows = np.einsum("nk,nk->n", missed, missed) * (self.tuning.step / PARTS) ** 2
        squares = np.bincount(self.caps.rows.caps, of_rows, minlength=len(bits)).astype(np.float64)
        for c, (part, own) in enumerate(zip(self.caps.parts, self.axes, strict=True)):
            if own is not None:  # what the axes leave out
                squares[c] += float(np.sum(part**2) - np.sum((part @ own.rows.T) ** 2))
        return np.asarray(bits + squares / (_DISTORTION_PER_BIT * self.tuning.step**2))

    def or_cheaper(self, other: FirstPass, contexts: Contexts | None = None) -> FirstPass:
        """The same caps, each along the axes of the one that it costs less in.

        ``contexts`` are those of this one if it has its own.
        """
        pays = self.costs(contexts or self.tuning.contexts) < other.costs(self.tuning.contexts)
        if pays.all() or not pays.any():
            return self if pays.all() else other
        axes = [a if pays[c] else b for c, (a, b) in enumerate(zip(self.axes, other.axes, strict=True))]
        classes = np.zeros((len(pays), max(self.classes.shape[1], other.classes.shape[1])), dtype=np.uint8)
        for chosen, own in ((pays, self.classes), (~pays, other.classes)):
            classes[chosen, : own.shape[1]] = own[chosen]
        return FirstPass(self.caps, axes, self.tuning, classes)


class RoundedCaps:
    """Caps predicted and rounded as they will be encoded: up only where that is worth its bits.

    Parameters
    ----------
    first : FirstPass
    """

    def __init__(self, first: FirstPass) -> None:
        self._first, caps, tuning = first, first.caps, first.tuning
        x = caps.along(first.axes, tuning.step)
        classes = np.zeros((len(caps.parts), x.shape[1]), dtype=np.uint8)
        known = min(x.shape[1], first.classes.shape[1])
        classes[:, :known] = first.classes[:, :known]
        rounding = FrugalRounding(caps.rows, classes, tuning.contexts)
        self.differences = predict_and_round(x, caps.rows, tuning.predictor, rounding)
        self.telling = tell(self.differences.values, caps.rows)
        self._widths = self.telling.component_counts
        self.errors = self._errors(x)

    @property
    def axes(self) -> Axes:
        """Along which each cap is coded."""
        return self._first.axes

    @property
    def distortion(self) -> float:
        """Sum of squares of what rounding changed, in the units of the coefficients."""
        return float(sum(np.trace(errors) for errors in self.errors))

    @property
    def used(self) -> int:
        """Components that are not zero throughout, of all caps."""
        return int(np.count_nonzero(self.telling.classes))

    def with_tuning(self, tuning: Tuning) -> RoundedCaps:
        """The same caps along the same axes with another step: what is usual is known if it is nearly the same."""
        near = abs(math.log(tuning.step / self._first.tuning.step)) < _NEARLY_THE_SAME
        classes = self._first.classes if near else None
        return RoundedCaps(FirstPass(self._first.caps, self.axes, tuning, classes))

    def encode(self, keep: bool) -> list[EncodedCap]:
        """Encode them; ``keep`` what will be decoded if that is wanted."""
        caps, contexts = self._first.caps, self._first.tuning.contexts
        writer = CapsWriter(len(caps.parts), contexts.table)
        axes = [None if own is None else own.first(w) for own, w in zip(self.axes, self._widths, strict=True)]
        _write_classes(writer, self.telling)
        write_axes(writer, axes)
        self.telling.write(writer, self.differences.values, contexts)
        found = []
        for c, (lanes, bits) in enumerate(writer.finish()):
            own, part = axes[c], caps.parts[c]
            content = CapBytes(lanes, bits, int(self._widths[c]), own is not None)
            kept = None
            if keep:
                multiples = self.differences.multiples[caps.rows.by_member[c], : content.width]
                count = part.shape[1] if own is None else content.width
                kept = DecodedCap(multiples, count, None if own is None else own.rows)
            used = int(np.count_nonzero(self.telling.classes[c]))
            found.append(EncodedCap(content, used, self.errors[c], kept))
        return found

    def _errors(self, x: NDArray[np.float64]) -> list[NDArray[np.float64]]:
        """Sums of products of errors of the coefficients of each cap."""
        caps, step = self._first.caps, self._first.tuning.step
        found = []
        for c, (part, own) in enumerate(zip(caps.parts, self.axes, strict=True)):
            rows = caps.rows.by_member[c]
            if own is None:
                missed = (self.differences.multiples[rows, : part.shape[1]] - x[rows, : part.shape[1]]) * (step / PARTS)
            else:
                # Axes after the last that is used are not in the file.
                width = self._widths[c]
                missed = self.differences.multiples[rows, :width] @ own.rows[:width] * (step / PARTS) - part
            found.append(missed.T @ missed)
        return found


def _write_classes(writer: CapsWriter, telling: Telling) -> None:
    """The steps from the class of each component to that of the next, up to the last that is used."""
    steps = [
        zigzag(np.diff(own[:width].astype(np.int64), prepend=FIRST_CLASS))
        for own, width in zip(telling.classes, telling.component_counts, strict=True)
    ]
    numbers = np.concatenate([np.zeros(0, dtype=np.int64), *steps])
    writer.numbers(telling.component_counts, numbers, np.full(numbers.size, CLASS_STEPS))
