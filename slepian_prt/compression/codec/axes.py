"""Principal axes of a cap's coefficients, with no more digits than they need."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.codec.cap_stream import CapsReader, CapsWriter, from_zigzag, zigzag
from slepian_prt.compression.codec.models import MODELS, plain_tokens, token_bits

# Principal axes are kept down to this standard deviation in steps, to within this part of a step of what they carry,
# and stored in multiples of 2^-e.
_AXIS_COUNTS = 0.25
_AXIS_ERROR = 0.15
_COARSEST_AXES, _FINEST_AXES = 4, 15

# Models of the differences between the exponents, and the models, of successive axes; and what the first differ from.
_STEP_MODEL = 16
_FIRST_EXPONENT, _FIRST_MODEL = 8, 20


@dataclass(frozen=True)
class RoundedAxes:
    """Principal axes, in multiples of 2^-exponent.

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

    def first(self, count: int) -> RoundedAxes:
        """The first ``count`` axes."""
        return RoundedAxes(self.multiples[:count], self.exponents[:count], self.rows[:count])

    @property
    def bits(self) -> float:
        """What they cost in a file, nearly."""
        return float(self._costs().min(axis=1, initial=np.inf).sum()) if len(self.multiples) else 0.0

    def models(self) -> NDArray[np.int64]:
        """(A,) models that code the multiples of each axis with the fewest bits."""
        return self._costs().argmin(axis=1)

    def _costs(self) -> NDArray[np.float64]:
        """(A, MODELS) bits."""
        tokens = plain_tokens(np.abs(self.multiples))
        return np.array([token_bits()[:, row].sum(axis=1) for row in tokens]).reshape(-1, MODELS)


def write_axes(writer: CapsWriter, axes: Sequence[RoundedAxes | None]) -> None:
    """Write those of all caps; None where there are none."""
    counts = np.array([0 if part is None else len(part.multiples) for part in axes], dtype=np.int64)
    if not counts.any():
        return
    held = [part for part in axes if part is not None]
    models = [part.models() for part in held]
    usual = np.full(int(counts.sum()), _STEP_MODEL)
    writer.numbers(counts, _steps([part.exponents for part in held], _FIRST_EXPONENT), usual)
    writer.numbers(counts, _steps(models, _FIRST_MODEL), usual)
    sizes = np.array([0 if part is None else part.multiples.size for part in axes], dtype=np.int64)
    of_numbers = [np.repeat(own, part.multiples.shape[1]) for own, part in zip(models, held, strict=True)]
    writer.values(sizes, np.concatenate([part.multiples.ravel() for part in held]), np.concatenate(of_numbers))


def read_axes(reader: CapsReader, counts: NDArray[np.int64], components: Sequence[int]) -> list[RoundedAxes | None]:
    """The inverse of `write_axes`: ``counts`` (caps,) axes of so many components, None where there are none.

    Raises
    ------
    ValueError
        Numbers that no writer writes.
    """
    if not counts.any():
        return [None] * counts.size
    usual = np.full(int(counts.sum()), _STEP_MODEL)
    exponents = _sums(reader.numbers(counts, usual), counts, _FIRST_EXPONENT)
    models = _sums(reader.numbers(counts, usual), counts, _FIRST_MODEL)
    for numbers, limit in ((exponents, _FINEST_AXES), (models, MODELS - 1)):
        if numbers.min() < 0 or numbers.max() > limit:
            raise ValueError("principal axes")
    widths = np.repeat(np.asarray(components, dtype=np.int64), counts)
    sizes = counts * np.asarray(components, dtype=np.int64)
    multiples = np.split(reader.values(sizes, np.repeat(models, widths)).astype(np.int32), np.cumsum(sizes)[:-1])
    found: list[RoundedAxes | None] = []
    for count, width, part, own in zip(
        counts, components, multiples, np.split(exponents, np.cumsum(counts)[:-1]), strict=True
    ):
        rows = part.reshape(int(count), width)
        found.append(RoundedAxes(rows, own, _orthonormal(rows, own)[0]) if count else None)
    return found


def round_axes(x: NDArray, step: float) -> RoundedAxes | None:
    """Principal axes of coefficients (N, K), rounded; None where no axis is long enough."""
    variances, vectors = np.linalg.eigh(x.T @ x / max(len(x), 1))
    sizes, vectors = np.sqrt(np.maximum(variances[::-1], 0.0)), vectors[:, ::-1].T
    kept = int(np.sum(sizes > _AXIS_COUNTS * step))
    if kept == 0:
        return None
    digits = np.ceil(np.log2(sizes[:kept] / (_AXIS_ERROR * step)))
    exponents = np.clip(digits, _COARSEST_AXES, _FINEST_AXES).astype(np.int64)
    multiples = np.rint(np.ldexp(vectors[:kept], exponents[:, None].astype(np.intc))).astype(np.int32)
    rows, lengths = _orthonormal(multiples, exponents)
    return RoundedAxes(multiples, exponents, rows) if lengths.min() > 0.5 else None


def _orthonormal(multiples: NDArray, exponents: NDArray) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Gram-Schmidt of the rows in order, and how long each was beside those before it."""
    rows = np.ldexp(multiples.astype(np.float64), -exponents[:, None].astype(np.intc))
    q, r = np.linalg.qr(rows.T)
    lengths = np.diag(r)
    return (q * np.where(lengths < 0.0, -1.0, 1.0)).T, np.abs(lengths)


def _steps(parts: Sequence[NDArray[np.int64]], first: int) -> NDArray[np.int64]:
    """Differences between successive numbers, without a sign."""
    return np.concatenate([zigzag(np.diff(part, prepend=first)) for part in parts])


def _sums(steps: NDArray[np.int64], counts: NDArray[np.int64], first: int) -> NDArray[np.int64]:
    """What `_steps` was made from."""
    parts = np.split(from_zigzag(steps), np.cumsum(counts)[:-1])
    return np.concatenate([first + np.cumsum(part) for part in parts])
