"""Error of relit radiance at some of the vertices, from their transfer vectors, against a reference of those vertices.

Under maps the reference is Monte Carlo without a bandlimit; under light of which only the spectrum is known, transfer
that was traced with many rays at a high bandlimit. Both measure the error at every bandlimit at once, and may take off
the noise of their own reference, which is known from its two independent halves.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from slepian_prt.evaluation.metrics import relative_square
from slepian_prt.evaluation.reference import ReferenceVertices, path_bounces, vertex_reference
from slepian_prt.lighting.environment import Environment
from slepian_prt.lighting.projection import project_environment
from slepian_prt.lighting.spectrum import LightPrior
from slepian_prt.sphere.harmonics import bandlimit_of, degrees, real_sh
from slepian_prt.transport.planned import PlannedScene
from slepian_prt.transport.settings import LARGEST_BANDLIMIT

# References take at most this many samples per vertex.
_MOST_SAMPLES = 1 << 15

# Bounces of a reference for transfer with as many as matter.
_MANY_BOUNCES = 16


class VertexError(NamedTuple):
    """Squared relative errors at the bandlimits 0, 1, …, L under each light.

    Attributes
    ----------
    squared : (L+1, lights)
        Mean squared difference over the mean square of the reference; never negative.
    standard_error : (L+1, lights)
        Relative standard error of the root of it, because only some vertices are measured; at most one.
    """

    squared: NDArray[np.float64]
    standard_error: NDArray[np.float64]


class ErrorMetric(Protocol):
    @property
    def names(self) -> tuple[str, ...]:
        """Names of the lights."""
        ...

    @property
    def vertices(self) -> NDArray[np.int64]:
        """(n,) where errors are measured."""
        ...

    @property
    def noise(self) -> NDArray[np.float64]:
        """(lights,) relative RMS noise of the reference."""
        ...

    def subset(self, rows: slice) -> ErrorMetric:
        """The same metric at some of its vertices."""
        ...

    def errors(self, vectors: NDArray, *, subtract_noise: bool = True) -> VertexError:
        """Errors of transfer vectors (n, channels, (L+1)²) at the vertices, cut at every bandlimit.

        With ``subtract_noise`` the squared noise of the reference is taken off.
        """
        ...

    def squared_difference(self, first: NDArray, second: NDArray) -> NDArray[np.float64]:
        """(L+1, lights) mean squared differences of the radiance of two sets of vectors (n, channels, (L+1)²) at the
        vertices, cut at every bandlimit, over the mean square of the reference."""
        ...

    def inner_product(self, first: NDArray, second: NDArray) -> NDArray[np.float64]:
        """(lights,) mean products of the radiance of two sets of vectors (n, channels, (L+1)²) at any vertices, over
        the mean square of the reference."""
        ...

    @property
    def reference_square(self) -> NDArray[np.float64]:
        """(lights,) mean square of the reference."""
        ...


@dataclass(frozen=True, eq=False)
class MapMetric:
    """Radiance at the vertices under maps, against Monte Carlo without a bandlimit.

    Vertices that a reference has black are left out of its errors: they may be inside other geometry, where transfer
    is that of neighbours outside.

    Attributes
    ----------
    names : tuple of str
    lighting : tuple of (3, (R+1)²)
        The maps up to a bandlimit R, no lower than that of the vectors that will be measured.
    vertices : (n,)
    references : tuple of ReferenceVertices
        Radiance (n, 3) under each map.
    albedo : (n, 3)
    """

    names: tuple[str, ...]
    lighting: tuple[NDArray[np.float64], ...]
    vertices: NDArray[np.int64]
    references: tuple[ReferenceVertices, ...]
    albedo: NDArray[np.float64]

    @classmethod
    def of(
        cls,
        planned: PlannedScene,
        environments: Sequence[Environment],
        vertices: NDArray,
        noise: float,
        *,
        bandlimit: int = LARGEST_BANDLIMIT,
        bounces: Sequence[int | None] | None = None,
        largest_samples: int = _MOST_SAMPLES,
        seed: int | None = None,
    ) -> MapMetric:
        """Measure references with at most so much relative ``noise``, if ``largest_samples`` per vertex reach it.

        Parameters
        ----------
        bandlimit : int
            Of the lighting.
        bounces : sequence of int or None
            Those of the transfer that will be measured, by default those of the planned scene; None stands for as
            many as matter. The reference has the most of them.
        """
        limits = (planned.settings.bounces,) if bounces is None else bounces
        most = max(_MANY_BOUNCES if limit is None else int(limit) for limit in limits)
        references = tuple(
            vertex_reference(
                planned.scene,
                environment,
                noise=noise,
                largest_samples=largest_samples,
                bounces=path_bounces(most if planned.plan.interreflection else 0, planned.plan.effects),
                view=planned.plan.view,
                seed=1 + int(vertices[0]) if seed is None else seed,
                vertices=vertices,
            )
            for environment in environments
        )
        albedo = np.ones((len(vertices), 3)) if planned.plan.view is not None else planned.scene.mesh.albedo[vertices]
        names = tuple(environment.name for environment in environments)
        lighting = tuple(project_environment(environment, bandlimit) for environment in environments)
        return cls(names, lighting, vertices, references, albedo.astype(np.float64))

    def subset(self, rows: slice) -> MapMetric:
        references = tuple(replace(reference, radiance=reference.radiance[rows]) for reference in self.references)
        return replace(self, vertices=self.vertices[rows], references=references, albedo=self.albedo[rows])

    @property
    def noise(self) -> NDArray[np.float64]:
        return np.array([reference.noise for reference in self.references])

    def errors(self, vectors: NDArray, *, subtract_noise: bool = True) -> VertexError:
        errors = []
        for lighting, reference in zip(self.lighting, self.references, strict=True):
            lit = reference.radiance.any(axis=1)
            exact = reference.radiance[lit].astype(np.float64)
            radiance = _radiance_at_bandlimits(vectors[lit], lighting) * self.albedo[lit]
            squares = np.sum((radiance - exact) ** 2, axis=2)
            errors.append(_vertex_error(squares, _mean_square(exact), reference.noise if subtract_noise else 0.0))
        return VertexError(*(np.stack(parts, axis=1) for parts in zip(*errors, strict=True)))

    def squared_difference(self, first: NDArray, second: NDArray) -> NDArray[np.float64]:
        squares = []
        for lighting, reference in zip(self.lighting, self.references, strict=True):
            radiance = _radiance_at_bandlimits(first - second, lighting) * self.albedo
            mean = np.mean(np.sum(radiance**2, axis=2), axis=1)
            squares.append(_over(mean, _mean_square(reference.radiance)))
        return np.stack(squares, axis=1)

    def inner_product(self, first: NDArray, second: NDArray) -> NDArray[np.float64]:
        products = []
        for lighting, reference in zip(self.lighting, self.references, strict=True):
            light = lighting[:, : first.shape[2]]
            a, b = (np.einsum("ncm,cm->nc", _three_channels(vectors), light) for vectors in (first, second))
            mean = np.mean(a * b, axis=0) @ np.mean(self.albedo**2, axis=0)
            products.append(_over(mean, _mean_square(reference.radiance)))
        return np.array(products)

    @property
    def reference_square(self) -> NDArray[np.float64]:
        return np.array([_mean_square(reference.radiance) for reference in self.references])


@dataclass(frozen=True, eq=False)
class SpectrumMetric:
    """Light of a spectrum, averaged over its rotations, against transfer traced with many rays at a high bandlimit.

    Attributes
    ----------
    name : str
    vertices : (n,)
    power : (R+1,)
        Of the light per harmonic, to the bandlimit R of the reference.
    halves : two arrays (n, channels, (R+1)²)
        Independent of each other.
    beyond : float
        Mean energy of a transfer vector above R, taken to meet the power of R.
    """

    name: str
    vertices: NDArray[np.int64]
    power: NDArray[np.float64]
    halves: tuple[NDArray[np.float32], NDArray[np.float32]]
    beyond: float

    @classmethod
    def of(
        cls, prior: LightPrior, vertices: NDArray, halves: tuple[NDArray, NDArray], normals: NDArray
    ) -> SpectrumMetric:
        """From transfer without interreflection, (n, (R+1)²), traced twice."""
        mean = 0.5 * (halves[0] + halves[1]).astype(np.float64)
        # (1/π) ∫ V (n·ω)₊² dω / π, which degree one tells, is the energy in all degrees.
        whole = (4.0 / 3.0) * np.sum(mean[:, 1:4] * real_sh(1, normals)[:, 1:], axis=1)
        cross = np.sum(halves[0].astype(np.float64) * halves[1], axis=1)
        beyond = max(0.0, float(np.mean(whole - cross)))
        first, second = (half[:, None, :] for half in halves)
        return cls(prior.name, vertices, prior.weights**2, (first, second), beyond)

    def subset(self, rows: slice) -> SpectrumMetric:
        first, second = (half[rows] for half in self.halves)
        return replace(self, vertices=self.vertices[rows], halves=(first, second))

    @property
    def names(self) -> tuple[str, ...]:
        return (f"light of {self.name}",)

    @cached_property
    def _energies(self) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
        """(n, R+1) weighted squares of the reference's vectors, (R+1,) noise of its mean, and the whole energy."""
        first, second = self.halves
        mean = _squares_by_degree(0.5 * (first + second)) * self.power
        noise = np.mean(_squares_by_degree(0.5 * (first - second)), axis=0) * self.power
        whole = float(np.sum(np.mean(mean, axis=0) - noise)) + self.beyond * float(self.power[-1])
        return mean, noise, whole

    @property
    def noise(self) -> NDArray[np.float64]:
        _, noise, whole = self._energies
        return np.sqrt(_over(noise.sum(keepdims=True), whole))

    def errors(self, vectors: NDArray, *, subtract_noise: bool = True) -> VertexError:
        bandlimit = bandlimit_of(vectors.shape[2])
        reference, _, whole = self._energies
        common = min(bandlimit, self.power.size - 1)
        size = (common + 1) ** 2
        difference = vectors[:, :, :size] - 0.5 * (self.halves[0] + self.halves[1])[:, :, :size]
        within = np.cumsum(_squares_by_degree(difference) * self.power[: common + 1], axis=1)
        above = reference.sum(axis=1)[:, None] - np.cumsum(reference, axis=1)[:, : common + 1]
        squares = (within + above + self.beyond * float(self.power[-1])).T
        squares = np.concatenate([squares, np.repeat(squares[-1:], bandlimit - common, axis=0)])
        error = _vertex_error(squares, whole, float(self.noise[0]) if subtract_noise else 0.0)
        return VertexError(*(part[:, None] for part in error))

    def squared_difference(self, first: NDArray, second: NDArray) -> NDArray[np.float64]:
        _, _, whole = self._energies
        bandlimit = bandlimit_of(first.shape[2])
        common = min(bandlimit, self.power.size - 1)
        size = (common + 1) ** 2
        squares = np.mean(_squares_by_degree(first[:, :, :size] - second[:, :, :size]), axis=0)
        squares = np.cumsum(squares * self.power[: common + 1])
        squares = np.concatenate([squares, np.full(bandlimit - common, squares[-1])])
        return _over(squares[:, None], whole)

    def inner_product(self, first: NDArray, second: NDArray) -> NDArray[np.float64]:
        _, _, whole = self._energies
        size = min(first.shape[2], self.power.size**2)
        products = np.mean(first[:, :, :size].astype(np.float64) * second[:, :, :size], axis=(0, 1))
        by_degree = np.bincount(degrees(bandlimit_of(size)), products)
        return _over(np.array([self.power[: by_degree.size] @ by_degree]), whole)

    @property
    def reference_square(self) -> NDArray[np.float64]:
        return np.array([self._energies[2]])


