"""The search on made-up tables: no clock, no renderer, every trial in closed form."""

import re

import numpy as np
import pytest

from slepian_prt.accuracy.goal import Goal
from slepian_prt.accuracy.search import Choose, Refuse, decide
from slepian_prt.accuracy.trials import MeasureCoding, MeasureTransport
from tests.accuracy.tables import MadeUp, empty, search

WORLD = MadeUp()


def explored(world, table, *combinations):
    """With trials of these rays and bandlimits."""
    for samples, bandlimit in combinations:
        table = world.measure(table, MeasureTransport(samples, bandlimit))
    return table


def transport(steps):
    return [step for step in steps if isinstance(step, MeasureTransport)]


@pytest.mark.parametrize("error", [0.2, 0.1, 0.05, 0.02, 0.01])
def test_the_cheapest_that_meets_the_error(error):
    """By brute force over all that could be chosen, errors in closed form."""
    steps, table = search(WORLD, empty(), Goal(error=error))
    assert isinstance(steps[-1], Choose)
    choice = steps[-1].choice
    assert choice.worst <= error
    # The first candidate is the cheapest whose transport has the first share of the error; the fastest is chosen.
    first = table.choices[0]
    limit = (first.step.share * error) ** 2
    feasible = [c for c in table.worst_squared if WORLD.squared(*c) <= limit]
    seconds = {c: table.model.transport(*c) + table.model.coding(c[1]) for c in feasible}
    assert seconds[first.combination] == pytest.approx(min(seconds.values()), rel=1e-9)
    assert choice.seconds == min(c.seconds for c in table.choices)


def test_finer_errors_take_no_fewer_trials_and_longer_runs():
    found = [search(WORLD, empty(), Goal(error=error)) for error in (0.2, 0.05, 0.01)]
    seconds = [steps[-1].choice.seconds for steps, _ in found]
    assert seconds == sorted(seconds)
    assert all(len(steps) <= 12 for steps, _ in found)


def test_compression_gets_what_transport_leaves():
    steps, _ = search(WORLD, empty(), Goal(error=0.05))
    coding = next(step for step in steps if isinstance(step, MeasureCoding))
    left = 0.05**2 - WORLD.squared(coding.samples, coding.bandlimit)
    assert 0.7 * left < coding.allowance[0] < left


def test_nothing_meets_it():
    """The message says what the least is, and what is offered is met."""
    world = MadeUp(floor=0.04)
    steps, table = search(world, empty(), Goal(error=0.03))
    assert isinstance(steps[-1], Refuse)
    assert steps[-1].message.startswith("an error of 0.03 cannot be met under sky: ")
    least = float(re.search(r"leaves? ([\d.]+) ±", steps[-1].message)[1])
    assert least == pytest.approx(min(np.sqrt(s) for s in table.worst_squared.values()), rel=0.03)
    offer = float(re.search(r"`max_error=([\d.]+)`", steps[-1].message)[1])
    assert isinstance(search(world, empty(), Goal(error=offer))[0][-1], Choose)


def test_what_limits_is_named():
    few = search(MadeUp(noise=5.0), empty(samples=(64,)), Goal(error=0.02))[0][-1]
    assert "64 rays per vertex leave" in few.message
    low = search(MadeUp(), empty(bandlimits=(3,)), Goal(error=0.02))[0][-1]
    assert "bandlimit 3 leaves" in low.message


def test_expensive_trials_are_skipped_if_a_candidate_exists():
    """At 0.8 of the error, transport is sufficient; a trial of more degrees might find something faster."""
    world = MadeUp(left_out=0.0, noise=0.0, floor=0.08)
    goal = Goal(error=0.1)
    small = empty(receivers=6144)  # where a trial costs as much as the run
    step = decide(explored(world, small, (64, 10), (256, 10)), goal, 0.0)
    assert isinstance(step, MeasureTransport)
    assert step.candidate
    large = empty(receivers=10_000_000)
    step = decide(explored(world, large, (64, 10), (256, 10)), goal, 0.0)
    assert not step.candidate
    # Without a candidate, expensive trials are made.
    step = decide(explored(MadeUp(floor=0.2), small, (64, 10), (256, 10)), goal, 0.0)
    assert not step.candidate


