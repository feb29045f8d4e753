"""Second stage: principal axes inside the coefficients of a cap.

What the bases of the first stage hold of a cap's vectors is nearly all of them in few numbers, so that their covariance
is small, and its principal axes nearly those of the vectors themselves, which never need to be held.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.bases import Candidate
from slepian_prt.compression.linear_basis import LinearBasis
from slepian_prt.compression.prediction import by_degree
from slepian_prt.compression.principal_components import principal


@dataclass(frozen=True)
class Refined:
    """The second stage of one cap.

    Attributes
    ----------
    candidate : Candidate
        The first of its terms is the mean.
    mean : (channels, K)
    axes : (K, K)
    """

    candidate: Candidate
    mean: NDArray[np.float64]
    axes: NDArray[np.float64]

    def coefficients(self, first: NDArray, count: int) -> NDArray[np.float32]:
        """(n, count channels) from those of the first stage, (n, K channels)."""
        axes = self.axes[:count].astype(np.float32)
        along = _by_channel(first, len(self.mean)) @ axes.T - (self.mean @ self.axes[:count].T).astype(np.float32)
        return along.swapaxes(1, 2).reshape(len(along), -1)


def refine(basis: LinearBasis, lost: NDArray, coefficients: NDArray, channels: int) -> Refined:
    """Mean and principal axes of the coefficients (n, K channels) of one cap.

    Parameters
    ----------
    basis : LinearBasis
        Of the first stage.
    lost : (L+1,)
        What it is expected to lose, in each degree.
    """
    mean, axes, variances = principal(_by_channel(coefficients, channels))
    of_mean = float(np.mean(np.sum(mean * mean, axis=1)))
    synthesis = basis.synthesis

    def cut(k: int) -> LinearBasis:
        return LinearBasis(
            basis.center,
            basis.bandlimit,
            min(k - 1, len(axes)),
            dense=(axes[: k - 1] @ basis.functions).astype(np.float32),
            mean=(mean @ synthesis).astype(np.float32),
            weights=basis.weights,
        )

    def missing(k: int) -> NDArray[np.float64]:
        rest = axes[k - 1 :].T * variances[k - 1 :] @ axes[k - 1 :]
        return lost + by_degree(np.einsum("km,km->m", rest @ synthesis, synthesis))

    energies = np.concatenate([[of_mean], variances])
    return Refined(Candidate(energies, float(energies.sum()), cut, missing), mean, axes)


def _by_channel(coefficients: NDArray, channels: int) -> NDArray:
    """(n, channels, K) from (n, K channels)."""
    return coefficients.reshape(len(coefficients), -1, channels).swapaxes(1, 2)
