"""The concentration problem on a spherical cap, for plain functions and for transport.

In the cap's own frame (centre = z) every problem here is block-diagonal in the order m, with equal blocks for m and
-m. Functions are kept that way, as coefficients over the degree for each order: a basis of L = 500 takes 0.3 GB
instead of the 500 GB of its dense matrix.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slepian_prt.errors import UserError, check_bandlimit, check_half_angle, check_integer, check_real
from slepian_prt.slepian.kernels import SecondMoment, check_zonal
from slepian_prt.sphere.directions import check_directions
from slepian_prt.sphere.harmonics import legendre_polynomials, num_coefficients
from slepian_prt.sphere.quadrature import CapNodes, cap_nodes
from slepian_prt.sphere.rotation import rotate_sh, rotation_to
from slepian_prt.summary import Summarised

# Eigenvalues below this part of the largest are rounding; their eigenvectors are chosen by the second criterion.
SMALLEST_KNOWN = 1e-28

# Degree in θ, beyond 2LΘ, that a rule has to be exact to for products to be exact to rounding.
_SMOOTH = 34.0


@dataclass(frozen=True, repr=False)
class CapBasis(Summarised):
    """Functions concentrated in a cap, strongest first.

    Attributes
    ----------
    bandlimit : int
    half_angle : float
        Θ in radians.
    center : (3,)
    blocks : tuple of arrays, the m-th of shape (L+1-m, k_m)
        Orthonormal columns: coefficients over the degrees m..L in the cap's frame, shared by the orders m and -m.
    orders : (K,) int
        Signed order m of each function.
    ranks : (K,) int
        Its column in ``blocks[abs(m)]``.
    eigenvalues : (K,)
        Concentrations λ in [0, 1] for the plain problem, else mean energy over the cap along each function. Below about
        1e-28 of the first they are rounding, and need not fall.
    leakages : (K,) or None
        1 - λ, computed from the cap's complement, so that concentrations next to one keep their digits.
    """

    bandlimit: int
    half_angle: float
    center: NDArray[np.float64]
    blocks: tuple[NDArray[np.float64], ...]
    orders: NDArray[np.int64]
    ranks: NDArray[np.int64]
    eigenvalues: NDArray[np.float64]
    leakages: NDArray[np.float64] | None = None

    def __len__(self) -> int:
        return self.orders.size

    @cached_property
    def radial(self) -> NDArray[np.float64]:
        """(K, L+1): coefficients of each function over the degree, in the cap's frame; zero below |m|."""
        radial = np.zeros((len(self), self.bandlimit + 1))
        for i, (m, rank) in enumerate(zip(np.abs(self.orders), self.ranks, strict=True)):
            radial[i, m:] = self.blocks[m][:, rank]
        return radial

    @cached_property
    def functions(self) -> NDArray[np.float64]:
        """((L+1)², K): SH coefficients in the world frame, one column per function."""
        return rotate_sh(self.in_cap_frame(), rotation_to(self.center)).T

    def in_cap_frame(self) -> NDArray[np.float64]:
        """(K, (L+1)²): SH coefficients in the cap's own frame, one row per function."""
        return scatter_radial(self.radial, self.orders)

    def _summary(self) -> dict[str, object]:
        return {
            "bandlimit": self.bandlimit,
            "half_angle": self.half_angle,
            "center": ", ".join(f"{value:.3g}" for value in self.center),
            **summarise_functions(self.bandlimit, self.eigenvalues),
        }


def summarise_functions(bandlimit: int, eigenvalues: NDArray[np.float64]) -> dict[str, object]:
    """How many of all functions a basis has, and the range of their eigenvalues."""
    span = f"{eigenvalues[0]:.4g} to {eigenvalues[-1]:.2g}" if eigenvalues.size else None
    return {"functions": f"{eigenvalues.size} of {num_coefficients(bandlimit)}", "eigenvalues": span}


def scatter_radial(radial: NDArray, orders: NDArray) -> NDArray[np.float64]:
    """SH coefficients (K, (L+1)²) of functions given by radial coefficients (K, L+1) and signed orders (K,)."""
    bandlimit = radial.shape[1] - 1
    l = np.arange(bandlimit + 1)
    dense = np.zeros((radial.shape[0], num_coefficients(bandlimit)))
    signed = np.asarray(orders, dtype=np.int64)[:, None]
    row, degree = np.nonzero(l >= np.abs(signed))
    dense[row, (l * l + l + signed)[row, degree]] = radial[row, degree]
    return dense


