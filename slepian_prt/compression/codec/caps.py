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
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.codec.axes import read_axes
from slepian_prt.compression.codec.cap_stream import CapBytes, CapsReader, from_zigzag
from slepian_prt.compression.codec.contexts import CLASSES, Contexts
from slepian_prt.compression.codec.prediction import PARTS, Predictor, level_activity
from slepian_prt.compression.codec.surface import CapRows
from slepian_prt.compression.codec.telling import LevelReader

# Entropy model of the steps between the classes of successive components, and what the first differs from.
CLASS_STEPS = 18
FIRST_CLASS = 18


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
    multiples : (N, w) float64
        Whole numbers, of sixteenths of a step, in the order of the cap's members; further components are zero.
    count : int
        Components: A.
    axes : (A, K) or None
        Orthonormal principal axes; None if the multiples are those of the coefficients themselves.
    """

    multiples: NDArray[np.float64]
    count: int
    axes: NDArray[np.float64] | None

    def values(self, step: float) -> NDArray[np.float32]:
        """(N, A) numbers."""
        full = np.zeros((len(self.multiples), self.count), dtype=np.float32)
        np.multiply(self.multiples, step / PARTS, out=full[:, : self.multiples.shape[1]], casting="same_kind")
        return full

    def coefficients(self, step: float) -> NDArray[np.float64]:
        """(N, K) coefficients."""
        values = np.zeros((len(self.multiples), self.count))
        values[:, : self.multiples.shape[1]] = self.multiples * (step / PARTS)
        return values if self.axes is None else np.asarray(values @ self.axes)


def decode_caps(
    contents: Sequence[CapBytes], component_counts: Sequence[int], rows: CapRows, tuning: Tuning
) -> list[DecodedCap]:
    """The inverse of `encoding.encode_caps`, exactly.

    Parameters
    ----------
    contents : sequence of CapBytes
    component_counts : sequence of int
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
    if np.any(widths > np.asarray(component_counts, dtype=np.int64)):
        raise ValueError("width of a cap")
    reader = CapsReader(contents, tuning.contexts.table)
    classes = _read_classes(reader, widths)
    counts = np.where([content.principal_axes for content in contents], widths, 0)
    axes = read_axes(reader, counts, component_counts)
    levels = LevelReader(reader, rows, classes, tuning.contexts)
    width = int(widths.max(initial=0))
    multiples, sizes = np.zeros((len(rows), width)), np.zeros(len(rows))
    for level in rows.levels:
        told, components, values = levels.read(level, level_activity(level, sizes))
        sizes[level.rows] = np.bincount(told, np.abs(values), minlength=level.rows.stop - level.rows.start)
        decoded = multiples[level.rows]
        decoded[:] = tuning.predictor.predict(level, multiples)
        decoded[told, components] += float(tuning.predictor.steps[level.depth]) * values
    reader.check_end()
    found = []
    for content, count, rows_of_cap, own in zip(contents, component_counts, rows.by_member, axes, strict=True):
        whole = multiples[rows_of_cap, : content.width]
        if content.principal_axes:
            rows_of_axes = np.zeros((0, count)) if own is None else own.rows
            found.append(DecodedCap(whole, content.width, rows_of_axes))
        else:
            found.append(DecodedCap(whole, count, None))
    return found


def _read_classes(reader: CapsReader, widths: NDArray[np.int64]) -> NDArray[np.uint8]:
    steps = from_zigzag(reader.numbers(widths, np.full(int(widths.sum()), CLASS_STEPS)))
    classes = np.zeros((widths.size, int(widths.max(initial=0))), dtype=np.uint8)
    for own, part in zip(classes, np.split(steps, np.cumsum(widths)[:-1]), strict=True):
        found = FIRST_CLASS + np.cumsum(part)
        if found.size and (found.min() < 0 or found.max() >= CLASSES):
            raise ValueError("class of a component")
        own[: found.size] = found
    return classes
