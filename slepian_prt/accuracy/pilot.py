"""Trials of transport and of compression, as a search asks for them."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.accuracy.coding_pilot import CodingPilot, draw_caps
from slepian_prt.accuracy.goal import Goal, Light
from slepian_prt.accuracy.table import Combination, CostModel, Table
from slepian_prt.accuracy.trials import MeasureCoding, MeasureTransport, TransportTrial
from slepian_prt.accuracy.tuning import TUNING, SearchTuning
from slepian_prt.compression.grouping import Grouping, group_scene, group_transfer
from slepian_prt.compression.learning import learn_bases, pilot_of
from slepian_prt.compression.settings import CompressionSettings
from slepian_prt.compression.stored_mesh.stored import store_mesh
from slepian_prt.evaluation.vertex_error import ErrorMetric
from slepian_prt.lighting.spectrum import LightPrior
from slepian_prt.transport.estimator import Estimator
from slepian_prt.transport.planned import PlannedScene
from slepian_prt.transport.transfer import Transfer, compute_transfer


class Pilot:
    """Measures on some of the vertices; on all where they depend on each other, once for each number of rays.

    Parameters
    ----------
    planned : PlannedScene
    light : Light
        What compression is made for.
    settings : CompressionSettings
        All but tolerance and light prior.
    metric : ErrorMetric
    timed : (n,)
        Vertices that are traced beside those of the metric, for the time.
    report : callable
        Told what is measured.
    """

    def __init__(
        self,
        planned: PlannedScene,
        light: Light,
        settings: CompressionSettings,
        metric: ErrorMetric,
        timed: NDArray,
        report: Callable[[str], None],
        tuning: SearchTuning = TUNING,
    ) -> None:
        self.planned, self.metric = planned, metric
        self._light, self._settings, self._tuning = light, settings, tuning
        self._vertices = np.concatenate([metric.vertices, timed])
        self._report = report
        self._priors: dict[int, LightPrior] = {}
        self._groupings: list[Grouping] = []  # one, once it is wanted
        self._sources: dict[Combination, Estimator[Any]] = {}  # of candidates: their tables take long, and are large
        self._transfers: dict[int, Transfer] = {}  # by rays, the one of the highest bandlimit

    def with_metric(self, metric: ErrorMetric, timed: NDArray) -> Pilot:
        """The same scene, light and caps, measured at other vertices."""
        other = Pilot(self.planned, self._light, self._settings, metric, timed, self._report, self._tuning)
        other._priors, other._groupings = self._priors, self._groupings
        return other

    def empty_table(self, goal: Goal) -> Table:
        """What may be chosen toward a goal, and nothing known of it."""
        planned, tuning = self.planned, self._tuning
        samples = tuning.samples if goal.samples is None else (goal.samples,)
        bandlimits = tuning.bandlimits if goal.bandlimit is None else (goal.bandlimit,)
        model = CostModel(
            {s: planned.nodes(s) for s in samples},
            receivers=len(planned.scene.mesh.receivers),
            shadowed=planned.plan.shadowed.size,
            tried=self._vertices.size,
            by_blocks=planned.by_blocks,
            tuning=tuning,
        )
        return Table(model, samples, bandlimits, self.metric.names, self.metric.noise, tuning=tuning)

    def measure(self, table: Table, step: MeasureTransport | MeasureCoding) -> Table:
        """The table with one more trial."""
        begin = time.perf_counter()
        # Tables of directions are large: those of candidates that were not coded are not wanted again.
        wanted = {choice.combination for choice in table.choices} | {(step.samples, step.bandlimit)}
        self._sources = {key: source for key, source in self._sources.items() if key in wanted}
        if isinstance(step, MeasureTransport):
            self._report(f"pilot, {step.samples} rays, L = {step.bandlimit}")
            trial = self._trace(step) if self.planned.by_blocks else self._trace_all(step)
            return table.with_transport(replace(trial, cost=time.perf_counter() - begin))
        self._report(f"bases and caps on trial, {step.samples} rays, L = {step.bandlimit}")
        coding = self.coding(step.samples, step.bandlimit)
        return table.with_coding(step, coding.fit_tolerance(step.allowance), time.perf_counter() - begin)

    # --- Transport ---------------------------------------------------------------------------------------------------

    def source(self, samples: int, bandlimit: int) -> Estimator[Any]:
        """What traces a candidate, on the pilot and in the run."""
        combination = samples, bandlimit
        if combination not in self._sources:
            self._sources[combination] = self._new_source(samples, bandlimit)
        return self._sources[combination]

    def transfer(self, samples: int, bandlimit: int) -> Transfer:
        """What was traced with so many rays, cut to a bandlimit."""
        transfer = self._transfers[samples]
        if transfer.bandlimit == bandlimit:
            return transfer
        return replace(transfer.at_bandlimit(bandlimit), environment=transfer.environment)

    def _new_source(self, samples: int, bandlimit: int, seed: int | None = None) -> Estimator[Any]:
        """As planned; with another ``seed``, directions are turned otherwise, so that errors are independent."""
        seed = self.planned.settings.seed if seed is None else seed
        return self.planned.with_settings(samples=samples, bandlimit=bandlimit, seed=seed).estimator()

    def _trace(self, step: MeasureTransport) -> TransportTrial:
        tuning, vertices, count = self._tuning, self._vertices, len(self.planned.scene.mesh.receivers)
        begin = time.perf_counter()
        source = (self.source if step.candidate else self._new_source)(step.samples, step.bandlimit)
        source.estimate(vertices[: tuning.warm_up])  # compiles, and makes the tables
        prepared = time.perf_counter()
        vectors = source.estimate(vertices).vectors
        traced = time.perf_counter()
        seconds = (traced - prepared) * count / vertices.size * (tuning.scattered if count > vertices.size else 1.0)
        chosen = self.metric.vertices
        own, noise = vectors[: chosen.size], None
        if not step.candidate:
            other = (
                self._new_source(step.samples, step.bandlimit, self.planned.settings.seed + 1).estimate(chosen).vectors
            )
            noise = 0.5 * self.metric.squared_difference(own, other)
        return TransportTrial(step, self.metric.errors(own), noise, seconds + prepared - begin, 0.0)

    def _trace_all(self, step: MeasureTransport) -> TransportTrial:
        begin = time.perf_counter()
        transfer = compute_transfer(self.planned.with_settings(samples=step.samples, bandlimit=step.bandlimit))
        seconds = time.perf_counter() - begin
        self._transfers[step.samples] = transfer
        return TransportTrial(step, self.metric.errors(transfer.vectors[self.metric.vertices]), None, seconds, 0.0)

    # --- Compression -------------------------------------------------------------------------------------------------

    def coding(self, samples: int, bandlimit: int) -> CodingPilot:
        """Compression of a candidate, planned to be tried."""
        planned, tuning = self.planned, self._tuning
        scene, seed = planned.scene, planned.settings.seed
        settings = replace(self._settings, tolerance=tuning.first_tolerance, light_prior=self._prior(bandlimit))
        transfer = None if planned.by_blocks else self.transfer(samples, bandlimit)
        grouping = self._group_scene() if transfer is None else group_transfer(self._settings, transfer)
        parts = draw_caps(grouping.clusters, scene.traced_positions, seed, tuning)
        learnt, tried = pilot_of(grouping, seed), parts.vertices
        transport_error: NDArray[np.float32] | None = None
        if transfer is not None:
            pilot_vectors, vectors = transfer.vectors[learnt], transfer.vectors[tried]
        else:
            source = self.source(samples, bandlimit)
            both = source.estimate(np.concatenate([learnt, tried])).vectors
            pilot_vectors, vectors = both[: learnt.size], both[learnt.size :]
            higher = max(bandlimit, min(2 * bandlimit + tuning.beyond_bandlimit, tuning.highest_beyond))
            transport_error = -self._new_source(samples, higher, seed + 1).estimate(tried).vectors
            transport_error[:, :, : vectors.shape[2]] += vectors
        mesh = scene.mesh if transfer is None else transfer.mesh
        receivers = store_mesh(mesh, scene.parts, exact=settings.exact_mesh).mesh.receivers
        toward_view = transfer is not None and transfer.toward_view
        learned = learn_bases(settings, receivers, grouping, bandlimit, seed, pilot_vectors, toward_view=toward_view)
        return CodingPilot(learned, parts, vectors, transport_error, self.metric, tuning)

    def _group_scene(self) -> Grouping:
        if not self._groupings:
            self._groupings.append(group_scene(self._settings, self.planned))
        return self._groupings[0]

    def _prior(self, bandlimit: int) -> LightPrior:
        if bandlimit not in self._priors:
            self._priors[bandlimit] = self._light.prior(bandlimit)
        return self._priors[bandlimit]
