"""Coefficients of caps as bits: predicted along the surface, rounded, entropy-coded.

Coefficients of an orthonormal basis are rounded with one step: reverse water-filling, because components whose
variance is below the distortion round to zero and cost next to nothing, and all others get the same distortion. A cap's
receivers are coded coarse to fine (`surface`), predicted from neighbours as decoded (`prediction`); of what differs is
told how far it reaches and how large it is (`contexts`), in lanes of the cap's own (`lanes`). All caps make their steps
together, so that few calls do large work; each decodes alone, too. Decoding is exact on any machine.

Optionally a cap's coefficients are first brought into their principal axes, which are then coded too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.codec.axes import RoundedAxes, read_axes, round_axes, write_axes
from slepian_prt.compression.codec.cap_stream import CapBytes, CapsReader, CapsWriter, from_zigzag, zigzag
from slepian_prt.compression.codec.contexts import CLASSES, Contexts
from slepian_prt.compression.codec.prediction import (
    PARTS,
    Differences,
    Predictor,
    level_activity,
    predict_and_round,
    round_with_dead_zone,
)
from slepian_prt.compression.codec.rounding import FrugalRounding
from slepian_prt.compression.codec.surface import CapRows
from slepian_prt.compression.codec.telling import LevelReader, Telling, tell

# Entropy model of the steps between the classes of successive components, and what the first differs from.
_CLASS_STEPS = 18
_FIRST_CLASS = 18

# What a bit buys in distortion, in squared steps, when the step is changed a little: measured on two scans, 0.4 at 3 %
# and 1.1 at 15 % error. (Far above the 0.12 of a quantiser by itself: what is coded also predicts what follows.)
_DISTORTION_PER_BIT = 0.6


@dataclass(frozen=True)
class Tuning:
    """What all caps of a file are coded with.

    Attributes
    ----------
    step : float
    predictor : Predictor
    contexts : Contexts
    """

    step: float
    predictor: Predictor
    contexts: Contexts


@dataclass(frozen=True)
class Coded:
    """Coefficients of all caps as they are in the file.

    Attributes
    ----------
    tuning : Tuning
    caps : tuple of CapBytes
    """

    tuning: Tuning
    caps: tuple[CapBytes, ...]


@dataclass(frozen=True)
class DecodedCap:
    """One cap as its bytes tell it.

    Attributes
    ----------
    multiples : (N, A) int32
        Sixteenths of a step, in the order of the cap's members.
    axes : (A, K) or None
        Orthonormal principal axes; None if the multiples are those of the coefficients themselves.
    """

    multiples: NDArray[np.int32]
    axes: NDArray[np.float64] | None

    def values(self, step: float) -> NDArray[np.float32]:
        """(N, A) numbers."""
        return (self.multiples * (step / PARTS)).astype(np.float32)

    def coefficients(self, step: float) -> NDArray[np.float64]:
        """(N, K) coefficients."""
        values = self.multiples.astype(np.float64) * (step / PARTS)
        return values if self.axes is None else np.asarray(values @ self.axes)


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
        What `decode_caps` would give, if it was wanted.
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
    x = [np.asarray(part, dtype=np.float64) for part in coefficients]
    axes = [
        round_axes(part, tuning.step) if wanted is not False and len(part) else None
        for part, wanted in zip(x, principal_axes, strict=True)
    ]
    told = CodingAttempt(x, axes, rows, tuning)
    if any(wanted is None and found is not None for wanted, found in zip(principal_axes, axes, strict=True)):
        plain = [None if wanted is None else found for wanted, found in zip(principal_axes, axes, strict=True)]
        told = cheaper(told, CodingAttempt(x, plain, rows, tuning))
    return told.encode(keep)


def cheaper(one: CodingAttempt, other: CodingAttempt) -> CodingAttempt:
    """The same caps, each along the axes of the attempt that it costs less in."""
    pays = one.costs() < other.costs()
    if pays.all() or not pays.any():
        return one if pays.all() else other
    return one.along([a if pays[c] else b for c, (a, b) in enumerate(zip(one.axes, other.axes, strict=True))])


def round_frugally(
    x: NDArray[np.float64], rows: CapRows, predictor: Predictor, contexts: Contexts
) -> tuple[Differences, Telling]:
    """Predict and round coefficients ``x`` (n, width), in parts: up where that is worth the bits that it costs.

    A first pass finds what is usual for the components, on which these bits depend.
    """
    first = tell(predict_and_round(x, rows, predictor, round_with_dead_zone).values, rows)
    found = predict_and_round(x, rows, predictor, FrugalRounding(rows, first.classes, contexts))
    return found, tell(found.values, rows)


class CodingAttempt:
    """Caps predicted and rounded, each along the axes given or as it is.

    Parameters
    ----------
    x : sequence of (N, K)
        Coefficients of each cap, in the order of its members.
    axes : sequence of RoundedAxes or None
    rows : CapRows
    tuning : Tuning
    """

    def __init__(self, x: Sequence[NDArray], axes: Sequence[RoundedAxes | None], rows: CapRows, tuning: Tuning) -> None:
        self._x, self.axes, self._rows, self._tuning = x, axes, rows, tuning
        along = [part if own is None else part @ own.rows.T for part, own in zip(x, axes, strict=True)]
        width = max((part.shape[1] for part in along), default=0)
        padded = np.zeros((len(rows), width))
        for part, rows_of_cap in zip(along, rows.by_member, strict=True):
            padded[rows_of_cap, : part.shape[1]] = part
        padded *= PARTS / tuning.step
        self.differences, self.telling = round_frugally(padded, rows, tuning.predictor, tuning.contexts)
        self._missed = (self.differences.multiples - padded) / PARTS
        self._widths = self.telling.component_counts

    def along(self, axes: Sequence[RoundedAxes | None]) -> CodingAttempt:
        """The same along other axes."""
        return CodingAttempt(self._x, axes, self._rows, self._tuning)

    def with_contexts(self, contexts: Contexts) -> CodingAttempt:
        """The same with contexts of its own."""
        return CodingAttempt(self._x, self.axes, self._rows, replace(self._tuning, contexts=contexts))

    def costs(self) -> NDArray[np.float64]:
        """(caps,) in bits, distortion counted as the bits that it would take to remove it."""
        bits = self.telling.bits(self.differences.values, self._tuning.contexts)
        bits += [0.0 if own is None else own.first(w).bits for own, w in zip(self.axes, self._widths, strict=True)]
        squares = np.array([float(np.trace(errors)) for errors in self._errors()])
        return np.asarray(bits + squares / _DISTORTION_PER_BIT)

    def encode(self, keep: bool) -> list[EncodedCap]:
        contexts, step = self._tuning.contexts, self._tuning.step
        writer = CapsWriter(len(self._x), contexts.table)
        axes = [None if own is None else own.first(w) for own, w in zip(self.axes, self._widths, strict=True)]
        _write_classes(writer, self.telling)
        write_axes(writer, axes)
        self.telling.write(writer, self.differences.values, contexts)
        found = []
        for c, ((lanes, bits), errors) in enumerate(zip(writer.finish(), self._errors(), strict=True)):
            own = axes[c]
            content = CapBytes(lanes, bits, int(self._widths[c]), own is not None)
            kept = None
            if keep:
                width = self._x[c].shape[1] if own is None else content.width
                multiples = self.differences.multiples[self._rows.by_member[c], :width].astype(np.int32)
                kept = DecodedCap(multiples, None if own is None else own.rows)
            used = int(np.count_nonzero(self.telling.classes[c]))
            found.append(EncodedCap(content, used, errors * step**2, kept))
        return found

    def _errors(self) -> list[NDArray[np.float64]]:
        """Sums of products of errors of the coefficients of each cap, in squared steps."""
        found = []
        for c, (part, own) in enumerate(zip(self._x, self.axes, strict=True)):
            rows = self._rows.by_member[c]
            if own is None:
                missed = self._missed[rows, : part.shape[1]]
            else:
                # Axes after the last that is used are not in the file.
                w = self._widths[c]
                decoded = self.differences.multiples[rows, :w] / PARTS
                missed = decoded @ own.rows[:w] - part / self._tuning.step
            found.append(missed.T @ missed)
        return found


def decode_caps(
    contents: Sequence[CapBytes], components: Sequence[int], rows: CapRows, tuning: Tuning
) -> list[DecodedCap]:
    """The inverse of `encode_caps`, exactly.

    Parameters
    ----------
    contents : sequence of CapBytes
    components : sequence of int
        K of each cap.
    rows : CapRows
        Of these caps.
    tuning : Tuning

    Raises
    ------
    ValueError
        The bytes are not those of such caps.
    """
    widths = np.array([content.width for content in contents], dtype=np.int64)
    if np.any(widths > np.asarray(components, dtype=np.int64)):
        raise ValueError("width of a cap")
    reader = CapsReader(contents, tuning.contexts.table)
    classes = _read_classes(reader, widths)
    counts = np.where([content.principal_axes for content in contents], widths, 0)
    axes = read_axes(reader, counts, components)
    levels = LevelReader(reader, rows, classes, tuning.contexts)
    width = int(widths.max(initial=0))
    multiples, sizes = np.zeros((len(rows), width)), np.zeros(len(rows))
    for level in rows.levels:
        values = levels.read(level, level_activity(level, sizes))
        sizes[level.rows] = np.abs(values).sum(axis=1)
        values *= float(tuning.predictor.steps[level.depth])
        values += tuning.predictor.predict(level, multiples)
        multiples[level.rows] = values
    reader.check_end()
    found = []
    for content, count, rows_of_cap, own in zip(contents, components, rows.by_member, axes, strict=True):
        full = np.zeros((rows_of_cap.size, content.width if content.principal_axes else count), dtype=np.int32)
        full[:, : content.width] = multiples[rows_of_cap, : content.width]
        found.append(DecodedCap(full, own.rows if own is not None else _no_axes(content, count)))
    return found


def _no_axes(content: CapBytes, components: int) -> NDArray[np.float64] | None:
    return np.zeros((0, components)) if content.principal_axes else None


def _write_classes(writer: CapsWriter, telling: Telling) -> None:
    """The steps from the class of each component to that of the next, up to the last that is used."""
    steps = [
        zigzag(np.diff(own[:width].astype(np.int64), prepend=_FIRST_CLASS))
        for own, width in zip(telling.classes, telling.component_counts, strict=True)
    ]
    numbers = np.concatenate([np.zeros(0, dtype=np.int64), *steps])
    writer.numbers(telling.component_counts, numbers, np.full(numbers.size, _CLASS_STEPS))


def _read_classes(reader: CapsReader, widths: NDArray[np.int64]) -> NDArray[np.uint8]:
    steps = from_zigzag(reader.numbers(widths, np.full(int(widths.sum()), _CLASS_STEPS)))
    classes = np.zeros((widths.size, int(widths.max(initial=0))), dtype=np.uint8)
    for own, part in zip(classes, np.split(steps, np.cumsum(widths)[:-1]), strict=True):
        found = _FIRST_CLASS + np.cumsum(part)
        if found.size and (found.min() < 0 or found.max() >= CLASSES):
            raise ValueError("class of a component")
        own[: found.size] = found
    return classes
