"""The grid of Mitsuba's ``envmap``, and radiance on it as spherical harmonics.

Measured with Mitsuba 3.9: texel (row r, column c) of an H x W map is centred on the direction with
u = (c + ½)/W = atan2(x, -z)/2π and v = r/(H - 1) = acos(y)/π, and the map is interpolated bilinearly. The first and
the last row sit on the poles, half a row off the usual convention.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from slepian_prt.sphere.harmonics import degrees, legendre_polynomials, num_coefficients, orders
from slepian_prt.sphere.rotation import rotate_sh

if TYPE_CHECKING:
    from scipy.sparse import csr_array

# Rows per degree, and columns per order by half, below which bilinear interpolation matters, and is carried out.
_ROWS_PER_DEGREE = 8

# Texels that are transformed at a time.
_BLOCK = 1 << 20

# Columns: where the map's frame (polar axis z, azimuth -2πu from x) goes in Mitsuba's world, y up.
_MAP_TO_WORLD = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]])


@dataclass(frozen=True)
class TexelProjection:
    """The linear map from texels to spherical-harmonic coefficients in the world.

    An FFT along each row and a Legendre sum over the rows; Clenshaw–Curtis weights make it exact for maps that are
    bandlimited themselves. Maps of fewer than 8 rows or 16 columns per degree are interpolated first, as Mitsuba would.

    Attributes
    ----------
    height, width : int
        Of the map: of any shape, with two rows at least.
    bandlimit : int
    to_world : (3, 3)
        Rotation from the map's frame (y up) to the world.
    """

    height: int
    width: int
    bandlimit: int
    to_world: NDArray[np.float64] = field(default_factory=lambda: np.eye(3))

    def __call__(self, texels: NDArray) -> NDArray[np.float64]:
        """(C, (L+1)²) coefficients of texels (H, W, C)."""
        if self._finer is not None:
            rows, columns = self._finer
            texels = _along(rows, _along(columns, np.asarray(texels, dtype=np.float64), 1), 0)
        return self.of_rows([texels])

    def of_rows(self, blocks: Iterable[NDArray]) -> NDArray[np.float64]:
        """The same, of a map that comes in blocks of rows from the top; it must have `enough_rows`."""
        height, width = self._grid
        moments: NDArray[np.complex128] | None = None
        done = 0
        for block in blocks:
            if moments is None:
                moments = np.empty((height, self.bandlimit + 1, block.shape[2]), dtype=np.complex128)
            step = max(1, _BLOCK // (width * block.shape[2]))
            for begin in range(0, len(block), step):
                part = block[begin : begin + step].astype(np.float64)
                transformed = np.fft.rfft(part, axis=1)
                moments[done : done + len(part)] = transformed[:, : self.bandlimit + 1]
                done += len(part)
        assert moments is not None
        assert done == height
        # ∫ f(φ') e^{-imφ'} dφ' with φ' = -2π(c + ½)/W, the azimuth in the map's frame.
        moments = np.conj(moments * self._phases[:, None])
        legendre = _weighted_legendre(self.bandlimit, height)
        return rotate_sh(legendre_sum(moments, legendre), self.to_world @ _MAP_TO_WORLD)

    def adjoint(self, coefficients: NDArray) -> NDArray[np.float64]:
        """(H, W, C) texels from coefficients (C, (L+1)²): the transpose, what gradients go back through."""
        height, width = self._grid
        in_map = rotate_sh(np.asarray(coefficients, dtype=np.float64), (self.to_world @ _MAP_TO_WORLD).T)
        moments = legendre_spread(in_map, _weighted_legendre(self.bandlimit, height))
        spectrum = np.zeros((height, width // 2 + 1, len(in_map)), dtype=np.complex128)
        spectrum[:, : self.bandlimit + 1] = np.conj(moments * self._phases[:, None])
        # The transpose of the real part of an FFT: an inverse FFT without its 1/W, half of each m > 0.
        spectrum[:, 1 : self.bandlimit + 1] *= 0.5
        texels = np.fft.irfft(spectrum, n=width, axis=1, norm="forward")
        if self._finer is not None:
            rows, columns = self._finer
            texels = _along(columns.T.tocsr(), _along(rows.T.tocsr(), texels, 0), 1)
        return np.asarray(texels)

    def matrices(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The same map as two matrices, but for the rotation into the world.

        Returns
        -------
        along : (2L+1, W)
            Times a row of texels: its sums with cosines and sines, by order from -L to L.
        across : (2L+1, L+1, H)
            For each order: times the sums of all rows, coefficients of all degrees in the map's frame; zero below |m|.
        """
        height, width = self._grid
        bandlimit, azimuth = self.bandlimit, 2.0 * math.pi * (np.arange(width) + 0.5) / width
        m = np.arange(1, bandlimit + 1)[:, None]
        # ∫ f e^{-imφ'} dφ' with φ' = -azimuth; coefficients of negative orders are minus its imaginary part.
        along = np.concatenate([-np.sin(m[::-1] * azimuth), np.ones((1, width)), np.cos(m * azimuth)])
        along *= 2.0 * math.pi / width
        across = np.zeros((2 * bandlimit + 1, bandlimit + 1, height))
        for order, functions in enumerate(_weighted_legendre(bandlimit, height)):
            across[bandlimit + order, order:] = across[bandlimit - order, order:] = functions
        if self._finer is not None:
            rows, columns = self._finer
            along, across = along @ columns, across @ rows.toarray()
        return along, across

    def rotation_of_sums(self) -> NDArray[np.float64]:
        """((L+1)², (2L+1)(L+1)): coefficients in the world from those of `matrices`, order after order."""
        bandlimit = self.bandlimit
        degree = degrees(bandlimit)
        rotation = np.zeros((num_coefficients(bandlimit), (2 * bandlimit + 1) * (bandlimit + 1)))
        turned = rotate_sh(np.eye(num_coefficients(bandlimit)), self.to_world @ _MAP_TO_WORLD)
        rotation[:, (orders(bandlimit) + bandlimit) * (bandlimit + 1) + degree] = turned.T
        return rotation

    @staticmethod
    def enough_rows(height: int, bandlimit: int) -> bool:
        """Whether a map of this height, and twice as wide, is projected without interpolation."""
        return height >= _ROWS_PER_DEGREE * (bandlimit + 1) + 1

    @cached_property
    def _grid(self) -> tuple[int, int]:
        rows = _ROWS_PER_DEGREE * (self.bandlimit + 1) + 1
        height = self.height if self.height >= rows else math.ceil(rows / self.height) * self.height + 1
        return height, math.ceil(2 * rows / self.width) * self.width

    @cached_property
    def _finer(self) -> tuple[csr_array, csr_array] | None:
        """Interpolation of rows and of columns to the grid that is projected; None if it is the map's own."""
        height, width = self._grid
        if (height, width) == (self.height, self.width):
            return None
        return interpolation(self.height, self.width, height, width)

    @cached_property
    def _phases(self) -> NDArray[np.complex128]:
        width = self._grid[1]
        m = np.arange(self.bandlimit + 1)
        return np.exp(-1j * np.pi * m / width) * (2.0 * np.pi / width)


