"""What compression costs and loses, from coding some of the caps."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from slepian_prt.accuracy.trials import ToleranceTrial
from slepian_prt.accuracy.tuning import TUNING, SearchTuning
from slepian_prt.compression.checkpoint import MemoryStore
from slepian_prt.compression.clustering import Clusters
from slepian_prt.compression.learning import LearnedBases
from slepian_prt.compression.projection import Projection, choose_projection, widen
from slepian_prt.compression.trial import CodingTrial, try_caps
from slepian_prt.evaluation.vertex_error import ErrorMetric, MapMetric, SpectrumMetric
from slepian_prt.scene.receivers import morton
from slepian_prt.sphere.harmonics import num_coefficients
from slepian_prt.transport.estimator import TransferBlock


@dataclass(frozen=True)
class CapParts:
    """Neighbouring vertices of some of the caps.

    Attributes
    ----------
    caps : list of int
        Those that are tried.
    members : list of (n,)
        Of all caps, thinned where they are tried.
    """

    caps: list[int]
    members: list[NDArray[np.int64]]

    @property
    def vertices(self) -> NDArray[np.int64]:
        """Of the caps that are tried, ascending."""
        return np.sort(np.concatenate([self.members[c] for c in self.caps]))


def draw_caps(clusters: Clusters, positions: NDArray, seed: int, tuning: SearchTuning = TUNING) -> CapParts:
    """Caps at random, with no more vertices than are tried, which are near each other."""
    caps = np.random.default_rng(seed).permutation(np.flatnonzero(clusters.sizes))[: tuning.tried_caps].tolist()
    members = list(clusters.members)
    for c in caps:
        along = members[c][np.argsort(morton(positions[members[c]]), kind="stable")]
        begin = max(0, (along.size - tuning.vertices_of_cap) // 2)
        members[c] = np.sort(along[begin : begin + tuning.vertices_of_cap])
    return CapParts(caps, members)


@dataclass(frozen=True, eq=False)
class CodingPilot:
    """What compression is tried on.

    Attributes
    ----------
    learned : LearnedBases
    parts : CapParts
    vectors : (n, channels, (L+1)²)
        Transfer at the vertices of the parts.
    transport_error : (n, 1, (R+1)²) or None
        The same less transport of other rays and of more degrees, whose noise is independent; None if there is none.
    metric : ErrorMetric
    tuning : SearchTuning
    """

    learned: LearnedBases
    parts: CapParts
    vectors: NDArray[np.float32]
    transport_error: NDArray[np.float32] | None
    metric: ErrorMetric
    tuning: SearchTuning = TUNING

    def fit_tolerance(self, allowance: NDArray) -> ToleranceTrial:
        """The coarsest tolerance that adds at most so much, (lights,), to the squared relative error of transport."""
        tuning, (finest, coarsest) = self.tuning, (self.tuning.finest_tolerance, self.tuning.coarsest_tolerance)
        # The tolerance is about the error under light of such a spectrum, and what it adds is less.
        tolerance = tuning.usual_tolerance * float(np.sqrt(np.min(allowance)))
        power, before = 1.0, None
        for _ in range(tuning.tolerance_trials):
            tolerance = min(max(tolerance, finest), coarsest)
            trial = self.try_tolerance(tolerance)
            room = tuning.room_used * math.sqrt(float(np.min(allowance / np.maximum(trial.squared, 1e-300))))
            if before is not None and before.tolerance != tolerance:
                power = _exponent(before, trial, tuning)
            change = room ** (1.0 / power)
            if (tolerance >= coarsest and change >= 1.0) or (tolerance <= finest and change <= 1.0):
                return trial
            if 1.0 / tuning.close_tolerance <= change <= tuning.close_tolerance:
                break
            least, most = tuning.tolerance_steps
            before, tolerance = trial, tolerance * min(max(change, least), most)
        # Near enough to know what another tolerance gives without trying it.
        change = min(max(change, 1.0 / tuning.close_tolerance), tuning.close_tolerance)
        return replace(
            trial,
            learned=trial.learned.with_tolerance(trial.tolerance * change),
            warm_start=trial.warm_start.scaled(change),
            squared=trial.squared * change ** (2.0 * power),
        )

    def try_tolerance(self, tolerance: float) -> ToleranceTrial:
        """What one tolerance costs and adds."""
        begin = time.perf_counter()
        vertices = self.parts.vertices
        traced = TransferBlock(vertices, self.vectors, np.zeros(vertices.size, dtype=np.float32), 0)
        projection: Projection | None = choose_projection(self.learned.with_tolerance(tolerance))
        while projection is not None:
            store = MemoryStore()
            store.add(0, projection.block(traced))
            projected = time.perf_counter() - begin
            blocks = replace(projection.caps(store), members=self.parts.members)
            used, projection = projection, widen(projection, blocks)
        coding = try_caps(used, blocks, self.parts.caps)
        count = len(self.learned.receivers)
        seconds = self.tuning.projection_passes * projected + coding.reading + coding.decoding
        seconds += self.tuning.coding_passes * coding.coding
        return ToleranceTrial(
            used.learned,
            coding.warm_start,
            self._added_error(coding),
            coding.bytes_per_vertex + used.overhead / count,
            seconds * count / vertices.size,
        )

    def _added_error(self, coding: CodingTrial) -> NDArray[np.float64]:
        """(lights,) what coding adds to the squared error of transport.

        That is less than its own square: what is rounded away is noise of few rays in part, and is alike to what the
        bandlimit leaves out. So the product of both errors is negative. It shows in the product with the difference
        from transport of other rays and of more degrees.
        """
        own_square = expected_error(self.metric, coding)
        if self.transport_error is None:
            return own_square
        vertices = self.parts.vertices
        difference = np.zeros_like(self.transport_error)
        for c, coefficients in zip(self.parts.caps, coding.decoded, strict=True):
            members = self.parts.members[c]
            rows = np.searchsorted(vertices, members)
            vectors = coding.projection.reconstruct(c, members, coefficients)
            difference[rows, :, : vectors.shape[2]] = vectors - self.vectors[rows]
        own = self.metric.inner_product(difference, difference)
        both = self.metric.inner_product(difference, self.transport_error)
        added = np.clip(1.0 + 2.0 * both / np.maximum(own, 1e-300), self.tuning.least_added, 1.0)
        return np.asarray(own_square * added)


def expected_error(metric: ErrorMetric, coding: CodingTrial) -> NDArray[np.float64]:
    """(lights,) squared relative errors that compression is expected to make, from coding some caps."""
    lost = coding.expected.lost
    if isinstance(metric, MapMetric):
        size, albedo_square = num_coefficients(lost.size - 1), np.mean(metric.albedo**2, axis=0)
        squares = [float(coding.error_under(light[:, :size]) @ albedo_square) for light in metric.lighting]
    else:
        assert isinstance(metric, SpectrumMetric)
        common = min(lost.size, metric.power.size)
        squares = [float(metric.power[:common] @ lost[:common])]
    reference = metric.reference_square
    return np.where(reference > 0.0, np.array(squares) / np.maximum(reference, 1e-300), 0.0)


def _exponent(before: ToleranceTrial, after: ToleranceTrial, tuning: SearchTuning) -> float:
    """Of the law by which errors grow with the tolerance."""
    growth = 0.5 * math.log(max(np.max(after.squared / np.maximum(before.squared, 1e-300)), 1e-300))
    least, most = tuning.tolerance_exponents
    return min(max(growth / math.log(after.tolerance / before.tolerance), least), most)
