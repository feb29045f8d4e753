"""Projected blocks, read cap by cap."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.checkpoint import Block, Store
from slepian_prt.compression.codec.caps import Tuning
from slepian_prt.compression.codec.surface import CapRows, surface_of
from slepian_prt.compression.codec.tuning import tune
from slepian_prt.scene.receivers import Receivers

# Coefficients that are coded together: they take some 60 bytes each meanwhile.
_PIECE = 1 << 21


class ProjectedCaps(Protocol):
    """Coefficients of all receivers, wherever they are: in this process, or with workers.

    Attributes
    ----------
    widths : (caps,)
        Coefficients of a receiver of each cap.
    """

    @property
    def widths(self) -> NDArray[np.int64]: ...

    def size(self, caps: Sequence[int]) -> int:
        """Number of receivers in some caps."""

    def energies(self) -> tuple[float, float]:
        """Sums over all receivers of the squared norms of (weighted) vectors and of what the bases miss."""

    def largest(self) -> float:
        """The largest size of a coefficient."""

    def coefficients(self, cap: int) -> NDArray[np.float32]:
        """(n, K channels) of a cap, in the order of its members."""

    def tune(self, caps: Sequence[int], distortion: float, finest: float, principal_axes: bool | None) -> Tuning:
        """Step and models for some of the caps; see `codec.tuning.tune`."""


@dataclass(frozen=True, eq=False)
class CapBlocks:
    """Coefficients of receivers, cap by cap.

    Attributes
    ----------
    receivers : Receivers
    index : (V,)
        Cap of each receiver.
    members : sequence of (n,)
        The receivers of each cap, ascending; or some of them, if the blocks hold those alone.
    widths : (caps,)
        Coefficients of a receiver of each cap.
    store : Store
    overrides : dict of int to Block
        Blocks that replace what the store has of their receivers.
    """

    receivers: Receivers
    index: NDArray[np.int32]
    members: Sequence[NDArray[np.int64]]
    widths: NDArray[np.int64]
    store: Store
    overrides: dict[int, Block]

    def size(self, caps: Sequence[int]) -> int:
        """Number of receivers in some caps."""
        return sum(self.members[c].size for c in caps)

    def energies(self) -> tuple[float, float]:
        """Sums over all receivers of the squared norms of (weighted) vectors and of what the bases miss."""
        energy, missed = np.zeros((2, len(self.receivers)), dtype=np.float64)
        for block in self._blocks():
            energy[block.vertices], missed[block.vertices] = block.statistics.energy, block.statistics.missed
        pieces = [np.concatenate([self.members[c] for c in piece]) for piece in self.pieces()]
        # Piece by piece, as workers do that have no more than one.
        return sum(float(energy[own].sum()) for own in pieces), sum(float(missed[own].sum()) for own in pieces)

    def largest(self) -> float:
        """The largest size of a coefficient."""
        return max((float(np.abs(block.coefficients).max(initial=0.0)) for block in self._blocks()), default=0.0)

    def coefficients(self, cap: int) -> NDArray[np.float32]:
        """(n, K channels) of a cap, in the order of its members."""
        members, width = self.members[cap], int(self.widths[cap])
        values = np.zeros((members.size, width), dtype=np.float32)

        def place(vertices: NDArray, flat: NDArray) -> None:
            values[np.searchsorted(members, vertices)] = flat.reshape(vertices.size, width)

        for number, starts in self._starts.items():
            rows, numbers = _slices(starts, cap)
            if rows.stop > rows.start:
                place(*self.store.part(number, rows, numbers))
        for block in self.overrides.values():
            rows, numbers = _slices(self._starts_of(block), cap)
            place(block.vertices[rows], block.coefficients[numbers])
        return values

    def rows(self, caps: Sequence[int]) -> CapRows:
        """How the codec visits some caps."""
        return surface_of(self.receivers).rows([self.members[c] for c in caps])

    def tune(self, caps: Sequence[int], distortion: float, finest: float, principal_axes: bool | None) -> Tuning:
        """Step and models for some of the caps; see `codec.tuning.tune`."""
        return tune([self.coefficients(c) for c in caps], self.rows(caps), distortion, finest, principal_axes)

    def pieces(self) -> list[range]:
        """The caps in pieces whose coefficients are few enough to be coded together."""
        return pieces_of(np.array([part.size for part in self.members]) * self.widths)

    @cached_property
    def _starts(self) -> dict[int, tuple[NDArray[np.int64], NDArray[np.int64]]]:
        """For each block, where each cap's receivers begin, and their coefficients."""
        return {number: self._starts_of(block) for number, block in self.store}

    def _starts_of(self, block: Block) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        sizes = np.bincount(self.index[block.vertices], minlength=len(self.widths))
        return np.append(0, np.cumsum(sizes)), np.append(0, np.cumsum(sizes * self.widths))

    def _blocks(self) -> Iterator[Block]:
        """One after the other: together they may not fit in memory."""
        yield from (block for _, block in self.store)
        yield from self.overrides.values()


def pieces_of(counts: NDArray[np.int64], most: int | None = None) -> list[range]:
    """Successive caps in pieces of nearly so many coefficients together at most, from how many each has."""
    most = _PIECE if most is None else most
    starts = np.flatnonzero(np.diff((np.cumsum(counts) - counts) // most, prepend=-1))
    return [range(begin, end) for begin, end in zip(starts, [*starts[1:], len(counts)], strict=True)]


def _slices(starts: tuple[NDArray, NDArray], cap: int) -> tuple[slice, slice]:
    first, second = (slice(int(start[cap]), int(start[cap + 1])) for start in starts)
    return first, second
