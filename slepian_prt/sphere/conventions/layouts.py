"""Arrays that tools keep coefficients in, as rows (…, n²) of ours in the order l² + l + m.

In the arrays of ours a light is (3, n²), and what has one number for each harmonic (…, n²). Each layout says how many
degrees an array of its kind holds, and moves numbers, nothing else.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slepian_prt.sphere.harmonics import degrees, num_coefficients, orders


@dataclass(frozen=True)
class Layout:
    """An array that a tool keeps coefficients in.

    Attributes
    ----------
    shape : str
        For the reader: what the last axes are.
    bandlimit : callable
        Given a shape, the bandlimit of such an array, or None if it is none.
    to_rows : callable
        Given an array, the same numbers as (…, n²), or (…, 3, n²) of colours.
    from_rows : callable
        The inverse.
    colours : bool
        Whether it is of red, green and blue.
    """

    shape: str
    bandlimit: Callable[[tuple[int, ...]], int | None]
    to_rows: Callable[[NDArray], NDArray]
    from_rows: Callable[[NDArray], NDArray]
    colours: bool = False


def _of_square(size: int) -> int | None:
    root = math.isqrt(size)
    return root - 1 if size > 0 and root * root == size else None


def _rows(shape: tuple[int, ...]) -> int | None:
    return _of_square(shape[-1]) if shape else None


def _colours_first(shape: tuple[int, ...]) -> int | None:
    return _of_square(shape[-1]) if len(shape) >= 2 and shape[-2] == 3 else None


def _colours_last(shape: tuple[int, ...]) -> int | None:
    return _of_square(shape[-2]) if len(shape) >= 2 and shape[-1] == 3 else None


def _swapped(values: NDArray) -> NDArray:
    return np.swapaxes(values, -1, -2)


# --- SHTOOLS: cosines [0, l, m] and sines [1, l, m] -------------------------------------------------------------------


def _triangles(shape: tuple[int, ...]) -> int | None:
    square = len(shape) >= 3 and shape[-3] == 2 and shape[-2] == shape[-1] > 0
    return shape[-1] - 1 if square else None


def _places(bandlimit: int) -> tuple[NDArray, NDArray, NDArray]:
    l, m = degrees(bandlimit), orders(bandlimit)
    return (m < 0).astype(int), l, np.abs(m)


def _from_triangles(values: NDArray) -> NDArray:
    return np.asarray(values[(..., *_places(values.shape[-1] - 1))])


def _to_triangles(rows: NDArray) -> NDArray:
    bandlimit = math.isqrt(rows.shape[-1]) - 1
    values = np.zeros((*rows.shape[:-1], 2, bandlimit + 1, bandlimit + 1), dtype=rows.dtype)
    values[(..., *_places(bandlimit))] = rows
    return values


# --- Gaussian splatting: f_dc_0 to 2, then f_rest_0 and on, all of red, of green, of blue ----------------------------


def _properties(shape: tuple[int, ...]) -> int | None:
    if len(shape) >= 3 and shape[-1] == 3 and shape[-2] in (4, 9, 16):
        return None  # the features of the trainer, colours last, which is another layout
    return _of_square(shape[-1] // 3) if shape and shape[-1] % 3 == 0 else None


def _from_properties(values: NDArray) -> NDArray:
    rest = values[..., 3:].reshape(*values.shape[:-1], 3, values.shape[-1] // 3 - 1)
    return np.concatenate([values[..., :3, None], rest], axis=-1)


def _to_properties(rows: NDArray) -> NDArray:
    rest = rows[..., 1:].reshape(*rows.shape[:-2], 3 * (rows.shape[-1] - 1))
    return np.concatenate([rows[..., 0], rest], axis=-1)


ROWS = Layout("(…, n²)", _rows, np.asarray, np.asarray)
COLOURS_FIRST = Layout("(…, 3, n²)", _colours_first, np.asarray, np.asarray, True)
COLOURS_LAST = Layout("(…, n², 3)", _colours_last, _swapped, _swapped, True)
TRIANGLES = Layout("(…, 2, L+1, L+1)", _triangles, _from_triangles, _to_triangles)
PROPERTIES = Layout("(…, 3n²)", _properties, _from_properties, _to_properties, True)


def cut_or_filled(rows: NDArray, bandlimit: int) -> NDArray:
    """Rows (…, n²) at a bandlimit, zero in degrees that they have not."""
    size = num_coefficients(bandlimit)
    filled = np.zeros((*rows.shape[:-1], size), dtype=rows.dtype)
    kept = min(size, rows.shape[-1])
    filled[..., :kept] = rows[..., :kept]
    return filled
