"""How many functions a region holds: Shannon numbers, their refinements, and the exact count."""

from __future__ import annotations

import math

from slepian_prt.errors import UserError, check_bandlimit, check_epsilon, check_half_angle
from slepian_prt.slepian.concentration import cap_basis
from slepian_prt.sphere.caps import cap_area, cap_boundary


def shannon_number(bandlimit: int, half_angle: float) -> float:
    """N = (L+1)² A/4π = (L+1)² sin²(Θ/2), the sum of all concentrations (Simons, Dahlen & Wieczorek 2006)."""
    return (check_bandlimit(bandlimit) + 1) ** 2 * math.sin(check_half_angle(half_angle) / 2) ** 2


def generalized_shannon_number(
    bandlimit: int, half_angle: float, epsilon: float, *, log_base: float = 10.0, radially_symmetric: bool = False
) -> float:
    """N_g(ε) of Lessig & Fiume (EGSR 2010), Eq. 6: N + log((1-ε)/ε) B(∂U) log C.

    C = (L+1)² A(U), B = lg((L+1)² |∂U|²)/lg(2π) with |∂U| = 2π sin Θ; radially symmetric signals have C = 4(L+1)Θ.
    The paper does not fix the base of the outer logarithms; with 10 the number is close to the exact count of
    concentrations above ε, with e it is up to several times too large. The second term is dropped where one of its
    logarithms is negative (C < 1 or (L+1)|∂U| < 1: regions too small for the asymptotics), and the whole clipped to
    [0, the dimension of the space].

    Raises
    ------
    ValueError
        An argument outside its range.
    """
    bandlimit, half_angle, epsilon = check_bandlimit(bandlimit), check_half_angle(half_angle), check_epsilon(epsilon)
    if not (math.isfinite(log_base) and log_base > 1.0):
        raise UserError(f"log_base must be finite and above 1, not {log_base!r}")
    k = bandlimit + 1
    region = 4.0 * k * half_angle if radially_symmetric else k * k * cap_area(half_angle)
    number = region / (4.0 * math.pi)
    boundary = k * cap_boundary(half_angle)
    if region > 1.0 and boundary > 1.0:
        b = 2.0 * math.log(boundary) / math.log(2.0 * math.pi)
        number += math.log((1.0 - epsilon) / epsilon, log_base) * b * math.log(region, log_base)
    return min(max(number, 0.0), float(k if radially_symmetric else k * k))


def refined_shannon_number(bandlimit: int, half_angle: float, epsilon: float) -> float:
    """N_ref(ε): two-term asymptotics with the spherical constant, clipped to [0, (L+1)²].

    N_ref = K² sin²(Θ/2) + (K sin Θ/π²) [ℓ ln C - 2π Im lnΓ(½ + iℓ/2π)], K = L + 1, ℓ = ln((1-ε)/ε),
    C = 32 e⁻³ K sin Θ e^g, g = 1 - ln|cos Θ| - artanh(sin Θ)/sin Θ, and g = 1 - ln 2 at 90°.
    """
    bandlimit, half_angle, epsilon = check_bandlimit(bandlimit), check_half_angle(half_angle), check_epsilon(epsilon)
    k = bandlimit + 1
    number = shannon_number(bandlimit, half_angle)
    sine = math.sin(min(half_angle, math.pi - half_angle))
    if k * sine > 0.0:
        ratio = math.log((1.0 - epsilon) / epsilon)
        c = 32.0 * math.exp(-3.0 + _curvature_term(half_angle)) * k * sine
        from scipy.special import loggamma  # takes an eighth of a second to import

        phase = float(loggamma(complex(0.5, ratio / (2.0 * math.pi))).imag)
        number += k * sine / math.pi**2 * (ratio * math.log(c) - 2.0 * math.pi * phase)
    return min(max(number, 0.0), float(k * k))


def _curvature_term(half_angle: float) -> float:
    """g(Θ) = 1 - ln|cos Θ| - artanh(sin Θ)/sin Θ; both logarithms diverge at 90°, where g = 1 - ln 2."""
    sine, cosine = math.sin(half_angle), abs(math.cos(half_angle))
    if sine < 1e-4:
        return sine * sine / 6.0
    # artanh(s) = ln((1 + s)/c) leaves ln c (1/s - 1) of the two divergent logarithms.
    log_cosine = math.log(cosine) if cosine > 0.0 else 0.0
    return 1.0 - math.log1p(sine) / sine + log_cosine * (1.0 - sine) / sine


def concentration_count(bandlimit: int, half_angle: float, epsilon: float, *, radially_symmetric: bool = False) -> int:
    """The exact number of Slepian functions of the cap whose concentration is above ε."""
    epsilon = check_epsilon(epsilon)
    return len(cap_basis(bandlimit, half_angle, threshold=epsilon, radially_symmetric=radially_symmetric))
