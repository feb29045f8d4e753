"""What we raise, and the checks of arguments that every layer shares."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray


class UserError(ValueError):
    """Something that the user can mend.

    The message is one line that says what is wrong, with the value, and what to do about it. The command line prints
    it as it stands and exits with status 2.
    """


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


def check_integer(value: Any, name: str, smallest: int, largest: int | None = None) -> int:
    """Return ``value`` as an int; raise UserError unless it is an integer from ``smallest`` to ``largest``."""
    allowed = f"an integer in [{smallest}, {largest}]"
    if largest is None:
        allowed = {0: "a non-negative integer", 1: "a positive integer"}.get(
            smallest, f"an integer of at least {smallest}"
        )
    try:
        number = operator.index(value)
    except TypeError:
        raise UserError(f"{name} must be {allowed}, not {value!r}") from None
    if isinstance(value, bool) or number < smallest or (largest is not None and number > largest):
        raise UserError(f"{name} must be {allowed}, not {value!r}")
    return number


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
