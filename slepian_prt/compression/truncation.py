"""How many functions of each cap to keep."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.bases import Candidate
from slepian_prt.slepian.shannon import concentration_count, generalized_shannon_number, refined_shannon_number
from slepian_prt.sphere.caps import Cap

TRUNCATIONS = ("n_g", "n_ref", "count")


def tails(candidate: Candidate) -> NDArray[np.float64]:
    """(K_max + 1,) expected squared error after 0, 1, …, K_max functions; never negative."""
    beyond = max(candidate.total - float(candidate.energies.sum()), 0.0)
    if beyond < 1e-13 * candidate.total:
        beyond = 0.0  # a complete basis: the difference is rounding
    return np.concatenate([np.cumsum(candidate.energies[::-1])[::-1], [0.0]]) + beyond


def predicted_error(candidates: Sequence[Candidate], terms: NDArray, sizes: NDArray) -> float:
    """Expected relative RMS error of the transfer vectors, caps weighted by their numbers of vertices."""
    total = sum(size * c.total for c, size in zip(candidates, sizes, strict=True))
    lost = sum(size * tails(c)[k] for c, k, size in zip(candidates, terms, sizes, strict=True))
    return math.sqrt(lost / total) if total > 0.0 else 0.0


def by_terms(candidates: Sequence[Candidate], wanted: int) -> NDArray[np.int64]:
    """The same number in every cap, or all there are."""
    return np.array([min(wanted, c.energies.size) for c in candidates])


def by_shannon(
    candidates: Sequence[Candidate], caps: tuple[Cap, ...], bandlimit: int, rule: str, epsilon: float
) -> NDArray[np.int64]:
    """The cap's Shannon number: ``n_g`` of the paper, ``n_ref``, or the exact ``count`` of concentrations above ε."""
    numbers: dict[str, Callable[[int, float, float], float]] = {
        "n_g": generalized_shannon_number,
        "n_ref": refined_shannon_number,
        "count": concentration_count,
    }
    wanted = [max(1, math.ceil(numbers[rule](bandlimit, cap.half_angle, epsilon))) for cap in caps]
    return np.array([min(k, c.energies.size) for k, c in zip(wanted, candidates, strict=True)])


def by_tolerance(candidates: Sequence[Candidate], sizes: NDArray, tolerance: float) -> NDArray[np.int64]:
    """Fewest coefficients whose predicted error over all caps together is at most ``tolerance``.

    A coefficient costs the same in every cap per vertex, and so saves most where the energy along its function is
    largest: one threshold on the energy for all caps is optimal.
    """
    thresholds = np.unique(np.concatenate([c.energies for c in candidates]))[::-1]

    def terms_above(threshold: float) -> NDArray[np.int64]:
        counts = []
        for c in candidates:
            above = np.flatnonzero(c.energies > threshold)
            counts.append(int(above[-1]) + 1 if above.size else 1)
        return np.array(counts)

    # Lower thresholds keep more; find the highest that suffices.
    low, high = 0, thresholds.size - 1
    if predicted_error(candidates, terms_above(thresholds[high]), sizes) > tolerance:
        return np.array([c.energies.size for c in candidates])
    while low < high:
        middle = (low + high) // 2
        if predicted_error(candidates, terms_above(thresholds[middle]), sizes) <= tolerance:
            high = middle
        else:
            low = middle + 1
    return terms_above(thresholds[high])