def cap_basis(
    bandlimit: int,
    half_angle: float,
    center: ArrayLike = (0.0, 0.0, 1.0),
    kernel: ArrayLike | SecondMoment | None = None,
    *,
    terms: int | None = None,
    threshold: float | None = None,
    radially_symmetric: bool = False,
) -> CapBasis:
    """Best linear basis for signals, or for transport, over a spherical cap.

    Parameters
    ----------
    bandlimit : int
        L >= 0.
    half_angle : float
        Θ in [0, π]; both ends have their exact limits.
    center : (3,)
    kernel : None, (L+1,) zonal coefficients, or SecondMoment
        None solves the plain problem (Slepian functions: Simons, Dahlen & Wieczorek, SIAM Review 2006) through
        Grünbaum's commuting tridiagonal operator. Otherwise the eigenvectors of C_U = (1/|U|) ∫_U R_n C₀ R_nᵀ dn,
        from the singular values of a factor.
    terms : int, optional
        Only the first K functions, 1 <= K <= M with M = (L+1)², or L+1 radially symmetric ones.
    threshold : float, optional
        Only functions whose eigenvalue is above it; much faster at high L. By default all M.
    radially_symmetric : bool
        Only functions of order 0.

    Returns
    -------
    CapBasis

    Raises
    ------
    ValueError
        An argument outside its range.
    """
    bandlimit = check_bandlimit(bandlimit)
    half_angle = check_half_angle(half_angle)
    axis = check_directions(center, "center")[0]
    if threshold is not None:
        threshold = check_real(threshold, "threshold", "[0, inf]", lambda x: x >= 0.0)
    last_order = 0 if radially_symmetric else bandlimit
    if terms is not None:
        terms = check_integer(terms, "terms", 1, bandlimit + 1 if radially_symmetric else num_coefficients(bandlimit))
    if kernel is None:
        blocks, values, leakages = _plain_blocks(bandlimit, half_angle, last_order, threshold)
        return _merge(bandlimit, half_angle, axis, blocks, values, leakages, terms, threshold)
    factors = cap_moment_factors(bandlimit, half_angle, kernel, last_order)
    return moment_basis(bandlimit, half_angle, factors, axis, terms=terms, threshold=threshold)


def moment_basis(
    bandlimit: int,
    half_angle: float,
    factors: list[NDArray[np.float64]],
    center: NDArray | None = None,
    *,
    terms: int | None = None,
    threshold: float | None = None,
) -> CapBasis:
    """Eigenvectors of a second moment over a cap that is known by its factors, see `cap_moment_factors`."""
    blocks, values = [], []
    for m, factor in enumerate(factors):
        vectors, eigenvalues = _right_singular(factor, _incident_factor(bandlimit, half_angle, m))
        blocks.append(vectors)
        values.append(eigenvalues)
    axis = np.array([0.0, 0.0, 1.0]) if center is None else center
    return _merge(bandlimit, half_angle, axis, blocks, values, None, terms, threshold)


# --- The plain problem -----------------------------------------------------------------------------------------------


def _plain_blocks(
    bandlimit: int, half_angle: float, last_order: int, threshold: float | None
) -> tuple[list[NDArray], list[NDArray], list[NDArray]]:
    inside = cap_nodes(bandlimit + 1, half_angle)
    outside = cap_nodes(bandlimit + 1, half_angle, complement=True)
    blocks, values, leakages = [], [], []
    for m in range(last_order + 1):
        size = bandlimit + 1 - m
        inside_factor = _sampled_order(bandlimit, m, inside)
        outside_factor = _sampled_order(bandlimit, m, outside)
        wanted = size if threshold is None else min(size, 8 + int(1.1 * (bandlimit + 1) * half_angle / math.pi))
        while True:
            vectors = _grunbaum_vectors(bandlimit, m, half_angle, wanted)
            concentration = np.sum((inside_factor @ vectors) ** 2, axis=0)
            leakage = np.sum((outside_factor @ vectors) ** 2, axis=0)
            if threshold is None or wanted == size or concentration[-1] <= threshold:
                break
            wanted = min(size, 2 * wanted)
        vectors *= _pole_signs(bandlimit, m, vectors, concentration)
        # Each of the two is good to rounding relative to itself; the larger one follows from the smaller.
        mostly_in = leakage < 0.5
        concentration = np.clip(np.where(mostly_in, 1.0 - leakage, concentration), 0.0, 1.0)
        leakage = np.clip(np.where(mostly_in, leakage, 1.0 - concentration), 0.0, 1.0)
        blocks.append(vectors)
        values.append(concentration)
        leakages.append(leakage)
        if threshold is not None and concentration[0] <= threshold:
            break  # the largest concentration falls with the order
    return blocks, values, leakages


