"""Precomputation within a wanted error or time: pilot, choice, the work itself, and its verification."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slepian_prt.accuracy.coding_pilot import CodingPilot
from slepian_prt.accuracy.goal import Goal
from slepian_prt.accuracy.search import Choice, Chooser
from slepian_prt.accuracy.transport_pilot import (
    BANDLIMITS,
    LARGE_PILOT,
    PILOT,
    SAMPLES,
    SMALL_ERROR,
    TransportPilot,
    TransportTrial,
    pilot_vertices,
)
from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.compression.grouping import Grouping, group_transfer, surveyed
from slepian_prt.compression.settings import CompressionSettings
from slepian_prt.compression.stream import compressed, streamed
from slepian_prt.errors import UserError
from slepian_prt.evaluation.vertex_error import ErrorMetric, MapMetric, SpectrumMetric
from slepian_prt.lighting.environment import Environment
from slepian_prt.lighting.projection import project_environment
from slepian_prt.lighting.spectrum import LightPrior, falling_prior, measured_prior
from slepian_prt.scene.mesh import Mesh
from slepian_prt.transport.effects import Effect
from slepian_prt.transport.planned import PlannedScene, plan_scene
from slepian_prt.transport.settings import TransportSettings

# Noise of references: this part of the error asked for, and without one.
_NOISE_PART = 0.35
_USUAL_NOISE = 0.015

# Reference of light that only has a spectrum: rays and bandlimit, the latter for light that falls with the degree.
_SPECTRUM_SAMPLES = 1024
_SURVEY_SAMPLES = 256
_SPECTRUM_BANDLIMIT = 30
_FALLING_BANDLIMIT = 20

# If the verification finds more error than was asked for, this often all is done once more, aimed lower.
_REPEATS = 1
_AIMED_LOWER = 0.95
_ENOUGH = 256


# How often it is coded again, finer, if the vertices that were chosen by have too much error; and a little finer still.
_REVIEWS = 2
_FINER = 0.98

# Coefficients that are kept as they will be decoded, so that the verification need not decode them.
_KEPT = 50_000_000


@dataclass(frozen=True)
class Light:
    """What relit radiance is measured under.

    Attributes
    ----------
    environments : tuple of Environment
        Errors are measured under each.
    spectrum : str
        What compression is made for, and without environments what errors are measured under: light that falls as
        1/(l+1), or that of the mean spectrum of ``maps``. Empty for that of the environments.
    maps : tuple of Environment
    """

    environments: tuple[Environment, ...] = ()
    spectrum: str = ""
    maps: tuple[Environment, ...] = ()

    def prior(self, bandlimit: int) -> LightPrior:
        """What compression is made for."""
        known = self.maps or (() if self.spectrum else self.environments)
        if not known:
            return falling_prior(bandlimit)
        lighting = [project_environment(light, bandlimit) for light in known]
        return measured_prior(lighting, bandlimit, ", ".join(light.name for light in known))


@dataclass(frozen=True)
class Verification:
    """Attributes
    ----------
    names : tuple of str
        Of the lights.
    vertices : int
        That were held out.
    error, predicted, noise : (lights,)
        Relative RMS; of the reference its own noise.
    seconds, predicted_seconds : float
        From the first to the last but writing the file.
    """

    names: tuple[str, ...]
    vertices: int
    error: NDArray[np.float64]
    predicted: NDArray[np.float64]
    noise: NDArray[np.float64]
    seconds: float
    predicted_seconds: float


@dataclass(frozen=True)
class BudgetedResult:
    """What `precompute_within` found.

    Attributes
    ----------
    packed : CompressedTransfer
    choices : tuple of Choice
    chosen : Choice
    verification : Verification
    """

    packed: CompressedTransfer
    choices: tuple[Choice, ...]
    chosen: Choice
    verification: Verification


def precompute_within(
    scene: str | Path | Mesh,
    goal: Goal,
    light: Light,
    settings: CompressionSettings,
    transport: TransportSettings,
    *,
    started: float | None = None,
    on_plan: Callable[[tuple[Effect, ...]], None] = lambda _: None,
    on_choice: Callable[[Sequence[Choice], Choice, float], None] = lambda _choices, _chosen, _rest: None,
    advance: Callable[[int, int], None] = lambda _done, _total: None,
    report: Callable[[str], None] = lambda _: None,
) -> BudgetedResult:
    """Transfer of a scene with rays, bandlimit and tolerance chosen for a wanted error or time.

    The error is that of relit radiance at the vertices, relative RMS, against a reference without a bandlimit.

    Parameters
    ----------
    scene : path of a mesh or Mitsuba scene, or a `Mesh`
    goal : Goal
    light : Light
        Without maps and spectrum, the light of the scene itself.
    settings : CompressionSettings
        Of them basis, clusters, grouping and refinement count.
    transport : TransportSettings
        Of it effects, bounces, albedo, view and seed.
    started : when time begins to count, by `time.perf_counter`; by default now
    on_plan : as of `precompute`
    on_choice : given what could be chosen, the choice, and the seconds that everything else takes
    advance, report : as of `precompute_compressed`

    Raises
    ------
    UserError
        The goal cannot be met, or what `precompute_compressed` raises.
    """
    goal.check()
    started = time.perf_counter() if started is None else started
    _check(settings)
    with plan_scene(scene, transport) as planned:
        if not light.environments and not light.spectrum:
            if planned.scene.environment is None:
                raise UserError("no light to measure errors under: name a map with `environment`, or a `light_prior`")
            light = replace(light, environments=(planned.scene.environment,))
        task = _Task(planned, goal, light, settings, report)
        tightened = 1.0
        for repeat in range(_REPEATS + 1):
            chooser = task.chooser(started, repeat)
            chosen = chooser.choose(tightened)
            rest = chooser.spent
            on_choice(chooser.choices, chosen, rest)
            packed = task.done(chosen, on_plan if repeat == 0 else (lambda _: None), advance)
            report("verification")
            error, noise = task.verified(packed)
            seconds = time.perf_counter() - started
            wanted = goal.error
            met = wanted is None or float(error.max()) <= wanted
            if met or goal.seconds is not None or repeat == _REPEATS or not task.has_others():
                break
            assert wanted is not None
            report(f"{float(error.max()):.2%} on vertices held out; once more, aimed lower")
            tightened *= _AIMED_LOWER * wanted / float(error.max())
    names = task.yardstick.names
    checked = Verification(
        names, task.held_out.vertices.size, error, chosen.error, noise, seconds, rest + chosen.seconds
    )
    packed = replace(packed, verified=dict(zip(names, error.tolist(), strict=True)))
    return BudgetedResult(packed, tuple(chooser.choices), chosen, checked)


def _check(settings: CompressionSettings) -> None:
    """Raise UserError if a goal leaves no room for these."""
    if settings.needs_all_vectors or settings.basis in ("slepian", "direct", "none"):
        raise UserError(
            f"`max_error` and `max_seconds` choose a tolerance, which basis {settings.basis} cannot promise; use "
            "adapted, transport, incident or sh"
        )
    if settings.by_number or settings.tolerance is not None:
        raise UserError(
            "`max_error` and `max_seconds` choose the tolerance; leave out `tolerance`, `terms`, `truncate`"
        )
    if settings.resolved_coding not in ("coded", None):
        raise UserError("`max_error` and `max_seconds` choose how coefficients are rounded; leave out `coding`")


class _Task:
    """One goal on one scene."""

    def __init__(
        self,
        planned: PlannedScene,
        goal: Goal,
        light: Light,
        settings: CompressionSettings,
        report: Callable[[str], None],
    ) -> None:
        self.planned, self.goal, self.light, self.settings, self._report = planned, goal, light, settings, report
        self.yardstick: ErrorMetric
        self.held_out: ErrorMetric
        self._known: ErrorMetric
        self._others = np.zeros(0, dtype=np.int64)
        self._groupings: list[Grouping] = []
        self._priors: dict[int, LightPrior] = {}

    def chooser(self, started: float, repeat: int) -> Chooser:
        """With a pilot of its own."""
        size = LARGE_PILOT if (self.goal.error or 1.0) <= SMALL_ERROR else PILOT
        self._report("reference of the pilot")
        if repeat == 0:
            chosen, held_out = map(self._open, pilot_vertices(self.planned, self.planned.settings.seed, size))
            self._known = self._measure(np.concatenate([chosen, held_out]))
            self.yardstick = self._known.subset(slice(chosen.size))
            self.held_out = self._known.subset(slice(chosen.size, None))
        else:
            # What has been looked at is known now; others are held out.
            self.yardstick = self._known
            self.held_out = self._measure(self._others)
        samples = SAMPLES if self.goal.samples is None else (self.goal.samples,)
        bandlimits = BANDLIMITS if self.goal.bandlimit is None else (self.goal.bandlimit,)
        pilot = TransportPilot(self.planned, self.yardstick, self.held_out.vertices, samples, bandlimits, self._report)
        return Chooser(pilot, self._coding, self.goal, started)

    def has_others(self) -> bool:
        """Whether there are vertices, enough to verify on, that have not been looked at."""
        first, second = pilot_vertices(self.planned, self.planned.settings.seed + 1, PILOT, self._known.vertices)
        self._others = self._open(np.union1d(first, second))[:: max(1, (2 * first.size) // PILOT)]
        return bool(self._others.size >= _ENOUGH)

    def _measure(self, vertices: NDArray) -> ErrorMetric:
        noise = _USUAL_NOISE if self.goal.error is None else _NOISE_PART * self.goal.error
        if self.light.environments:
            return MapMetric.of(self.planned, self.light.environments, vertices, noise)
        if not self.planned.by_blocks:
            raise UserError("a goal for light of a spectrum needs direct light only; name maps with `environment`")
        bandlimit = _SPECTRUM_BANDLIMIT if self.light.maps else _FALLING_BANDLIMIT
        planned, seed = self.planned, self.planned.settings.seed
        halves = [
            planned.with_settings(samples=_SPECTRUM_SAMPLES, bandlimit=bandlimit, seed=seed + 1 + half)
            for half in (0, 1)
        ]
        first, second = (half.estimator().estimate(vertices).vectors[:, 0] for half in halves)
        prior = self.light.prior(bandlimit)
        return SpectrumMetric.of(prior, vertices, (first, second), self.planned.scene.mesh.normals[vertices])

    def _open(self, vertices: NDArray) -> NDArray[np.int64]:
        """Vertices without those inside other geometry, which borrow their transfer from neighbours.

        Under maps they show by being black in the reference.
        """
        if self.light.environments or not self.planned.by_blocks or vertices.size == 0:
            return vertices
        quick = self.planned.with_settings(samples=_SURVEY_SAMPLES, bandlimit=1)
        return vertices[quick.estimator().estimate(vertices).blocked < 1.0]

    def _prior(self, bandlimit: int) -> LightPrior:
        if bandlimit not in self._priors:
            self._priors[bandlimit] = self.light.prior(bandlimit)
        return self._priors[bandlimit]

    def _coding(self, look: TransportTrial) -> CodingPilot:
        self._report(f"bases and caps on trial, {look.samples} rays, L = {look.bandlimit}")
        if look.transfer is not None:
            grouping = group_transfer(self.settings, look.transfer)
        else:
            if not self._groupings:
                self._groupings.append(surveyed(self.settings, self.planned))
            grouping = self._groupings[0]
        return CodingPilot(self.planned, look, self.settings, grouping, self._prior, self.yardstick)

    def done(
        self, chosen: Choice, on_plan: Callable[[tuple[Effect, ...]], None], advance: Callable[[int, int], None]
    ) -> CompressedTransfer:
        """The whole mesh."""
        self.planned.clock.stop("pilot")
        planned = self.planned.with_settings(samples=chosen.samples, bandlimit=chosen.bandlimit)
        on_plan(planned.plan.effects)
        if chosen.look.transfer is not None:
            transfer, started = chosen.look.transfer, time.perf_counter()
            return compressed(transfer, chosen.coded.work, self._report, started, self._review(chosen))
        assert chosen.look.source is not None
        work = chosen.coded.work
        work.keeps = work.bases[0].count * len(planned.scene.mesh.positions) <= _KEPT
        return streamed(planned, chosen.look.source, work, advance, self._report, self._review(chosen))

    def _review(self, chosen: Choice) -> Callable[[CompressedTransfer], float | None]:
        """Whether the vertices that were chosen by have the error that was aimed at; those held out are not looked at.

        What a trial of some caps foresaw of coding may be off.
        """
        left = _REVIEWS if self.goal.error is not None else 0

        def review(packed: CompressedTransfer) -> float | None:
            nonlocal left
            if left == 0:
                return None
            left -= 1
            found = _errors(self.yardstick, packed)
            transport = chosen.transport_error**2
            over = found - chosen.error**2
            if np.all(over <= 0.0):
                return None
            room = (chosen.error**2 - transport) / np.maximum(found - transport, 1e-300)
            return (
                chosen.coded.work.settings.resolved_tolerance
                * _FINER
                * float(np.sqrt(np.clip(np.min(room[over > 0.0]), 0.1, 1.0)))
            )

        return review

    def verified(self, packed: CompressedTransfer) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(lights,) error and noise of the reference at vertices that nothing was chosen by."""
        return np.sqrt(_errors(self.held_out, packed)), self.held_out.noise


def _errors(yardstick: ErrorMetric, packed: CompressedTransfer) -> NDArray[np.float64]:
    """(lights,) squared relative errors of compressed transfer."""
    return yardstick.errors(packed.reconstruct(yardstick.vertices)).squared[packed.bandlimit]
