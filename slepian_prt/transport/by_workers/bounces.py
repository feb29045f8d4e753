"""Bounces by workers, of an exchange of light whose rows are with them in blocks.

By columns (harmonics) where all rows fit into a worker: each gets them once, and columns do not depend on each other.
Else by rows: a block of rows needs the light of all receivers from the bounce before. Sums have the same order in both,
and as in one process.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from slepian_prt.distributed.held import value_of
from slepian_prt.machine.threads import run_in_threads
from slepian_prt.transport.interreflection import (
    Source,
    count_bounces,
    cut_columns,
    follow_bounces,
    reflectance_of,
)

if TYPE_CHECKING:
    from distributed import Future

    from slepian_prt.distributed.crew import Crew, Shared

# Most columns of a task, and tasks for each worker, so that all end about together.
_MOST_COLUMNS, _TASKS = 64, 4


class Rows(NamedTuple):
    """Some rows of an exchange.

    Attributes
    ----------
    receivers : (n,)
    weights : tuple of sparse (n, V)
        For each channel, or one for all.
    """

    receivers: NDArray[np.int64]
    weights: tuple[csr_array, ...]

    @property
    def nbytes(self) -> int:
        """Of the entries."""
        return sum(w.data.nbytes + w.indices.nbytes + w.indptr.nbytes for w in self.weights)

    def times(self, values: NDArray, channel: int) -> NDArray[np.float32]:
        """(n, k) of values (V, k)."""
        product: NDArray[np.float32] = self.weights[min(channel, len(self.weights) - 1)] @ values
        return product


class Start(NamedTuple):
    """What bounces begin with.

    Attributes
    ----------
    reflectance : (C, V)
        Of each channel.
    light : (V, C, k), or (V, 1, k) that is the same in all channels
    collected : as ``light``, or None
        What is added to; by default the light itself.
    """

    reflectance: NDArray[np.float32]
    light: NDArray[np.float32]
    collected: NDArray[np.float32] | None = None

    def of(self, channel: int, columns: slice) -> tuple[NDArray, NDArray, NDArray]:
        """Reflectance, light and a copy of what is added to, of some columns of a channel."""
        place = min(channel, self.light.shape[1] - 1)
        light = np.ascontiguousarray(self.light[:, place, columns])
        begin = light if self.collected is None else self.collected[:, place, columns]
        return self.reflectance[channel], light, np.array(begin, order="C")


# --- On workers ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Whole:
    """The exchange, of all its rows; of surfaces, and of paths where there are any."""

    parts: Sequence[Sequence[Rows]]

    def reflected(self, albedo: NDArray, values: NDArray, channel: int = 0) -> NDArray[np.float32]:
        """As of `Exchange`."""
        shining = albedo[:, None] * values
        found = [[(rows.receivers, rows.times(shining, channel)) for rows in part] for part in self.parts]
        return _assemble(found, values)


def _assemble(found: Sequence[Sequence[tuple[NDArray, NDArray]]], like: NDArray) -> NDArray[np.float32]:
    """Light of all receivers (V, k) from that of rows: first what surfaces sent, then what paths brought."""
    total = None
    for part in found:
        result = np.zeros_like(like)
        for receivers, light in part:
            result[receivers] = light
        total = result if total is None else total + result
    assert total is not None
    return total


def _follow(_scene: Any, item: tuple[Shared, list[list[Rows]], int, slice, int]) -> NDArray[np.float32]:
    handle, parts, channel, columns, bounces = item
    reflectance, light, collected = value_of(handle).of(channel, columns)
    whole, pieces = _Whole(parts), cut_columns(light.shape[1])

    def follow(piece: slice) -> NDArray[np.float32]:
        own = np.ascontiguousarray(light[:, piece])
        return follow_bounces(whole, reflectance, own, collected[:, piece], bounces, channel)

    run_in_threads(follow, pieces)  # scipy's sparse product lets go of the interpreter
    return collected


def _count(_scene: Any, item: tuple[Shared, list[list[Rows]], int]) -> int:
    handle, parts, channel = item
    albedo, ambient = value_of(handle)
    return count_bounces(_Whole(parts), albedo, ambient, channel)


def _reflect(
    _scene: Any, item: tuple[Shared, Rows, NDArray[np.float32] | None, int, slice]
) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Light of some rows from that of all receivers, or from what it begins with."""
    handle, rows, before, channel, columns = item
    start = value_of(handle)
    light = start.of(channel, columns)[1] if before is None else before
    return rows.receivers, rows.times(start.reflectance[channel][:, None] * light, channel)


