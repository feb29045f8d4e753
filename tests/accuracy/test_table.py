"""What a table of few trials lets expect, against made-up transport in closed form."""

import numpy as np
import pytest

from slepian_prt.accuracy.trials import MeasureCoding, MeasureTransport
from tests.accuracy.tables import MadeUp, coded, empty

WORLD = MadeUp(left_out=0.5, noise=0.4)


@pytest.fixture(scope="module")
def table():
    found = empty()
    for step in (MeasureTransport(64, 10), MeasureTransport(256, 10), MeasureTransport(256, 20)):
        found = WORLD.measure(found, step)
    return found


def test_errors_of_untried_combinations(table):
    """Both parts follow the laws that are assumed, so they are exact."""
    for samples, bandlimit in ((64, 20), (128, 5), (1024, 15), (4096, 20)):
        squared = table.squared_error(samples, bandlimit)[0]
        assert squared == pytest.approx(WORLD.squared(samples, bandlimit), rel=1e-9)
    assert table.noise(64, 20)[0] == pytest.approx(WORLD.noise_square(64, 20), rel=1e-9)
    assert np.isinf(table.squared_error(256, 25)[0])


def test_noise_is_unknown_with_one_number_of_rays():
    one = WORLD.measure(empty(), MeasureTransport(64, 10))
    assert one.noise(64, 10)[0] == 0.0
    assert one.squared_error(64, 7)[0] == WORLD.squared(64, 7)


def test_seconds_are_scaled_by_the_last_trial(table):
    slow = table.with_transport(WORLD.trial(table, MeasureTransport(512, 10), pace=3.0))
    assert slow.pace == pytest.approx(3.0)
    assert slow.transport_seconds(1024, 20) == pytest.approx(3.0 * table.transport_seconds(1024, 20))
    assert slow.transport_seconds(256, 20) == table.transport_seconds(256, 20)  # measured
    slower = table.with_transport(WORLD.trial(table, MeasureTransport(512, 10), pace=30.0))
    coding = [t.seconds(1024, 20) - t.transport_seconds(1024, 20) for t in (table, slow, slower)]
    assert coding == pytest.approx([coding[0], 3.0 * coding[0], 3.0 * coding[0]])


def test_more_takes_longer(table):
    assert table.seconds(256, 10) > table.seconds(64, 10)
    assert table.seconds(64, 20) > table.seconds(64, 10)
    assert not table.model.fits(table.samples[-1], 50)


def test_feasible_is_what_meets_the_error(table):
    feasible = table.feasible(0.05)
    assert feasible
    assert all(table.squared_error(*c)[0] <= 0.05**2 for c in feasible)
    # More rays stay feasible.
    samples, bandlimit = feasible[0]
    assert (4 * samples, bandlimit) in feasible
    limit = table.transport_seconds(samples, bandlimit)
    assert all(table.transport_seconds(*c) <= limit for c in table.feasible(0.05, limit))


def test_a_choice_adds_up(table):
    step = MeasureCoding(256, 10, np.array([1e-4]), 0.75)
    choice = table.with_coding(step, coded([3e-4], 2.0), 0.5).choices[0]
    transport = WORLD.squared(256, 10)
    assert choice.transport_error[0] == pytest.approx(np.sqrt(transport))
    assert choice.worst == pytest.approx(np.sqrt(transport + 3e-4))
    assert choice.spread == pytest.approx(0.01 * transport / (transport + 3e-4))
    assert choice.seconds == pytest.approx(2.0 + table.transport_seconds(256, 10))


def test_a_trial_of_more_degrees_stands_for_fewer_only_where_all_is_traced(table):
    assert table.trial(256, 10).bandlimit == 10
    assert table.trial(256, 7) is None
    whole = WORLD.measure(empty(by_blocks=False), MeasureTransport(64, 10))
    assert whole.trial(64, 7).bandlimit == 10
    assert whole.transport_seconds(64, 7) == 0.0
