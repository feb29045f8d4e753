"""Lighting of another bandlimit than the transfer's: cut, or zero in the degrees that it has not; never refused.

Radiance is the product of the degrees that both have. So what is cut changes nothing, as the transfer holds nothing of
it, and what is filled up is the light that was given, as smooth as it was.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slepian_prt.arrays import real_numbers
from slepian_prt.errors import UserError
from slepian_prt.sphere.conventions.layouts import cut_or_filled
from slepian_prt.sphere.harmonics import bandlimit_of

log = logging.getLogger(__name__)

# Of coefficients: their products with transfer, added up, stay far within float32.
LARGEST = 1e30

# What was said in the call that is under way, if it is one of many lights.
_said: ContextVar[set[str] | None] = ContextVar("_said", default=None)


@contextmanager
def each_remark_once() -> Iterator[None]:
    """Around a call of many lights, a hundred of which would say the same; the next call says it again."""
    token = _said.set(set() if _said.get() is None else _said.get())
    try:
        yield
    finally:
        _said.reset(token)


def is_lighting(shape: tuple[int, ...]) -> bool:
    """Whether an array of that shape holds coefficients: (3, n²), or (B, 3, n²) of B > 0 lights."""
    square = len(shape) in (2, 3) and shape[-1] > 0 and math.isqrt(shape[-1]) ** 2 == shape[-1]
    return square and shape[-2] == 3 and 0 not in shape


def fit_lighting(lighting: NDArray, bandlimit: int, of: str = "the transfer") -> NDArray:
    """Lighting (…, n²) at a bandlimit, (…, (L+1)²): cut or filled up with zeros, with a remark; else as it is.

    The remark says ``of`` what that bandlimit is.
    """
    given = bandlimit_of(lighting.shape[-1])
    if given == bandlimit:
        return lighting
    _remark(given, bandlimit, of)
    return cut_or_filled(lighting, bandlimit)


def one_light(lighting: ArrayLike, bandlimit: int, of: str = "the transfer") -> NDArray:
    """Coefficients (3, n²) of one light at a bandlimit, as `fit_lighting` has them.

    Raises
    ------
    UserError
        Of another shape, not real, not finite, or too large.
    """
    values = real_numbers(lighting, "lighting")
    if values.ndim != 2 or not is_lighting(values.shape):
        raise UserError(f"lighting must have shape (3, n²), n² harmonics in red, green and blue, not {values.shape}")
    check_lighting(values)
    return fit_lighting(values, bandlimit, of)


def lights_of(lighting: ArrayLike, bandlimit: int) -> NDArray:
    """Coefficients (…, n²) of any number of lights or channels at a bandlimit, as `fit_lighting` has them.

    Raises
    ------
    UserError
        Of another shape, not real, not finite, or too large.
    """
    values = real_numbers(lighting, "lighting")
    if values.ndim == 0 or values.size == 0 or math.isqrt(values.shape[-1]) ** 2 != values.shape[-1]:
        raise UserError(f"lighting must have shape (3, n²), n² harmonics in red, green and blue, not {values.shape}")
    check_lighting(values)
    return fit_lighting(values, bandlimit)


def check_lighting(values: NDArray) -> None:
    """Raise UserError for coefficients that are not finite, or of no light that there is."""
    if not np.isfinite(values).all():
        raise UserError("lighting must be finite; check the map that it was projected from")
    if values.size and max(float(values.max()), -float(values.min())) > LARGEST:
        raise UserError(f"lighting must be within {LARGEST:g}, which is more than pictures hold; scale it down")


def _remark(given: int, wanted: int, of: str) -> None:
    if given > wanted:
        text = f"lighting of bandlimit {given} is cut to {wanted}, that of {of}"
    else:
        dark = f"degree {wanted}" if given + 1 == wanted else f"degrees {given + 1} to {wanted}"
        text = (
            f"lighting of bandlimit {given} counts as dark in {dark} of {of}; project its map at bandlimit {wanted} "
            "for all of its light"
        )
    said = _said.get()
    if said is None or text not in said:
        log.warning(text)
        if said is not None:
            said.add(text)