def legendre_sum(moments: NDArray[np.complex128], legendre: Sequence[NDArray]) -> NDArray[np.float64]:
    """Coefficients (C, (L+1)²) of what has the Fourier coefficients ∫ f e^{-imφ} dφ on rings about the pole.

    Parameters
    ----------
    moments : (rings, L+1, C)
    legendre : for each order m, (L+1-m, rings)
        Normalised Legendre functions times the weights of the rings.
    """
    bandlimit = len(legendre) - 1
    coefficients = np.zeros((moments.shape[2], num_coefficients(bandlimit)))
    for order, functions in enumerate(legendre):
        # Real and imaginary part side by side: one real product instead of a complex one.
        pairs = np.concatenate([moments[:, order].real, moments[:, order].imag], axis=1)
        real, imaginary = np.split((functions @ pairs).T, 2)
        l = np.arange(order, bandlimit + 1)
        coefficients[:, l * l + l + order] = real
        if order:
            coefficients[:, l * l + l - order] = -imaginary
    return coefficients


def legendre_spread(coefficients: NDArray, legendre: Sequence[NDArray]) -> NDArray[np.complex128]:
    """(rings, L+1, C) moments from coefficients (C, (L+1)²): the transpose of `legendre_sum`."""
    bandlimit = len(legendre) - 1
    moments = np.zeros((legendre[0].shape[1], bandlimit + 1, len(coefficients)), dtype=np.complex128)
    for order, functions in enumerate(legendre):
        l = np.arange(order, bandlimit + 1)
        moments[:, order] = functions.T @ coefficients[:, l * l + l + order].T
        if order:
            moments[:, order] -= 1j * (functions.T @ coefficients[:, l * l + l - order].T)
    return moments


