"""What we raise, and the checks of arguments that every layer shares."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from typing import Any


class UserError(ValueError):
    """Something that the user can mend.

    The message is one line that says what is wrong, with the value, and what to do about it. The command line prints
    it and exits with status 2. Where it, or another sentence for the user, names a parameter, the parameter stands
    between backticks, alone or with a value: `max_error`, `effects=direct`. There the command line has its own option,
    --max-error, --effects direct.
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


def _check_real(value: Any, name: str, interval: str, inside: Callable[[float], bool]) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise UserError(f"{name} must be a number in {interval}, not {value!r}") from None
    if not inside(number):
        raise UserError(f"{name} must be a number in {interval}, not {value!r}")
    return number
