"""What is foretold of differences before they are read: contexts, which choose the model of each.

Two things are told of a row of differences: its *width*, the number of bits of the number of components up to the last
that is not zero; then the magnitudes of so many components. How large they are is foretold by the size usual for the
component, its *class*, by the *activity* of the row, how much the neighbours of its vertex differed from what was
predicted of them, and by how far a component is from the end of the width.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.codec.lanes import ModelTable
from slepian_prt.compression.codec.models import DEAD_ZONE, MODELS, TOKENS, WHOLE, frequencies, power_parts

# Sizes of components: class c stands for a mean difference of 2^((c - 20) / 2); 0 for no difference at all.
CLASSES = 34
# Components that hardly ever differ are not told apart further.
_QUIET = 6
# A row's differences against what is usual: thresholds in quarter octaves.
ACTIVITIES = 20
# Octaves from a component to the end of the width, the last for all beyond.
_OCTAVES = 5
MIDDLE_OCTAVE = 2
BASES = 2 * CLASSES + ACTIVITIES
CONTEXTS = BASES * _OCTAVES

# What is usual counts this much beside what the neighbours had.
_USUAL = 0.3

# Of a row of width w the first 2^w - 1 components are told.
WIDTHS = 16
# A width is foretold to reach the last component from which on so many differences that are not zero are expected.
_SHARES_WHOLE = 1 << 20
_EXPECTED = round(0.7 * _SHARES_WHOLE)
_ACTIVITY_GROUPS = ACTIVITIES // 2
WIDTH_CONTEXTS = WIDTHS * _ACTIVITY_GROUPS

# Shares are stored as -8 times their log2, up to this.
_SHARES_PER_OCTAVE = 8
RAREST_SHARE = 12 * _SHARES_PER_OCTAVE

_CLASS_MEANS = np.concatenate([[0.0], power_parts(1 - 20, CLASSES - 1, 2)])
_ACTIVITY_EDGES = power_parts(-8, ACTIVITIES - 1, 4)
# The smallest width that reaches a component.
_REACHES = np.frexp(np.arange(1, 1 << (WIDTHS - 1)).astype(np.float64))[1].astype(np.int64)


@dataclass(frozen=True, eq=False)
class Contexts:
    """Which model codes what is met in each context, of all caps of a file.

    Attributes
    ----------
    models : (CONTEXTS,) uint8
        Of magnitudes.
    changes : (BASES,) uint8
        Share of the differences that are not zero, of all that are foretold alike, whether they are told or not; see
        `RAREST_SHARE`.
    width_tables : (tables, WIDTHS) uint8
        Shares of widths.
    width_table : (WIDTH_CONTEXTS,) uint8
        Which of the tables.
    """

    models: NDArray[np.uint8]
    changes: NDArray[np.uint8]
    width_tables: NDArray[np.uint8]
    width_table: NDArray[np.uint8]

    @cached_property
    def table(self) -> ModelTable:
        """All distributions that symbols may have: of tokens, then of widths."""
        widths = np.zeros((len(self.width_tables), TOKENS), dtype=np.int64)
        widths[:, :WIDTHS] = width_frequencies(self.width_tables)
        return ModelTable(np.concatenate([frequencies().astype(np.int64), widths]))

    def of_magnitudes(self, base: NDArray[np.int64], octaves: NDArray[np.int64] | int) -> NDArray[np.uint8]:
        """Models of magnitudes: see `magnitude_bases` and `octaves_left`."""
        return np.asarray(self.models[magnitude_contexts(base, octaves)])

    def of_widths(self, contexts: NDArray[np.int64]) -> NDArray[np.int64]:
        """Models of widths in such contexts, see `width_contexts`."""
        return MODELS + self.width_table[contexts].astype(np.int64)

    def expected_widths(self, classes: NDArray) -> NDArray[np.int64]:
        """(caps, ACTIVITIES) widths that are foretold of caps of these classes (caps, width), in whole numbers."""
        changes = _share_sizes()[self.changes]
        expected = np.zeros((len(classes), ACTIVITIES), dtype=np.int64)
        for activity in range(ACTIVITIES):
            own = changes[magnitude_bases(activity, classes)]
            own[classes == 0] = 0
            beyond = np.cumsum(own[:, ::-1], axis=1)[:, ::-1]
            expected[:, activity] = widths_of((beyond > _EXPECTED).sum(axis=1))
        return expected


def widths_of(counts: NDArray[np.int64]) -> NDArray[np.int64]:
    """The number of bits of each number of components."""
    return np.frexp(np.asarray(counts, dtype=np.float64))[1].astype(np.int64)


def width_contexts(
    expected: NDArray[np.int64], caps: NDArray[np.int64], activities: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Contexts of the widths of rows, by their caps and activities, from `Contexts.expected_widths`."""
    return np.asarray(expected[caps, activities] * _ACTIVITY_GROUPS + activities // 2)


def last_nonzero(values: NDArray) -> NDArray[np.int64]:
    """(n,) how many components there are up to the last that is not zero."""
    filled = values != 0
    width = values.shape[1]
    if width == 0:
        return np.zeros(len(values), dtype=np.int64)
    return np.where(filled.any(axis=1), width - np.argmax(filled[:, ::-1], axis=1), 0)


def told_counts(widths: NDArray[np.int64], component_counts: NDArray[np.int64]) -> NDArray[np.int64]:
    """(n,) how many components are told of, from the widths of rows and how many their caps have."""
    return np.minimum((1 << widths) - 1, component_counts)


def octaves_left(widths: NDArray[np.int64], components: NDArray[np.int64]) -> NDArray[np.int64]:
    """Octaves from components that are told of to the end of the widths of their rows."""
    return np.minimum(widths - _REACHES[components], _OCTAVES - 1)


def magnitude_bases(activities: NDArray[np.int64] | int, classes: NDArray) -> NDArray[np.int64]:
    """What a row and a component foretell of a magnitude together."""
    return activities + 2 * classes.astype(np.int64)


def magnitude_contexts(bases: NDArray[np.int64], octaves: NDArray[np.int64] | int) -> NDArray[np.int64]:
    """Contexts of magnitudes, from `magnitude_bases` and `octaves_left`."""
    return bases * _OCTAVES + octaves


def context_sizes() -> NDArray[np.float64]:
    """(CONTEXTS,) mean magnitudes that contexts stand for by themselves."""
    return np.asarray(2.0 ** (0.25 * (np.arange(CONTEXTS) // _OCTAVES - 48)))


def classes_of(values: NDArray[np.int32]) -> NDArray[np.uint8]:
    """(width,) class of each component of a cap."""
    mean = np.abs(values).mean(axis=0) if len(values) else np.zeros(values.shape[1])
    with np.errstate(divide="ignore"):
        kind = np.clip(np.rint(2.0 * np.log2(mean)) + 20.0, 1, CLASSES - 1)
    return np.where(mean > 0.0, kind, 0).astype(np.uint8)


def steadied(classes: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The classes (width,) of a cap, less exact: what they foretell would be worth less than telling them exactly.

    Those up to the last that is not zero are at least `_QUIET`, and follow no single steps up and down.
    """
    found = np.zeros_like(classes)
    held = 0
    for k, own in enumerate(np.maximum(classes[: int(last_nonzero(classes[None])[0])], _QUIET).tolist()):
        held = own if held == 0 or abs(own - held) > 1 else held
        found[k] = held
    return found


def usual_sizes(classes: NDArray) -> NDArray[np.float64]:
    """(caps,) sums of what classes (caps, width) stand for: rounded once, the same on every machine."""
    return np.array([math.fsum(_CLASS_MEANS[row]) for row in classes])


def activities_of(around: NDArray[np.float64], usual: NDArray[np.float64]) -> NDArray[np.int64]:
    """(n,) how active the neighbours of each row are against what is usual, 0 to ACTIVITIES - 1."""
    ratio = np.divide(around + _USUAL * usual, (1.0 + _USUAL) * usual, out=np.zeros_like(usual), where=usual > 0.0)
    return np.searchsorted(_ACTIVITY_EDGES, ratio)


def width_frequencies(tables: NDArray[np.uint8]) -> NDArray[np.int64]:
    """(tables, WIDTHS) parts of 2¹² that stored tables stand for; none is zero."""
    shares = _share_sizes()[tables]
    parts = 1 + shares * (WHOLE - WIDTHS) // shares.sum(axis=1, keepdims=True)
    parts[np.arange(len(parts)), parts.argmax(axis=1)] += WHOLE - parts.sum(axis=1)
    return np.asarray(parts)


def stored_shares(counts: NDArray[np.float64]) -> NDArray[np.uint8]:
    """(tables, WIDTHS) tables to be stored, from how often (tables, WIDTHS) each width was seen."""
    shares = (counts + 1e-9) / (counts.sum(axis=1, keepdims=True) + WIDTHS * 1e-9)
    return _stored(shares)


def stored_changes(seen: NDArray, changed: NDArray) -> NDArray[np.uint8]:
    """(BASES,) to be stored, from how many differences (BASES,) were seen and were not zero."""
    usual = np.exp(-DEAD_ZONE / np.maximum(context_sizes()[::_OCTAVES], 1e-3))
    return _stored((changed + usual) / (seen + 1.0))


def _stored(shares: NDArray) -> NDArray[np.uint8]:
    return np.clip(np.rint(-_SHARES_PER_OCTAVE * np.log2(shares)), 0, RAREST_SHARE).astype(np.uint8)


@functools.cache
def _share_sizes() -> NDArray[np.int64]:
    """(RAREST_SHARE + 1,) what stored shares stand for, of 2^20."""
    return np.rint(power_parts(-RAREST_SHARE, RAREST_SHARE + 1, _SHARES_PER_OCTAVE)[::-1] * _SHARES_WHOLE).astype(
        np.int64
    )
