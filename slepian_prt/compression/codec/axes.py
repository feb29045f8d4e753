"""Principal axes of a cap's coefficients, with no more digits than they need."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.codec.entropy import MODELS, Reader, Writer, bit_costs, symbols_of

# Principal axes are kept down to this standard deviation in steps, to within this part of a step of what they carry,
# and stored in multiples of 2^-e.
_AXIS_COUNTS = 0.25
_AXIS_ERROR = 0.15
_COARSEST_AXES, _FINEST_AXES = 4, 15


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

    def write(self, writer: Writer) -> None:
        """Code the multiples, each axis with the model that takes the fewest bits."""
        writer.number(len(self.multiples), self.multiples.shape[1] + 1)
        for row, exponent in zip(self.multiples, self.exponents.tolist(), strict=True):
            cost = bit_costs()[:, symbols_of(row)].sum(axis=1)
            model = int(np.argmin(cost))
            writer.number(exponent, _FINEST_AXES + 1)
            writer.number(model, MODELS)
            writer.values(row, model)

    @staticmethod
    def read(reader: Reader, components: int) -> RoundedAxes:
        """The inverse of `write`."""
        count = reader.number(components + 1)
        multiples = np.zeros((count, components), dtype=np.int32)
        exponents = np.zeros(count, dtype=np.int64)
        for i in range(count):
            exponents[i] = reader.number(_FINEST_AXES + 1)
            multiples[i] = reader.values(components, reader.number(MODELS))
        return RoundedAxes(multiples, exponents, _orthonormal(multiples, exponents)[0])


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
