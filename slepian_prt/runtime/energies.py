"""Squared norms of transfer vectors in each degree, from their coefficients."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.prediction import by_degree
from slepian_prt.sphere.harmonics import num_coefficients


class DegreeEnergies:
    """Sums over many vectors, each some coefficients times some functions."""

    def __init__(self, bandlimit: int) -> None:
        self._squares = np.zeros(num_coefficients(bandlimit))

    def add(self, coefficients: NDArray[np.float32], functions: NDArray[np.float64]) -> None:
        """Vectors coefficients (n, r) times functions (r, channels (L+1)²)."""
        gram = (coefficients.T @ coefficients).astype(np.float64)
        self._squares += np.sum(functions * (gram @ functions), axis=0).reshape(-1, self._squares.size).sum(axis=0)

    @property
    def sums(self) -> NDArray[np.float64]:
        """(L+1,) of all that was added."""
        return by_degree(np.maximum(self._squares, 0.0))
