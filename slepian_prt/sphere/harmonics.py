"""Real spherical harmonics, orthonormal on S², with the Condon–Shortley phase.

Index ``l*l + l + m``; m > 0 goes with cos(mφ), m < 0 with sin(|m|φ); z is the polar axis. The values equal those of
``drjit.sh_eval`` and √2 Re/Im of ``scipy.special.sph_harm_y``.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from slepian_prt.errors import check_bandlimit
from slepian_prt.sphere.directions import check_directions

# Directions evaluated at a time: all rows of one degree then fit the second-level cache up to L of about 50.
_CHUNK = 512


def num_coefficients(bandlimit: int) -> int:
    """M = (L+1)², the dimension of the space of functions of bandlimit L."""
    return (bandlimit + 1) ** 2


def bandlimit_of(size: int) -> int:
    """L of functions with (L+1)² coefficients, the inverse of `num_coefficients`; rounded down if there is none."""
    return math.isqrt(size) - 1


def degrees(bandlimit: int) -> NDArray[np.int64]:
    """Degree l of each of the (L+1)² coefficients, shape (M,)."""
    return np.repeat(np.arange(bandlimit + 1), 2 * np.arange(bandlimit + 1) + 1)


def orders(bandlimit: int) -> NDArray[np.int64]:
    """Order m of each of the (L+1)² coefficients, shape (M,)."""
    return np.concatenate([np.arange(-l, l + 1) for l in range(bandlimit + 1)])


@cache
def legendre_factors(bandlimit: int) -> tuple[NDArray, NDArray, NDArray]:
    """Constants of the recurrence below: the start values at l = m, and a_lm, b_lm, indexed [l, m]."""
    l = np.arange(bandlimit + 1, dtype=np.float64)[:, None]
    m = np.arange(bandlimit + 1, dtype=np.float64)[None, :]
    with np.errstate(divide="ignore", invalid="ignore"):
        a = np.sqrt((4 * l * l - 1) / (l * l - m * m))
        b = np.sqrt(((l - 1) ** 2 - m * m) * (2 * l + 1) / ((2 * l - 3) * (l * l - m * m)))
    # The root of a product, taken as the exponential of a sum of exact logarithms, would lose digits; the running
    # product of ratios next to one keeps them.
    k = np.arange(1, bandlimit + 1, dtype=np.float64)
    start = np.sqrt(np.concatenate([[1.0], np.cumprod((2 * k + 1) / (2 * k))]) / (4 * np.pi))
    start[1:] *= np.sqrt(2.0)
    start[1::2] *= -1.0
    return start, a, b


def legendre_polynomials(
    bandlimit: int, order: int, z: NDArray[np.float64], z_low: NDArray[np.float64] | None = None
) -> NDArray[np.float64]:
    """Normalised associated Legendre functions of one order, without their factor sin^m θ.

    With p_lm the value returned, y_l0 = p_l0 and y_lm = p_lm Re (x + iy)^m, y_l,-m = p_lm Im (x + iy)^m for m > 0.
    p_lm is a polynomial in z, so nothing is lost next to the poles.

    Parameters
    ----------
    bandlimit : int
    order : m in [0, L].
    z : (n,) cosines.
    z_low : (n,) optional; the cosine is ``z + z_low``. Carries what a node next to the pole loses in ``z`` alone.

    Returns
    -------
    (L+1-m, n) array, degrees m..L.
    """
    start, a, b = legendre_factors(bandlimit)
    p = np.empty((bandlimit + 1 - order, z.size))
    p[0] = start[order]
    for l in range(order + 1, bandlimit + 1):
        # p_lm = a_lm z p_(l-1)m - b_lm p_(l-2)m
        row = p[l - order]
        np.multiply(p[l - order - 1], z, out=row)
        if z_low is not None:
            row += p[l - order - 1] * z_low
        row *= a[l, order]
        if l >= order + 2:
            row -= b[l, order] * p[l - order - 2]
    return p


def real_sh(bandlimit: int, directions: ArrayLike, dtype: DTypeLike = np.float64) -> NDArray:
    """Evaluate all real spherical harmonics of degree 0..L.

    Column l² + l + m has degree l and order m; m > 0 goes with cos mφ, m < 0 with sin |m|φ. They are orthonormal on the
    sphere, ∫ y_i y_j dω = δ_ij, with the Condon–Shortley phase (-1)^m: y_1,-1 = -√(3/4π) y. The polar axis is z, while
    what is up in scenes and maps is y. So has ``drjit.sh_eval`` them; `convert_sh` knows how other tools do.

    Parameters
    ----------
    bandlimit : int
        L >= 0.
    directions : (n, 3) or (3,)
        Need not be normalised.
    dtype : float64 or float32
        Of the result. The recurrence itself always runs in float64: in float32 it is off by 5e-4 at L = 100.

    Returns
    -------
    (n, (L+1)²) array, stored with the directions contiguous (Fortran order).

    Raises
    ------
    ValueError
        A bandlimit that is not an integer in [0, 1000]; a direction that is zero or not finite.
    """
    bandlimit = check_bandlimit(bandlimit)
    unit = check_directions(directions)
    values = np.empty((num_coefficients(bandlimit), unit.shape[0]), dtype=dtype)
    for begin in range(0, unit.shape[0], _CHUNK):
        x, y, z = unit[begin : begin + _CHUNK].T
        _evaluate(bandlimit, x, y, np.ascontiguousarray(z), values[:, begin : begin + _CHUNK])
    return values.T


def _evaluate(bandlimit: int, x: NDArray, y: NDArray, z: NDArray, out: NDArray) -> None:
    """Fill ``out`` (M, n). The recurrence of `legendre_polynomials`, keeping only three degrees at a time."""
    start, a, b = legendre_factors(bandlimit)
    n = z.size
    cos_m = np.empty((bandlimit + 1, n))  # sin^m θ cos mφ = Re (x + iy)^m
    sin_m = np.empty((bandlimit + 1, n))
    cos_m[0], sin_m[0] = 1.0, 0.0
    for m in range(1, bandlimit + 1):
        cos_m[m] = x * cos_m[m - 1] - y * sin_m[m - 1]
        sin_m[m] = x * sin_m[m - 1] + y * cos_m[m - 1]

    rows = np.empty((3, bandlimit + 1, n))
    scratch = np.empty((bandlimit + 1, n))
    for l in range(bandlimit + 1):
        p, p1, p2 = rows[l % 3], rows[(l - 1) % 3], rows[(l - 2) % 3]
        p[l] = start[l]
        if l >= 1:
            np.multiply(p1[:l], z, out=p[:l])
            p[:l] *= a[l, :l, None]
        if l >= 2:
            np.multiply(p2[: l - 1], b[l, : l - 1, None], out=scratch[: l - 1])
            p[: l - 1] -= scratch[: l - 1]
        centre = l * l + l
        np.multiply(p[: l + 1], cos_m[: l + 1], out=out[centre : centre + l + 1], casting="same_kind")
        if l >= 1:
            np.multiply(p[l:0:-1], sin_m[l:0:-1], out=out[centre - l : centre], casting="same_kind")
