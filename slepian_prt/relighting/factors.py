"""Transfer of each cap as coefficients times functions, with no more functions than the error of the transfer asks for.

Coefficients as the file has them belong to functions that are orthonormal under the light prior. The mean transfer,
which is not in the file, lies among them but for a little, which takes a few functions more.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.compression.decoder import CapCoefficients, decode_all
from slepian_prt.compression.linear_basis import LinearBasis
from slepian_prt.compression.pilot import channel_mixing
from slepian_prt.machine.threads import one_blas_thread
from slepian_prt.relighting.mean_functions import MeanFunctions, shared_half_angle
from slepian_prt.sphere.harmonics import degrees, num_coefficients
from slepian_prt.sphere.rotation import rotate_sh, rotation_to

# Relit are functions that leave out no more than this part of the error of coded transfer.
_LEFT_OUT = 0.01

# Squares of norms below this part of the largest are rounding.
_ROUNDING = 1e-13


@dataclass(frozen=True)
class Factors:
    """One cap: transfer of its vertices ≈ ``coefficients`` times ``functions``.

    Attributes
    ----------
    coefficients : (n, r) float32
    functions : (r, channels, (L+1)²) float32
    """

    coefficients: NDArray[np.float32]
    functions: NDArray[np.float32]

    @property
    def energies(self) -> NDArray[np.float64]:
        """(r,) squared norms of transfer along each function, if those are orthonormal."""
        return np.einsum("nr,nr->r", self.coefficients, self.coefficients, dtype=np.float64)

    def chosen(self, keep: NDArray[np.bool_]) -> Factors:
        """Only those functions."""
        return self if keep.all() else Factors(self.coefficients[:, keep], self.functions[keep])

    def and_also(self, coefficients: NDArray[np.float32], joint: Joint) -> Factors:
        """The sum with ``coefficients`` (n, k) of functions that were joined to orthonormal ``self.functions``.

        The functions that come in are along the principal axes of what they are for.
        """
        added = (coefficients @ joint.outer).astype(np.float64)
        axes = np.linalg.eigh(added.T @ added)[1]
        values = self.coefficients + coefficients @ joint.inner.astype(np.float32)
        rest = np.tensordot(axes.T, joint.rest, 1).astype(np.float32)
        return Factors(
            np.concatenate([values, (added @ axes).astype(np.float32)], axis=1),
            np.concatenate([self.functions, rest]),
        )


@dataclass(frozen=True, eq=False)
class Joint:
    """Some functions (k, channels, (L+1)²) as inner @ functions + outer @ rest, beside orthonormal functions.

    Attributes
    ----------
    inner : (k, r)
        Along the functions there are.
    outer : (k, s)
    rest : (s, channels, (L+1)²)
        Orthonormal, also to them.
    """

    inner: NDArray[np.float64]
    outer: NDArray[np.float64]
    rest: NDArray[np.float64]

    @classmethod
    def of(cls, functions: NDArray[np.float64], more: NDArray[np.float64]) -> Joint:
        """The joint of ``more`` to orthonormal ``functions``."""
        size = math.prod(functions.shape[1:])  # there may be no functions
        rows, others = functions.reshape(-1, size), more.reshape(-1, size)
        inner = others @ rows.T
        rest = others - inner @ rows
        values, vectors = np.linalg.eigh(rest @ rest.T)
        kept = values > _ROUNDING * np.sum(others * others)
        outer = vectors[:, kept] * np.sqrt(values[kept])
        rest = (vectors[:, kept] / np.sqrt(values[kept])).T @ rest
        return cls(inner, outer, rest.reshape(-1, *functions.shape[1:]))


def drop_least(parts: Sequence[Factors], lost: float) -> list[Factors]:
    """Factors of all caps without those of their orthonormal functions that make ``lost`` (relative RMS) of transfer.

    Principal axes of all coefficients would take 1 to 4 % fewer functions, and as long as all else.
    """
    energies = np.concatenate([part.energies for part in parts])
    sizes = np.concatenate([np.full(len(part.functions), len(part.coefficients)) for part in parts])
    # Per number that has to be read: a function of a small cap is worth more than one of a large cap.
    order = np.argsort(energies / np.maximum(sizes, 1), kind="stable")
    keep = energies > 0.0
    keep[order[np.cumsum(energies[order]) <= lost**2 * energies.sum()]] = False
    ends = np.cumsum([len(part.functions) for part in parts])
    return [part.chosen(mine) for part, mine in zip(parts, np.split(keep, ends[:-1]), strict=True)]


def all_factors(packed: CompressedTransfer) -> list[Factors]:
    """The factors of all caps; of coded transfer without functions that hold less than a hundredth of its error."""
    decoded = decode_all(packed)
    maker = _Maker(packed)
    # Threads of BLAS that wait for each other make many small problems slow, by minutes on a busy machine.
    with one_blas_thread():
        parts = [
            maker.of_cap(c, coefficients) if len(coefficients.values) else maker.of_none()
            for c, coefficients in enumerate(decoded)
        ]
        if packed.coded is not None:
            error = packed.predicted_error_under_prior
            parts = drop_least(parts, _LEFT_OUT * (packed.predicted_error if error is None else error))
        return [maker.in_world(c, part) if len(part.functions) else part for c, part in enumerate(parts)]


class _Maker:
    """Makes factors with functions that are orthonormal if weighted by the light prior, in the frame of each cap.

    There most caps have the same functions, so that what is known of them is worked out once.
    """

    def __init__(self, packed: CompressedTransfer) -> None:
        self._packed = packed
        # One channel stands for all three; three are mixed back.
        self._mixing = channel_mixing(packed.channels).astype(np.float64)
        prior = packed.bases[0].weights
        self._weights = np.ones(packed.bandlimit + 1) if prior is None else prior
        self._functions: dict[bytes, NDArray[np.float64]] = {}
        self._means: dict[tuple[int, float], MeanFunctions] = {}
        self._joints: dict[tuple[int, int], Joint] = {}

    def of_none(self) -> Factors:
        """Those of a cap that holds no vertex: no functions."""
        shape = 0, len(self._mixing), num_coefficients(self._packed.bandlimit)
        return Factors(np.zeros((0, 0), np.float32), np.zeros(shape, np.float32))

    def of_cap(self, c: int, coefficients: CapCoefficients) -> Factors:
        """One cap's factors, the mean transfer among them."""
        packed, basis = self._packed, self._packed.bases[c]
        functions, values = self._in_frame(basis), coefficients.values
        if coefficients.axes is not None:
            rows = coefficients.axes @ functions.reshape(len(functions), -1)
            functions = rows.reshape(-1, *functions.shape[1:])
        active = packed.mesh.receivers.active[packed.clusters.members[c]]
        factors = Factors(np.where(active[:, None], values, np.float32(0.0)), functions.astype(np.float32))
        if basis.mean is not None:  # of its own: then there is no common one
            offset = basis.mean.astype(np.float64) * self._weights[degrees(packed.bandlimit)]
            joint = Joint.of(functions, np.einsum("dm,dc->cm", offset, self._mixing)[None])
            return factors.and_also(active[:, None].astype(np.float32), joint)
        if packed.mean is None:
            return factors
        mean, along = self._mean(c, active)
        return factors.and_also(along, self._joint(functions, mean, basis, coefficients.axes is None))

    def in_world(self, c: int, factors: Factors) -> Factors:
        """The same with functions as they are, in the world frame."""
        basis = self._packed.bases[c]
        by_degree = self._weights[degrees(self._packed.bandlimit)].astype(np.float32)
        functions: NDArray[np.float32] = factors.functions / by_degree
        if basis.radial is not None:
            functions = rotate_sh(functions, rotation_to(basis.center))
        return Factors(factors.coefficients, functions)

    def _in_frame(self, basis: LinearBasis) -> NDArray[np.float64]:
        """(K channels, channels, (L+1)²) functions of one basis; those that are not radial in the world frame."""
        parts = (basis.orders, basis.radial) if basis.radial is not None else (basis.dense, np.array(basis.count))
        key = b"|".join(part.tobytes() for part in parts if part is not None)
        if key not in self._functions:
            mixed = np.einsum("km,dc->kdcm", basis.local_functions, self._mixing)
            self._functions[key] = mixed.reshape(-1, len(self._mixing), num_coefficients(basis.bandlimit))
        return self._functions[key]

    def _mean(self, c: int, active: NDArray[np.bool_]) -> tuple[MeanFunctions, NDArray[np.float32]]:
        """Functions, and coefficients (n, k): the mean transfer about each normal that is not zero, where active."""
        packed = self._packed
        assert packed.mean is not None
        lit = np.flatnonzero(active)
        normals = packed.normals[packed.clusters.members[c][lit]] @ rotation_to(packed.bases[c].center)
        lengths = np.linalg.norm(normals, axis=1)
        lit, normals = lit[lengths > 0.0], normals[lengths > 0.0] / lengths[lengths > 0.0, None]
        key = int(packed.clusters.occlusion_classes[c]), shared_half_angle(normals)
        if key not in self._means:
            self._means[key] = MeanFunctions.of_cap(packed.mean.zonal[key[0]] * self._weights, key[1])
        mean = self._means[key]
        along = np.zeros((len(active), len(mean.functions)), dtype=np.float32)
        along[lit] = mean.along(normals)
        return mean, along

    def _joint(self, functions: NDArray[np.float64], mean: MeanFunctions, basis: LinearBasis, shared: bool) -> Joint:
        """The joint of the mean's functions to those of a cap; kept for other caps with the same if they are shared."""
        if basis.radial is None:
            turned, key = rotate_sh(mean.functions, rotation_to(basis.center)), None
        else:
            turned, key = mean.functions, (id(functions), id(mean)) if shared else None
        if key is not None and key in self._joints:
            return self._joints[key]
        joint = Joint.of(functions, np.einsum("km,c->kcm", turned, self._mixing[0]))
        if key is not None:
            self._joints[key] = joint
        return joint
