"""What errors are measured against at some of the vertices: light that is known, or only its spectrum.

Both measure the error at every bandlimit at once, and take off the noise of their own reference, which is known from
its two independent halves.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from slepian_prt.evaluation.reference import ReferenceVertices, vertex_reference
from slepian_prt.lighting.environment import Environment
from slepian_prt.lighting.projection import project_environment
from slepian_prt.lighting.spectrum import LightPrior
from slepian_prt.sphere.harmonics import degrees, real_sh
from slepian_prt.transport.transfer import LARGEST_BANDLIMIT, PlannedScene

# References per vertex take at most this many samples.
_MOST_SAMPLES = 1 << 15

# Bounces of a reference where interreflection is simulated.
_MANY_BOUNCES = 16


class VertexError(NamedTuple):
    """Squared relative errors at the bandlimits 0, 1, …, L under each light.

    Attributes
    ----------
    squared : (L+1, lights)
        Noise of the reference taken off; never negative.
    standard_error : (L+1, lights)
        Relative standard error of the root of it, because only some vertices were looked at.
    """

    squared: NDArray[np.float64]
    standard_error: NDArray[np.float64]


class ErrorMetric(Protocol):
    @property
    def names(self) -> tuple[str, ...]:
        """Of the lights."""
        ...

    @property
    def vertices(self) -> NDArray[np.int64]:
        """(n,) where errors are measured."""
        ...

    @property
    def noise(self) -> NDArray[np.float64]:
        """(lights,) relative RMS of that of the reference."""
        ...

    def subset(self, rows: slice) -> ErrorMetric:
        """The same at some of the vertices."""
        ...

    def errors(self, vectors: NDArray) -> VertexError:
        """Of transfer vectors (n, channels, (L+1)²) at the vertices, cut at every bandlimit."""
        ...

    def squared_difference(self, first: NDArray, second: NDArray) -> NDArray[np.float64]:
        """(L+1, lights) mean squared differences, cut at every bandlimit, over the mean square of the reference."""
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
    """Radiance at the vertices under maps, by Monte Carlo without a bandlimit."""

    names: tuple[str, ...]
    lighting: tuple[NDArray[np.float64], ...]
    vertices: NDArray[np.int64]
    references: tuple[ReferenceVertices, ...]
    albedo: NDArray[np.float64]

    @classmethod
    def of(
        cls, planned: PlannedScene, environments: Sequence[Environment], vertices: NDArray, noise: float
    ) -> MapMetric:
        """References with at most so much relative noise, if that can be had."""
        view = planned.toward
        bounces = _MANY_BOUNCES if planned.plan.interreflection else 0
        if planned.plan.interreflection and planned.settings.bounces is not None:
            bounces = int(planned.settings.bounces)
        references = tuple(
            vertex_reference(
                planned.scene,
                environment,
                noise=noise,
                largest_samples=_MOST_SAMPLES,
                bounces=bounces,
                view=view,
                seed=1 + int(vertices[0]),
                vertices=vertices,
            )
            for environment in environments
        )
        albedo = np.ones((len(vertices), 3)) if view is not None else planned.scene.mesh.albedo[vertices]
        names = tuple(environment.name for environment in environments)
        lighting = tuple(project_environment(environment, LARGEST_BANDLIMIT) for environment in environments)
        return cls(names, lighting, vertices, references, albedo.astype(np.float64))

    def subset(self, rows: slice) -> MapMetric:
        references = tuple(replace(reference, radiance=reference.radiance[rows]) for reference in self.references)
        return replace(self, vertices=self.vertices[rows], references=references, albedo=self.albedo[rows])

    @property
    def noise(self) -> NDArray[np.float64]:
        return np.array([reference.noise for reference in self.references])

    def errors(self, vectors: NDArray) -> VertexError:
        bandlimit = math.isqrt(vectors.shape[2]) - 1
        squared, deviation = [], []
        for lighting, reference in zip(self.lighting, self.references, strict=True):
            # What the reference sees as black may be inside other geometry, where transfer borrows from neighbours.
            lit = reference.radiance.any(axis=1)
            exact = reference.radiance[lit].astype(np.float64)
            scale = float(np.mean(np.sum(exact**2, axis=1))) if lit.any() else 0.0
            missing, found = -exact, []
            for l in range(bandlimit + 1):
                degree = slice(l * l, (l + 1) ** 2)
                part = np.einsum("ncm,cm->nc", _channels(vectors[lit][:, :, degree]), lighting[:, degree])
                missing = missing + part * self.albedo[lit]
                found.append(np.sum(missing**2, axis=1))
            one = _error(np.array(found), scale, np.full(bandlimit + 1, reference.noise**2))
            squared.append(one.squared[:, 0])
            deviation.append(one.standard_error[:, 0])
        return VertexError(np.stack(squared, axis=1), np.stack(deviation, axis=1))

    def squared_difference(self, first: NDArray, second: NDArray) -> NDArray[np.float64]:
        bandlimit = math.isqrt(first.shape[2]) - 1
        found = np.zeros((bandlimit + 1, len(self.names)))
        for i, (lighting, scale) in enumerate(zip(self.lighting, self.reference_square, strict=True)):
            sums = np.zeros((len(first), 3))
            for l in range(bandlimit + 1):
                degree = slice(l * l, (l + 1) ** 2)
                part = _channels(first[:, :, degree] - second[:, :, degree])
                sums += np.einsum("ncm,cm->nc", part, lighting[:, degree]) * self.albedo
                found[l, i] = float(np.mean(np.sum(sums**2, axis=1))) / scale if scale > 0.0 else 0.0
        return found

    def inner_product(self, first: NDArray, second: NDArray) -> NDArray[np.float64]:
        found = []
        for lighting, scale in zip(self.lighting, self.reference_square, strict=True):
            light = lighting[:, : first.shape[2]]
            a, b = (np.einsum("ncm,cm->nc", _channels(vectors), light) for vectors in (first, second))
            mean = float(np.mean(a * b, axis=0) @ np.mean(self.albedo**2, axis=0))
            found.append(mean / scale if scale > 0.0 else 0.0)
        return np.array(found)

    @cached_property
    def reference_square(self) -> NDArray[np.float64]:
        return np.array([np.mean(np.sum(r.radiance.astype(np.float64) ** 2, axis=1)) for r in self.references])


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
    def _degrees(self) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
        """(n, R+1) weighted squares of the reference's vectors, (R+1,) noise of its mean, and the whole energy."""
        first, second = self.halves
        mean = _by_degree(0.5 * (first + second)) * self.power
        noise = np.mean(_by_degree(0.5 * (first - second)), axis=0) * self.power
        whole = float(np.sum(np.mean(mean, axis=0) - noise)) + self.beyond * float(self.power[-1])
        return mean, noise, whole

    @property
    def noise(self) -> NDArray[np.float64]:
        _, noise, whole = self._degrees
        return np.array([math.sqrt(float(noise.sum()) / whole) if whole > 0.0 else 0.0])

    def errors(self, vectors: NDArray) -> VertexError:
        bandlimit = math.isqrt(vectors.shape[2]) - 1
        reference, noise, whole = self._degrees
        held = min(bandlimit, self.power.size - 1)
        size = (held + 1) ** 2
        off = _by_degree(vectors[:, :, :size] - 0.5 * (self.halves[0] + self.halves[1])[:, :, :size])
        wrong = np.cumsum(off * self.power[: held + 1], axis=1)
        left = reference.sum(axis=1)[:, None] - np.cumsum(reference, axis=1)[:, : held + 1]
        squares = (wrong + left + self.beyond * float(self.power[-1])).T
        squares = np.concatenate([squares, np.repeat(squares[-1:], bandlimit - held, axis=0)])
        return _error(squares, whole, np.full(bandlimit + 1, float(noise.sum()) / whole if whole > 0.0 else 0.0))

    def squared_difference(self, first: NDArray, second: NDArray) -> NDArray[np.float64]:
        _, _, whole = self._degrees
        bandlimit = math.isqrt(first.shape[2]) - 1
        held = min(bandlimit, self.power.size - 1)
        size = (held + 1) ** 2
        off = np.cumsum(np.mean(_by_degree(first[:, :, :size] - second[:, :, :size]), axis=0) * self.power[: held + 1])
        off = np.concatenate([off, np.full(bandlimit - held, off[-1])])
        return off[:, None] / whole if whole > 0.0 else np.zeros((bandlimit + 1, 1))

    def inner_product(self, first: NDArray, second: NDArray) -> NDArray[np.float64]:
        _, _, whole = self._degrees
        size = min(first.shape[2], self.power.size**2)
        products = np.mean(first[:, :, :size].astype(np.float64) * second[:, :, :size], axis=(0, 1))
        by_degree = np.bincount(degrees(math.isqrt(size) - 1), products)
        return np.array([float(self.power[: by_degree.size] @ by_degree) / whole if whole > 0.0 else 0.0])

    @property
    def reference_square(self) -> NDArray[np.float64]:
        return np.array([self._degrees[2]])


