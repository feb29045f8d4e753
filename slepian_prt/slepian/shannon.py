"""How many functions a region holds: Shannon numbers, their refinements, and the exact count.

All take the half-angle of a cap, or a region from `cap_region`, `polygon_region` or `mask_region`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slepian_prt.errors import UserError, check_bandlimit, check_epsilon, check_half_angle, check_real
from slepian_prt.slepian.concentration import cap_basis
from slepian_prt.slepian.kernels import check_zonal
from slepian_prt.slepian.region_concentration import region_basis
from slepian_prt.sphere.caps import cap_area, cap_boundary
from slepian_prt.sphere.regions import Region, region_area, region_boundary


def shannon_number(bandlimit: int, half_angle: float | Region, *, radially_symmetric: bool = False) -> float:
    """N = (L+1)² A/4π, the sum of all concentrations (Simons, Dahlen & Wieczorek 2006).

    (L+1)² sin²(Θ/2) for a cap; radially symmetric functions of a cap have (L+1) Θ/π (Wieczorek & Simons 2005), about
    the sum of their concentrations.

    Parameters
    ----------
    bandlimit : int
    half_angle : float or region
        Of a cap, in [0, π]; or any region of the sphere.
    radially_symmetric : bool
        Only functions of order 0; of a cap.

    Raises
    ------
    UserError
        An argument outside its range.
    """
    k = check_bandlimit(bandlimit) + 1
    if radially_symmetric:
        return k * (_angle_of_symmetry(half_angle) / math.pi)
    return k * k * _extent(half_angle).area / (4.0 * math.pi)


def generalized_shannon_number(
    bandlimit: int,
    half_angle: float | Region,
    epsilon: float,
    *,
    log_base: float = 10.0,
    radially_symmetric: bool = False,
) -> float:
    """N_g(ε) of Lessig & Fiume (EGSR 2010), Eq. 6: N + log((1-ε)/ε) B(∂U) log C.

    C = (L+1)² A(U), B = lg((L+1)² |∂U|²)/lg(2π) with |∂U| the length of the boundary; radially symmetric signals have
    C = 4(L+1)Θ. The paper does not fix the base of the outer logarithms; with 10 the number is close to the exact count
    of concentrations above ε, with e it is up to several times too large. For radially symmetric signals it is mostly
    far too large with either, unless ε = ½: see `refined_shannon_number`. The second term is dropped where one of its
    logarithms is negative (C < 1 or (L+1)|∂U| < 1: regions too small for the asymptotics), and the whole clipped to
    [0, the dimension of the space].

    Parameters
    ----------
    bandlimit, half_angle, radially_symmetric : as in `shannon_number`
    epsilon : float in (0, 1)
    log_base : float > 1

    Raises
    ------
    UserError
        An argument outside its range.
    """
    bandlimit, epsilon = check_bandlimit(bandlimit), check_epsilon(epsilon)
    log_base = check_real(log_base, "log_base", "(1, inf)", lambda x: 1.0 < x < math.inf)
    k = bandlimit + 1
    number = shannon_number(bandlimit, half_angle, radially_symmetric=radially_symmetric)
    region, boundary = 4.0 * math.pi * number, k * _extent(half_angle).boundary
    if region > 1.0 and boundary > 1.0:
        b = 2.0 * math.log(boundary) / math.log(2.0 * math.pi)
        number += _log_odds(epsilon) / math.log(log_base) * b * math.log(region, log_base)
    return min(max(number, 0.0), float(k if radially_symmetric else k * k))


def refined_shannon_number(
    bandlimit: int,
    half_angle: float | Region,
    epsilon: float,
    *,
    kernel: ArrayLike | None = None,
    radially_symmetric: bool = False,
) -> float:
    """N_ref(ε): two-term asymptotics with the spherical constant, clipped to [0, the dimension of the space].

    For a cap, with K = L + 1, ℓ = ln((1-ε)/ε), φ = 2π Im lnΓ(½ + iℓ/2π):

        N_ref = K² sin²(Θ/2) + (K sin Θ/π²) [ℓ ln(32 e⁻³ K sin Θ e^g) - φ],

    g = 1 - ln|cos Θ| - artanh(sin Θ)/sin Θ, and g = 1 - ln 2 at 90°. Any other region has |∂U|/2π for the first sin Θ,
    2A(1 - A/4π)/|∂U| for the second, and g of the cap of its area: the same numbers where it is a cap.

    The second term is largest where ℓ is about 2π times the argument of its logarithm, and falls beyond, as no count
    does: there it stays at its maximum, which is 0 where that argument is below e^(ψ(½)) = .14. So N_ref never falls as
    ε does, and is at least N for ε < ½. On regions so small or thin that it no longer grows it is too low, and nothing
    but N on the smallest ones; see docs/shannon.md.

    Radially symmetric functions of a cap are those of one order, m = 0, a problem on the interval [0, Θ] with one end
    in angle and one in degree. Each such pair gives half of the logarithmic term of the line, which has two ends
    (Landau & Widom 1980):

        N_ref = K Θ/π + (1/2π²) [ℓ ln(4 K sin Θ) - φ] + 3 (ℓ²/π² - 1)/(16π K tan Θ).

    The argument 4 K sin Θ and the last term, of the next order and kept within ±½, were found from exact spectra up to
    L = 400. The i-th eigenvalue λ has N_ref(λ) = i - ½ where λ and 1 - λ are above 1e-4: to .035 from K sin Θ = 2 on,
    and to .01 from 6 on. The last term makes N_ref(½) differ from N by 3/(16π K tan Θ).

    Parameters
    ----------
    bandlimit, half_angle, radially_symmetric : as in `shannon_number`
    epsilon : float in (0, 1)
    kernel : (L+1,) zonal coefficients t_l, optional
        For eigenvalues of transport above ε of the first: L becomes the highest degree with t_l² > ε max t². That takes
        the kernel's band for flat; docs/shannon.md has the errors.

    Raises
    ------
    UserError
        An argument outside its range.
    """
    bandlimit, epsilon = check_bandlimit(bandlimit), check_epsilon(epsilon)
    bandlimit = int(_degrees_above(bandlimit, epsilon, kernel).max(initial=0))
    number = shannon_number(bandlimit, half_angle, radially_symmetric=radially_symmetric)
    k, extent, ratio = bandlimit + 1, _extent(half_angle), _log_odds(epsilon)
    if extent.boundary > 0.0:
        if radially_symmetric:
            next_order = 3.0 / (16.0 * math.pi * k * math.tan(extent.cap_angle))
            number += _second_term(ratio, 0.5 / math.pi**2, math.log(4.0 * k * extent.width), next_order)
        else:
            argument = math.log(32.0 * k * extent.width) - 3.0 + _curvature_term(extent.cap_angle)
            number += _second_term(ratio, k * extent.boundary / (2.0 * math.pi**3), argument)
    return min(max(number, 0.0), float(k if radially_symmetric else k * k))


def szego_number(
    bandlimit: int,
    half_angle: float | Region,
    epsilon: float,
    *,
    kernel: ArrayLike | None = None,
    radially_symmetric: bool = False,
) -> float:
    """Eigenvalues of transport above ε of the largest, by Szegő's theorem: linear in the region, no logarithm.

    After Mahajan, Shlizerman, Ramamoorthi & Belhumeur, *A Theory of Locally Low Dimensional Light Transport* (SIGGRAPH
    2007). What was taken from there is the idea, as their abstract and Lessig & Fiume (2010) tell it: by Szegő's
    eigenvalue theorem the eigenvalues of the covariance of transport over a patch are spread as the samples of the
    kernel's power spectrum, so that their number grows with the patch's area (with its width, for shadows' edges). They
    work in flatland; the form on the sphere is ours: transport with zonal coefficients t_l over the whole sphere has
    the eigenvalues t_l², 2l + 1 times each, and a patch keeps its share of them,

        (A/4π) Σ_{l ≤ L: t_l² > ε max t²} (2l+1),

    or (Θ/π) times the number of such degrees for radially symmetric signals of a cap. Without a kernel, N.

    Parameters
    ----------
    bandlimit, half_angle, radially_symmetric : as in `shannon_number`
    epsilon : float in (0, 1)
    kernel : (L+1,) zonal coefficients, optional
        As `cosine_lobe` gives them, on any scale; by default all are equal.

    Raises
    ------
    UserError
        An argument outside its range.
    """
    degrees = _degrees_above(check_bandlimit(bandlimit), check_epsilon(epsilon), kernel)
    if radially_symmetric:
        return degrees.size * (_angle_of_symmetry(half_angle) / math.pi)
    return float(np.sum(2 * degrees + 1)) * _extent(half_angle).area / (4.0 * math.pi)


def concentration_count(
    bandlimit: int,
    half_angle: float | Region,
    epsilon: float,
    *,
    kernel: ArrayLike | None = None,
    radially_symmetric: bool = False,
) -> int:
    """The exact number of Slepian functions whose concentration is above ε.

    With a kernel, the number of eigenvalues of transport over the cap that are above ε of the first.

    Parameters
    ----------
    bandlimit, half_angle, radially_symmetric : as in `shannon_number`
        Regions are solved densely, for L up to about 50; see `region_basis`.
    epsilon : float in (0, 1)
    kernel : (L+1,) zonal coefficients, optional
        Of transport over a cap.

    Raises
    ------
    UserError
        An argument outside its range; a kernel, or radial symmetry, on a region that is not given as a half-angle.
    """
    epsilon = check_epsilon(epsilon)
    if kernel is not None:
        angle = _angle_of_symmetry(half_angle, "eigenvalues of transport")
        scaled = _check_kernel(kernel, check_bandlimit(bandlimit))
        values = cap_basis(bandlimit, angle, kernel=scaled, radially_symmetric=radially_symmetric).eigenvalues
        return count_above(values, epsilon * values[0])
    if radially_symmetric or not isinstance(half_angle, Region):
        angle = _angle_of_symmetry(half_angle)
        return len(cap_basis(bandlimit, angle, threshold=_above(epsilon), radially_symmetric=radially_symmetric))
    if region_area(half_angle) == 0.0:
        check_bandlimit(bandlimit)
        return 0
    return len(region_basis(bandlimit, half_angle, threshold=_above(epsilon)))


def count_above(values: NDArray, level: float) -> int:
    """How many eigenvalues (K,) are above a level; those that are equal to it but for rounding are not."""
    return int(np.sum(values > _above(level)))


def _above(level: float) -> float:
    """On the hemisphere L + 1 concentrations are exactly ½, and come out as that give or take 1e-15 to 1e-14."""
    return level * (1.0 + 1e-12)


# --- Regions ---------------------------------------------------------------------------------------------------------


class _Extent(NamedTuple):
    """Area, length of the boundary, sin Θ of a cap or its like, and half-angle of the cap of the same area."""

    area: float
    boundary: float
    width: float
    cap_angle: float


def _extent(half_angle: float | Region) -> _Extent:
    if not isinstance(half_angle, Region):
        angle = check_half_angle(half_angle)
        return _Extent(cap_area(angle), cap_boundary(angle), math.sin(min(angle, math.pi - angle)), angle)
    area, boundary = region_area(half_angle), region_boundary(half_angle)
    share = min(area / (4.0 * math.pi), 1.0)
    width = 2.0 * area * (1.0 - share) / boundary if boundary > 0.0 else 0.0
    return _Extent(area, boundary if width > 0.0 else 0.0, width, 2.0 * math.asin(math.sqrt(share)))


def _degrees_above(bandlimit: int, epsilon: float, kernel: ArrayLike | None) -> NDArray[np.int64]:
    """Degrees whose power is above ε of the largest; all of them without a kernel."""
    power = np.ones(bandlimit + 1) if kernel is None else _check_kernel(kernel, bandlimit) ** 2
    return np.flatnonzero(power > epsilon)


def _check_kernel(kernel: ArrayLike, bandlimit: int) -> NDArray[np.float64]:
    """Zonal coefficients relative to the largest, so that no scale of theirs leaves float64 when squared."""
    zonal = check_zonal(kernel, bandlimit)
    largest = np.abs(zonal).max()
    if largest == 0.0:
        raise UserError("kernel must have a coefficient that is not zero, or it transports nothing to count")
    return zonal / largest


def _angle_of_symmetry(half_angle: float | Region, what: str = "radially symmetric functions") -> float:
    """The half-angle of a cap, where nothing else will do."""
    if isinstance(half_angle, Region):
        raise UserError(f"{what} are those of a cap: give its half_angle in radians, not a region")
    return check_half_angle(half_angle)


def _log_odds(epsilon: float) -> float:
    """ℓ = ln((1-ε)/ε), whose quotient overflows below 1e-308."""
    return math.log1p(-epsilon) - math.log(epsilon)


def _second_term(ratio: float, weight: float, argument: float, next_order: float = 0.0) -> float:
    """w [ℓ a - φ(ℓ)] + q (ℓ²/π² - 1), the last within ±½, as far from ℓ = 0 as it grows with ℓ; 0 if nowhere.

    φ' = Re ψ(½ + iℓ/2π) grows without end as |ℓ| does.

    Parameters
    ----------
    ratio : float
        ℓ.
    weight, argument, next_order : float
        w > 0, the logarithm a, and q.
    """
    from scipy.optimize import brentq
    from scipy.special import digamma, loggamma  # takes an eighth of a second to import

    if argument <= float(digamma(0.5)):
        return 0.0
    # Of the complement, with 1 - ε for ε, the sum is the same but for its sign; so ℓ >= 0 is enough.
    sign, distance = math.copysign(1.0, ratio), abs(ratio)
    q = sign * next_order

    def slope(x: float) -> float:
        return (
            weight * (argument - float(digamma(complex(0.5, x / (2.0 * math.pi))).real))
            + 2.0 * min(q, 0.0) * x / math.pi**2
        )

    # A next order that falls takes the sum along; one that grows to ½ does so by itself.
    grown = distance if slope(distance) >= 0.0 else float(brentq(slope, 0.0, distance))
    phase = 2.0 * math.pi * float(loggamma(complex(0.5, grown / (2.0 * math.pi))).imag)
    squared = (distance if q > 0.0 else grown) ** 2 / math.pi**2
    return sign * (weight * (grown * argument - phase) + min(max(q * (squared - 1.0), -0.5), 0.5))


def _curvature_term(half_angle: float) -> float:
    """g(Θ) = 1 - ln|cos Θ| - artanh(sin Θ)/sin Θ; both logarithms diverge at 90°, where g = 1 - ln 2."""
    sine, cosine = math.sin(half_angle), abs(math.cos(half_angle))
    if sine < 1e-4:
        return sine * sine / 6.0
    # artanh(s) = ln((1 + s)/c) leaves ln c (1/s - 1) of the two divergent logarithms.
    log_cosine = math.log(cosine) if cosine > 0.0 else 0.0
    return 1.0 - math.log1p(sine) / sine + log_cosine * (1.0 - sine) / sine
