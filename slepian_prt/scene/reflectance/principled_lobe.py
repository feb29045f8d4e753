"""The diffuse lobe of Mitsuba's ``principled`` and ``principledthin``, which cannot be evaluated apart from the others.

Both ignore the type mask of a `BSDFContext`. Their lobe is a formula of the base colour, the roughness r, the flatness
and the sheen (Burley, *Physically Based Shading at Disney*, 2012, Sec. 5.3, and its 2015 extension; Mitsuba's
``principled.cpp``), in which r appears to the second power at most. So its bihemispherical integral is a polynomial of
r whose coefficients are integrated once.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

_NODES, _AZIMUTHS = 32, 32
_LUMINANCE = np.array([0.212671, 0.715160, 0.072169])  # of linear sRGB


class _Integrals(NamedTuple):
    """Means over pairs of cosine-distributed directions.

    Attributes
    ----------
    rough : (3,)
        Of diffuse and retro-reflection of a white base, by the power of the roughness.
    flat : (3,)
        Of the flattened lobe that replaces these, likewise.
    sheen : float
        Of sheen of unit weight, which Mitsuba does not divide by π.
    """

    rough: NDArray[np.float64]
    flat: NDArray[np.float64]
    sheen: float


@cache
def _integrals() -> _Integrals:
    """By Gauss-Legendre in the cosines and the trapezoidal rule in the angle between the azimuths."""
    node, weight = np.polynomial.legendre.leggauss(_NODES)
    cosine, weight = 0.5 * (node + 1.0), 0.5 * weight * (node + 1.0)  # 2µ dµ on [0, 1]
    i, o = cosine[:, None, None], cosine[None, :, None]
    azimuth = 2.0 * math.pi * (np.arange(_AZIMUTHS) + 0.5) / _AZIMUTHS
    between = i * o + np.sqrt((1.0 - i * i) * (1.0 - o * o)) * np.cos(azimuth)
    half = 0.5 * (1.0 + between)  # squared cosine of the angle to the half vector

    def mean(values: NDArray) -> float:
        whole = np.broadcast_to(values, (_NODES, _NODES, _AZIMUTHS))
        return float(np.einsum("iop,i,o->", whole, weight, weight)) / _AZIMUTHS

    fi, fo = (1.0 - i) ** 5, (1.0 - o) ** 5
    rough = [(1.0 - 0.5 * fi) * (1.0 - 0.5 * fo), 2.0 * half * (fi + fo - fi * fo), 4.0 * half**2 * fi * fo]
    scatter = [(1.0 - fi) * (1.0 - fo), half * (fi + fo - 2.0 * fi * fo), half**2 * fi * fo]
    flat = [1.25 * (1.0 / (i + o) - 0.5) * power for power in scatter]
    flat[0] = flat[0] + 1.25 * 0.5
    sheen = math.pi * mean((1.0 - np.sqrt(half)) ** 5)
    return _Integrals(np.array([mean(term) for term in rough]), np.array([mean(term) for term in flat]), sheen)


def principled_albedo(parts: dict[str, Any], points: Any, *, thin: bool) -> NDArray[np.float64]:
    """(n, 3) what the diffuse reflecting lobe reflects of diffuse light.

    Parameters
    ----------
    parts : textures of the BSDF by name
    points : Mitsuba surface interactions
    thin : bool
        ``principledthin``, which has no metal and lets part of the light through.
    """

    def number(name: str) -> NDArray[np.float64]:
        return np.array(parts[name].eval_1(points), dtype=np.float64)[:, None]

    base = np.array(parts["base_color"].eval(points), dtype=np.float64).T
    kept = 1.0 - number("spec_trans")
    if thin:
        kept = kept * (1.0 - 0.5 * number("diff_trans"))
        sheen_kept = kept
    else:
        sheen_kept = 1.0 - number("metallic")
        kept = kept * sheen_kept
    integrals, flatness = _integrals(), number("flatness")
    powers = number("roughness") ** np.arange(3)
    factor = (1.0 - flatness) * (powers @ integrals.rough)[:, None] + flatness * (powers @ integrals.flat)[:, None]
    # The means over the channels are the luminance where there are not three of them.
    luminance = base @ _LUMINANCE[:, None] if base.shape[1] == 3 else base.mean(axis=1, keepdims=True)
    tint = np.divide(base, luminance, out=np.ones_like(base), where=luminance > 0.0)
    sheen = number("sheen") * (1.0 + number("sheen_tint") * (tint - 1.0)) * integrals.sheen
    # The formula does not conserve energy: white with much sheen would reflect more than all light.
    return np.asarray(np.minimum(kept * factor * base + sheen_kept * sheen, 1.0))
