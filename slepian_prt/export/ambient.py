"""What engines have a place for already, as parts of transfer, and what of it each of them keeps.

Each of these is a few numbers of a vertex, and a rule by which engines shade with them. What the rule makes of the
numbers is a transfer vector again: its distance from the true one is what is lost.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.compression.decoder import decode_all, forget
from slepian_prt.compression.prediction import Expectation, by_degree
from slepian_prt.export.kinds import BENT_NORMALS, FIRST_DEGREE, GAMES202, OCCLUSION, SKY_VISIBILITY
from slepian_prt.lighting.spectrum import falling_prior
from slepian_prt.slepian.kernels import cosine_lobe
from slepian_prt.sphere.conventions.layouts import cut_or_filled
from slepian_prt.sphere.harmonics import bandlimit_of, degrees, real_sh
from slepian_prt.sphere.quadrature import sphere_rule

# Values of the harmonics of degree 0, and of degree 1 along its axis.
Y0, Y1 = math.sqrt(1.0 / (4.0 * math.pi)), math.sqrt(3.0 / (4.0 * math.pi))

# Vertices at a time.
_BLOCK = 1 << 13

# The polynomial below: its degree, and what its square over the whole sphere counts. Without that it reaches thousands
# beyond the horizon, where nothing is but noise and what compression lost; with more it is no longer near to 1.
_FADING, _CALM = 8, 1e-3


class Approximation(NamedTuple):
    """What is kept of some transfer vectors.

    Attributes
    ----------
    values : (n, channels, k) float64
        What is written; of bent normals and sky visibility there is one channel.
    vectors : (n, channels, (L+1)²) float64
        What engines make of it.
    """

    values: NDArray[np.float64]
    vectors: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Ambient:
    """What an engine has a place for, of all vertices.

    Attributes
    ----------
    values : (V, channels, k) float32
    occlusion : (V, channels) float32
        Radiance of white vertices under constant light of 1.
    expected : Expectation
        What is lost of transfer, in each degree.
    measured : dict of str to float
        Relative RMS errors of radiance under some lights.
    """

    values: NDArray[np.float32]
    occlusion: NDArray[np.float32]
    expected: Expectation
    measured: dict[str, float]

    def error(self) -> float:
        """Relative RMS error of radiance under light that falls as 1/(l+1)², averaged over its rotations."""
        return self.expected.relative(falling_prior(len(self.expected.lost) - 1).weights ** 2)


def ambient_part(packed: CompressedTransfer, what: str, lights: Mapping[str, NDArray] | None = None) -> Ambient:
    """Reduce transfer to what engines have a place for.

    Parameters
    ----------
    packed : CompressedTransfer
    what : one of `KINDS`, not transfer
    lights : dict of str to (3, (L+1)²), optional
        Under which the loss is measured, beside that to be expected.
    """
    lights = lights or {}
    receivers, decoded = packed.mesh.receivers, packed.coded is not None
    lost, total = np.zeros((2, packed.bandlimit + 1))
    squares = {name: np.zeros(2) for name in lights}
    values, occlusion = [], []
    if decoded:
        decode_all(packed)  # together: far faster than block by block
    for first in range(0, len(receivers), _BLOCK):
        rows = np.arange(first, min(first + _BLOCK, len(receivers)))
        vectors = packed.reconstruct(rows).astype(np.float64)
        kept = RULES[what](vectors, receivers.normals[rows])
        values.append(kept.values.astype(np.float32))
        occlusion.append((vectors[:, :, 0] / Y0).astype(np.float32))
        difference = kept.vectors - vectors
        lost += by_degree(np.einsum("ncm,ncm->m", difference, difference))
        total += by_degree(np.einsum("ncm,ncm->m", vectors, vectors))
        for name, light in lights.items():
            squares[name] += [_squared(difference, light), _squared(vectors, light)]
    if decoded:
        forget(packed)
    measured = {name: math.sqrt(off / all_of_it) if all_of_it else 0.0 for name, (off, all_of_it) in squares.items()}
    return Ambient(np.concatenate(values), np.concatenate(occlusion), Expectation(lost, total), measured)


def _squared(vectors: NDArray, light: NDArray) -> float:
    """Sum of the squared radiance of transfer vectors (n, channels, M), in three colours."""
    return float(
        np.square(np.einsum("ncm,cm->nc", np.broadcast_to(vectors, (len(vectors), *light.shape)), light)).sum()
    )


def keep_occlusion(vectors: NDArray, normals: NDArray) -> Approximation:
    """Radiance under constant light of 1, times the light that the open hemisphere about the normal would send."""
    occlusion = vectors[:, :, :1] / Y0
    return Approximation(occlusion, occlusion * _open(vectors, normals)[:, None])


def keep_bent_normals(vectors: NDArray, normals: NDArray) -> Approximation:
    """Where unblocked light comes from, ∫ V(ω) (n·ω)₊ ω dω over its length, in which engines look up the light.

    That is what occlusion is multiplied with, instead of the light about the normal. Of three channels it is that of
    their mean, and the normal itself where no light comes from.
    """
    toward = _first_degree(vectors.mean(axis=1))[:, 1:]
    length = np.linalg.norm(toward, axis=1, keepdims=True)
    bent = np.where(length > 0.0, toward / np.maximum(length, 1e-300), normals)
    return Approximation(bent[:, None], vectors[:, :, :1] / Y0 * _open(vectors, bent)[:, None])


def keep_sky_visibility(vectors: NDArray, normals: NDArray) -> Approximation:
    """Sky visibility as Unity's probe volumes have it: DC, x, y, z.

    For the visibility V of the sky, DC = ∫ V Y₀ dω and (x, y, z) = 2/3 ∫ V Y₁ ω dω, with Y₀ = √(1/4π), Y₁ = √(3/4π),
    so that Y₀ DC + Y₁ (x, y, z)·n is what a white sky sends to a surface of normal n: with that, light is multiplied
    that the open hemisphere about the normal would send. Unity makes (x, y, z) shorter where that would be negative for
    a normal to the other side, which no surface here has.

    Transfer has V (n·ω)₊, from which V is taken back up to a fading of a few degrees above the horizon.

    References
    ----------
    Unity Technologies, Graphics repository: ``DynamicGISkyOcclusion.urtshader`` ("Layout is DC, x, y, z"; 2/3 is its
    ``radianceToIrradianceFactor``) and ``EvalSHSkyOcclusion`` in ``ProbeVolume.hlsl``, of its core render pipeline.
    """
    moments = visible_moments(vectors.mean(axis=1), normals)
    values = moments * (Y0, *[2.0 / 3.0 * Y1] * 3)
    shade = Y0 * values[:, 0] + Y1 * np.einsum("nd,nd->n", values[:, 1:], normals)
    shaded = shade[:, None] * _open(vectors, normals)
    return Approximation(values[:, None], np.broadcast_to(shaded[:, None], vectors.shape))


def keep_first_degree(vectors: NDArray, _normals: NDArray) -> Approximation:
    """Transfer in degrees 0 and 1: DC, x, y, z, which are multiplied with those of the light in Y₀ and Y₁ ω."""
    kept = np.where(degrees(math.isqrt(vectors.shape[2]) - 1) <= 1, vectors, 0.0)
    return Approximation(_first_degree(vectors), kept)


def keep_second_degree(vectors: NDArray, _normals: NDArray) -> Approximation:
    """Transfer in degrees 0 to 2, of the mean of the channels."""
    values = cut_or_filled(vectors.mean(axis=1, keepdims=True), 2)
    size = vectors.shape[2]
    return Approximation(values, np.broadcast_to(cut_or_filled(values, bandlimit_of(size)), vectors.shape))


Rule = Callable[[NDArray, NDArray], Approximation]
RULES: dict[str, Rule] = {
    OCCLUSION: keep_occlusion,
    BENT_NORMALS: keep_bent_normals,
    SKY_VISIBILITY: keep_sky_visibility,
    FIRST_DEGREE: keep_first_degree,
    GAMES202: keep_second_degree,
}


def _first_degree(vectors: NDArray) -> NDArray[np.float64]:
    """(…, 4) coefficients of Y₀, Y₁ x, Y₁ y, Y₁ z; ours are those of Y₀, -Y₁ y, Y₁ z, -Y₁ x."""
    return np.asarray(vectors[..., [0, 3, 1, 2]] * (1.0, -1.0, -1.0, 1.0))


def _open(vectors: NDArray, axes: NDArray) -> NDArray[np.float64]:
    """(n, M) transfer of the open hemispheres about unit vectors; zero about vectors of zero."""
    bandlimit = math.isqrt(vectors.shape[2]) - 1
    lobe = cosine_lobe(bandlimit)[degrees(bandlimit)]
    is_axis = axes.any(axis=1, keepdims=True)
    return np.asarray(real_sh(bandlimit, np.where(is_axis, axes, (0.0, 0.0, 1.0))) * lobe * is_axis)


def visible_moments(vectors: NDArray, normals: NDArray) -> NDArray[np.float64]:
    """(n, 4) integrals of 1, x, y, z over what is visible of the hemispheres, from transfer (n, M) of unit albedo.

    Transfer is T = V (n·ω)₊ / π. A polynomial p with μ p(μ) ≈ 1 for 0 < μ < 1 turns its moments ∫ T p(n·ω) … dω, which
    are exact in the bandlimit, into those of V, up to a fading toward the horizon.
    """
    bandlimit = math.isqrt(vectors.shape[1]) - 1
    zonal = fading_polynomial(min(bandlimit, _FADING))
    degree = len(zonal) - 1
    # Moments are linear in T: x T has harmonics of one degree more than T.
    times = _times_coordinates(degree)
    is_normal = normals.any(axis=1, keepdims=True)
    weights = real_sh(degree, np.where(is_normal, normals, (0.0, 0.0, 1.0))) * zonal[degrees(degree)] * is_normal
    parts = vectors[:, : times.shape[2]]
    return np.asarray(np.pi * np.einsum("nm,dmk,nk->nd", weights, times, parts, optimize=True))


@cache
def fading_polynomial(degree: int) -> NDArray[np.float64]:
    """(degree,) c_l of p(μ) = Σ c_l (2l+1)/4π P_l(μ), for which μ p(μ) is near to 1 on [0, 1] in least squares.

    Beside that ∫ μ p dμ = 1 and ∫ μ² p dμ = 1/2 over [0, 1], so that moments of an open hemisphere are exact.
    """
    nodes, weights = np.polynomial.legendre.leggauss(degree + 2)
    mu, weights = 0.5 * nodes + 0.5, 0.5 * weights
    basis = mu[:, None] * np.polynomial.legendre.legvander(mu, degree - 1)
    normal = basis.T @ (weights[:, None] * basis) + np.diag(2.0 * _CALM / (2.0 * np.arange(degree) + 1.0))
    constraints = np.stack([weights @ basis, (weights * mu) @ basis])
    system = np.block([[normal, constraints.T], [constraints, np.zeros((2, 2))]])
    solved = np.linalg.solve(system, np.concatenate([weights @ basis, [1.0, 0.5]]))[:degree]
    return np.asarray(solved * 4.0 * np.pi / (2.0 * np.arange(degree) + 1.0))


@cache
def _times_coordinates(degree: int) -> NDArray[np.float64]:
    """(4, (degree+1)², (degree+2)²) harmonics of 1, x, y, z times those of degrees up to degree + 1."""
    directions, weights = sphere_rule(2 * degree + 2)
    given = real_sh(degree + 1, directions)
    wanted = real_sh(degree, directions)
    factors = np.column_stack([np.ones(len(directions)), directions])
    return np.einsum("q,qd,qm,qk->dmk", weights, factors, wanted, given, optimize=True)
