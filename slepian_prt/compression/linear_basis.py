"""K functions of one cap, and coefficients of transfer vectors in them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from slepian_prt.slepian.concentration import scatter_radial
from slepian_prt.sphere.harmonics import degrees, num_coefficients
from slepian_prt.sphere.rotation import rotate_sh, rotation_to

# float16 is within 2⁻¹¹ of what it rounds, relatively, or 2⁻²⁵; above the second of these it has no numbers.
_FAINTEST, _BRIGHTEST = 2.0**-10, 65504.0


@dataclass(frozen=True)
class LinearBasis:
    """K functions of one cap: t ≈ mean + S⁻¹ Σ_k c_k f_k with c = fᵀ S (t - mean), S = diag of the weights.

    The functions are orthonormal. They are kept in whichever of three forms is smallest to store; what was rounded to
    float16 is made orthonormal again before it is used.

    Attributes
    ----------
    center : (3,)
    orders : (K,) int16 or None, radial : (K, L+1) float32, float16 or None
        Functions of one order each in the cap's frame.
    dense : (K, (L+1)²) float32, float16 or None
        Functions in the world frame. If this and ``radial`` are None, the functions are the first K harmonics.
    mean : (channels, (L+1)²) float32, float16 or None
    weights : (L+1,) or None
        Of a light prior, for each degree; None stands for ones.
    known_functions : (K, (L+1)²) or None
        What `functions` would make anew.
    count, bandlimit : int
        K and L.
    """

    center: NDArray[np.float64]
    bandlimit: int
    count: int
    orders: NDArray[np.int16] | None = None
    radial: NDArray | None = None
    dense: NDArray | None = None
    mean: NDArray | None = None
    weights: NDArray[np.float64] | None = None
    known_functions: NDArray[np.float64] | None = None

    @cached_property
    def functions(self) -> NDArray[np.float64]:
        """(K, (L+1)²) in the world frame."""
        if self.known_functions is not None:
            return self.known_functions
        if self.radial is not None:
            return rotate_sh(self.local_functions, rotation_to(self.center))
        return self.local_functions

    @property
    def local_functions(self) -> NDArray[np.float64]:
        """(K, (L+1)²): those of one order each in the cap's frame, others in the world frame."""
        if self.radial is not None and self.orders is not None:
            radial = self.radial.astype(np.float64)
            if self.radial.dtype == np.float16:
                for m in np.unique(self.orders):
                    radial[self.orders == m] = orthonormal_rows(radial[self.orders == m])
            return scatter_radial(radial, self.orders)
        if self.dense is not None:
            dense = self.dense.astype(np.float64)
            return orthonormal_rows(dense) if self.dense.dtype == np.float16 else dense
        return np.eye(self.count, num_coefficients(self.bandlimit))

    @cached_property
    def analysis(self) -> NDArray[np.float32]:
        """(K, (L+1)²): what a vector is multiplied with to get its coefficients."""
        return (self.functions * self._scale).astype(np.float32)

    @property
    def synthesis(self) -> NDArray[np.float64]:
        """(K, (L+1)²): what coefficients are multiplied with to get the vector."""
        return self.functions if self.weights is None else np.asarray(self.functions / self._scale)

    @property
    def _scale(self) -> NDArray[np.float64]:
        return np.ones(1) if self.weights is None else self.weights[degrees(self.bandlimit)]

    def first(self, count: int) -> LinearBasis:
        """The basis of the first ``count`` functions."""
        return replace(
            self,
            count=count,
            orders=None if self.orders is None else self.orders[:count],
            radial=None if self.radial is None else self.radial[:count],
            dense=None if self.dense is None else self.dense[:count],
            known_functions=self.functions[:count],  # Gram-Schmidt went in order
        )

    def project(self, vectors: NDArray) -> NDArray[np.float32]:
        """(n, K channels) coefficients of transfer vectors (n, channels, (L+1)²); those of one function together."""
        centred = vectors if self.mean is None else vectors - self.mean
        n, channels, size = centred.shape
        coefficients = centred.reshape(-1, size) @ self.analysis.T
        by_function = np.swapaxes(coefficients.reshape(n, channels, self.count), 1, 2)
        return by_function.reshape(n, self.count * channels).astype(np.float32)

    def reconstruct(self, coefficients: NDArray, channels: int) -> NDArray[np.float32]:
        """(n, channels, (L+1)²) transfer vectors from (n, K channels) coefficients."""
        n = len(coefficients)
        by_channel = np.swapaxes(coefficients.reshape(n, self.count, channels), 1, 2).reshape(n * channels, self.count)
        vectors = (by_channel.astype(np.float32) @ self.synthesis.astype(np.float32)).reshape(
            n, channels, num_coefficients(self.bandlimit)
        )
        return vectors if self.mean is None else vectors + self.mean


def in_range_of_float16(largest: float) -> bool:
    """Whether numbers, the largest of which has this magnitude, keep some three digits in float16."""
    return largest == 0.0 or _FAINTEST <= largest <= _BRIGHTEST


def in_float16(bases: Sequence[LinearBasis]) -> tuple[LinearBasis, ...]:
    """Bases of all caps with what is stored of them in float16, but for means that are too large or small for it."""
    means = [float(np.abs(basis.mean).max(initial=0.0)) for basis in bases if basis.mean is not None]
    names = ("radial", "dense", "mean") if in_range_of_float16(max(means, default=0.0)) else ("radial", "dense")
    return tuple(
        replace(
            basis,
            known_functions=None,
            **{name: part.astype(np.float16) for name in names if (part := getattr(basis, name)) is not None},
        )
        for basis in bases
    )


def orthonormal_rows(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Gram-Schmidt of nearly orthonormal rows, in order."""
    q, r = np.linalg.qr(rows.T)
    return np.asarray((q * np.where(np.diag(r) < 0.0, -1.0, 1.0)).T)
