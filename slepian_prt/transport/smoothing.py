"""Noise of paths taken out of transfer vectors, along a surface or across a picture, as far as it was measured.

Neighbours' vectors differ little, and their noise is independent. So vectors are split into bands, from what changes
between neighbours to what changes over some rings of them (diffusion wavelets: Coifman & Maggioni, Appl. Comput.
Harmon. Anal. 2006; in pictures Dammertz et al., HPG 2010). With P a mean over a receiver and its neighbours,

    x = P^n x + Σ_k d_k,    d_k = (P^a - P^b) x,    (a, b) = (0, 1), (1, 3), (3, 7), (7, 15), (15, 19).

How much of a band is noise is known, since the variance of x is. Each band is multiplied by Wiener's gain S / (S + N),
per receiver and degree, with the energies of signal and noise of that degree in the rings around. What cannot be told
from noise goes; borders of shadows and caustics stay, since their energy stands out. How far is smoothed follows: far
in high degrees of a few paths, hardly where vectors are clean.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, diags_array

from slepian_prt.errors import UserError
from slepian_prt.machine.threads import run_in_threads
from slepian_prt.sphere.harmonics import num_coefficients

# Each band: how many times as wide the guides are taken, and how often the mean is applied. First along what the guides
# call one surface, then across (on tubes: first along them). More rings gain little further.
BANDS = ((1.0, 1), (1.0, 2), (1.0, 4), (1.0, 8), (4.0, 4))

# Energies are added up over so many rings: fewer leave noise in the gains, more blur them across borders.
_POOLED = 4

# What stands for a variance is a mean over so many rings, where it is compared with what halves differ by.
_CALIBRATED = 8

# Difference of normals across which little is averaged.
_NORMALS = 0.15

# Parts of the extent that are one place, and the cosine of normals there from which on they are of one surface.
_PLACE, _AGREE = 1e-6, 0.95

# Random signs that tell what bands let through of noise: sqrt(2 / _PROBES) off before it is averaged over rings.
_PROBES = 64
_AT_ONCE = 8

# Degrees that are smoothed at the same time, each with arrays of its own.
_WORKERS = 4


@dataclass(frozen=True)
class Smoothed:
    """Vectors with less noise.

    Attributes
    ----------
    vectors : (V, C, (L+1)²) float32
    variance : (V, C, L+1) float32
        Expected squared error of one coefficient of each degree: noise that stayed, and signal that went.
    removed : float
        Relative RMS of what was taken out.
    gains : (L+1, 5) float64
        Mean gain of each degree in each of the `BANDS`: 1 is kept, 0 gone.
    """

    vectors: NDArray[np.float32]
    variance: NDArray[np.float32]
    removed: float
    gains: NDArray[np.float64]


def smooth(
    vectors: NDArray, variance: NDArray, neighbours: NDArray[np.integer], guides: NDArray | None = None
) -> Smoothed:
    """Take out what cannot be told from noise.

    The sum over all receivers is kept. A degree whose error would not fall, by Stein's unbiased estimate of it (Ann.
    Statist. 1981), stays as it is; so do receivers around which there is no variance.

    Parameters
    ----------
    vectors : (V, C, (L+1)²) float32
    variance : (V, C, L+1)
        Of one coefficient of each degree, as from `variance_of_paths` or `variance_of_halves`.
    neighbours : (E, 2)
        Pairs of receivers side by side, each pair once, whose noise is independent.
    guides : (V, k), optional
        What tells surfaces apart, in units of a difference across which little is averaged: pairs count
        exp(-|difference|² / 2).

    Notes
    -----
    Memory beyond the result is some arrays (V, C, 2L+1) for each of up to four threads.

    Raises
    ------
    UserError
        Arrays that do not fit together, or numbers that are not finite.
    """
    vectors, variance = np.asarray(vectors, dtype=np.float32), np.asarray(variance, dtype=np.float32)
    guides = None if guides is None else np.asarray(guides, dtype=np.float64)
    _check(vectors, variance, neighbours, guides)
    count, bandlimit = len(vectors), variance.shape[2] - 1
    result, left = np.empty_like(vectors), np.empty_like(variance)
    gains = np.ones((bandlimit + 1, len(BANDS)))
    filters = _Filters.along(neighbours, count, guides)

    def smooth_degree(degree: int) -> None:
        columns = slice(degree**2, (degree + 1) ** 2)
        result[:, :, columns], left[:, :, degree], gains[degree] = _smooth_degree(
            vectors[:, :, columns], variance[:, :, degree], filters
        )

    # Those with most coefficients first; scipy's sparse product lets go of the interpreter.
    run_in_threads(smooth_degree, reversed(range(bandlimit + 1)), _WORKERS)
    size = float(np.linalg.norm(vectors))
    removed = float(np.linalg.norm(result - vectors)) / size if size > 0.0 else 0.0
    return Smoothed(result, left, removed, gains)


def surface_guides(normals: NDArray) -> NDArray[np.float64]:
    """Guides (V, 3) of surfaces, from unit normals: little is averaged across 9 degrees at first, then across 34."""
    return np.asarray(normals, dtype=np.float64) / _NORMALS


def across_seams(neighbours: NDArray[np.integer], positions: NDArray, normals: NDArray) -> NDArray[np.int64]:
    """(E', 2) pairs, with those of receivers at one place whose normals agree, as at the seams of a texture.

    Without them both sides of a seam would be smoothed apart, and show it.
    """
    extent = float(np.ptp(positions, axis=0).max(initial=0.0)) if len(positions) else 0.0
    places = np.rint(positions / max(_PLACE * extent, 1e-300))
    order = np.lexsort([*np.transpose(normals), *places.T])  # by place, and there by normal
    before, after = order[:-1], order[1:]
    same = np.all(places[before] == places[after], axis=1)
    same &= np.einsum("ij,ij->i", normals[before], normals[after]) > _AGREE
    found = np.stack([before[same], after[same]], axis=1)
    return np.concatenate([np.asarray(neighbours, dtype=np.int64), found])


# --- Variance --------------------------------------------------------------------------------------------------------


def variance_of_paths(second_moment: NDArray, vectors: NDArray, paths: int) -> NDArray[np.float32]:
    """(V, C, L+1) variance of one coefficient of each degree, were the paths independent.

    Parameters
    ----------
    second_moment : (V, C)
        Mean square of the throughput β of paths that escape. A degree's coefficients have Σ_m (β y_lm)² = β² (2l+1)/4π
        between them, by the addition theorem.
    vectors : (V, C, (L+1)²)
        Means over the paths.
    paths : int
        Of each receiver, 2 or more.
    """
    mean = _mean_square(vectors)
    moment = np.asarray(second_moment, dtype=np.float32)[:, :, None] / np.float32(4.0 * np.pi)
    return np.asarray(np.maximum(moment - mean, 0.0) / np.float32(paths - 1))


def variance_of_halves(half_difference: NDArray, neighbours: NDArray[np.integer]) -> NDArray[np.float32]:
    """(V, C, L+1) variance of one coefficient of each degree, measured: a mean over its orders and two rings.

    Parameters
    ----------
    half_difference : (V, C, (L+1)²)
        (A - B) / 2 of two independent estimates, whose mean (A + B) / 2 has this variance.
    neighbours : (E, 2)
    """
    squares = _mean_square(half_difference)
    mean = mean_over_neighbours(neighbours, len(squares))
    return _apply(mean, squares.reshape(len(squares), -1), 2).reshape(squares.shape)


def calibrate_variance(
    variance: NDArray, half_difference: NDArray, neighbours: NDArray[np.integer]
) -> NDArray[np.float32]:
    """A variance with the size that halves show, and with less noise than theirs has.

    Paths in low-discrepancy directions vary less than independent ones, several times so; but where they vary, and in
    which channel, is known best from their second moment.

    Parameters
    ----------
    variance : (V, C, L+1)
        Of `variance_of_paths`.
    half_difference : (V, C, (L+1)²)
        As of `variance_of_halves`.
    neighbours : (E, 2)
    """
    count, shape = len(variance), variance.shape
    mean = mean_over_neighbours(neighbours, count)
    foreseen = _apply(mean, np.asarray(variance, dtype=np.float32).reshape(count, -1), 2)
    measured = _apply(mean, _mean_square(half_difference).reshape(count, -1), _CALIBRATED)
    expected = _apply(mean, foreseen, _CALIBRATED)
    ratio = np.divide(measured, expected, out=np.ones_like(measured), where=expected > 0.0)
    return np.asarray(foreseen * ratio).reshape(shape)


def relative_noise(variance: NDArray, vectors: NDArray, power: NDArray | None = None) -> float:
    """Expected relative RMS of the noise of radiance, averaged over the rotations of a light.

    Parameters
    ----------
    variance : (V, C, L+1)
        Of one coefficient of each degree.
    vectors : (V, C, (L+1)²)
    power : (L+1,), optional
        Of the light, in one harmonic of each degree; without it the light is white, and the noise that of the vectors.
    """
    of_orders = 2.0 * np.arange(variance.shape[2]) + 1.0
    weights = of_orders if power is None else of_orders * power
    size = float(np.sum(_mean_square(vectors).sum(axis=(0, 1), dtype=np.float64) * weights))
    noise = float(np.sum(variance.sum(axis=(0, 1), dtype=np.float64) * weights))
    return (noise / size) ** 0.5 if size > 0.0 else 0.0


def _mean_square(vectors: NDArray) -> NDArray[np.float32]:
    """(V, C, L+1) means over the orders of each degree."""
    first = np.arange(round(vectors.shape[2] ** 0.5)) ** 2
    sums = np.add.reduceat(np.square(vectors, dtype=np.float32), first, axis=2)
    return np.asarray(sums / np.diff(first, append=vectors.shape[2]).astype(np.float32))


# --- Bands -----------------------------------------------------------------------------------------------------------


def mean_over_neighbours(neighbours: NDArray[np.integer], count: int, guides: NDArray | None = None) -> csr_array:
    """(V, V) float32 weights of a receiver and its neighbours: symmetric, and each row sums to one.

    Symmetric, so that what all receivers get between them is kept. The weights are those of Metropolis and Hastings,
    w_ij / (1 + max(Σ_k w_ik, Σ_k w_jk)).
    """
    a, b = np.asarray(neighbours, dtype=np.int64).T
    weights = np.ones(a.size)
    if guides is not None:
        weights = np.exp(-0.5 * np.square(guides[a].astype(np.float64) - guides[b]).sum(axis=1))
    around = np.bincount(a, weights, count) + np.bincount(b, weights, count)
    weights /= 1.0 + np.maximum(around[a], around[b])
    own = 1.0 - np.bincount(a, weights, count) - np.bincount(b, weights, count)
    apart = csr_array((np.r_[weights, weights], (np.r_[a, b], np.r_[b, a])), shape=(count, count))
    return (apart + diags_array(own)).tocsr().astype(np.float32)


def _apply(mean: csr_array, values: NDArray, times: int) -> NDArray[np.float32]:
    for _ in range(times):
        values = mean @ values
    return values


class _Filters(NamedTuple):
    """What divides values into bands, and what that does to noise.

    Attributes
    ----------
    means : tuple of sparse (V, V)
        Of each band.
    products : (B + 1, B + 1, V) float32
        Of the rows of the bands' operators, by which white noise has covariances; the last is what no band takes.
    own : (B + 1, V) float32
        Their diagonals: how much of its own noise a receiver gets.
    """

    means: tuple[csr_array, ...]
    products: NDArray[np.float32]
    own: NDArray[np.float32]

    @classmethod
    def along(cls, neighbours: NDArray[np.integer], count: int, guides: NDArray | None) -> _Filters:
        """Measured by E[(D z)(D' z)] and E[z D z] over random signs z, since the matrices are large."""
        if guides is None:
            means = (mean_over_neighbours(neighbours, count),) * len(BANDS)
        else:
            widths = {width for width, _ in BANDS}
            made = {width: mean_over_neighbours(neighbours, count, guides / width) for width in widths}
            means = tuple(made[width] for width, _ in BANDS)
        size = len(BANDS) + 1
        own, products = np.zeros((size, count), np.float32), np.zeros((size, size, count), np.float32)
        filters = cls(means, products, own)
        rng = np.random.default_rng(0)
        for _ in range(0, _PROBES, _AT_ONCE):
            signs = rng.integers(0, 2, (count, _AT_ONCE)).astype(np.float32) * 2.0 - 1.0
            bands = [band for band, _ in filters.bands(signs)]
            for i, j in zip(*np.triu_indices(size), strict=True):
                products[i, j] += np.einsum("vk,vk->v", bands[i], bands[j]) / _PROBES
            own += np.array([np.einsum("vk,vk->v", signs, band) / _PROBES for band in bands])
        for i, j in zip(*np.triu_indices(size), strict=True):
            products[i, j] = products[j, i] = filters.around(products[i, j])
        return filters

    def bands(self, values: NDArray) -> Iterator[tuple[NDArray, NDArray]]:
        """Of (V, n) values, finest first: each band, and the values that it was taken from; then what is left."""
        for mean, (_, times) in zip(self.means, BANDS, strict=True):
            before, values = values, _apply(mean, values, times)
            yield before - values, before
        yield values, values

    def around(self, values: NDArray) -> NDArray[np.float32]:
        """Means of (V, …) values over the rings that energies are pooled over."""
        return _apply(self.means[0], values, _POOLED)


def _smooth_degree(
    vectors: NDArray[np.float32], variance: NDArray[np.float32], filters: _Filters
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float64]]:
    """One degree, (V, C, 2l+1), of the variance (V, C): smoothed, its expected squared error, and mean gains."""
    count, channels, orders = vectors.shape
    if not variance.any():
        return vectors, variance, np.ones(len(BANDS))
    result, lost = vectors.copy(), np.zeros(count, dtype=np.float32)
    gains = np.ones((len(BANDS) + 1, count), dtype=np.float32)
    bands = zip(range(len(BANDS)), filters.bands(vectors.reshape(count, -1)), filters.bands(variance), strict=False)
    for k, (band, _), (_, around) in bands:
        energy = np.einsum("vk,vk->v", band, band)
        noise = filters.around(orders * filters.products[k, k] * around.sum(axis=1))
        gain = _wiener(np.maximum(filters.around(energy) - noise, 0.0), noise)
        # Once more, with the energy that passed: noise that is taken for signal here or there is not so twice.
        signal = filters.around(gain * gain * energy)
        gain = gains[k] = _wiener(signal, noise)
        band *= (1.0 - gain)[:, None]
        result -= band.reshape(vectors.shape)
        lost += (1.0 - gain) * np.sqrt(signal)  # signals of bands side by side are alike
    spread = filters.around(variance)
    # Gains that differ from place to place would change what all receivers get between them, by a tenth of a percent.
    missing = (vectors - result).sum(axis=0, dtype=np.float64).astype(np.float32)
    result += missing * (spread / np.maximum(spread.sum(axis=0), np.finfo(np.float32).tiny))[:, :, None]
    # Stein's estimate of the error of all receivers.
    change = result - vectors
    squares = np.einsum("vcm,vcm->v", change, change)
    white = orders * variance.sum(axis=1, dtype=np.float64)
    own = np.einsum("kv,kv->v", gains, filters.own)
    error = float((squares + (2.0 * own - 1.0) * white).sum())
    if error >= white.sum():
        return vectors, variance, np.ones(len(BANDS))
    passed = np.einsum("kv,klv,lv->v", gains, filters.products, gains)
    left = passed[:, None] * spread + (lost**2 / (channels * orders))[:, None]
    # Where the error is, is known from gains; how large it is from them, or from that estimate if it says more.
    left *= np.float32(np.clip(error / (orders * left.sum(dtype=np.float64)), 1.0, 2.0))
    return result, left, gains[:-1].mean(axis=1)


def _wiener(signal: NDArray, noise: NDArray) -> NDArray[np.float32]:
    """S / (S + N), and 1 where there is no noise."""
    return np.divide(signal, signal + noise, out=np.ones_like(signal), where=noise > 0.0)


def _check(vectors: NDArray, variance: NDArray, neighbours: NDArray, guides: NDArray | None) -> None:
    """Raise UserError on arrays that do not fit together."""
    if vectors.ndim != 3 or variance.ndim != 3:
        raise UserError(
            f"vectors must be (V, C, (L+1)²) and variance (V, C, L+1), not of shapes {vectors.shape}, {variance.shape}"
        )
    count, channels, size = vectors.shape
    if variance.shape[:2] != (count, channels) or num_coefficients(variance.shape[2] - 1) != size:
        raise UserError(f"variance of shape {variance.shape} does not fit vectors of shape {vectors.shape}")
    if not (np.isfinite(vectors).all() and np.isfinite(variance).all() and variance.min(initial=0.0) >= 0.0):
        raise UserError("vectors and variance must be finite, and variance not negative; leave such receivers out")
    pairs = np.asarray(neighbours)
    integral = np.issubdtype(pairs.dtype, np.integer)
    if not (integral and pairs.ndim == 2 and pairs.shape[1] == 2):
        raise UserError(f"neighbours must be pairs (E, 2) of integers, not {pairs.dtype} of shape {pairs.shape}")
    if pairs.size and (pairs.min() < 0 or pairs.max() >= count):
        raise UserError(f"neighbours must be numbers of the {count} receivers, not {pairs.min()} to {pairs.max()}")
    if guides is not None and (guides.ndim != 2 or len(guides) != count or not np.isfinite(guides).all()):
        raise UserError(f"guides must be ({count}, k) finite numbers, not of shape {guides.shape}")
