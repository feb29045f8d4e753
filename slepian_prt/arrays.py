"""Arrays of numbers as users give them."""

from __future__ import annotations

from textwrap import shorten
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slepian_prt.errors import UserError


def real_numbers(values: ArrayLike, name: str, *, copy: bool = False) -> NDArray[np.float64]:
    """Return ``values`` as float64; NaN and infinity are left to the caller, who knows which of them it was.

    Raises
    ------
    UserError
        Ragged, complex, text, or integers beyond float64; ``name`` is told.
    """
    try:
        array = np.asarray(values)
        if array.dtype.kind in "biuf":
            with np.errstate(over="ignore"):  # of what only longer floats hold
                return array.astype(np.float64, copy=copy)
        if array.dtype.kind == "O" and None not in array:  # of integers that no other type holds, or other objects
            return array.astype(np.float64)
    except (TypeError, ValueError, OverflowError):
        pass
    raise UserError(f"{name} must be real numbers, not {_told(values)}")


def whole_numbers(values: ArrayLike, name: str) -> NDArray[np.int64]:
    """Return ``values`` as int64.

    Raises
    ------
    UserError
        Ragged, text, or a number that is not whole or that int64 does not hold.
    """
    try:
        array = np.asarray(values)
        if array.dtype.kind in "bi" or array.size == 0:
            return array.astype(np.int64)
        if array.dtype.kind in "uf":
            with np.errstate(invalid="ignore"):
                whole = array.astype(np.int64)
            if np.all(whole == array):
                return whole
    except (TypeError, ValueError, OverflowError):
        pass
    raise UserError(f"{name} must be whole numbers, not {_told(values)}")


def _told(values: Any) -> str:
    kind = getattr(values, "dtype", None)
    return shorten(repr(values), 60) if kind is None else f"an array of {kind}"
