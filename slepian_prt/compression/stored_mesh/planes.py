"""Whole numbers as planes of bytes, which deflate well where most are small."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def to_planes(values: NDArray[np.integer]) -> NDArray[np.uint8]:
    """(k, b, n) bytes of signed numbers (n, k), in as few bytes b as hold the largest.

    0, -1, 1, -2, … become 0, 1, 2, 3, …. All low bytes of a column stand together, then those above them.
    """
    signed = np.ascontiguousarray(values.T, dtype=np.int64)
    folded = ((signed << 1) ^ (signed >> 63)).view(np.uint64)
    width = (int(folded.max(initial=0)).bit_length() + 7) // 8
    octets = folded.astype("<u8").view(np.uint8).reshape(*folded.shape, 8)
    return np.ascontiguousarray(np.moveaxis(octets[..., :width], 2, 1))


def from_planes(planes: NDArray[np.uint8], columns: int) -> NDArray[np.int64]:
    """(n, ``columns``) numbers that `to_planes` was given.

    Raises
    ------
    ValueError
    """
    if planes.dtype != np.uint8 or planes.ndim != 3 or len(planes) != columns or planes.shape[1] > 8:
        raise ValueError("planes of bytes")
    octets = np.zeros((columns, planes.shape[2], 8), dtype=np.uint8)
    octets[..., : planes.shape[1]] = np.moveaxis(planes, 1, 2)
    folded = octets.view("<u8")[..., 0].astype(np.uint64)
    signed = (folded >> np.uint64(1)).view(np.int64) ^ -(folded & np.uint64(1)).view(np.int64)
    return np.ascontiguousarray(signed.T)


def to_ordered(values: NDArray[np.floating]) -> NDArray[np.int64]:
    """Whole numbers in the order of floats (float16, float32, float64) whose bits they are, 0 for +0 and -1 for -0."""
    bits = values.view(f"i{values.dtype.itemsize}").astype(np.int64)
    return np.where(bits < 0, bits ^ _below_sign(values.dtype), bits)


def from_ordered(numbers: NDArray[np.int64], dtype: np.dtype[Any]) -> NDArray[np.floating]:
    """What `to_ordered` was given; numbers count modulo what the type holds."""
    kind = f"i{dtype.itemsize}"
    bits = numbers.astype(kind).astype(np.int64)  # wraps
    floats: NDArray[np.floating] = np.where(bits < 0, bits ^ _below_sign(dtype), bits).astype(kind).view(dtype)
    return floats


def _below_sign(dtype: np.dtype[Any]) -> np.int64:
    """All bits of a float but its sign."""
    return np.int64((1 << (8 * dtype.itemsize - 1)) - 1)
