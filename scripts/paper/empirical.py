"""The spectrum of transport as it is found: singular values of a discretised operator."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from slepian_prt.sphere.harmonics import degrees, real_sh


def empirical_spectrum(
    zonal: NDArray, half_angle: float, *, reflection: bool = False, samples: int = 20_000, seed: int = 0
) -> NDArray[np.float64]:
    """Squared singular values of a discretised transport operator, relative to the first.

    Rows are the transfer vectors D_t y(c(x)) of points x whose axes c(x) are drawn at random from the cap. With
    ``reflection`` the points have normals in the cap Θ/2 and the axis is the reflection of a fixed view direction,
    (θ, φ) → (2θ, φ) (Lessig & Fiume, Sec. 4); rows then carry the Jacobian √(dω_c/dω_n) = √(4 cos θ), so that the
    operator's norm is that over the cap of axes.

    Parameters
    ----------
    zonal : (L+1,) coefficients t_l
    half_angle : Θ of the cap of axes, radians

    Returns
    -------
    (min(samples, (L+1)²),)
    """
    rng = np.random.default_rng(seed)
    bandlimit = len(zonal) - 1
    theta = 2.0 * np.arcsin(np.sqrt(rng.random(samples)) * math.sin(half_angle / (4 if reflection else 2)))
    phi = rng.random(samples) * 2.0 * math.pi
    weight = np.ones(samples)
    if reflection:
        weight, theta = np.sqrt(4.0 * np.cos(theta)), 2.0 * theta
    axes = np.column_stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])
    rows = real_sh(bandlimit, axes) * zonal[degrees(bandlimit)] * weight[:, None]
    sigma = np.linalg.svd(rows, compute_uv=False)
    return (sigma / sigma[0]) ** 2
