"""What equal means: exact for copies and integers, to rounding for sums of floats.

A sum of products may be added up in any order: BLAS has another one for every processor. By the standard bound (Higham,
Accuracy and Stability of Numerical Algorithms, 2002, Sec. 3.1), whatever the order,

    |fl(Σ x_i y_i) - Σ x_i y_i| ≤ γ_n Σ |x_i y_i|,   γ_n = n u / (1 - n u),   u = ε/2,

so that two such results differ by no more than n ε Σ |x_i y_i|. Rotations and other matrices that follow each other add
their numbers of terms.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike


def assert_exact(actual: ArrayLike, expected: ArrayLike, because: str) -> None:
    """The same numbers, bit for bit; only where no BLAS, LAPACK or sum of floats made them, for the reason given."""
    np.testing.assert_array_equal(actual, expected, err_msg=because)  # noqa: TID251


def assert_rounded(actual: ArrayLike, expected: ArrayLike, terms: int, size: float | None = None) -> None:
    """Sums of the same products, in any order.

    Parameters
    ----------
    actual, expected : arrays
        In the coarser of their precisions.
    terms : int
        How many products follow each other from what is the same in both: n of the bound.
    size : float, optional
        Bounds Σ |x_i y_i|; by default the largest number expected, for sums that do not cancel.
    """
    actual, expected = np.asarray(actual), np.asarray(expected)
    epsilon = max(np.finfo(values.dtype).eps for values in (actual, expected))
    largest = float(np.abs(expected).max(initial=0.0)) if size is None else size
    np.testing.assert_allclose(actual, expected, rtol=0.0, atol=terms * float(epsilon) * largest)
