"""Quadrature on the interval, the sphere and its caps, and near-uniform direction sets."""

from __future__ import annotations

import math
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slepian_prt.errors import check_half_angle, check_integer
from slepian_prt.sphere.rotation import rotation_to


class IntervalRule(NamedTuple):
    """Nodes and weights on [-1, 1] in ascending order; ``complement`` is 1 - |node|, to full relative accuracy."""

    nodes: NDArray[np.float64]
    weights: NDArray[np.float64]
    complement: NDArray[np.float64]


class CapNodes(NamedTuple):
    """A Gauss rule in z = cos θ on a band of the sphere about the z axis, all of its fields of shape (n,).

    ``z + z_low`` is the node to about twice float64's digits where it is next to a pole, and ``sine`` its sin θ.
    """

    z: NDArray[np.float64]
    z_low: NDArray[np.float64]
    sine: NDArray[np.float64]
    weights: NDArray[np.float64]


@cache
def gauss_legendre(n: int) -> IntervalRule:
    """Gauss–Legendre rule of n nodes, exact for polynomials of degree 2n - 1, good to rounding.

    Newton's method in θ, with P_n evaluated by differences: d_(k+1) = (k d_k - (2k+1) t P_k)/(k+1), P_(k+1) = P_k +
    d_(k+1), t = 1 - cos θ = 2 sin²(θ/2). In cos θ itself the outermost weights are lost (`numpy.leggauss` is off by
    1e-9 at n = 500), because a rounding of the node there is a change of 1e-11 in 1 - x.

    Raises
    ------
    ValueError
        n is not a positive integer.
    """
    n = check_integer(n, "n", 1)
    half = (n + 1) // 2
    k = np.arange(1, half + 1)
    # Tricomi's approximation; n = 1 has its only node at π/2.
    theta = (4 * k - 1) * np.pi / (4 * n + 2)
    theta += (n - 1) / (8.0 * n**3) / np.tan(theta)
    for _ in range(8):
        value, slope = _legendre_and_slope(n, theta)
        step = value / slope
        theta = theta - step
        if np.all(np.abs(step) <= 4e-16 * theta):
            break
    if n % 2:
        theta[-1] = np.pi / 2
    _, slope = _legendre_and_slope(n, theta)
    weights = 2.0 / slope**2
    complement = 2.0 * np.sin(theta / 2) ** 2
    nodes = np.cos(theta)
    if n % 2:
        nodes[-1], complement[-1] = 0.0, 1.0
    mirrored = slice(None, None, -1) if n % 2 == 0 else slice(-2, None, -1)
    rule = IntervalRule(
        np.concatenate([-nodes, nodes[mirrored]]),
        np.concatenate([weights, weights[mirrored]]),
        np.concatenate([complement, complement[mirrored]]),
    )
    for array in rule:
        array.setflags(write=False)
    return rule


def _legendre_and_slope(n: int, theta: NDArray) -> tuple[NDArray, NDArray]:
    """P_n(cos θ) and its derivative with respect to θ, for θ in (0, π/2]."""
    t = 2.0 * np.sin(theta / 2) ** 2
    p = np.ones_like(theta)
    d = np.zeros_like(theta)
    for k in range(n):
        d = (k * d - (2 * k + 1) * t * p) / (k + 1)
        p = p + d
    # dP_n/dθ = -n (P_(n-1) - cos θ P_n) / sin θ, and P_(n-1) - cos θ P_n = t P_n - d_n
    return p, -n * (t * p - d) / np.sin(theta)


def cap_nodes(n: int, half_angle: float, complement: bool = False) -> CapNodes:
    """Gauss rule in z on the cap θ <= Θ about z, or on the rest of the sphere if ``complement``.

    Weights sum to 1 - cos Θ (or 1 + cos Θ); both are formed without cancellation, so that caps of 1e-8 rad and their
    complements keep all digits.
    """
    half_angle = check_half_angle(half_angle)
    if complement:
        mirrored = cap_nodes(n, math.pi - half_angle)
        return CapNodes(-mirrored.z, -mirrored.z_low, mirrored.sine, mirrored.weights)
    rule = gauss_legendre(n)
    height, rest = 2.0 * math.sin(half_angle / 2) ** 2, 2.0 * math.cos(half_angle / 2) ** 2
    # Distances of each node from both ends of the interval, relative to its length.
    near, far = 0.5 * rule.complement, 1.0 - 0.5 * rule.complement
    t = height * np.where(rule.nodes > 0.0, near, far)  # 1 - cos θ
    s = rest + height * np.where(rule.nodes > 0.0, far, near)  # 1 + cos θ
    z = np.where(t <= s, 1.0 - t, s - 1.0)
    z_low = np.where(t <= s, (1.0 - z) - t, s - (1.0 + z))
    return CapNodes(z, z_low, np.sqrt(t * s), 0.5 * height * rule.weights)


def cap_rule(degree: int, half_angle: float, center: ArrayLike = (0.0, 0.0, 1.0)) -> tuple[NDArray, NDArray]:
    """Exact rule on a cap for spherical polynomials up to ``degree`` (for products of two L-bandlimited ones: 2L).

    Parameters
    ----------
    degree : int >= 0
    half_angle : Θ in [0, π], radians
    center : (3,)

    Returns
    -------
    (n, 3) unit directions and (n,) positive weights that sum to the cap's area 4π sin²(Θ/2).

    Raises
    ------
    ValueError
    """
    degree = check_integer(degree, "degree", 0)
    nodes = cap_nodes(degree // 2 + 1, half_angle)
    azimuths = 2.0 * np.pi * np.arange(degree + 1) / (degree + 1)
    z, phi = np.repeat(nodes.z, azimuths.size), np.tile(azimuths, nodes.z.size)
    sine = np.repeat(nodes.sine, azimuths.size)
    directions = np.column_stack([sine * np.cos(phi), sine * np.sin(phi), z])
    weights = np.repeat(nodes.weights * (2.0 * np.pi / azimuths.size), azimuths.size)
    return directions @ rotation_to(center).T, weights


def sphere_rule(degree: int) -> tuple[NDArray, NDArray]:
    """Exact rule on S² for spherical polynomials up to ``degree``: (n, 3) directions, (n,) weights that sum to 4π."""
    return cap_rule(degree, math.pi)


def spherical_fibonacci(n: int) -> NDArray[np.float64]:
    """n near-uniform directions on S² (Keinert et al., SIGGRAPH Asia 2015), shape (n, 3), equal weights 4π/n."""
    n = check_integer(n, "n", 1)
    z = 1.0 - (2.0 * np.arange(n) + 1.0) / n
    return _on_spiral(z)


def hemisphere_fibonacci(n: int) -> NDArray[np.float64]:
    """n directions about z whose density is cos θ/π, on a golden spiral, shape (n, 3).

    (1/π) ∫ f(ω) (ω_z)₊ dω ≈ mean of f over them. Sorted by elevation, the zenith first.
    """
    n = check_integer(n, "n", 1)
    return _on_spiral(np.sqrt(1.0 - (np.arange(n) + 0.5) / n))


def _on_spiral(z: NDArray) -> NDArray[np.float64]:
    golden_angle = math.pi * (3.0 - math.sqrt(5.0))
    phi = golden_angle * np.arange(z.size)
    sine = np.sqrt(np.maximum(0.0, (1.0 - z) * (1.0 + z)))
    return np.column_stack([sine * np.cos(phi), sine * np.sin(phi), z])
