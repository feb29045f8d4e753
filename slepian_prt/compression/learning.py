"""What is decided before the vectors are there: candidates for the bases of all caps, from a pilot."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.bases import Candidate, Frame, Problem, candidates
from slepian_prt.compression.clustering import Clusters, frames_of, spread
from slepian_prt.compression.grouping import Grouping
from slepian_prt.compression.linear_basis import LinearBasis
from slepian_prt.compression.pilot import PilotStatistics, decorrelate, learn, pilot_vertices
from slepian_prt.compression.principal_components import pca_candidates
from slepian_prt.compression.settings import CompressionSettings
from slepian_prt.machine.threads import one_blas_thread
from slepian_prt.scene.receivers import Receivers


@dataclass(frozen=True, eq=False)
class LearnedBases:
    """Candidates for the bases of all caps.

    Attributes
    ----------
    settings : CompressionSettings
    receivers : Receivers
    grouping : Grouping
    bandlimit, channels, seed : int
    candidates : tuple of Candidate
        One per cap.
    pilot : PilotStatistics or None
        What they were learnt from; None for bases that are made from all vectors.
    widest : dict
        The widest bases so far, by how they are kept: narrower ones are their first functions. A memo.
    """

    settings: CompressionSettings
    receivers: Receivers
    grouping: Grouping
    bandlimit: int
    channels: int
    seed: int
    candidates: tuple[Candidate, ...]
    pilot: PilotStatistics | None
    widest: dict[Any, tuple[LinearBasis, ...]] = field(default_factory=dict, repr=False)

    @property
    def clusters(self) -> Clusters:
        return self.grouping.clusters

    @property
    def weights(self) -> NDArray[np.float64] | None:
        """(L+1,) of the light prior."""
        prior = self.settings.light_prior
        return None if prior is None else prior.weights

    @property
    def power(self) -> NDArray[np.float64]:
        """(L+1,) of light that errors count under, ones without a prior."""
        return np.ones(self.bandlimit + 1) if self.weights is None else self.weights**2

    @cached_property
    def normals(self) -> NDArray[np.float64]:
        """(V, 3) as the file will hold them."""
        return self.receivers.normals.astype(np.float32).astype(np.float64)

    def with_tolerance(self, tolerance: float) -> LearnedBases:
        """The same for another tolerance."""
        return replace(self, settings=replace(self.settings, tolerance=tolerance))

    def without_candidates(self) -> LearnedBases:
        """What projecting and coding need, once the bases are chosen."""
        return replace(self, candidates=(), widest={})

    def add_mean(self, vectors: NDArray, vertices: NDArray, sign: float = 1.0) -> None:
        """Add what the normals alone tell of some vertices to their vectors (n, channels, (L+1)²), in place."""
        if self.pilot is None or self.pilot.mean is None:
            return
        classes = self.clusters.occlusion_classes[self.clusters.index[vertices]]
        for number in np.unique(classes):
            rows = classes == number
            vectors[rows, 0] += sign * self.pilot.mean.vectors(self.normals[vertices[rows]], int(number))


def learn_bases(
    settings: CompressionSettings,
    receivers: Receivers,
    grouping: Grouping,
    bandlimit: int,
    seed: int,
    vectors: NDArray,
    *,
    toward_view: bool = False,
) -> LearnedBases:
    """Candidates from a pilot.

    Parameters
    ----------
    settings : CompressionSettings
    receivers : Receivers
    grouping : Grouping
    bandlimit, seed : int
    vectors : (n, channels, (L+1)²)
        Of the vertices that `pilot_of` names.
    toward_view : bool
        Whether they are transfer toward a camera, of which normals tell little.
    """
    vertices = pilot_of(grouping, seed)
    coded = settings.resolved_coding == "coded"
    # The decoder knows the normals, and adds what they tell again.
    normals = None if toward_view or not coded else receivers.normals.astype(np.float32).astype(np.float64)
    with one_blas_thread():
        pilot = learn(grouping.clusters, grouping.axes, vertices, decorrelate(vectors), normals)
        weights = None if settings.light_prior is None else settings.light_prior.weights
        problem = Problem(bandlimit, _frames(settings, grouping), pilot, weights)
        name = "sh" if settings.basis == "none" else settings.basis
        found = tuple(candidates(name, problem))
    return LearnedBases(settings, receivers, grouping, bandlimit, vectors.shape[1], seed, found, pilot)


def pilot_of(grouping: Grouping, seed: int) -> NDArray[np.int64]:
    """The vertices that bases are learnt from."""
    return pilot_vertices(grouping.clusters, grouping.axes, seed)


def fit_bases(
    settings: CompressionSettings, receivers: Receivers, grouping: Grouping, bandlimit: int, seed: int, vectors: NDArray
) -> LearnedBases:
    """Candidates from all vectors (V, channels, (L+1)²), for clustered PCA."""
    found = tuple(pca_candidates(bandlimit, grouping.clusters, vectors))
    return LearnedBases(settings, receivers, grouping, bandlimit, vectors.shape[1], seed, found, None)


def _frames(settings: CompressionSettings, grouping: Grouping) -> tuple[Frame, ...]:
    """Where the functions of each cap stand."""
    clusters = grouping.clusters
    shared = settings.resolved_coding == "coded" or bool(settings.refine)
    centers = frames_of(clusters) if shared else [cap.center for cap in clusters.caps]
    spreads = [spread(c, grouping.axes[members]) for c, members in zip(centers, clusters.members, strict=True)]
    half_angles = [cap.half_angle for cap in clusters.caps]
    if shared:
        # One set of functions for all caps: it is stored once, and what it does not fit costs little.
        half_angles = [float(np.average(half_angles, weights=clusters.sizes))] * len(centers)
        spreads = [float(np.average(spreads, weights=clusters.sizes))] * len(centers)
    return tuple(map(Frame, centers, half_angles, spreads, clusters.occlusion_classes.tolist()))
