"""The error to expect, degree by degree, so that it is known for any light before anything is lit."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slepian_prt.sphere.harmonics import bandlimit_of, degrees


@dataclass(frozen=True)
class Expectation:
    """Expected squared norms of what compression loses of a transfer vector, and of the vector.

    Attributes
    ----------
    lost, total : (L+1,)
        In each degree.
    """

    lost: NDArray[np.float64]
    total: NDArray[np.float64]

    def relative(self, power: NDArray | None = None) -> float:
        """Relative RMS error of radiance under light of the given power per harmonic, averaged over its rotations.

        Without ``power``, under white light: the relative error of the transfer vectors themselves.
        """
        power = np.ones(self.lost.size) if power is None else power
        total = float(power @ self.total)
        return math.sqrt(max(float(power @ self.lost), 0.0) / total) if total > 0.0 else 0.0


def by_degree(squares: NDArray) -> NDArray[np.float64]:
    """(L+1,) sums over the orders of each degree of ((L+1)²,) numbers."""
    bandlimit = bandlimit_of(squares.size)
    return np.asarray(np.bincount(degrees(bandlimit), squares, minlength=bandlimit + 1), dtype=np.float64)
