"""What compression costs and loses, from coding some of the caps."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from slepian_prt.accuracy.transport_pilot import TransportTrial
from slepian_prt.compression.checkpoint import MemoryStore
from slepian_prt.compression.clustering import Clusters
from slepian_prt.compression.encoder import Encoder, Trial, WarmStart
from slepian_prt.compression.grouping import Grouping
from slepian_prt.compression.pilot import pilot_vertices
from slepian_prt.compression.settings import CompressionSettings
from slepian_prt.evaluation.vertex_error import ErrorMetric
from slepian_prt.lighting.spectrum import LightPrior
from slepian_prt.scene.receivers import morton
from slepian_prt.transport.planned import PlannedScene

# Caps that are coded on trial, and so many neighbouring vertices of each at most: caps differ more from each other than
# within.
_TRIED, _OF_EACH = 24, 250

# Transport beside it reaches this degree, for the part of its error that is the bandlimit's.
_BESIDE = 30

# How long all caps take until the step is right, over once with a choice of axes; small parts of caps take longer.
_PASSES = 0.8

# A tolerance that is off by more than this factor is tried again; one that is less off is changed by a little less.
_CLOSE = 1.35
_USUAL = 1.35
_SAFE = 0.98
_TRIALS = 4
_FINEST, _COARSEST = 1e-5, 0.9

# Coding is not counted on to mend more than it spoils.
_LEAST_ADDED = 0.1

Prior = Callable[[int], LightPrior | None]


@dataclass(frozen=True)
class Coded:
    """What is foreseen of compression with one tolerance.

    Attributes
    ----------
    work : Encoder
        Ready for all blocks.
    tolerance : float
    squared : (lights,)
        Squared relative errors of relit radiance.
    bytes_per_vertex : float
        Bases and cap indices counted.
    seconds : float
        For the whole mesh.
    """

    work: Encoder
    tolerance: float
    squared: NDArray[np.float64]
    bytes_per_vertex: float
    seconds: float


class CodingPilot:
    """Compression of transfer that was looked at, on trial.

    Parameters
    ----------
    planned : PlannedScene
    look : TransportTrial
    settings : CompressionSettings
        All but tolerance and light prior.
    grouping : Grouping
    prior : callable
        Gives the light prior for a bandlimit.
    yardstick : ErrorMetric
    """

    def __init__(
        self,
        planned: PlannedScene,
        look: TransportTrial,
        settings: CompressionSettings,
        grouping: Grouping,
        prior: Prior,
        yardstick: ErrorMetric,
    ) -> None:
        self._yardstick, self._count = yardstick, len(planned.scene.mesh.positions)
        begin = time.perf_counter()
        mesh = planned.scene.mesh if look.transfer is None else look.transfer.mesh
        toward_view = look.transfer is not None and look.transfer.toward_view
        settings = replace(settings, tolerance=0.05, light_prior=prior(look.bandlimit))
        self._work = Encoder(settings, mesh, grouping, look.bandlimit, planned.settings.seed, toward_view=toward_view)
        sizes = grouping.clusters.sizes
        self._caps = np.random.default_rng(planned.settings.seed).permutation(np.flatnonzero(sizes))[:_TRIED].tolist()
        self._parts = _neighbours(planned.scene.traced_positions, grouping.clusters, self._caps)
        self._vertices = np.sort(np.concatenate([self._parts.members[c] for c in self._caps]))
        of_bases = pilot_vertices(grouping.clusters, grouping.axes, planned.settings.seed)
        self._apart: NDArray[np.float32] | None = None  # from other transport
        if look.transfer is not None:
            vectors = look.transfer.vectors
            of_bases_vectors, self._vectors = vectors[of_bases], vectors[self._vertices]
        else:
            assert look.source is not None
            found = look.source.estimate(np.concatenate([of_bases, self._vertices])).vectors
            of_bases_vectors, self._vectors = found[: of_bases.size], found[of_bases.size :]
            higher = max(look.bandlimit, min(2 * look.bandlimit + 4, _BESIDE))
            beside = replace(look.source, seed=planned.settings.seed + 1, bandlimit=higher)
            self._apart = -beside.estimate(self._vertices).vectors
            self._apart[:, :, : self._vectors.shape[2]] += self._vectors
        self._work.learn(lambda _: of_bases_vectors)
        self.seconds = time.perf_counter() - begin

    def within(self, squared: NDArray) -> Coded:
        """The coarsest tolerance that adds at most so much, (lights,), to the squared relative error of transport."""
        # The tolerance is about the error under light of such a spectrum, and what it adds is less.
        tolerance = _USUAL * float(np.sqrt(np.min(squared)))
        power, before = 1.0, None
        for _ in range(_TRIALS):
            tolerance = min(max(tolerance, _FINEST), _COARSEST)
            found = self._tried(tolerance)
            room = _SAFE * float(np.sqrt(np.min(squared / np.maximum(found.squared, 1e-300))))
            if before is not None and before.tolerance != tolerance:
                grown = 0.5 * math.log(max(np.max(found.squared / np.maximum(before.squared, 1e-300)), 1e-300))
                power = min(max(grown / math.log(tolerance / before.tolerance), 0.5), 3.0)
            change = room ** (1.0 / power)
            at_limit = (tolerance >= _COARSEST and change >= 1.0) or (tolerance <= _FINEST and change <= 1.0)
            if at_limit or 1.0 / _CLOSE <= change <= _CLOSE:
                break
            before, tolerance = found, tolerance * min(max(change, 0.1), 3.0)
        if at_limit:
            return found
        # Near enough to know what another tolerance gives without trying it.
        change = min(max(change, 1.0 / _CLOSE), _CLOSE)
        work = found.work.asked(found.tolerance * change)
        assert found.work.start is not None
        tuning = found.work.start.tuning
        work.start = WarmStart(replace(tuning, step=tuning.step * change))
        return replace(
            found, work=work, tolerance=found.tolerance * change, squared=found.squared * change ** (2 * power)
        )

    def _tried(self, tolerance: float) -> Coded:
        begin = time.perf_counter()
        work = self._work.asked(tolerance)
        while True:
            store = MemoryStore()
            nothing = np.zeros(self._vertices.size)
            store.add(0, work.block(self._vertices, self._vectors.copy(), nothing, 0))
            projected = time.perf_counter() - begin
            if not work.widened(store, {}):
                break
        trial: Trial = work.of_clusters(self._parts).trial(store, self._caps)
        work.start = trial.start
        ratio = self._count / self._vertices.size
        return Coded(
            work,
            tolerance,
            self._added(work, trial),
            trial.bytes + work.overhead / self._count,
            ratio * (0.5 * projected + trial.reading + _PASSES * trial.coding + trial.decoding),
        )

    def _added(self, work: Encoder, trial: Trial) -> NDArray[np.float64]:
        """(lights,) what coding adds to the squared error of transport.

        That is less than its own square: what is rounded away is noise of few rays in part, and is alike to what the
        bandlimit leaves out. So the product of both errors is negative. It shows in the product with the difference
        from transport of other rays and of more degrees, whose noise is independent.
        """
        found = self._yardstick.of_coding(work, trial)
        if self._apart is None:
            return found
        off = np.zeros_like(self._apart)
        for c, coefficients in zip(self._caps, trial.decoded, strict=True):
            rows = np.searchsorted(self._vertices, self._parts.members[c])
            vectors = work.of_clusters(self._parts).reconstructed(c, coefficients)
            off[rows, :, : vectors.shape[2]] = vectors - self._vectors[rows]
        own = self._yardstick.inner_product(off, off)
        both = self._yardstick.inner_product(off, self._apart)
        return np.asarray(found * np.clip(1.0 + 2.0 * both / np.maximum(own, 1e-300), _LEAST_ADDED, 1.0))


def _neighbours(positions: NDArray, clusters: Clusters, numbers: Sequence[int]) -> Clusters:
    """Caps with no more vertices than are tried, which are near each other."""
    members = list(clusters.members)
    for c in numbers:
        along = members[c][np.argsort(morton(positions[members[c]]), kind="stable")]
        begin = max(0, (along.size - _OF_EACH) // 2)
        members[c] = np.sort(along[begin : begin + _OF_EACH])
    return clusters.thinned(members)
