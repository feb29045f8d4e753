"""The next step toward a goal: a pure function of the table of what was measured so far.

First transport is explored, cheap trials first, until some combination of rays and bandlimit is expected to leave room
for compression. Then compression is tried of a few candidates, each of which gives transport another share of the
error, and the fastest of them is chosen. Toward a time, it is the most exact one that keeps it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slepian_prt.accuracy.goal import Goal
from slepian_prt.accuracy.table import Combination, Table
from slepian_prt.accuracy.trials import Choice, MeasureCoding, MeasureTransport
from slepian_prt.accuracy.tuning import Stage


@dataclass(frozen=True)
class Choose:
    """The search is over."""

    choice: Choice


@dataclass(frozen=True)
class Refuse:
    """Nothing meets the goal; the message says what can be had."""

    message: str


Step = MeasureTransport | MeasureCoding | Choose | Refuse


def decide(table: Table, goal: Goal, spent: float) -> Step:
    """What to measure next, or the choice: the fastest that meets the error, or the most exact that keeps the time.

    Where both are wanted, the error counts if it can be met in time; else the time does.

    Parameters
    ----------
    table : Table
    goal : Goal
        Checked.
    spent : float
        Seconds so far, of those that the goal allows.
    """
    if goal.error is not None:
        step = _toward_error(table, goal.error)
        in_time = goal.seconds is None or not isinstance(step, Choose) or spent + step.choice.seconds <= goal.seconds
        if in_time:
            return step
    assert goal.seconds is not None
    return _toward_time(table, goal.seconds, spent)


# --- Exploring -------------------------------------------------------------------------------------------------------


def _explore(table: Table, target: float, sufficient: float, seconds: float = math.inf) -> MeasureTransport | None:
    """A trial of transport, until a combination is expected to have the error ``target``, or none can.

    If there is one that has the error ``sufficient``, trials that are expensive beside it are skipped. Nothing is tried
    whose transport would take more than ``seconds`` of all receivers.
    """
    lowest = min(max(table.tuning.explored_bandlimits[0], table.bandlimits[0]), table.bandlimits[-1])
    for samples in table.samples[:3:2] if table.model.by_blocks else table.samples[:1]:
        if samples not in table.explored:
            return MeasureTransport(samples, lowest)
    if table.feasible(target, seconds):
        return None
    trial = _next_trial(table, target, seconds)
    runs = [table.seconds(*c) for c in table.feasible(sufficient, seconds)]
    if trial is None or (runs and table.trial_seconds(*trial) > table.tuning.expensive * min(runs)):
        return None
    return MeasureTransport(*trial)


def _next_trial(table: Table, target: float, seconds: float) -> Combination | None:
    """More rays or more degrees, whichever matters more; more rays only if that can help."""
    explored = table.explored
    bandlimit, most = max(trial.bandlimit for trial in explored.values()), max(explored)
    degrees = (*table.tuning.explored_bandlimits, table.bandlimits[-1])
    higher = [l for l in degrees if bandlimit < l <= table.bandlimits[-1]][:1]
    noise = table.noise(most, bandlimit)
    left_out = np.maximum(table.squared_error(most, bandlimit) - noise, 0.0)
    unknown = len(explored) == 1
    by_noise = unknown or bool(np.max(noise) > np.max(left_out))
    helps = unknown or bool(higher) or bool(np.max(left_out) <= target**2)
    more = [s for s in table.samples if s >= 4 * most][: int(helps)]
    trials = [(s, bandlimit) for s in more] + [(most, l) for l in higher]
    trials = [c for c in trials if table.model.fits(*c) and table.transport_seconds(*c) <= seconds]
    # What is worse is improved first, if it can be.
    return min(trials, key=lambda c: (c[0] > most) != by_noise, default=None)


# --- A wanted error --------------------------------------------------------------------------------------------------


def _toward_error(table: Table, error: float) -> Step:
    choices = [choice for choice in table.choices if choice.step.share is not None]
    for stage in _stages(table, choices, error):
        trial: Step | None = _code_last_candidate(table, error, stage.margin)
        if trial is None and not choices:
            trial = _explore(table, stage.target * error, stage.sufficient * error)
        trial = trial or _next_candidate(table, choices, error, stage.margin)
        if trial is not None:
            return trial
    if choices:
        return Choose(min(choices, key=lambda choice: choice.seconds))
    return Refuse(_what_can_be_had(table, error))


def _stages(table: Table, choices: list[Choice], error: float) -> Sequence[Stage]:
    """All of them; once there are choices, the stage that led to them."""
    stages = table.tuning.stages
    if not choices:
        return stages
    allowing = (
        s for s in stages if any(_allowance(table, c.combination, error, s.margin) is not None for c in choices)
    )
    return [next(allowing, stages[-1])]


def _code_last_candidate(table: Table, error: float, margin: float) -> MeasureCoding | None:
    """Compression of the candidate whose transport was measured last, if there is room for it."""
    last = _last_candidate(table)
    if last is None or last.share is None:
        return None
    allowance = _allowance(table, (last.samples, last.bandlimit), error, margin)
    return None if allowance is None else MeasureCoding(last.samples, last.bandlimit, allowance, last.share)


def _next_candidate(
    table: Table, choices: list[Choice], error: float, margin: float
) -> MeasureTransport | MeasureCoding | None:
    """The fastest candidate for the next share of the error, as long as it pays to try one."""
    tuning, best = table.tuning, min((choice.seconds for choice in choices), default=math.inf)
    if choices and _cost(table, choices[-1].step.share) > tuning.worth_trying * best:
        return None
    # Shares before the last one that led to a choice had nothing else to offer.
    begin = 1 + max((tuning.shares.index(c.step.share) for c in choices if c.step.share is not None), default=-1)
    coded = {choice.combination for choice in choices}
    for share in tuning.shares[begin:]:
        # Transport that takes as long as the best choice in all cannot lead to a better one.
        candidates = (
            c
            for c in table.feasible(share * error)
            if c not in coded and table.transport_seconds(*c) < tuning.hopeless * best
        )
        allowances = {c: a for c in candidates if (a := _allowance(table, c, error, margin)) is not None}
        if not allowances or sum(trial.step.share == share for trial in table.transport) >= tuning.attempts:
            continue
        fastest = min(allowances, key=lambda c: table.seconds(*c))
        if table.trial(*fastest) is None:
            return MeasureTransport(*fastest, share, candidate=True)
        return MeasureCoding(*fastest, allowances[fastest], share)
    return None


def _allowance(table: Table, combination: Combination, error: float, margin: float) -> NDArray[np.float64] | None:
    """(lights,) what transport leaves of the squared error; None if that is too little for compression.

    Something is kept free for what is not known well, among it ``margin`` standard errors.
    """
    tuning, squared = table.tuning, table.squared_error(*combination)
    uncertain = margin * table.standard_error(*combination) * squared / error**2
    free = 1.0 - np.minimum(tuning.models_off + uncertain, tuning.most_free)
    rest = np.asarray((free * error) ** 2 - squared)
    return rest if np.all(rest >= (tuning.least_for_coding * error) ** 2) else None


def _last_candidate(table: Table) -> MeasureTransport | None:
    """The trial of transport that was made last, if it was of a candidate that compression was not tried of."""
    if not table.transport or not table.transport[-1].step.candidate:
        return None
    step = table.transport[-1].step
    coded = {choice.combination for choice in table.choices}
    return None if (step.samples, step.bandlimit) in coded else step


def _cost(table: Table, share: float | None) -> float:
    """Seconds that trials for a share took."""
    transport = sum(trial.cost for trial in table.transport if trial.step.share == share)
    return transport + sum(choice.cost for choice in table.choices if choice.step.share == share)


def _what_can_be_had(table: Table, error: float) -> str:
    """What the least error is, and what limits it."""
    tuning = table.tuning
    samples, bandlimit = min(table.worst_squared, key=lambda c: table.worst_squared[c])
    squared = table.squared_error(samples, bandlimit)
    worst = int(np.argmax(squared))
    # If more degrees were there and did not help, it is the rays.
    by_rays = table.noise(samples, bandlimit)[worst] > 0.5 * squared[worst] or bandlimit < table.bandlimits[-1]
    limit = f"{samples} rays per vertex leave" if by_rays else f"bandlimit {bandlimit} leaves"
    least = max(math.sqrt(float(squared[worst])), float(table.reference_noise[worst]))
    spread = least * float(table.standard_error(samples, bandlimit)[worst])
    margin = tuning.stages[0].margin
    offer = math.ceil(1000.0 * (least + margin * spread) / (tuning.offered * max(tuning.shares))) / 1000.0
    return (
        f"an error of {error:g} cannot be met under {table.lights[worst]}: {limit} {least:.2g} ± {spread:.1g} before "
        f"compression, which is the least that can be had; ask for `max_error={offer:g}` or more, or for smoother light"
    )


# --- A wanted time ---------------------------------------------------------------------------------------------------


def _toward_time(table: Table, seconds: float, spent: float) -> Step:
    tuning, last = table.tuning, _last_candidate(table)
    if last is not None and last.share is None:
        return _code_in_time(table, (last.samples, last.bandlimit))
    timed = [choice for choice in table.choices if choice.step.share is None]
    keep = (1.0 - tuning.time_free) * seconds
    if timed:
        in_time = any(spent + choice.seconds <= keep for choice in table.choices)
        if in_time or len(timed) >= tuning.timed_candidates or spent > tuning.time_for_trials * keep:
            return _most_exact(table, seconds, spent)
    elif keep <= spent:
        return Refuse(
            f"{seconds:g} seconds cannot be kept: loading, planning and the pilot took {spent:.1f}; ask for "
            f"`max_seconds={math.ceil(2.0 * spent)}` or more"
        )
    trial = None if timed else _explore(table, 0.0, 0.0, tuning.time_to_explore * (keep - spent))
    if trial is not None:
        return trial
    candidate = _most_exact_candidate(table, timed, tuning.time_for_run * (keep - spent))
    if candidate in {choice.combination for choice in timed}:
        return _most_exact(table, seconds, spent)
    if table.trial(*candidate) is None:
        return MeasureTransport(*candidate, candidate=True)
    return _code_in_time(table, candidate)


def _code_in_time(table: Table, combination: Combination) -> MeasureCoding:
    """Compression may add about as much error as transport has."""
    allowance = np.maximum(table.squared_error(*combination), table.tuning.least_allowance)
    return MeasureCoding(*combination, allowance)


def _most_exact_candidate(table: Table, timed: list[Choice], seconds: float) -> Combination:
    """Of those that are hardly worse than the most exact that takes no more than so many seconds, the fastest."""
    tuning, limit = table.tuning, math.inf
    for choice in timed:  # each took too long
        limit = tuning.speed_up * min(limit, table.seconds(*choice.combination), choice.seconds)
    limit = min(seconds, limit)
    within = [c for c in table.feasible(math.inf) if table.seconds(*c) <= limit]
    # If there is none: the fastest there is, with what is left of the time.
    within = within or [min(table.worst_squared, key=lambda c: table.seconds(*c))]
    enough = tuning.hardly_worse**2 * min(table.worst_squared[c] for c in within)
    return min((c for c in within if table.worst_squared[c] <= enough), key=lambda c: table.seconds(*c))


def _most_exact(table: Table, seconds: float, spent: float) -> Choose | Refuse:
    """Of the choices that keep the time; what was kept free of it may be used up before nothing is done at all."""
    for limit in ((1.0 - table.tuning.time_free) * seconds, seconds):
        fitting = [choice for choice in table.choices if spent + choice.seconds <= limit]
        if fitting:
            return Choose(min(fitting, key=lambda choice: choice.worst))
    least = min(choice.seconds for choice in table.choices)
    return Refuse(
        f"{seconds:g} seconds cannot be kept: the pilot took {spent:.1f}, and the fastest that was found would take "
        f"{least:.1f} more; ask for `max_seconds={math.ceil(1.5 * (spent + least))}`"
    )
