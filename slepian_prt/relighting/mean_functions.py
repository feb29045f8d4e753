"""The mean transfer about each normal as coefficients of a few functions, for all caps that are about as wide.

R_n t̄ over a cap of normals lies in the span of what concentrates the kernel t̄ on it. In the frame of the cap a function
f of order m has coefficients f_l, and the one of R_n t̄ along it is Σ t_l f_l y_lm(n) = g(n_z) Re (n_x + i n_y)^|m|, or
Im where m < 0: beside the azimuth a polynomial of n_z, which is smooth over a cap, so that a few Chebyshev polynomials
give it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slepian_prt.slepian.concentration import cap_basis, scatter_radial
from slepian_prt.sphere.harmonics import legendre_polynomials

# The mean transfer of a cap is held by as many functions as leave out less than this part of it.
_LEFT_OUT = 1e-5

# What each coefficient may be off by, in parts of the norm of the mean transfer: a tenth of what is left out even if
# a hundred functions are off at once.
_INTERPOLATED = 1e-7

# Caps share functions of one at most this much wider, but for the narrowest, to which polynomials would see no width.
_ANGLE_STEP = 1.25
_NARROWEST = 0.01


@dataclass(frozen=True, eq=False)
class MeanFunctions:
    """Functions for caps of normals about z.

    Attributes
    ----------
    functions : (k, (L+1)²)
        Orthonormal, each of one order.
    orders : (k,)
    lowest : float
        z of the normals is between this and 1.
    polynomials : (D, k)
        Chebyshev coefficients of g over that interval.
    """

    functions: NDArray[np.float64]
    orders: NDArray[np.int64]
    lowest: float
    polynomials: NDArray[np.float64]

    @classmethod
    def of_cap(cls, kernel: NDArray[np.float64], half_angle: float) -> MeanFunctions:
        """What holds the zonal ``kernel`` t_l (L+1,) about normals within ``half_angle`` of z."""
        bandlimit = kernel.size - 1
        basis = cap_basis(bandlimit, half_angle, kernel=kernel)
        left = np.cumsum(basis.eigenvalues[::-1])[::-1]
        count = max(1, int(np.sum(left > _LEFT_OUT**2 * left[0])))
        radial, orders = basis.radial[:count], basis.orders[:count]
        lowest = math.cos(half_angle)
        # g is of a degree below the number of these nodes, so that all of its coefficients are exact.
        angles = (np.arange(bandlimit + 1) + 0.5) * np.pi / (bandlimit + 1)
        nodes = lowest + 0.5 * (1.0 - lowest) * (1.0 + np.cos(angles))
        values = np.empty((nodes.size, count))
        for m in np.unique(np.abs(orders)).tolist():
            chosen = np.abs(orders) == m
            values[:, chosen] = (radial[chosen, m:] * kernel[m:] @ legendre_polynomials(bandlimit, m, nodes)).T
        degree = np.arange(bandlimit + 1)[:, None]
        polynomials = np.cos(degree * angles) @ values * (2.0 / nodes.size)
        polynomials[0] *= 0.5
        norm = np.linalg.norm(kernel * np.sqrt((2.0 * degree[:, 0] + 1.0) / (4.0 * np.pi)))
        # No Chebyshev polynomial exceeds 1: what is cut off is at most the sum of its coefficients.
        cut = np.cumsum(np.abs(polynomials[::-1]), axis=0)[::-1].max(axis=1)
        used = max(1, int(np.sum(cut > _INTERPOLATED * norm)))
        return cls(scatter_radial(radial, orders), orders, lowest, polynomials[:used])

    def along(self, normals: NDArray[np.float64]) -> NDArray[np.float32]:
        """(n, k) coefficients of the mean transfer about unit ``normals`` (n, 3), in the frame of the cap."""
        x, y, z = normals.T
        place = 2.0 * (z - self.lowest) / (1.0 - self.lowest) - 1.0
        chebyshev = np.ones((len(self.polynomials), place.size))
        chebyshev[1:2] = place
        for degree in range(2, len(chebyshev)):
            chebyshev[degree] = 2.0 * place * chebyshev[degree - 1] - chebyshev[degree - 2]
        turns = np.empty((1 + int(np.abs(self.orders).max()), place.size), dtype=np.complex128)
        turns[0] = 1.0
        for m in range(1, len(turns)):
            turns[m] = turns[m - 1] * (x + 1j * y)
        result = (self.polynomials.T @ chebyshev).astype(np.float32)
        even = self.orders >= 0
        result[even] *= turns.real.astype(np.float32)[self.orders[even]]
        result[~even] *= turns.imag.astype(np.float32)[-self.orders[~even]]
        return result.T


def shared_half_angle(normals: NDArray[np.float64]) -> float:
    """The half-angle of one of a few caps about z that holds unit ``normals`` (n, 3)."""
    # Of the chord and not of z, which tells small angles badly; a little more, for the rounding of normals in files.
    chord = float(np.linalg.norm(normals - [0.0, 0.0, 1.0], axis=1).max(initial=0.0))
    widest = max(_NARROWEST, 2.0 * math.asin(min(1.0, 0.5 * chord)) * (1.0 + 1e-6))
    return min(math.pi, _ANGLE_STEP ** math.ceil(math.log(widest) / math.log(_ANGLE_STEP)))
