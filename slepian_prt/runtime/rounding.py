"""Coefficients in bytes, and functions in as few bits as matter."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

# What a byte is divided by.
LARGEST = 255

# The smallest step of float16.
_SMALLEST = 2.0**-24


def to_bytes(
    coefficients: NDArray[np.floating], bits: int
) -> tuple[NDArray[np.uint8], NDArray[np.float32], NDArray[np.float64]]:
    """Coefficients (n, k) as parts of 255, each component over its own range.

    Returns
    -------
    bytes : (n, k)
        Of 2^bits different values.
    zeros : (k,)
        What part of 255 stands for zero.
    scales : (k,)
        coefficients ≈ (bytes / 255 - zeros) scales
    """
    low, high = coefficients.min(axis=0).astype(np.float64), coefficients.max(axis=0).astype(np.float64)
    scales = np.where(high > low, high - low, 1.0)
    zeros = (-low / scales).astype(np.float32)
    levels = (1 << bits) - 1
    told = np.rint((coefficients - low) * (levels / scales)) * (LARGEST / levels)
    return np.rint(told).astype(np.uint8), zeros, scales


def round_functions(functions: NDArray[np.float64], step: float) -> NDArray[np.float64]:
    """Functions as multiples of a power of two that is no larger than ``step``, all of them numbers of float16.

    What small numbers lack in bits, compression of files takes out.
    """
    unit = 2.0 ** math.floor(math.log2(max(step, _SMALLEST)))
    return (np.rint(functions / unit) * unit).astype(np.float16).astype(np.float64)
