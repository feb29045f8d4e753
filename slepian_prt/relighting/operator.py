"""Compressed transfer as the matrix that lighting is multiplied with, kept in the factors it is compressed to.

Within a cap, T ≈ C F with few functions F and coefficients C, so that radiance is C (F e): F e is small, and what takes
time is to read C once. Its speed is that of the memory.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from slepian_prt.compression.bases import shared_half_angle
from slepian_prt.compression.clustering import enclose_clusters
from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.compression.decoder import CapCoefficients, decode_all, forget
from slepian_prt.compression.pilot import MeanTransfer, channel_mixing
from slepian_prt.slepian.concentration import cap_basis, scatter_radial
from slepian_prt.sphere.caps import Cap
from slepian_prt.sphere.harmonics import degrees, num_coefficients
from slepian_prt.sphere.rotation import rotate_sh, rotation_to

# Relit are functions that leave out no more than this part of the error of coded transfer.
_LEFT_OUT = 0.01

# The mean transfer of a cap is held by as many functions as leave out less than this part of it.
_MEAN_LEFT_OUT = 1e-5

# From so many functions, and for one light, products of a matrix that is stored by columns with each of three vectors
# are up to twice as fast as one with all three (OpenBLAS, measured).
_LONG = 100


@dataclass(frozen=True)
class Factors:
    """One cap: transfer of its vertices ≈ ``coefficients`` times ``functions``.

    Attributes
    ----------
    coefficients : (n, r) float32
    functions : (r, channels, (L+1)²) float64
    """

    coefficients: NDArray[np.float32]
    functions: NDArray[np.float64]

    def orthonormal(self, weights: NDArray[np.float64]) -> tuple[NDArray[np.float64], Factors]:
        """The same with functions that are orthonormal if weighted, the most important first, and each one's energy.

        ``weights`` ((L+1)²,) are those of a light prior.
        """
        rows = (self.functions * weights).reshape(len(self.functions), -1)
        # Dependent functions are common: the mean of a cap mostly lies among the functions of its basis.
        values, vectors = np.linalg.eigh(rows @ rows.T)
        kept = values > 1e-12 * values[-1]
        mixed = vectors[:, kept] * np.sqrt(values[kept])
        gram = self.coefficients.T.astype(np.float64) @ self.coefficients
        energies, axes = np.linalg.eigh(mixed.T @ gram @ mixed)
        axes = axes[:, ::-1]
        functions = axes.T @ (vectors[:, kept] / np.sqrt(values[kept])).T @ rows
        coefficients = self.coefficients @ (mixed @ axes).astype(np.float32)
        functions = functions.reshape(-1, *self.functions.shape[1:]) / weights
        return np.maximum(energies[::-1], 0.0), Factors(coefficients, functions)

    def first(self, count: int) -> Factors:
        """Only the first ``count`` functions."""
        return Factors(np.ascontiguousarray(self.coefficients[:, :count]), self.functions[:count])


def drop_least(parts: Sequence[Factors], weights: NDArray[np.float64], lost: float) -> list[Factors]:
    """Factors of all caps with as few functions as leave out ``lost`` (relative RMS) of the weighted transfer."""
    # Threads of BLAS that wait for each other make many small problems slow, by minutes on a busy machine.
    with threadpool_limits(1, "blas"):
        made = [part.orthonormal(weights) for part in parts]
    energies = np.concatenate([energy for energy, _ in made])
    sizes = np.concatenate([np.full(energy.size, len(part.coefficients)) for energy, part in made])
    # Per number that has to be read: a function of a small cap is worth more than one of a large cap.
    order = np.argsort(energies / np.maximum(sizes, 1), kind="stable")
    dropped = order[np.cumsum(energies[order]) <= lost**2 * energies.sum()]
    keep = np.ones(energies.size, dtype=bool)
    keep[dropped] = False
    ends = np.cumsum([energy.size for energy, _ in made])
    counts = [int(part.sum()) for part in np.split(keep, ends[:-1])]
    return [part.first(count) for (_, part), count in zip(made, counts, strict=True)]


class TransferOperator:
    """Radiance from lighting, and gradients of lighting from those of radiance.

    Parameters
    ----------
    parts : Factors of each cap
    members : vertices of each cap
    """

    def __init__(self, parts: Sequence[Factors], members: Sequence[NDArray]) -> None:
        self._blocks = [
            np.asarray(part.coefficients, order="F" if len(part.functions) >= _LONG else "C") for part in parts
        ]
        self._functions = np.concatenate([part.functions for part in parts]).astype(np.float32)
        self._ranks = np.concatenate([[0], np.cumsum([part.functions.shape[0] for part in parts])])
        self._members = list(members)

    @property
    def size(self) -> int:
        """Numbers that are read for each light: coefficients and functions."""
        return sum(block.size for block in self._blocks) + self._functions.size

    def apply(self, lighting: NDArray) -> NDArray[np.float32]:
        """(B, V, 3) radiance for unit albedo under B lightings (B, 3, (L+1)²)."""
        count = len(lighting)
        lit = self._lit(lighting)
        # Rows of whole 16 bytes go to their vertices at the speed of a copy; others take several times as long.
        width = -(-3 * count // 4) * 4
        lit = np.pad(lit, ((0, 0), (0, width - 3 * count)))
        rows = np.empty((sum(members.size for members in self._members), width), dtype=np.float32)
        wide = rows.view(np.complex128).reshape(len(rows), *(() if width == 4 else (width // 4,)))
        for c, (block, members) in enumerate(zip(self._blocks, self._members, strict=True)):
            product = _product(block, lit[self._ranks[c] : self._ranks[c + 1]], 3 * count)
            wide[members] = product.view(np.complex128).reshape(len(product), *wide.shape[1:])
        return np.moveaxis(rows[:, : 3 * count].reshape(-1, count, 3), 1, 0)

    def adjoint(self, gradient: NDArray) -> NDArray[np.float64]:
        """(B, 3, (L+1)²) from gradients (B, V, 3) of radiance: the transpose of `apply`."""
        count = len(gradient)
        given = np.moveaxis(np.asarray(gradient, dtype=np.float32), 0, 1).reshape(-1, 3 * count)
        lit = np.empty((int(self._ranks[-1]), 3 * count), dtype=np.float32)
        for c, (block, members) in enumerate(zip(self._blocks, self._members, strict=True)):
            lit[self._ranks[c] : self._ranks[c + 1]] = block.T @ given[members]
        by_light = lit.reshape(-1, count, 3).astype(np.float64)
        channels, size = self._functions.shape[1:]
        result = np.empty((count, 3, size))
        for c in range(3):
            result[:, c] = by_light[:, :, c].T @ self._functions[:, c if channels == 3 else 0]
        return result

    def _lit(self, lighting: NDArray) -> NDArray[np.float32]:
        """(all functions, 3 B): what each function makes of each light in each colour."""
        lights = np.asarray(lighting, dtype=np.float32)
        channels, size = self._functions.shape[1:]
        if channels == 1:
            return self._functions[:, 0] @ lights.reshape(-1, size).T
        lit = np.empty((len(self._functions), len(lights), 3), dtype=np.float32)
        for c in range(3):
            lit[:, :, c] = self._functions[:, c] @ lights[:, c].T
        return lit.reshape(len(self._functions), -1)


def _product(block: NDArray[np.float32], lit: NDArray[np.float32], columns: int) -> NDArray[np.float32]:
    """(n, r) times (r, k), of which only the first ``columns`` matter."""
    if block.shape[1] < _LONG or columns > 3:
        return np.asarray(block @ lit)
    product = np.empty((len(block), lit.shape[1]), dtype=np.float32)
    for column in range(columns):
        product[:, column] = block @ np.ascontiguousarray(lit[:, column])
    return product


# --- From compressed transfer ----------------------------------------------------------------------------------------


def transfer_operator(packed: CompressedTransfer) -> TransferOperator:
    """What lighting is multiplied with for unit albedo; made at the first use, kept as long as the transfer is.

    Of coded transfer, functions are left out that hold less than a hundredth of its error.
    """
    known = _operators.get(packed)
    if known is None:
        known = _operators[packed] = TransferOperator(_all_factors(packed), packed.clusters.members)
        forget(packed)  # what was decoded is as large as what was made of it
    return known


_operators: WeakKeyDictionary[CompressedTransfer, TransferOperator] = WeakKeyDictionary()


def _all_factors(packed: CompressedTransfer) -> list[Factors]:
    mean = None if packed.mean is None else _MeanFunctions(packed, packed.mean)
    parts = [_factors(packed, c, coefficients, mean) for c, coefficients in enumerate(decode_all(packed))]
    if packed.coded is None:
        return parts
    prior, error = packed.bases[0].weights, packed.predicted_error_under_prior
    weights = np.ones(num_coefficients(packed.bandlimit)) if prior is None else prior[degrees(packed.bandlimit)]
    return drop_least(parts, weights, _LEFT_OUT * (packed.predicted_error if error is None else error))


def _factors(packed: CompressedTransfer, c: int, coefficients: CapCoefficients, mean: _MeanFunctions | None) -> Factors:
    """One cap's coefficients and the functions they belong to, the mean transfer among them."""
    basis, size, channels = packed.bases[c], num_coefficients(packed.bandlimit), packed.channels
    # One channel stands for all three; three are mixed back.
    mixing = channel_mixing(channels).astype(np.float64)
    functions = np.einsum("km,dc->kdcm", basis.synthesis, mixing).reshape(-1, channels * size)
    if coefficients.axes is not None:
        functions = coefficients.axes @ functions
    columns = [coefficients.values]
    if basis.mean is not None:
        offset = np.einsum("dm,dc->cm", basis.mean.astype(np.float64), mixing).reshape(1, -1)
        functions = np.concatenate([functions, offset])
        columns.append(np.ones((len(coefficients.values), 1), dtype=np.float32))
    if mean is not None:
        model, along = mean.of_cap(c)
        functions = np.concatenate([functions, np.einsum("km,c->kcm", model, mixing[0]).reshape(len(model), -1)])
        columns.append(along)
    values = np.concatenate(columns, axis=1)
    values[~packed.mesh.receivers.active[packed.clusters.members[c]]] = 0.0
    return Factors(values, functions.reshape(-1, channels, size))


