"""The concentration problem on a region of any shape."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError, check_bandlimit, check_real
from slepian_prt.slepian.concentration import summarise_functions
from slepian_prt.sphere.harmonics import num_coefficients, real_sh
from slepian_prt.sphere.regions import Region
from slepian_prt.summary import Summarised


@dataclass(frozen=True, repr=False)
class RegionBasis(Summarised):
    """Slepian functions of a region of any shape, most concentrated first.

    Attributes
    ----------
    bandlimit : int
    functions : ((L+1)², K)
        SH coefficients, one orthonormal column per function.
    eigenvalues, leakages : (K,)
        Concentrations λ and 1 - λ, each from its own side of the boundary.
    """

    bandlimit: int
    functions: NDArray[np.float64]
    eigenvalues: NDArray[np.float64]
    leakages: NDArray[np.float64]

    def __len__(self) -> int:
        return self.eigenvalues.size

    def _summary(self) -> dict[str, object]:
        return {"bandlimit": self.bandlimit, **summarise_functions(self.bandlimit, self.eigenvalues)}


def region_basis(bandlimit: int, region: Region, *, threshold: float | None = None) -> RegionBasis:
    """Solve the concentration problem on a union or difference of caps, a polygon, or a mask.

    Singular values of √w Y on a quadrature rule of the region, folded into a triangle chunk by chunk; the leakages
    from the complement's rule in the same way. Dense: (L+1)⁶ operations, so meant for L up to about 50.

    Parameters
    ----------
    bandlimit : int
    region : from `cap_region` (and ``|``, ``&``, ``-``, ``~``), `polygon_region` or `mask_region`
    threshold : float, optional
        Only functions whose concentration is above it.

    Raises
    ------
    UserError
        A bad bandlimit or threshold; a region of no area.
    """
    bandlimit = check_bandlimit(bandlimit)
    if threshold is not None:
        threshold = check_real(threshold, "threshold", "[0, inf]", lambda x: x >= 0.0)
    inside = _folded_samples(bandlimit, region)
    if not inside.any():
        raise UserError("region must have an area above zero, not 0")
    outside = _folded_samples(bandlimit, ~region)
    _, sigma, rows = np.linalg.svd(inside)
    # Within the span of nearly equal concentrations (next to one) the complement tells functions apart.
    functions = rows.T
    leakages = np.sum((outside @ functions) ** 2, axis=0)
    mostly_in = leakages < 0.5
    concentrations = np.clip(np.where(mostly_in, 1.0 - leakages, sigma**2), 0.0, 1.0)
    leakages = np.clip(np.where(mostly_in, leakages, 1.0 - concentrations), 0.0, 1.0)
    strongest = np.argmax(np.abs(functions) > 0.5 * np.abs(functions).max(axis=0), axis=0)
    functions = functions * np.where(functions[strongest, np.arange(len(sigma))] < 0.0, -1.0, 1.0)
    keep = slice(None) if threshold is None else concentrations > threshold
    return RegionBasis(bandlimit, functions[:, keep], concentrations[keep], leakages[keep])


def _folded_samples(bandlimit: int, region: Region) -> NDArray[np.float64]:
    """A square R with Rᵀ R the localisation matrix of the region."""
    size = num_coefficients(bandlimit)
    triangle = np.zeros((size, size))
    directions, weights = region.rule(2 * bandlimit)
    step = max(size, 4096)
    for begin in range(0, len(weights), step):
        chunk = slice(begin, begin + step)
        samples = real_sh(bandlimit, directions[chunk]) * np.sqrt(weights[chunk])[:, None]
        triangle = np.asarray(np.linalg.qr(np.concatenate([triangle, samples]), mode="r"))
    return triangle
