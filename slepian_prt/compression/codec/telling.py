"""What is told of the differences of caps, level by level: widths of rows, then magnitudes with their signs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.codec.cap_stream import CapsReader, CapsWriter
from slepian_prt.compression.codec.contexts import (
    Contexts,
    activities_of,
    classes_of,
    last_nonzero,
    magnitude_bases,
    octaves_left,
    steadied,
    told_counts,
    usual_sizes,
    width_contexts,
    widths_of,
)
from slepian_prt.compression.codec.models import plain_tokens, token_bits
from slepian_prt.compression.codec.prediction import neighbour_activity
from slepian_prt.compression.codec.surface import CapRows, Level


class Places(NamedTuple):
    """Differences that are told, one row after the other, and what foretells their magnitudes.

    Attributes
    ----------
    rows, components : (n,)
    bases, octaves : (n,)
        As of `Contexts.of_magnitudes`.
    """

    rows: NDArray[np.int64]
    components: NDArray[np.int64]
    bases: NDArray[np.int64]
    octaves: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Telling:
    """How the differences of some caps are told.

    Attributes
    ----------
    rows : CapRows
    classes : (caps, width) uint8
    activities, widths : (n,)
        Of the rows.
    """

    rows: CapRows
    classes: NDArray[np.uint8]
    activities: NDArray[np.int64]
    widths: NDArray[np.int64]

    @property
    def component_counts(self) -> NDArray[np.int64]:
        """(caps,) components up to the last that is not zero throughout."""
        return last_nonzero(self.classes)

    @property
    def places(self) -> Places:
        """What is told of all rows."""
        caps = self.rows.caps
        told = told_counts(self.widths, self.component_counts[caps])
        return places_of(told, self.widths, self.activities, self.classes, caps)

    def width_contexts(self, contexts: Contexts) -> NDArray[np.int64]:
        """(n,) contexts of the widths."""
        return width_contexts(contexts.expected_widths(self.classes), self.rows.caps, self.activities)

    def bits(self, values: NDArray[np.int32], contexts: Contexts) -> NDArray[np.float64]:
        """(caps,) that it costs to tell of values (n, width)."""
        caps, count, places = self.rows.caps, len(self.classes), self.places
        tokens = plain_tokens(np.abs(values[places.rows, places.components]))
        models = contexts.of_magnitudes(places.bases, places.octaves)
        cost = np.bincount(caps[places.rows], token_bits()[models, tokens], minlength=count)
        of_widths = contexts.table.bits[contexts.of_widths(self.width_contexts(contexts)), self.widths]
        of_widths[self.component_counts[caps] == 0] = 0.0
        return np.asarray(cost + np.bincount(caps, of_widths, minlength=count))

    def write(self, writer: CapsWriter, values: NDArray[np.int32], contexts: Contexts) -> None:
        """Tell of values (n, width), level by level as `read_level` reads them."""
        caps, places, speaks = self.rows.caps, self.places, self.component_counts > 0
        flat, models = values[places.rows, places.components], contexts.of_magnitudes(places.bases, places.octaves)
        width_models = contexts.of_widths(self.width_contexts(contexts))
        spoken = np.flatnonzero(speaks[caps])
        begin = 0
        for level in self.rows.levels:
            first, last = np.searchsorted(spoken, [level.rows.start, level.rows.stop])
            some = spoken[first:last]
            writer.symbols(np.where(speaks, level.counts, 0), self.widths[some], width_models[some])
            part = slice(begin, int(np.searchsorted(places.rows, level.rows.stop)))
            counts = np.bincount(caps[places.rows[part]], minlength=len(self.classes))
            writer.values(counts, flat[part], models[part])
            begin = part.stop


def tell(values: NDArray[np.int32], rows: CapRows) -> Telling:
    """How differences (n, width) are told."""
    classes = np.zeros((len(rows.sizes), values.shape[1]), dtype=np.uint8)
    for own, rows_of_cap in zip(classes, rows.by_member, strict=True):
        own[:] = steadied(classes_of(values[rows_of_cap]))
    around = neighbour_activity(rows, np.abs(values).sum(axis=1, dtype=np.float64))
    activities = activities_of(around, usual_sizes(classes)[rows.caps])
    return Telling(rows, classes, activities, widths_of(last_nonzero(values)))


class LevelReader:
    """Reads differences level by level.

    Parameters
    ----------
    reader : CapsReader
    rows : CapRows
    classes : (caps, width) uint8
    contexts : Contexts
    """

    def __init__(self, reader: CapsReader, rows: CapRows, classes: NDArray[np.uint8], contexts: Contexts) -> None:
        self._reader, self._caps, self._classes, self._contexts = reader, rows.caps, classes, contexts
        self._usual = usual_sizes(classes)[rows.caps]
        self._expected = contexts.expected_widths(classes)
        self._component_counts = last_nonzero(classes)

    def read(
        self, level: Level, around: NDArray[np.float64]
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
        """Rows, components and differences that are not zero; the neighbours of the rows differed by ``around``."""
        caps = self._caps[level.rows]
        activities = activities_of(around, self._usual[level.rows])
        speaks = self._component_counts > 0
        some = np.flatnonzero(speaks[caps])
        models = self._contexts.of_widths(width_contexts(self._expected, caps[some], activities[some]))
        widths = np.zeros(caps.size, dtype=np.int64)
        widths[some] = self._reader.symbols(np.where(speaks, level.counts, 0), models)
        told = told_counts(widths, self._component_counts[caps])
        places = places_of(told, widths, activities, self._classes, caps)
        counts = np.bincount(caps, told, minlength=len(self._classes)).astype(np.int64)
        values = self._reader.values(counts, self._contexts.of_magnitudes(places.bases, places.octaves))
        changed = np.flatnonzero(values)
        return places.rows[changed], places.components[changed], values[changed]


def places_of(
    told: NDArray[np.int64],
    widths: NDArray[np.int64],
    activities: NDArray[np.int64],
    classes: NDArray[np.uint8],
    caps: NDArray[np.int64],
) -> Places:
    """What is told of rows: so many components of each, from their widths, activities and caps."""
    rows = np.repeat(np.arange(told.size), told)
    components = np.arange(rows.size) - np.repeat(np.cumsum(told) - told, told)
    bases = magnitude_bases(activities[rows], classes.ravel()[(caps * classes.shape[1])[rows] + components])
    return Places(rows, components, bases, octaves_left(widths[rows], components))