def _grunbaum_vectors(bandlimit: int, m: int, half_angle: float, wanted: int) -> NDArray[np.float64]:
    """Coefficients of the ``wanted`` most concentrated functions of order m, (L+1-m, wanted), best first.

    Eigenvectors of the tridiagonal matrix that commutes with the localisation operator (Grünbaum, Longhi & Perlstadt,
    SIAM J. Appl. Math. 1982). Its eigenvalues are well apart where the concentrations crowd at 0 and 1, and their
    order is that of the concentrations, also where those are below rounding.
    """
    # Only here: what reads and relights transfer starts without SciPy, which takes a quarter of a second to import.
    from scipy.linalg import eigh_tridiagonal

    l = np.arange(m, bandlimit + 1, dtype=np.float64)
    diagonal = -l * (l + 1.0) * math.cos(half_angle)
    k = l[:-1]
    off = (k * (k + 2.0) - bandlimit * (bandlimit + 2.0)) * np.sqrt(
        ((k + 1.0) ** 2 - m * m) / ((2.0 * k + 1.0) * (2.0 * k + 3.0))
    )
    if l.size == 1:
        return np.ones((1, 1))
    if wanted == l.size:
        return eigh_tridiagonal(diagonal, off)[1]
    return eigh_tridiagonal(diagonal, off, select="i", select_range=(0, wanted - 1))[1]


def _sampled_order(bandlimit: int, m: int, nodes: CapNodes) -> NDArray[np.float64]:
    """Factor B (nodes, L+1-m) with BᵀB the localisation matrix of order m on the band that the nodes cover."""
    azimuthal = 2.0 * math.pi if m == 0 else math.pi
    values = legendre_polynomials(bandlimit, m, nodes.z, nodes.z_low)
    return (values * (np.sqrt(azimuthal * nodes.weights) * nodes.sine**m)).T


def _pole_signs(bandlimit: int, m: int, vectors: NDArray, concentration: NDArray) -> NDArray[np.float64]:
    """Signs that make each function positive (without its sin^m θ) at the pole of the side where it lives.

    The functions solve a differential equation whose solutions cannot vanish there.
    """
    at_north, at_south = (legendre_polynomials(bandlimit, m, np.array([z]))[:, 0] for z in (1.0, -1.0))
    pole_value = np.where(concentration >= 0.5, at_north @ vectors, at_south @ vectors)
    return np.where(pole_value < 0.0, -1.0, 1.0)


# --- Transport kernels -----------------------------------------------------------------------------------------------


def cap_moment_factors(
    bandlimit: int, half_angle: float, kernel: ArrayLike | SecondMoment, last_order: int | None = None
) -> list[NDArray[np.float64]]:
    """For each order m = 0..L a factor F_m, (r, L+1-m), with F_mᵀ F_m the block of C_U in the cap's frame."""
    last_order = bandlimit if last_order is None else last_order
    # L + 1 nodes are exact. On small caps, products of two functions of degree L are smooth: as J₀(2Lθ), a polynomial
    # in θ² of about half its degree in θ, which is 2LΘ and some more for the rounding.
    count = bandlimit + 1
    if isinstance(kernel, SecondMoment):
        count = min(count, math.ceil((2.0 * bandlimit * half_angle + _SMOOTH) / 4.0))
    nodes = cap_nodes(count, half_angle)
    # (1/|U|) ∫_U, with weights that stay right in the limit Θ = 0.
    weights = 0.5 * cap_nodes(count, math.pi).weights
    nodes = nodes._replace(weights=weights / (2.0 * math.pi))
    if isinstance(kernel, SecondMoment):
        if kernel.bandlimit != bandlimit:
            raise UserError(f"kernel must have bandlimit {bandlimit}, not {kernel.bandlimit}")
        return _averaged_moment_factors(kernel, nodes, last_order)
    zonal = check_zonal(kernel, bandlimit)
    return [_sampled_order(bandlimit, m, nodes) * zonal[m:] for m in range(last_order + 1)]