def _vertex_error(squares: NDArray, reference: float, noise: float) -> VertexError:
    """From (L+1, n) squared errors of single vertices, under one light: two arrays (L+1,)."""
    if reference <= 0.0:
        return VertexError(np.zeros(len(squares)), np.zeros(len(squares)))
    squared = relative_square(squares.mean(axis=1), reference, noise)
    spread = squares.std(axis=1) / math.sqrt(squares.shape[1]) / reference
    standard_error = np.where(squared > 0.0, 0.5 * spread / np.maximum(squared, 1e-300), 1.0)
    return VertexError(squared, np.minimum(standard_error, 1.0))


def _radiance_at_bandlimits(vectors: NDArray, lighting: NDArray) -> NDArray[np.float64]:
    """(L+1, n, 3) radiance of vectors (n, channels, (L+1)²) for unit albedo, cut at the bandlimits 0, 1, …, L."""
    bandlimit = bandlimit_of(vectors.shape[2])
    vectors = _three_channels(vectors)
    blocks = [slice(l * l, (l + 1) ** 2) for l in range(bandlimit + 1)]
    return np.cumsum([np.einsum("ncm,cm->nc", vectors[:, :, m], lighting[:, m]) for m in blocks], axis=0)


def _three_channels(vectors: NDArray) -> NDArray:
    return np.broadcast_to(vectors, (len(vectors), 3, vectors.shape[2])) if vectors.shape[1] == 1 else vectors


def _mean_square(radiance: NDArray) -> float:
    """Mean of squared norms of (n, 3), zero of none."""
    return float(np.mean(np.sum(radiance.astype(np.float64) ** 2, axis=1))) if len(radiance) else 0.0


def _over(values: NDArray, reference: float) -> NDArray[np.float64]:
    """Values over that of the reference; zero where nothing is lit."""
    return np.asarray(values / reference if reference > 0.0 else np.zeros_like(values))


def _squares_by_degree(vectors: NDArray) -> NDArray[np.float64]:
    """(n, L+1) squared norms in each degree, averaged over the channels."""
    squares = np.mean(vectors.astype(np.float64) ** 2, axis=1)
    bandlimit = bandlimit_of(squares.shape[1])
    starts = np.flatnonzero(np.diff(degrees(bandlimit), prepend=-1))
    return np.add.reduceat(squares, starts, axis=1)
