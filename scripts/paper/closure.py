"""Orthogonality and closure under rotation, measured: what bases over the hemisphere keep of either."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from slepian_prt.sphere.harmonics import bandlimit_of, real_sh
from slepian_prt.sphere.hemispherical import hemispherical_sh
from slepian_prt.sphere.quadrature import cap_rule, gauss_legendre
from slepian_prt.sphere.rotation import rotate_sh


def off_diagonal(gram: NDArray) -> float:
    """How far a Gram matrix is from diagonal: the part of its Frobenius norm that lies off the diagonal, 0 to 1."""
    return float(np.linalg.norm(gram - np.diag(np.diag(gram))) / np.linalg.norm(gram))


def gram_in_cap(functions: NDArray, half_angle: float) -> NDArray[np.float64]:
    """Gram matrix (K, K) over the cap about z of functions with coefficients (K, (L+1)²) in spherical harmonics."""
    bandlimit = bandlimit_of(functions.shape[1])
    directions, weights = cap_rule(2 * bandlimit, half_angle)
    values = real_sh(bandlimit, directions) @ functions.T
    return np.asarray((values * weights[:, None]).T @ values)


def hemispherical_gram_in_cap(bandlimit: int, half_angle: float) -> NDArray[np.float64]:
    """The same of hemispherical harmonics up to a degree, over a cap of at most 90°."""
    # In z these have no roots inside the hemisphere but at its ends, and products of the same m are polynomials.
    directions, weights = cap_rule(4 * bandlimit + 2, half_angle)
    values = hemispherical_sh(bandlimit, directions)
    return np.asarray((values * weights[:, None]).T @ values)


def lost_by_rotation(functions: NDArray, angle: float) -> float:
    """Energy that functions of a space lose, in the mean, when they are turned and projected back on the space.

    Parameters
    ----------
    functions : (K, (L+1)²)
        Coefficients that span the space, whatever their Gram matrix.
    angle : radians, about the x axis
    """
    orthonormal = np.linalg.qr(functions.T)[0].T
    kept = rotate_sh(orthonormal, _about_x(angle)) @ orthonormal.T
    return float(1.0 - np.sum(kept**2) / len(functions))


def lost_by_hemispherical(bandlimit: int, angle: float) -> tuple[float, float]:
    """The same of hemispherical harmonics up to a degree, which are zero below the horizon.

    Returns
    -------
    The part of all energy that is lost, and the part that is lost of what the rotation leaves above the horizon.
    """
    directions, weights = _lune(angle, 48 + 4 * bandlimit)
    here = hemispherical_sh(bandlimit, directions)
    turned = hemispherical_sh(bandlimit, _upward(directions @ _about_x(angle)))
    kept = float(np.sum(((here * weights[:, None]).T @ turned) ** 2))
    above = float(np.sum(weights @ turned**2))
    return 1.0 - kept / here.shape[1], 1.0 - kept / above


def _about_x(angle: float) -> NDArray[np.float64]:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def _lune(angle: float, nodes: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A rule over what the hemisphere and the same turned about x have in common.

    With x as the pole that is a rectangle of angles. Functions are like √(cos θ) at its borders; the ends of both axes
    are approached quadratically, so that they are smooth between nodes.
    """
    rule = gauss_legendre(nodes)
    t = 0.5 * (1.0 + rule.nodes)
    place = 0.5 * (1.0 - np.cos(np.pi * t))
    density = 0.25 * np.pi * np.sin(np.pi * t) * rule.weights
    s, psi = np.pi * place, angle + (np.pi - angle) * place
    directions = np.stack(
        np.broadcast_arrays(np.cos(s)[:, None], np.outer(np.sin(s), np.cos(psi)), np.outer(np.sin(s), np.sin(psi))),
        axis=-1,
    ).reshape(-1, 3)
    weights = np.outer(np.pi * density * np.sin(s), (np.pi - angle) * density)
    return _upward(directions), weights.ravel()


def _upward(directions: NDArray) -> NDArray[np.float64]:
    """Directions that rounding put below the horizon are on it."""
    return np.column_stack([directions[:, :2], np.maximum(directions[:, 2], 0.0)])
