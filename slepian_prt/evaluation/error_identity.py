"""What the first K functions lose of a signal over a cap: measured, and as the paper's identity has it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slepian_prt.errors import UserError, check_bandlimit, check_half_angle, check_integer
from slepian_prt.slepian.concentration import CapBasis, cap_basis
from slepian_prt.slepian.kernels import check_zonal
from slepian_prt.sphere.caps import cap_area
from slepian_prt.sphere.harmonics import degrees, num_coefficients, real_sh
from slepian_prt.sphere.regions import cap_region

# All functions are held at once: 54 MB at this bandlimit, 0.8 GB at twice that.
LARGEST_BANDLIMIT = 50

# Somewhere askew, so that the rotation of the functions to the cap is part of what is measured.
_CENTER = np.array([0.36, -0.48, 0.8])
_CHUNK = 2048


@dataclass(frozen=True)
class IdentityRow:
    """Squared error over a cap of one signal with its first functions alone.

    Attributes
    ----------
    terms : int
        K, how many functions are kept.
    quadrature : float
        ‖B − B̃‖²_U, from values of B and B̃ at the nodes of a rule on the cap.
    identity : float
        Σ_{i>K} b̄_i² λ_i.
    """

    terms: int
    quadrature: float
    identity: float

    @property
    def difference(self) -> float:
        """Of the two, relative to the second; 0 where both are zero, infinite where the second alone is."""
        if self.quadrature == self.identity:
            return 0.0
        return abs(self.quadrature - self.identity) / self.identity if self.identity > 0.0 else math.inf


def check_size(bandlimit: int) -> int:
    """A bandlimit that the error can be checked at, or raise UserError."""
    bandlimit = check_bandlimit(bandlimit)
    if bandlimit > LARGEST_BANDLIMIT:
        raise UserError(
            f"bandlimit must be at most {LARGEST_BANDLIMIT} for the error to be checked, where all functions are held "
            f"at once, not {bandlimit}"
        )
    return bandlimit


def measure_identity(
    bandlimit: int,
    half_angle: float,
    terms: Sequence[int],
    *,
    kernel: ArrayLike | None = None,
    radially_symmetric: bool = False,
    seed: int = 0,
) -> list[IdentityRow]:
    """Compare ‖B − B̃‖²_U with Σ_{i>K} b̄_i² λ_i (Lessig & Fiume 2010, Sec. 3) for one random signal and several K.

    Without a kernel B = Σ b_lm y_lm has random coefficients and B̃ keeps its part in the first K Slepian functions. With
    one, the light E = Σ e_lm y_lm is random, B(n) = Σ t_l e_lm y_lm(n), and B̃ is what transfer vectors give that are
    projected on the first K functions v_i of transport over the cap: ‖B − B̃‖²_U = |U| Σ_{i>K} (e·v_i)² λ_i. The
    functions are solved for order by order in the cap's frame; the rule is that of a region, about an axis askew.

    What differs is rounding of the values at the nodes, which cancel on small caps: relative differences are below
    5e-13 √(E₀/E_K), with E_K the error of K functions.

    Parameters
    ----------
    bandlimit : int
        At most 50.
    half_angle : float
        Radians, above 0.
    terms : sequence of K
        One or more, each from 0 to the number of functions.
    kernel : (L+1,) zonal coefficients, optional
    radially_symmetric : bool
        Signals symmetric about the cap's axis, and functions of order 0 alone (the paper's Eq. 9).
    seed : int
        Not negative.

    Raises
    ------
    UserError
        A bandlimit above 50; a cap of no area; terms or a seed outside their range.
    """
    bandlimit, half_angle = check_size(bandlimit), check_half_angle(half_angle)
    if half_angle == 0.0:
        raise UserError("half_angle must be above 0 for the error to be checked: a cap of no area has none")
    terms, seed = _check_terms(terms, bandlimit, radially_symmetric), check_integer(seed, "seed", 0)
    zonal = np.ones(bandlimit + 1) if kernel is None else check_zonal(kernel, bandlimit)
    basis = cap_basis(bandlimit, half_angle, _CENTER, kernel, radially_symmetric=radially_symmetric)
    # All functions are an orthonormal basis, so the signal's coefficients in harmonics are as random as these.
    signal = basis.functions @ np.random.default_rng(seed).standard_normal(len(basis))
    amplitudes = basis.functions.T @ signal
    measured = _squared_errors(basis, zonal, signal, amplitudes, terms)
    # Eigenvalues of transport are means over the cap, concentrations integrals.
    scale = 1.0 if kernel is None else cap_area(half_angle)
    return [
        IdentityRow(k, float(error), scale * float(np.sum(amplitudes[k:] ** 2 * basis.eigenvalues[k:])))
        for k, error in zip(terms, measured, strict=True)
    ]


def _check_terms(terms: Sequence[int], bandlimit: int, radially_symmetric: bool) -> list[int]:
    if isinstance(terms, np.ndarray):
        terms = terms.tolist()
    if not isinstance(terms, Sequence) or isinstance(terms, str) or not terms:
        raise UserError(f"terms must be a list of numbers of functions, as [0, 4, 9], not {terms!r}")
    largest = bandlimit + 1 if radially_symmetric else num_coefficients(bandlimit)
    return [check_integer(k, f"terms[{i}]", 0, largest) for i, k in enumerate(terms)]


def _squared_errors(
    basis: CapBasis, zonal: NDArray, signal: NDArray, amplitudes: NDArray, terms: Sequence[int]
) -> NDArray[np.float64]:
    """‖B − B̃‖²_U for each K, from the values of both at the nodes of a rule."""
    directions, weights = cap_region(basis.center, basis.half_angle).rule(2 * basis.bandlimit)
    kept = np.column_stack([basis.functions[:, :k] @ amplitudes[:k] for k in terms])
    errors = np.zeros(len(terms))
    for begin in range(0, len(weights), _CHUNK):
        chunk = slice(begin, begin + _CHUNK)
        transfer = real_sh(basis.bandlimit, directions[chunk]) * zonal[degrees(basis.bandlimit)]
        errors += weights[chunk] @ ((transfer @ signal)[:, None] - transfer @ kept) ** 2
    return errors