def _averaged_moment_factors(moment: SecondMoment, nodes: CapNodes, last_order: int) -> list[NDArray[np.float64]]:
    """Turn the columns of C₀'s factor to every polar angle of the rule and sort what arrives by order.

    The azimuth needs no rule: averaging over it keeps just the blocks of equal |m|. Degrees of up to 2L in cos θ
    make L + 1 nodes exact. Rows are folded into a triangular factor as they come, which bounds the memory.
    """
    bandlimit = moment.bandlimit
    l = np.arange(bandlimit + 1)
    columns = [
        scatter_radial(np.pad(g.T, ((0, 0), (m, 0))), np.full(g.shape[1], sign * m))
        for m, g in enumerate(moment.factors)
        for sign in ((1,) if m == 0 else (1, -1))
    ]
    vectors = np.concatenate(columns)
    factors: list[NDArray[np.float64]] = [np.zeros((0, bandlimit + 1 - m)) for m in range(last_order + 1)]
    for z, sine, weight in zip(nodes.z, nodes.sine, nodes.weights, strict=True):
        turn = np.array([[z, 0.0, sine], [0.0, 1.0, 0.0], [-sine, 0.0, z]])
        turned = rotate_sh(vectors, turn) * math.sqrt(2.0 * math.pi * weight)
        for m in range(last_order + 1):
            column = l[m:] * (l[m:] + 1)
            rows = turned[:, column]
            if m > 0:
                rows = np.concatenate([turned[:, column + m], turned[:, column - m]]) * math.sqrt(0.5)
            factors[m] = np.asarray(np.linalg.qr(np.concatenate([factors[m], rows]), mode="r"))
    return factors


def _incident_factor(bandlimit: int, half_angle: float, m: int) -> NDArray[np.float64]:
    """Second criterion where the kernel is blind: concentration in the cap Θ + 90°, where all transport lives."""
    return _sampled_order(bandlimit, m, cap_nodes(bandlimit + 1, min(math.pi, half_angle + math.pi / 2)))


def _right_singular(factor: NDArray, second: NDArray) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Right singular vectors (size, size) and squared singular values, largest first.

    Never the eigen-decomposition of the product, which loses everything below 1e-16 of the largest. The null space
    of the factor (degrees that the kernel does not have) is ordered by ``second``.
    """
    size = factor.shape[1]
    _, sigma, rows = np.linalg.svd(factor, full_matrices=True)
    eigenvalues = np.zeros(size)
    eigenvalues[: sigma.size] = sigma[:size] ** 2
    vectors = rows.T.copy()
    rank = int(np.sum(eigenvalues > SMALLEST_KNOWN * eigenvalues[0])) if eigenvalues[0] > 0.0 else 0
    eigenvalues[rank:] = 0.0
    if rank < size:
        _, _, inner = np.linalg.svd(second @ vectors[:, rank:])
        vectors[:, rank:] = vectors[:, rank:] @ inner.T
    strongest = np.argmax(np.abs(vectors) > 0.5 * np.abs(vectors).max(axis=0), axis=0)
    vectors *= np.where(vectors[strongest, np.arange(size)] < 0.0, -1.0, 1.0)
    return vectors, eigenvalues


# --- Common ----------------------------------------------------------------------------------------------------------


def _merge(
    bandlimit: int,
    half_angle: float,
    center: NDArray,
    blocks: list[NDArray],
    values: list[NDArray],
    leakages: list[NDArray] | None,
    terms: int | None,
    threshold: float | None,
) -> CapBasis:
    """One list over all orders, strongest first, never changing the order within one m.

    Ties go to the lower rank, then the lower |m|, then m > 0; what is below rounding is thereby in a fixed order too.
    """
    ranks = np.concatenate([np.arange(v.size) for v in values for _ in (1, 2)])
    orders = np.concatenate([np.full(v.size, sign * m) for m, v in enumerate(values) for sign in (1, -1)])
    eigenvalues = np.concatenate([v for v in values for _ in (1, 2)])
    falling = np.concatenate([np.minimum.accumulate(v) for v in values for _ in (1, 2)])
    keep = np.concatenate([np.full(v.size, m > 0 or sign > 0) for m, v in enumerate(values) for sign in (1, -1)])
    if threshold is not None:
        keep &= eigenvalues > threshold
    index = np.flatnonzero(keep)
    index = index[np.lexsort((orders[index] < 0, np.abs(orders[index]), ranks[index], -falling[index]))][:terms]
    missing = bandlimit + 1 - len(blocks)
    empty = tuple(np.zeros((missing - i, 0)) for i in range(missing))
    leak = None if leakages is None else np.concatenate([v for v in leakages for _ in (1, 2)])[index]
    return CapBasis(
        bandlimit, half_angle, center, (*blocks, *empty), orders[index], ranks[index], eigenvalues[index], leak
    )
