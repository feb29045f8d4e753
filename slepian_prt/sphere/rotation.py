"""Rotation of real spherical harmonic expansions.

A rotation acts on f as (R f)(ω) = f(Rᵀ ω). With R = Rz(α) Ry(β) Rz(γ) only Ry needs work, and it becomes diagonal too
in harmonics about the y axis: Ry(β) = Jᵀ Z(β) J with one constant orthogonal matrix J per degree (the idea of Feng et
al., J. Sci. Comput. 2015). J comes from the eigenvectors of the generator of rotations about y, whose eigenvalues are
the integers; they are a unit apart, so it is good to rounding at every degree (3.5e-14 at L = 200).
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slepian_prt.arrays import real_numbers
from slepian_prt.errors import UserError
from slepian_prt.sphere.directions import check_directions
from slepian_prt.sphere.harmonics import bandlimit_of, num_coefficients


def rotation_to(center: ArrayLike) -> NDArray[np.float64]:
    """The rotation Rz(φ) Ry(θ) that takes z to ``center``; at the poles φ = 0.

    Parameters
    ----------
    center : (3,) or (n, 3)

    Returns
    -------
    (3, 3) or (n, 3, 3) rotation matrices.
    """
    c = check_directions(center, "center")
    sin_theta = np.hypot(c[:, 0], c[:, 1])
    polar = sin_theta == 0.0
    safe = np.where(polar, 1.0, sin_theta)
    cos_phi, sin_phi = np.where(polar, 1.0, c[:, 0] / safe), np.where(polar, 0.0, c[:, 1] / safe)
    zero = np.zeros_like(sin_phi)
    matrices = np.stack(
        [
            np.stack([cos_phi * c[:, 2], -sin_phi, c[:, 0]], axis=-1),
            np.stack([sin_phi * c[:, 2], cos_phi, c[:, 1]], axis=-1),
            np.stack([-sin_theta, zero, c[:, 2]], axis=-1),
        ],
        axis=-2,
    )
    return matrices[0] if np.ndim(center) == 1 else matrices


def rotate_sh(coefficients: ArrayLike, rotation: ArrayLike) -> NDArray[Any]:
    """Coefficients of ω ↦ f(Rᵀω), given those of f.

    Parameters
    ----------
    coefficients : (..., (L+1)²)
        Real SH coefficients.
    rotation : (..., 3, 3)
        Proper rotations. The leading shapes broadcast: many vectors by one rotation, one vector by many, or pairwise.

    Returns
    -------
    (..., (L+1)²) float64, or float32 if that is what the coefficients are.

    Raises
    ------
    ValueError
        Numbers that are not real; a last axis that is not a square number; a matrix that is no rotation (beyond 1e-6).
    """
    c = np.asarray(coefficients)
    if c.dtype.kind not in "iuf":
        raise UserError(f"coefficients must be real numbers, not {c.dtype}")
    dtype = np.dtype(np.float32 if c.dtype == np.float32 else np.float64)
    c = c.astype(dtype, copy=False)
    r = real_numbers(rotation, "rotation")
    bandlimit = bandlimit_of(c.shape[-1]) if c.ndim else -1
    if c.ndim == 0 or num_coefficients(bandlimit) != c.shape[-1]:
        raise UserError(f"coefficients must have a last axis of (L+1)^2 entries, not shape {c.shape}")
    alpha, beta, gamma = _euler_zyz(r)
    shape = np.broadcast_shapes(c.shape[:-1], alpha.shape)
    # Inside, the vectors are columns: every step then runs along contiguous rows, one for each function.
    columns = np.array(np.broadcast_to(c, (*shape, c.shape[-1])).reshape(-1, c.shape[-1]).T, order="C")
    turns = [
        _cos_sin_multiples(bandlimit, np.broadcast_to(angle, shape).ravel(), dtype) for angle in (alpha, beta, gamma)
    ]
    for l in range(bandlimit + 1):
        degree = slice(l * l, (l + 1) ** 2)
        about_y = to_y_axis(l).astype(dtype, copy=False)
        v = _turn(columns[degree], turns[2])
        v = about_y.T @ _turn(about_y @ v, turns[1])
        columns[degree] = _turn(v, turns[0])
    return np.ascontiguousarray(columns.T).reshape(*shape, c.shape[-1])


def _turn(v: NDArray, cos_sin: tuple[NDArray, NDArray]) -> NDArray:
    """Rotate one degree, (2l+1, n), about z by the angles whose multiples are given."""
    l = len(v) // 2
    cos_m, sin_m = (multiples[1 : l + 1] for multiples in cos_sin)
    out = np.empty_like(v)
    out[l] = v[l]
    even, odd = v[l + 1 :], v[:l][::-1]
    out[l + 1 :] = even * cos_m - odd * sin_m
    out[:l] = (odd * cos_m + even * sin_m)[::-1]
    return out


def _cos_sin_multiples(bandlimit: int, angle: NDArray, dtype: np.dtype) -> tuple[NDArray, NDArray]:
    """Cosines and sines of 0, 1, …, L times each angle, (L+1, n)."""
    multiples = (np.arange(bandlimit + 1)[:, None] * angle).astype(dtype, copy=False)
    return np.cos(multiples), np.sin(multiples)


def _euler_zyz(rotation: NDArray) -> tuple[NDArray, NDArray, NDArray]:
    """Angles with R = Rz(α) Ry(β) Rz(γ).

    γ is read from what is left once α and β are undone: next to β = 0 and π each of α and γ alone is ill-determined,
    but their errors then cancel.
    """
    if rotation.shape[-2:] != (3, 3):
        raise UserError(f"rotation must have shape (..., 3, 3), not {rotation.shape}")
    defect = np.abs(rotation @ np.swapaxes(rotation, -1, -2) - np.eye(3)).max(initial=0.0)
    if not defect <= 1e-6 or np.any(np.linalg.det(rotation) < 0.0):
        raise UserError(f"rotation must be a proper rotation matrix (R Rᵀ differs from 1 by {defect:.3g})")
    alpha = np.arctan2(rotation[..., 1, 2], rotation[..., 0, 2])
    sin_beta = np.hypot(rotation[..., 0, 2], rotation[..., 1, 2])
    beta = np.arctan2(sin_beta, rotation[..., 2, 2])
    cos_a, sin_a = np.cos(alpha), np.sin(alpha)
    undone_x = cos_a[..., None] * rotation[..., 0, :] + sin_a[..., None] * rotation[..., 1, :]
    undone_y = cos_a[..., None] * rotation[..., 1, :] - sin_a[..., None] * rotation[..., 0, :]
    left_x = np.cos(beta)[..., None] * undone_x - np.sin(beta)[..., None] * rotation[..., 2, :]
    return alpha, beta, np.arctan2(undone_y[..., 0], left_x[..., 0])


@cache
def to_y_axis(l: int) -> NDArray[np.float64]:
    """The orthogonal J of degree l, (2l+1, 2l+1), rows ordered like m, for which Ry(β) = Jᵀ Z(β) J.

    The generator of rotations about y leaves the functions even in y (m >= 0) and those odd in y (m < 0) apart. On
    each it is antisymmetric tridiagonal, D (iT) D* with D = diag(i^k) and T real symmetric, so an eigenvector v of T
    with eigenvalue μ > 0 gives the plane (√2 Re Dv, -√2 Im Dv) that Ry(β) turns by μβ.
    """
    j = np.zeros((2 * l + 1, 2 * l + 1))
    for first in (0, 1):
        if first > l:
            continue
        m = np.arange(first, l)
        coupling = 0.5 * np.sqrt((l - m) * (l + m + 1.0))
        if first == 0 and l > 0:
            coupling[0] *= np.sqrt(2.0)
        size = l + 1 - first
        eigenvalues, vectors = np.zeros(1), np.ones((1, 1))
        if size > 1:
            eigenvalues, vectors = np.linalg.eigh(np.diag(coupling, -1))  # which looks at the lower triangle
        columns = l + np.arange(first, l + 1) if first == 0 else l - np.arange(first, l + 1)
        k = np.arange(size)
        real_part = np.where(k % 2 == 0, np.where(k % 4 == 0, 1.0, -1.0), 0.0)
        imaginary_part = np.where(k % 2 == 1, np.where(k % 4 == 1, 1.0, -1.0), 0.0)
        for mu, v in zip(np.rint(eigenvalues).astype(int), vectors.T, strict=True):
            if mu > 0:
                j[l + mu, columns] = np.sqrt(2.0) * real_part * v
                j[l - mu, columns] = -np.sqrt(2.0) * imaginary_part * v
            elif mu == 0:
                # Supported on every other m only; which, depends on l.
                j[l, columns] = (real_part + imaginary_part) * v
    j.setflags(write=False)
    return j
