"""What we raise, and the checks of arguments that every layer shares."""

from __future__ import annotations

import difflib
import math
import operator
from collections.abc import Callable, Iterable
from pathlib import PurePath
from textwrap import shorten
from typing import Any


class UserError(ValueError):
    """Something that the user can put right.

    The message is one line that says what is wrong, with the value, and what to do about it. The command line prints
    it and exits with status 2. Where it, or another sentence for the user, names a parameter, the parameter stands
    between backticks, alone or with a value: `max_error`, `effects=direct`. There the command line has its own option,
    --max-error, --effects direct.
    """

    def __init__(self, message: str) -> None:
        super().__init__(printable(message))


def printable(text: str) -> str:
    """A text without line breaks, commands to terminals, or what no encoding has: these are escaped.

    Names in files, and of files, may hold all of them.
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)


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
    """Return ``half_angle`` as a float; raise ValueError unless it lies in [0, π], to rounding of its own type."""
    eps = {2: 2.0**-10, 4: 2.0**-23}.get(getattr(getattr(half_angle, "dtype", None), "itemsize", 8), 0.0)
    number = check_real(half_angle, name, "[0, pi]", lambda x: 0.0 <= x <= math.pi * (1.0 + eps))
    return min(number, math.pi)


def check_epsilon(epsilon: Any, name: str = "epsilon") -> float:
    """Return ``epsilon`` as a float; raise ValueError unless it lies in the open interval (0, 1)."""
    return check_real(epsilon, name, "(0, 1)", lambda x: 0.0 < x < 1.0)


def check_real(value: Any, name: str, interval: str, inside: Callable[[float], bool]) -> float:
    """Return ``value`` as a float; raise UserError unless it is a number (neither a bool nor text) and ``inside``."""
    number = math.nan
    try:
        if not isinstance(value, bool | str | bytes) and getattr(getattr(value, "dtype", None), "kind", "f") != "b":
            number = float(value)
    except (TypeError, ValueError, OverflowError):
        pass
    if not inside(number):
        raise UserError(f"{name} must be a number in {interval}, not {shorten(repr(value), 80)}")
    return number


def check_transfer(transfer: object) -> None:
    """Raise UserError for the path of a transfer, or what else is none, where one is wanted."""
    if isinstance(transfer, str | PurePath):
        raise UserError(f"transfer must be what is in a file, not its path; give sp.load({str(transfer)!r})")
    if not hasattr(transfer, "bandlimit"):
        raise UserError(f"transfer must be what sp.precompute or sp.load gives, not {type(transfer).__name__}")


def check_choice(value: Any, name: str, choices: Iterable[str]) -> None:
    """Raise UserError unless ``value`` is one of the ``choices``; it names the one that may have been meant."""
    choices = tuple(choices)
    if value not in choices:
        near = difflib.get_close_matches(value.lower(), choices, n=1) if isinstance(value, str) else []
        meant = f"; did you mean {near[0]}?" if near else ""
        raise UserError(f"{name} must be one of {', '.join(choices)}, not {value!r}{meant}")
