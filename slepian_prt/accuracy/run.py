"""Precomputation within a wanted error or time: pilot, table, search, the run itself, and its verification."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from slepian_prt.accuracy.goal import Goal, Light
from slepian_prt.accuracy.memory import check_pilot_memory
from slepian_prt.accuracy.pilot import Pilot
from slepian_prt.accuracy.search import Choose, Refuse, decide
from slepian_prt.accuracy.table import Table
from slepian_prt.accuracy.trials import Choice
from slepian_prt.accuracy.tuning import TUNING, SearchTuning
from slepian_prt.accuracy.verify import Verification, squared_error, verify
from slepian_prt.accuracy.vertices import draw_others, draw_vertices, leave_out_interior, measure_references
from slepian_prt.compression.bases import BASES
from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.compression.encoder import WarmStart
from slepian_prt.compression.settings import CompressionSettings
from slepian_prt.compression.stream import encode_planned, encode_transfer, project_transfer, trace
from slepian_prt.compression.tracing import Projected
from slepian_prt.errors import UserError
from slepian_prt.evaluation.vertex_error import ErrorMetric
from slepian_prt.transport.by_workers.scene import by_workers
from slepian_prt.transport.effects import Effect
from slepian_prt.transport.planned import PlannedScene, plan_scene
from slepian_prt.transport.settings import TransportSettings

if TYPE_CHECKING:
    from slepian_prt.distributed.crew import Crew
    from slepian_prt.scene.loading import SceneSource


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
    scene: SceneSource,
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
    tuning: SearchTuning = TUNING,
    crew: Crew | None = None,
) -> BudgetedResult:
    """Transfer of a scene with rays, bandlimit and tolerance chosen for a wanted error or time.

    The error is that of relit radiance at the vertices, relative RMS, against a reference without a bandlimit.

    Parameters
    ----------
    scene : as of `precompute`
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
    advance, report : as of `compress_scene`
    tuning : SearchTuning
    crew : as of `compress_scene`

    Raises
    ------
    UserError
        The goal cannot be met, or what `compress_scene` raises.
    """
    goal.check()
    _check(settings)
    hooks = _Hooks(on_plan, on_choice, advance, report, scene, crew)
    started = time.perf_counter() if started is None else started
    with plan_scene(scene, transport) as here, by_workers(here, None if here.by_blocks else crew, scene) as planned:
        light = _resolve(light, planned)
        check_pilot_memory(planned, goal)
        report("reference of the pilot")
        size = tuning.large_pilot_vertices if (goal.error or 1.0) <= tuning.small_error else tuning.pilot_vertices
        drawn = draw_vertices(planned, transport.seed, size)
        chosen_by, others = (leave_out_interior(planned, light, vertices, tuning) for vertices in drawn)
        known = measure_references(planned, goal, light, np.concatenate([chosen_by, others]), tuning)
        metric, held_out = known.subset(slice(chosen_by.size)), known.subset(slice(chosen_by.size, None))
        pilot = Pilot(planned, light, settings, metric, held_out.vertices, report, tuning)
        unseen = np.setdiff1d(drawn[1], others)
        result = _precompute_and_verify(pilot, held_out, unseen, goal, started, hooks, tuning)
        aim = goal
        for _ in range(tuning.repeats):
            missed = 1.0 if goal.error is None else result.verification.worst / goal.error
            if goal.seconds is not None or aim.error is None or missed <= 1.0:
                break
            others, unseen = draw_others(planned, light, known.vertices, tuning)
            if others.size == 0:
                break
            report(f"{result.verification.worst:.2%} on vertices held out; once more, aimed lower")
            report("reference of the pilot")
            # What has been looked at is known now; others are held out.
            held_out = measure_references(planned, goal, light, others, tuning)
            aim = replace(aim, error=aim.error * tuning.aimed_lower / missed)
            pilot = pilot.with_metric(known, held_out.vertices)
            hooks = replace(hooks, on_plan=lambda _: None)
            result = _precompute_and_verify(pilot, held_out, unseen, aim, started, hooks, tuning)
    return result


@dataclass(frozen=True)
class _Hooks:
    """What is told of the progress, and who does the work; as of `precompute_within`."""

    on_plan: Callable[[tuple[Effect, ...]], None]
    on_choice: Callable[[Sequence[Choice], Choice, float], None]
    advance: Callable[[int, int], None]
    report: Callable[[str], None]
    scene: SceneSource
    crew: Crew | None


def _check(settings: CompressionSettings) -> None:
    """Raise UserError if a goal leaves no room for these."""
    able = [name for name, basis in BASES.items() if basis.build is not None and basis.complete]
    if settings.basis not in able:
        raise UserError(
            f"`max_error` and `max_seconds` choose a tolerance, which basis {settings.basis} cannot promise; use "
            f"one of {', '.join(able)}"
        )
    if settings.by_number or settings.tolerance is not None:
        raise UserError(
            "`max_error` and `max_seconds` choose the tolerance; leave out `tolerance`, `terms`, `truncate`"
        )
    if settings.resolved_coding != "coded":
        raise UserError("`max_error` and `max_seconds` choose how coefficients are rounded; leave out `coding`")


def _resolve(light: Light, planned: PlannedScene) -> Light:
    """The light of the scene, if no other is given."""
    if light.environments or light.spectrum:
        return light
    if planned.scene.environment is None:
        raise UserError("no light to measure errors under: name a map with `environment`, or a `light_prior`")
    return replace(light, environments=(planned.scene.environment,))


def _precompute_and_verify(
    pilot: Pilot,
    held_out: ErrorMetric,
    unseen: NDArray,
    aim: Goal,
    started: float,
    hooks: _Hooks,
    tuning: SearchTuning,
) -> BudgetedResult:
    """Search, run, and look at vertices that nothing was chosen by, all but the ``unseen`` of them."""
    table, choice = _search(pilot, aim, started)
    rest = time.perf_counter() - started
    hooks.on_choice(table.choices, choice, rest)
    reviews = 0 if aim.error is None else tuning.reviews
    packed = _precompute(pilot, choice, reviews, hooks, tuning)
    hooks.report("verification")
    planned, predicted = pilot.planned, rest + choice.seconds
    checked = verify(planned, held_out, unseen, packed, choice, started=started, predicted_seconds=predicted)
    packed = replace(
        packed,
        verified=dict(zip(checked.names, checked.error.tolist(), strict=True)),
        verified_vertices=checked.vertices,
        verified_left_out={
            name: {"inside": inside, "black": black}
            for name, inside, black in zip(checked.names, *(part.tolist() for part in checked.left_out), strict=True)
        },
    )
    return BudgetedResult(packed, table.choices, choice, checked)


def _search(pilot: Pilot, goal: Goal, started: float) -> tuple[Table, Choice]:
    """Measure what the search asks for, until it has chosen.

    Raises
    ------
    UserError
        Nothing meets the goal.
    """
    table = pilot.empty_table(goal)
    while True:
        step = decide(table, goal, time.perf_counter() - started)
        if isinstance(step, Choose):
            return table, step.choice
        if isinstance(step, Refuse):
            raise UserError(step.message)
        table = pilot.measure(table, step)


def _precompute(pilot: Pilot, choice: Choice, reviews: int, hooks: _Hooks, tuning: SearchTuning) -> CompressedTransfer:
    """All receivers, as chosen."""
    pilot.planned.clock.stop("pilot")
    planned = pilot.planned.with_settings(samples=choice.samples, bandlimit=choice.bandlimit)
    learned = choice.coded.learned
    hooks.on_plan(planned.plan.effects)
    if not planned.by_blocks:
        begin = time.perf_counter()
        transfer = pilot.transfer(choice.samples, choice.bandlimit)
        encode = partial(encode_transfer, transfer, started=begin)
        return _encode(encode, project_transfer(transfer, learned), pilot.metric, choice, reviews, hooks.report, tuning)
    source = pilot.source(choice.samples, choice.bandlimit)
    with trace(planned, source, learned, hooks.scene, hooks.crew, hooks.advance) as projected:
        encode = partial(encode_planned, planned)
        return _encode(encode, projected, pilot.metric, choice, reviews, hooks.report, tuning)


def _encode(
    encode: Callable[..., CompressedTransfer],
    projected: Projected,
    metric: ErrorMetric,
    choice: Choice,
    reviews: int,
    report: Callable[[str], None],
    tuning: SearchTuning,
) -> CompressedTransfer:
    """Encode; then look at the vertices that were chosen by, and encode again with a finer tolerance while they have
    more error than was aimed at. What a trial of some caps foresaw of coding may be off."""
    projection = projected.projection
    keep = projection.bases[0].count * len(projection.learned.receivers) <= tuning.kept_decoded
    report("coding")
    packed = encode(projected, warm_start=choice.coded.warm_start, keep_decoded=keep)
    for _ in range(reviews):
        factor = _finer(squared_error(metric, packed), choice, tuning)
        if factor is None:
            break
        tolerance = factor * projection.learned.settings.resolved_tolerance
        report(f"coding once more, tolerance {tolerance:.3g}")
        assert packed.coded is not None
        warm_start = WarmStart(packed.coded.tuning).scaled(factor)
        projection = replace(projection, learned=projection.learned.with_tolerance(tolerance))
        packed = encode(replace(projected, projection=projection), warm_start=warm_start, keep_decoded=keep)
    return packed


def _finer(squared: NDArray, choice: Choice, tuning: SearchTuning) -> float | None:
    """What the tolerance is to be multiplied by, so that compression adds what was aimed at; None if it does."""
    transport = choice.transport_error**2
    over = squared > choice.error**2
    if not np.any(over):
        return None
    room = (choice.error**2 - transport) / np.maximum(squared - transport, 1e-300)
    return tuning.review_finer * float(np.sqrt(np.clip(np.min(room[over]), tuning.review_fall, 1.0)))
