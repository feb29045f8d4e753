"""What is concentrated: zonal transport kernels, and second moments of transport in the vertex's own frame."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slepian_prt.arrays import real_numbers
from slepian_prt.errors import UserError, check_bandlimit, check_real
from slepian_prt.sphere.harmonics import bandlimit_of, degrees, num_coefficients, real_sh
from slepian_prt.sphere.quadrature import gauss_legendre
from slepian_prt.summary import summary_line


def cosine_lobe(bandlimit: int, exponent: float = 1.0) -> NDArray[np.float64]:
    """Zonal coefficients of (n+1)/2π (cos θ)₊ⁿ, scaled so that a constant environment of radiance 1 gives 1.

    The exponent 1 is the clamped cosine of diffuse reflection, 1, 2/3, 1/4, 0, -1/24, 0, … (Ramamoorthi & Hanrahan,
    SIGGRAPH 2001); larger ones are Phong's. With T(c·ω) = Σ t_l Σ_m y_lm(c) y_lm(ω), the recurrence
    t_l = t_(l-2) (n - l + 2)/(n + l + 1) follows from that of ∫₀¹ xⁿ P_l(x) dx.

    Returns
    -------
    (L+1,) coefficients t_l.

    Raises
    ------
    ValueError
        A bad bandlimit, or an exponent that is not positive and finite.
    """
    bandlimit = check_bandlimit(bandlimit)
    exponent = check_real(exponent, "exponent", "(0, inf)", lambda x: 0.0 < x < math.inf)
    t = np.empty(bandlimit + 1)
    for l in range(bandlimit + 1):
        if l == 0:
            t[l] = 1.0
        elif l == 1:
            t[l] = (exponent + 1.0) / (exponent + 2.0)
        else:
            t[l] = t[l - 2] * (exponent - l + 2.0) / (exponent + l + 1.0)
    return t


def zonal_coefficients(bandlimit: int, lobe: Callable[[NDArray], NDArray], nodes: int = 512) -> NDArray[np.float64]:
    """Coefficients t_l = 2π ∫ lobe(x) P_l(x) dx of any measured or given lobe of x = cos θ, by Gauss quadrature.

    The interval is split at x = 0, where lobes of a hemisphere end.
    """
    from scipy.special import eval_legendre  # only here, so that relighting starts without SciPy

    bandlimit = check_bandlimit(bandlimit)
    rule = gauss_legendre(nodes)
    x = np.concatenate([0.5 * (rule.nodes - 1.0), 0.5 * (rule.nodes + 1.0)])
    weighted = np.tile(0.5 * rule.weights, 2) * np.asarray(lobe(x), dtype=np.float64)
    return np.array([2.0 * math.pi * np.sum(weighted * eval_legendre(l, x)) for l in range(bandlimit + 1)])


def check_zonal(kernel: ArrayLike, bandlimit: int) -> NDArray[np.float64]:
    """Return ``kernel`` as the (L+1,) zonal coefficients of a bandlimit; raise UserError unless it holds as many."""
    try:
        zonal = np.asarray(kernel, dtype=np.float64)
    except (TypeError, ValueError):
        raise UserError(f"kernel must hold {bandlimit + 1} zonal coefficients, not {kernel!r}") from None
    if zonal.shape != (bandlimit + 1,):
        raise UserError(f"kernel must hold {bandlimit + 1} finite zonal coefficients, not shape {zonal.shape}")
    if not np.all(np.isfinite(zonal)):
        raise UserError(
            f"kernel must hold {bandlimit + 1} finite zonal coefficients, not {zonal[~np.isfinite(zonal)][0]}"
        )
    return zonal


def zonal_vectors(zonal: ArrayLike, axes: NDArray) -> NDArray[np.float32]:
    """Copies of a zonal kernel about axes: t_l y_lm(axis), shape (n, (L+1)²); zero where the axis is.

    Parameters
    ----------
    zonal : (L+1,)
    axes : (n, 3) unit vectors or zero
    """
    lobe = np.asarray(zonal, dtype=np.float64)
    bandlimit = lobe.size - 1
    lobe = lobe[degrees(bandlimit)]
    vectors = np.zeros((len(axes), num_coefficients(bandlimit)), dtype=np.float32)
    for begin in range(0, len(axes), 8192):
        block = slice(begin, begin + 8192)
        lit = np.any(axes[block] != 0.0, axis=1)
        if lit.any():
            vectors[block][lit] = real_sh(bandlimit, axes[block][lit]) * lobe
    return vectors


@dataclass(frozen=True)
class SecondMoment:
    """C₀ = E[t tᵀ] of transfer vectors in their own frame, averaged over azimuth and mirroring.

    The average is block-diagonal in m, with equal blocks for m and -m.

    Attributes
    ----------
    bandlimit : int
    factors : tuple of L+1 arrays, the m-th of shape (L+1-m, r_m)
        C₀ = G_m G_mᵀ on the coefficients of order m (degrees m..L) and, again, on those of order -m.
    """

    bandlimit: int
    factors: tuple[NDArray[np.float64], ...]

    @property
    def energy(self) -> float:
        """Trace of C₀: the mean squared norm of a transfer vector."""
        return float(sum((1 if m == 0 else 2) * np.sum(g * g) for m, g in enumerate(self.factors)))

    def __repr__(self) -> str:
        return summary_line("SecondMoment", {"bandlimit": self.bandlimit, "energy": self.energy})


def zonal_moment(zonal: ArrayLike) -> SecondMoment:
    """C₀ = D y(z) y(z)ᵀ D of a zonal kernel with coefficients t_l: the case that has one known vector."""
    t = np.asarray(zonal, dtype=np.float64)
    bandlimit = t.size - 1
    column = t * np.sqrt((2.0 * np.arange(bandlimit + 1) + 1.0) / (4.0 * math.pi))
    empty = tuple(np.zeros((bandlimit + 1 - m, 0)) for m in range(1, bandlimit + 1))
    return SecondMoment(bandlimit, (column[:, None], *empty))


def measured_moment(local_vectors: ArrayLike) -> SecondMoment:
    """C₀ of a pilot: transfer vectors rotated to their own frames (axis = z), shape (n, (L+1)²), n >= 1.

    Raises
    ------
    ValueError
        No vector, or a second axis that is not a square number.
    """
    x = real_numbers(local_vectors, "vectors")
    bandlimit = bandlimit_of(x.shape[-1]) if x.ndim == 2 else -1
    if x.ndim != 2 or x.shape[0] == 0 or num_coefficients(bandlimit) != x.shape[1]:
        raise UserError(f"local_vectors must have shape (n, (L+1)^2) with n >= 1, not {x.shape}")
    l = np.arange(bandlimit + 1)
    factors = []
    for m in range(bandlimit + 1):
        column = l[m:] * (l[m:] + 1)
        rows = x[:, column] if m == 0 else np.concatenate([x[:, column + m], x[:, column - m]])
        triangle: NDArray[np.float64] = np.asarray(np.linalg.qr(rows / np.sqrt(rows.shape[0]), mode="r"))
        factors.append(triangle.T)
    return SecondMoment(bandlimit, tuple(factors))
