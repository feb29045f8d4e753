"""What neighbours tell of each other's transfer where few rays were traced, measured against many."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from slepian_prt.evaluation.metrics import relative_square
from slepian_prt.transport.smoothing import mean_over_neighbours


def smoothed_error(vectors: NDArray, reference: NDArray, neighbours: NDArray, rings: int) -> float:
    """Relative RMS error of vectors smoothed along the surface as well as it can be done with gains of degrees.

    With P the mean over a vertex and its neighbours, x = Pʳx + Σ_k (Pᵏ - Pᵏ⁺¹) x. Each part of each degree, but the
    last, has the gain that brings the sum next to the reference: no choice of gains does better.

    Parameters
    ----------
    vectors, reference : (V, (L+1)²)
    neighbours : (E, 2)
    rings : int >= 1
        r.
    """
    mean = mean_over_neighbours(neighbours, len(vectors))
    left = 0.0
    for degree in range(round(vectors.shape[1] ** 0.5)):
        part = slice(degree**2, (degree + 1) ** 2)
        rest, bands = vectors[:, part].astype(np.float32), []
        for _ in range(rings):
            wider = mean @ rest
            bands.append((rest - wider).ravel())
            rest = wider
        wanted = (reference[:, part] - rest).ravel().astype(np.float64)
        columns = np.stack(bands, axis=1).astype(np.float64)
        gains = np.linalg.lstsq(columns, wanted, rcond=None)[0]
        left += float(np.sum((wanted - columns @ gains) ** 2))
    return float(np.sqrt(relative_square(left, float(np.sum(reference.astype(np.float64) ** 2)))))


def lasting_part(errors: Sequence[NDArray]) -> float:
    """Part of the squared error that is the same in independent estimates, 0 if it is random and 1 if it is not.

    The mean of S errors b + n, n independent with mean 0, has the expected square |b|² + |n|²/S.

    Parameters
    ----------
    errors : S >= 2 arrays of one shape
    """
    count = len(errors)
    single = float(np.mean([np.sum(error.astype(np.float64) ** 2) for error in errors]))
    together = float(np.sum(np.mean([error.astype(np.float64) for error in errors], axis=0) ** 2))
    return (together / single - 1.0 / count) / (1.0 - 1.0 / count)


def shared_by_neighbours(error: NDArray, neighbours: NDArray) -> float:
    """Correlation of the errors (V, M) of vertices side by side: Σ e_a · e_b over their mean energy, -1 to 1."""
    a, b = np.asarray(neighbours).T
    energy = np.einsum("vm,vm->v", error, error, dtype=np.float64)
    products = np.einsum("em,em->e", error[a], error[b], dtype=np.float64)
    return float(products.sum() / (0.5 * (energy[a] + energy[b])).sum())