def _add(_scene: Any, item: tuple[Shared, list[list[tuple[NDArray, NDArray]]], int, slice]) -> NDArray[np.float32]:
    handle, found, channel, columns = item
    return _assemble(found, value_of(handle).of(channel, columns)[1])


def _collect(
    _scene: Any, item: tuple[Shared, NDArray[np.float32] | None, NDArray[np.float32], int, slice]
) -> NDArray[np.float32]:
    handle, before, light, channel, columns = item
    collected = value_of(handle).of(channel, columns)[2] if before is None else before
    return collected + light


def _begin(_scene: Any, item: tuple[Shared, int, slice]) -> NDArray[np.float32]:
    handle, channel, columns = item
    begin: NDArray[np.float32] = value_of(handle).of(channel, columns)[2]
    return begin


# --- On the client ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class RemoteBounces:
    """The series by columns or by rows; see `Bounces`.

    Attributes
    ----------
    crew : Crew
    parts : list of list of Future
        `Rows`, of surfaces, and of paths where there are any.
    whole : bool
        Whether workers may have all rows: by columns.
    """

    crew: Crew
    parts: list[list[Future]]
    whole: bool

    def add(
        self, albedo: NDArray, direct: NDArray, channels: int, bounces: int, source: Source | None = None
    ) -> NDArray[np.float32]:
        """As `add_bounces`."""
        if source is None:
            light = direct[:, None, :]
        else:
            light = np.stack([direct + source(channel, slice(None)) for channel in range(channels)], axis=1)
        reflectance = np.stack([reflectance_of(albedo, channels, channel) for channel in range(channels)])
        total = np.empty((len(direct), channels, direct.shape[1]), dtype=np.float32)
        tasks = _TASKS * max(1, self.crew.count)
        width = min(_MOST_COLUMNS, max(1, -(-channels * direct.shape[1] // tasks)))
        pieces = list(product(range(channels), cut_columns(direct.shape[1], width)))
        self._follow(Start(reflectance, light), pieces, bounces, total)
        return total

    def count(self, albedo: NDArray, ambient: NDArray, channel: int = 0) -> int:
        """As `count_bounces`."""
        if not self.whole:
            return count_bounces(self, albedo, ambient, channel)
        handle = self.crew.share((albedo, ambient))
        try:
            (count,) = self.crew.gather(self.crew.submit(_count, [(handle, self.parts, channel)]))
        finally:
            self.crew.release(handle)
        return int(count)

    def follow(
        self, reflectance: NDArray, light: NDArray, collected: NDArray, bounces: int, channel: int
    ) -> NDArray[np.float32]:
        """As `follow_bounces`."""
        of_channels = np.broadcast_to(reflectance, (channel + 1, *reflectance.shape))
        total = np.empty((len(light), channel + 1, light.shape[1]), dtype=np.float32)
        start = Start(of_channels, light[:, None, :], collected[:, None, :])
        self._follow(start, [(channel, slice(0, light.shape[1]))], bounces, total)
        return total[:, channel]

    def reflected(self, albedo: NDArray, values: NDArray, channel: int = 0) -> NDArray[np.float32]:
        """As of `Exchange`, by rows."""
        return self.follow(albedo, values, np.zeros_like(values), 1, channel)

    def _follow(
        self, start: Start, pieces: Sequence[tuple[int, slice]], bounces: int, total: NDArray[np.float32]
    ) -> None:
        """Fill pieces, which are channels and columns, of (V, C, k)."""
        handle = self.crew.share(start)
        try:
            if self.whole:
                items = [(handle, self.parts, channel, columns, bounces) for channel, columns in pieces]
                futures = self.crew.submit(_follow, items)
            else:
                futures = [self._by_rows(handle, channel, columns, bounces) for channel, columns in pieces]
            for number, collected in self.crew.results(futures):
                channel, columns = pieces[number]
                total[:, channel, columns] = collected
        finally:
            self.crew.release(handle)

    def _by_rows(self, handle: Shared, channel: int, columns: slice, bounces: int) -> Future:
        crew = self.crew
        light = collected = None
        for _ in range(bounces):
            found = [
                crew.submit(_reflect, [(handle, rows, light, channel, columns) for rows in part]) for part in self.parts
            ]
            (light,) = crew.submit(_add, [(handle, found, channel, columns)])
            (collected,) = crew.submit(_collect, [(handle, collected, light, channel, columns)])
        if collected is None:
            (collected,) = crew.submit(_begin, [(handle, channel, columns)])
        return collected
