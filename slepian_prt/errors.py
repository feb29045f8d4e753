"""What we raise, and the checks of arguments that every layer shares."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray


class UserError(ValueError):
    """Something that the user can put right.

    The message is one line that says what is wrong, with the value, and what to do about it. The command line prints
    it as it stands and exits with status 2.
    """


def check_integer(value: Any, name: str, smallest: int, largest: int | None = None) -> int:
    """Return ``value`` as an int.

    Parameters
    ----------
    value : int or NumPy integer
    name : str
        Of the parameter, for the message.
    smallest, largest : int
        Both allowed; without ``largest`` there is no upper bound, and ``smallest`` is 0 or 1.

    Raises
    ------
    UserError
        Not an integer (a bool is none), or outside of these bounds.
    """
    try:
        number = smallest - 1 if isinstance(value, bool) else operator.index(value)
    except TypeError:
        number = smallest - 1
    if number < smallest or (largest is not None and number > largest):
        unbounded = "a positive integer" if smallest == 1 else "a non-negative integer"
        wanted = unbounded if largest is None else f"an integer in [{smallest}, {largest}]"
        raise UserError(f"{name} must be {wanted}, not {value!r}")
    return number


def check_bandlimit(bandlimit: Any, name: str = "bandlimit", largest: int = 1000) -> int:
    """Return ``bandlimit`` as an int.

    Raises
    ------
    ValueError
        Not an integer, negative, or above ``largest`` (from about 1400 on the recurrence of the associated Legendre
        functions leaves the range of float64).
    """
    return check_integer(bandlimit, name, 0, largest)


def check_half_angle(half_angle: Any, name: str = "half_angle") -> float:
    """Return ``half_angle`` as a float; raise ValueError unless it lies in [0, π]."""
    return _check_real(half_angle, name, "[0, pi]", lambda x: 0.0 <= x <= math.pi)


def check_epsilon(epsilon: Any, name: str = "epsilon") -> float:
    """Return ``epsilon`` as a float; raise ValueError unless it lies in the open interval (0, 1)."""
    return _check_real(epsilon, name, "(0, 1)", lambda x: 0.0 < x < 1.0)


def check_terms(terms: Any, largest: int, name: str = "terms") -> int:
    """Return ``terms`` as an int; raise ValueError unless 1 <= terms <= largest."""
    return check_integer(terms, name, 1, largest)


def check_directions(directions: ArrayLike, name: str = "directions") -> NDArray[np.float64]:
    """Return unit vectors, shape (n, 3), from finite non-zero ones; a single (3,) vector becomes (1, 3).

    Raises
    ------
    ValueError
        Wrong shape, or a direction that is zero or not finite (the first one is named).
    """
    vectors = np.atleast_2d(np.asarray(directions, dtype=np.float64))
    if vectors.ndim != 2 or vectors.shape[1] != 3:
        raise UserError(f"{name} must have shape (n, 3), not {np.shape(directions)}")
    # Scaled by the largest component first, so that neither 1e-200 nor 1e200 leaves the range when squared.
    scale = np.abs(vectors).max(axis=1, keepdims=True, initial=0.0)
    bad = ~(np.isfinite(scale) & (scale > 0.0))[:, 0]
    if bad.any():
        first = int(np.argmax(bad))
        raise UserError(f"{name}[{first}] must be finite and not zero, not {vectors[first].tolist()}")
    scaled = vectors / scale
    return scaled / np.linalg.norm(scaled, axis=1, keepdims=True)


def _check_real(value: Any, name: str, interval: str, inside: Callable[[float], bool]) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise UserError(f"{name} must be a number in {interval}, not {value!r}") from None
    if not inside(number):
        raise UserError(f"{name} must be a number in {interval}, not {value!r}")
    return number