def legendre_on_rings(
    bandlimit: int, polar_angles: NDArray[np.float64], weights: NDArray[np.float64]
) -> list[NDArray[np.float64]]:
    """For each order, (L+1-m, rings): normalised Legendre functions at polar angles times the weights of the rings."""
    cosine, sine = np.cos(polar_angles), np.sin(polar_angles)
    return [legendre_polynomials(bandlimit, order, cosine) * sine**order * weights for order in range(bandlimit + 1)]


def interpolation(height: int, width: int, new_height: int, new_width: int) -> tuple[csr_array, csr_array]:
    """Mitsuba's bilinear interpolation to a finer grid: (H', H) of rows and (W', W) of columns."""
    r = np.linspace(0.0, height - 1.0, new_height)
    c = (np.arange(new_width) + 0.5) * width / new_width - 0.5
    first = np.minimum(r.astype(int), max(height - 2, 0))
    rows = _two_points(first, np.minimum(first + 1, height - 1), r - first, height)
    left = np.floor(c).astype(int)
    return rows, _two_points(left % width, (left + 1) % width, c - left, width)


def resample(texels: NDArray, height: int, width: int) -> NDArray[np.float32]:
    """(H, W, C) texels interpolated as Mitsuba would, on a grid of ``height`` and ``width``."""
    rows, columns = interpolation(texels.shape[0], texels.shape[1], height, width)
    return _along(rows, _along(columns, texels.astype(np.float64), 1), 0).astype(np.float32)


def _two_points(first: NDArray, second: NDArray, part: NDArray, size: int) -> csr_array:
    from scipy.sparse import csr_array  # only for maps of few rows, so that relighting starts without SciPy

    n = np.arange(len(first))
    data, places = np.concatenate([1.0 - part, part]), np.concatenate([first, second])
    return csr_array((data, (np.concatenate([n, n]), places)), shape=(len(first), size))


def _along(matrix: csr_array, texels: NDArray, axis: int) -> NDArray[np.float64]:
    """A sparse matrix times one axis of an array."""
    moved = np.moveaxis(texels, axis, 0)
    product = matrix @ moved.reshape(len(moved), -1)
    return np.moveaxis(np.asarray(product).reshape(-1, *moved.shape[1:]), 0, axis)


@lru_cache(maxsize=4)
def _weighted_legendre(bandlimit: int, height: int) -> list[NDArray[np.float64]]:
    """`legendre_on_rings` of the rows of a map."""
    return legendre_on_rings(bandlimit, np.linspace(0.0, np.pi, height), clenshaw_curtis(height - 1))


def clenshaw_curtis(n: int) -> NDArray[np.float64]:
    """Weights of ∫ f(cos θ) sin θ dθ on θ_j = πj/n, j = 0..n, exact for polynomials of degree n."""
    k = np.arange(1, n // 2 + 1)
    b = np.where(2 * k == n, 1.0, 2.0) / (4.0 * k * k - 1.0)
    # The cosine sum is a real FFT of length 2n of coefficients at even frequencies.
    spectrum = np.zeros(n + 1)
    spectrum[0] = 1.0
    np.subtract.at(spectrum, 2 * k, b)
    full = np.zeros(2 * n)
    full[: n + 1] = spectrum
    weights = np.fft.fft(full).real[: n + 1] * (2.0 / n)
    weights[[0, n]] *= 0.5
    return np.asarray(weights)
