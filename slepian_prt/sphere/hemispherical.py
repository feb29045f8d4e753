"""Bases of functions over the hemisphere about z: hemispherical harmonics and the H-basis.

Hemispherical harmonics take the Legendre functions of spherical harmonics at 2 cos θ - 1 (Makhotkin, J. Quant.
Spectrosc. Radiat. Transf. 1996; Gautron et al., EGSR 2004). That is the map (θ, φ) → (θ', φ), cos θ' = 2 cos θ - 1,
from the hemisphere onto the sphere, which doubles all areas alike; so they are √2 times the spherical harmonics there.
The whole horizon becomes the lower pole: all that varies with φ vanishes on it, and slopes there are infinite, like
those of √(cos θ).

The H-basis (Habel & Wimmer, I3D 2010) is made of polynomials in x, y, z up to degree 2, spherical harmonics made
orthonormal over the hemisphere.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slepian_prt.errors import UserError, check_bandlimit
from slepian_prt.sphere.directions import check_directions
from slepian_prt.sphere.harmonics import legendre_polynomials, num_coefficients, real_sh
from slepian_prt.sphere.quadrature import gauss_legendre

# Directions are below the horizon from so many roundings of their own precision on: rotated ones on it are off by some.
_ROUNDINGS = 8.0

# Places of the six functions of the H-basis among all nine polynomials up to degree 2, in their published order.
_SIX = (0, 1, 2, 3, 4, 8)


def hemispherical_sh(bandlimit: int, directions: ArrayLike) -> NDArray[np.float64]:
    """Evaluate all hemispherical harmonics (HSH) of degree 0..L, orthonormal over the hemisphere z >= 0.

    Parameters
    ----------
    bandlimit : int
        L >= 0.
    directions : (n, 3) or (3,)
        With z >= 0; need not be normalised.

    Returns
    -------
    (n, (L+1)²) array
        Index, order and signs as of `real_sh`: l² + l + m, m > 0 with cos(mφ), Condon–Shortley phase. Gautron et al.
        have the same functions up to that phase, (-1)^m.

    Raises
    ------
    UserError
        A bandlimit that is not an integer in [0, 1000]; a direction that is zero, not finite or below the horizon.
    """
    bandlimit = check_bandlimit(bandlimit)
    return math.sqrt(2.0) * real_sh(bandlimit, onto_sphere(_check_upper(directions)))


def onto_sphere(directions: NDArray) -> NDArray[np.float64]:
    """Unit directions (n, 3) of the hemisphere z >= 0 where (θ, φ) → (θ', φ), cos θ' = 2 cos θ - 1, takes them."""
    x, y, z = directions.T
    # sin θ' / sin θ, in which nothing cancels: neither next to the pole nor on the horizon.
    sideways = 2.0 * np.sqrt(z / (1.0 + z))
    return np.column_stack([sideways * x, sideways * y, 2.0 * z - 1.0])


def h_basis(count: int, directions: ArrayLike) -> NDArray[np.float64]:
    """Evaluate the first functions of the H-basis, polynomials orthonormal over the hemisphere z >= 0.

    With s = √(3/2π), those of degree 0 and 1 are 1/√(2π), -s y, s (2z - 1), -s x.

    Parameters
    ----------
    count : 4, 6 or 9
        4 are degrees 0 and 1; 6 have √(15/2π) xy and √(15/8π) (x² - y²) too, which are √2 times the spherical
        harmonics, as Habel & Wimmer chose them; 9 are all polynomials up to degree 2, by the same construction.
    directions : (n, 3) or (3,)
        With z >= 0; need not be normalised.

    Returns
    -------
    (n, count) array
        4 and 9 at index l² + l + m, as `real_sh`, and with its Condon–Shortley phase; Habel & Wimmer, without it, have
        +x and +y.

    Raises
    ------
    UserError
        Another count; a direction that is zero, not finite or below the horizon.
    """
    coefficients = h_basis_in_sh(count)
    return real_sh(2, _check_upper(directions)) @ coefficients.T


def h_basis_in_sh(count: int) -> NDArray[np.float64]:
    """The H-basis as polynomials on all of the sphere: (count, 9) coefficients in spherical harmonics up to degree 2.

    Gram–Schmidt over the hemisphere by ascending degree, in closed form.

    Raises
    ------
    UserError
        The count is not 4, 6 or 9.
    """
    if isinstance(count, bool) or not isinstance(count, int | np.integer) or count not in (4, 6, 9):
        raise UserError(f"count must be 4, 6 or 9, not {count!r}")
    rows = math.sqrt(2.0) * np.eye(9)
    # 2z - 1 and 6z² - 6z + 1, shifted Legendre polynomials.
    rows[2, [0, 2]] = -math.sqrt(6.0), 2.0 * math.sqrt(2.0)
    rows[6, [0, 2, 6]] = 3.0 * math.sqrt(10.0), -2.0 * math.sqrt(30.0), 4.0 * math.sqrt(2.0)
    # yz and xz less 3/8 of y and x.
    for product, single in ((5, 1), (7, 3)):
        rows[product, [single, product]] = -0.375 * math.sqrt(640.0 / 19.0), math.sqrt(128.0 / 19.0)
    return rows[list(_SIX)] if count == 6 else rows[:count]


def sh_over_hemisphere(bandlimit: int, hemispherical_bandlimit: int) -> NDArray[np.float64]:
    """Integrals ∫ y_i h_j over the hemisphere z >= 0 of spherical and hemispherical harmonics.

    Functions of different m are orthogonal. For the others Gauss's rule in u = √(cos θ), in which the product is a
    polynomial times √(1 + u²)^m: it converges like (1 + √2)^(-2n), to rounding with the nodes taken.

    Parameters
    ----------
    bandlimit, hemispherical_bandlimit : int
        L and H.

    Returns
    -------
    ((L+1)², (H+1)²) array
    """
    bandlimit = check_bandlimit(bandlimit)
    highest = check_bandlimit(hemispherical_bandlimit, "hemispherical_bandlimit")
    rule = gauss_legendre(bandlimit + highest + 24)
    u, weights = 0.5 * (1.0 + rule.nodes), 0.5 * rule.weights
    z = u * u
    integrals = np.zeros((num_coefficients(bandlimit), num_coefficients(highest)))
    for m in range(min(bandlimit, highest) + 1):
        # sin^m θ sin^m θ', and dz = 2u du.
        ring = (2.0 * u * (1.0 - z) * np.sqrt(1.0 + z)) ** m * (2.0 * u * weights)
        spherical = legendre_polynomials(bandlimit, m, z) * ring
        hemispherical = math.sqrt(2.0) * legendre_polynomials(highest, m, 2.0 * z - 1.0)
        block = (np.pi if m else 2.0 * np.pi) * (spherical @ hemispherical.T)
        rows, columns = np.arange(m, bandlimit + 1), np.arange(m, highest + 1)
        for order in {m, -m}:
            integrals[np.ix_(rows * (rows + 1) + order, columns * (columns + 1) + order)] = block
    return integrals


def _check_upper(directions: ArrayLike) -> NDArray[np.float64]:
    """Unit vectors (n, 3) with z >= 0; UserError on the first below the horizon by more than its own rounding."""
    unit = check_directions(directions)
    given = np.asarray(directions).dtype
    precision = given if given.kind == "f" else np.float64
    below = unit[:, 2] < -_ROUNDINGS * float(np.finfo(precision).eps)
    if below.any():
        first = int(np.argmax(below))
        raise UserError(
            f"directions[{first}] is below the horizon, z = {unit[first, 2]:.3g}; give directions with z >= 0"
        )
    unit[:, 2] = np.maximum(unit[:, 2], 0.0)
    return unit