def test_a_candidate_that_fails_is_followed_by_another():
    """Its error on the pilot is what counts, not what was expected."""
    table = explored(WORLD, empty(), (64, 10), (256, 10))
    goal = Goal(error=0.05)
    first = decide(table, goal, 0.0)
    assert first.candidate
    second = decide(table.with_transport(MadeUp(floor=0.2).trial(table, first)), goal, 0.0)
    assert isinstance(second, MeasureTransport)
    assert (second.samples, second.bandlimit) != (first.samples, first.bandlimit)
    # And one that was as expected by compression of it.
    coding = decide(table.with_transport(WORLD.trial(table, first)), goal, 0.0)
    assert isinstance(coding, MeasureCoding)
    assert (coding.samples, coding.bandlimit, coding.share) == (first.samples, first.bandlimit, first.share)


def test_no_more_candidates_than_it_pays_to_try():
    """Where trials cost little beside the run, one for each share; where they cost as much, one."""
    large = search(WORLD, empty(receivers=100_000_000), Goal(error=0.03))[1]
    assert len(large.choices) > 1
    assert len({choice.step.share for choice in large.choices}) == len(large.choices)
    small = search(WORLD, empty(receivers=10_000), Goal(error=0.03))[1]
    assert len(small.choices) == 1


@pytest.mark.parametrize("seconds", [30.0, 100.0, 1000.0])
def test_a_time_is_kept_and_used(seconds):
    steps, table = search(WORLD, empty(), Goal(seconds=seconds), spent=5.0)
    choice = steps[-1].choice
    spent = 5.0 + sum(trial.cost for trial in table.transport) + sum(c.cost for c in table.choices)
    assert spent + choice.seconds <= seconds
    longer = search(WORLD, empty(), Goal(seconds=4.0 * seconds), spent=5.0)[0][-1].choice
    assert longer.worst <= choice.worst


def test_a_time_that_is_over():
    step = decide(empty(), Goal(seconds=1.0), 2.0)
    assert step.message == (
        "1 seconds cannot be kept: loading, planning and the pilot took 2.0; ask for `max_seconds=4` or more"
    )


def test_a_time_that_the_fastest_does_not_keep():
    steps, table = search(MadeUp(coding_seconds=100.0), empty(), Goal(seconds=60.0))
    assert "the fastest that was found would take 10" in steps[-1].message
    # What took too long was followed by something faster.
    assert [c.bandlimit for c in table.choices] == sorted((c.bandlimit for c in table.choices), reverse=True)


def test_an_error_and_a_time():
    """The error if there is time for it, else the time."""
    world = MadeUp(coding_seconds=0.1)
    steps, table = search(world, empty(), Goal(error=0.01))
    by_error = steps[-1].choice
    needed = by_error.seconds + sum(trial.cost for trial in (*table.transport, *table.choices))
    ample = search(world, empty(), Goal(error=0.01, seconds=1.01 * needed))[0][-1].choice
    assert ample.combination == by_error.combination
    short = search(world, empty(), Goal(error=0.01, seconds=0.8 * needed))[0][-1].choice
    assert short.step.share is None
    assert short.worst > 0.01


def test_where_all_is_traced_nothing_is_traced_again():
    """Receivers depend on each other: a trial is the run, and fewer degrees are there already."""
    steps, table = search(WORLD, empty(by_blocks=False), Goal(error=0.1))
    assert steps[-1].choice.transport_seconds == 0.0
    assert len({step.samples for step in transport(steps)}) == len(transport(steps))
    assert not any(step.candidate for step in transport(steps))
    assert steps[-1].choice.bandlimit < table.transport[0].bandlimit


def test_given_numbers_are_kept():
    steps, _ = search(WORLD, empty(samples=(128,), bandlimits=(7,)), Goal(error=0.1))
    assert steps[-1].choice.combination == (128, 7)
    assert all((step.samples, step.bandlimit) == (128, 7) for step in steps[:-1])


def test_the_same_table_gives_the_same_step():
    table = explored(WORLD, empty(), (64, 10), (256, 10))
    assert decide(table, Goal(error=0.05), 3.0) == decide(table, Goal(error=0.05), 7.0)
