"""The concentration problem on the line and on a disc of the plane: what the sphere's becomes on small caps.

Functions of the band |ω| ≤ L are concentrated in |x| ≤ R, frequencies and places being numbers or vectors of the plane.
Both problems are finite Fourier transforms, of which only the product c = L R counts (Slepian & Pollak 1961 on the
line, Slepian 1964 on the disc).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import check_epsilon, check_real
from slepian_prt.sphere.quadrature import gauss_legendre
from slepian_prt.sphere.rings import nodes_for

_LARGEST = 500.0
# Times 1 + 2c, more than twice what rounding makes of concentrations that are zero, found for c from 1 to 500.
_SMALLEST = 1e-30


class DiscSpectrum(NamedTuple):
    """Concentrations on a disc, largest first, (K,); and the signed order m of each function, (K,) int."""

    eigenvalues: NDArray[np.float64]
    orders: NDArray[np.int64]


def line_concentrations(product: float) -> NDArray[np.float64]:
    """Concentrations λ of functions of the band |ω| ≤ L in the interval |x| ≤ R, with c = L R; largest first.

    λ = (2c/π) R₀ₙ(c, 1)² of the prolate spheroidal wave functions. Squared singular values of the finite Fourier
    transform √(c/2π) e^{icxy} on [-1, 1], its even functions by cosines and its odd ones by sines. The singular values
    √λ have the absolute error of rounding, some 1e-17 at c = 1 and 2e-14 at c = 500. Twice that over √λ is the relative
    error of λ: at c = 1 it is 2e-5 where λ = 1e-25, and 1e-3 where λ = 5e-29.

    Parameters
    ----------
    product : float
        c in (0, 500]. The paper's Eq. 5 has C̃ = L̃Ũ with the length Ũ = 2R of the whole interval: C̃ = 2c.

    Returns
    -------
    (K,) concentrations above (1 + 2c) 1e-30, below which is rounding

    Raises
    ------
    UserError
        A product outside its range.
    """
    c = _check_product(product)
    # Half of the interval is enough: the kernels are even or odd in both variables.
    x, weights = _half_interval(c)
    scale = math.sqrt(2.0 * c / math.pi) * np.sqrt(np.outer(weights, weights))
    parts = [np.linalg.svd(scale * wave(c * np.outer(x, x)), compute_uv=False) ** 2 for wave in (np.cos, np.sin)]
    values = np.sort(np.concatenate(parts))[::-1]
    return np.minimum(values[values > _smallest(c)], 1.0)


def disc_concentrations(product: float, threshold: float = 1e-12) -> DiscSpectrum:
    """Concentrations λ of functions of the band |k| ≤ L in the disc |x| ≤ R of the plane, with c = L R.

    For each order m the squared singular values of the finite Hankel transform c J_m(c r s) on [0, 1] with √(r dr)
    (λ = c γ² of Slepian 1964). The sphere's problem on a cap tends to it as Θ → 0 with (L+1)Θ = c (Simons, Dahlen &
    Wieczorek 2006, Sec. 5).

    Parameters
    ----------
    product : float
        c in (0, 500].
    threshold : float in [(1 + 2c) 1e-30, 1)
        Only concentrations above it: there is no end to them, but below is rounding.

    Raises
    ------
    UserError
        An argument outside its range.
    """
    from scipy.special import jv  # only here, so that what needs no disc starts without SciPy

    c = _check_product(product)
    smallest = _smallest(c)
    interval = f"[{smallest:.2g}, 1), above rounding"
    threshold = check_real(threshold, "threshold", interval, lambda x: smallest <= x < 1.0)
    r, weights = _half_interval(c)
    scale = c * np.sqrt(np.outer(weights * r, weights * r))
    values, orders, m = [np.zeros(0)], [np.zeros(0, dtype=np.int64)], 0
    while True:
        found = np.linalg.svd(scale * jv(m, c * np.outer(r, r)), compute_uv=False) ** 2
        found = found[found > threshold]
        if not found.size:
            break
        for sign in (1,) if m == 0 else (1, -1):
            values.append(found)
            orders.append(np.full(found.size, sign * m))
        m += 1
    return _largest_first(np.concatenate(values), np.concatenate(orders))


def line_number(product: float, epsilon: float) -> float:
    """Slepian's estimate of the count on the line, the paper's Eq. 5 without its remainder: C̃/π + ln((1-ε)/ε) ln(C̃)/π².

    C̃ = 2c: the band's limit |ω| ≤ L̃, one side of it, times the length Ũ of the whole interval, and natural logarithms
    (Landau & Widom 1980); with C̃ = c, or the band's whole width 2L̃ for L̃, the first term is off by a factor of two. The
    second term is dropped where C̃ < 1, an interval too short for the asymptotics, and the sum is never below 0.

    Parameters
    ----------
    product : float
        c, half of C̃, in (0, 500].
    epsilon : float in (0, 1)
    """
    region, epsilon = 2.0 * _check_product(product), check_epsilon(epsilon)
    ratio = math.log1p(-epsilon) - math.log(epsilon)  # whose quotient overflows below 1e-308
    return max(0.0, region / math.pi + ratio * math.log(max(region, 1.0)) / math.pi**2)


def _check_product(product: float) -> float:
    interval = f"(0, {_LARGEST:g}], the bandlimit times the radius"
    return check_real(product, "product", interval, lambda x: 0.0 < x <= _LARGEST)


def _smallest(c: float) -> float:
    """The smallest concentration that is more than rounding."""
    return (1.0 + 2.0 * c) * _SMALLEST


def _half_interval(c: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Gauss nodes and weights on [0, 1] for products of two waves of c radians."""
    rule = gauss_legendre(nodes_for(2.0 * c))
    return 0.5 * (1.0 + rule.nodes), 0.5 * rule.weights


def _largest_first(eigenvalues: NDArray, orders: NDArray) -> DiscSpectrum:
    """Of equal ones that of order m comes before that of -m."""
    index = np.lexsort((orders < 0, np.abs(orders), -eigenvalues))
    return DiscSpectrum(np.minimum(eigenvalues[index], 1.0), orders[index])