def _error(squares: NDArray, scale: float, noise: NDArray) -> VertexError:
    """From (L+1, n) squared errors of single vertices."""
    if scale == 0.0:
        return VertexError(np.zeros((len(squares), 1)), np.zeros((len(squares), 1)))
    mean = squares.mean(axis=1)
    spread = squares.std(axis=1) / np.sqrt(squares.shape[1])
    squared = np.maximum(mean / scale - noise, 0.0)
    deviation = np.where(squared > 0.0, 0.5 * spread / scale / np.maximum(squared, 1e-300), 1.0)
    return VertexError(squared[:, None], np.minimum(deviation, 1.0)[:, None])


def _channels(vectors: NDArray) -> NDArray:
    return np.broadcast_to(vectors, (len(vectors), 3, vectors.shape[2])) if vectors.shape[1] == 1 else vectors


def _by_degree(vectors: NDArray) -> NDArray[np.float64]:
    """(n, L+1) squared norms in each degree, averaged over the channels."""
    squares = np.mean(vectors.astype(np.float64) ** 2, axis=1)
    bandlimit = math.isqrt(squares.shape[1]) - 1
    starts = np.flatnonzero(np.diff(degrees(bandlimit), prepend=-1))
    return np.add.reduceat(squares, starts, axis=1)