class _MeanFunctions:
    """The mean transfer of each cap as few functions.

    R_n t̄ over a cap of normals lies in the span of what concentrates the kernel t̄ on it.
    """

    def __init__(self, packed: CompressedTransfer, mean: MeanTransfer) -> None:
        self._packed, self._mean = packed, mean
        self._about_pole: dict[tuple[int, float], NDArray[np.float64]] = {}  # by occlusion class and half-angle

    def of_cap(self, c: int) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
        """Functions (k, (L+1)²) and coefficients (n, k) of them."""
        clusters, normals = self._packed.clusters, self._packed.normals
        members, occlusion_class, cap = clusters.members[c], int(clusters.occlusion_classes[c]), self._caps[c]
        functions = self._functions(occlusion_class, shared_half_angle(cap.half_angle))
        model = rotate_sh(functions, rotation_to(cap.center))
        along = np.empty((members.size, len(model)), dtype=np.float32)
        for begin in range(0, members.size, 8192):
            block = slice(begin, begin + 8192)
            vectors = self._mean.vectors(normals[members[block]], occlusion_class)
            along[block] = vectors @ model.T.astype(np.float32)
        return model, along

    def _functions(self, occlusion_class: int, half_angle: float) -> NDArray[np.float64]:
        """Functions about the pole."""
        key = occlusion_class, half_angle
        if key not in self._about_pole:
            kernel = self._mean.zonal[occlusion_class].astype(np.float64)
            basis = cap_basis(self._packed.bandlimit, half_angle, kernel=kernel)
            left = np.cumsum(basis.eigenvalues[::-1])[::-1]
            count = max(1, int(np.sum(left > _MEAN_LEFT_OUT**2 * left[0])))
            self._about_pole[key] = scatter_radial(basis.radial[:count], basis.orders[:count])
        return self._about_pole[key]

    @cached_property
    def _caps(self) -> tuple[Cap, ...]:
        """Caps of the clusters' normals; those of the clusters only if normals are what was grouped."""
        clusters = self._packed.clusters
        if clusters.sites is not None:
            return clusters.caps
        return enclose_clusters(clusters.index, len(clusters.caps), self._packed.normals).caps
