"""All caps rounded with one step, as often as it takes to find the step: piece by piece, here or elsewhere."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.blocks import CapBlocks
from slepian_prt.compression.codec.cap_stream import CapBytes
from slepian_prt.compression.codec.caps import DecodedCap, Tuning
from slepian_prt.compression.codec.encoding import EncodedCap, RoundedCaps, round_caps
from slepian_prt.compression.prediction import by_degree
from slepian_prt.compression.projection import Projection

# Pieces that are kept rounded between attempts; more would take too much memory, and are encoded each time.
HELD_PIECES = 4


@dataclass(frozen=True)
class CodedCap:
    """One cap as a file has it.

    Attributes
    ----------
    content : CapBytes
    used : int
        Components that are not zero throughout.
    lost : (L+1,)
        By degree, the sum over its receivers of the squares of what coding changed of their vectors.
    decoded : DecodedCap or None
        What decoders will get, if that was wanted.
    """

    content: CapBytes
    used: int
    lost: NDArray[np.float64]
    decoded: DecodedCap | None = None


@dataclass(frozen=True)
class Attempt:
    """All caps rounded with one step.

    Attributes
    ----------
    tuning : Tuning
    distortion : float
        Sum of squares of what rounding changed.
    used : int
        Components that are not zero throughout, of all caps.
    principal_axes : sequence of bool or None
        Which caps are coded along their principal axes; None where that is not known before they are encoded.
    encode : callable
        Gives all caps as bytes.
    """

    tuning: Tuning
    distortion: float
    used: int
    principal_axes: Sequence[bool] | None
    encode: Callable[[], list[CodedCap]]


class Coder(Protocol):
    """Rounds all caps."""

    def attempt(self, tuning: Tuning, choices: Sequence[bool | None], before: Attempt | None) -> Attempt:
        """Round with a step; ``choices`` of principal axes, each None where that pays.

        Where few pieces are there, the axes of the attempt ``before`` are taken.
        """


class LocalCoder:
    """Rounds all caps in this process.

    Parameters
    ----------
    projection : Projection
    blocks : CapBlocks
    keep : bool
        Whether what will be decoded is wanted too.
    """

    def __init__(self, projection: Projection, blocks: CapBlocks, keep: bool) -> None:
        self._projection, self._blocks, self._keep = projection, blocks, keep
        self._pieces = blocks.pieces()
        self._rounded: list[RoundedCaps] = []

    def attempt(self, tuning: Tuning, choices: Sequence[bool | None], before: Attempt | None) -> Attempt:
        if len(self._pieces) > HELD_PIECES:
            found = (self._encode(piece, self._round(piece, tuning, choices)) for piece in self._pieces)
            coded, distortions = zip(*found, strict=True)
            caps = [cap for part in coded for cap in part]
            axes = [cap.content.principal_axes for cap in caps]
            return Attempt(tuning, sum(distortions), sum(cap.used for cap in caps), axes, lambda: caps)
        if before is None:
            rounded = [self._round(piece, tuning, choices) for piece in self._pieces]
        else:
            rounded = [piece.with_tuning(tuning) for piece in self._rounded]
        self._rounded = rounded
        return Attempt(
            tuning,
            sum(piece.distortion for piece in rounded),
            sum(piece.used for piece in rounded),
            None,
            lambda: [cap for pair in zip(self._pieces, rounded, strict=True) for cap in self._encode(*pair)[0]],
        )

    def _round(self, piece: range, tuning: Tuning, choices: Sequence[bool | None]) -> RoundedCaps:
        coefficients = [self._blocks.coefficients(c) for c in piece]
        return round_caps(coefficients, self._blocks.rows(piece), tuning, [choices[c] for c in piece])

    def _encode(self, piece: range, rounded: RoundedCaps) -> tuple[list[CodedCap], float]:
        return encode_piece(self._projection, piece, rounded, self._keep), rounded.distortion


def encode_piece(projection: Projection, piece: Sequence[int], rounded: RoundedCaps, keep: bool) -> list[CodedCap]:
    """Caps as bytes; ``keep`` what will be decoded if that is wanted."""
    return [
        CodedCap(cap.content, cap.used, lost_by_degree(projection, c, cap), cap.decoded)
        for c, cap in zip(piece, rounded.encode(keep), strict=True)
    ]


def lost_by_degree(projection: Projection, c: int, cap: EncodedCap) -> NDArray[np.float64]:
    """(L+1,) sum over the receivers of a cap of the squares of what coding changed of their vectors."""
    basis, channels = projection.bases[c], projection.learned.channels
    errors = np.einsum("kclc->kl", cap.errors.reshape(basis.count, channels, basis.count, channels))
    return by_degree(np.sum((errors @ basis.synthesis) * basis.synthesis, axis=0))
