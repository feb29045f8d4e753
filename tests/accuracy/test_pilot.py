"""What a pilot measures of transport, and what the table makes of it, against transport itself."""

import numpy as np
import pytest

from slepian_prt.accuracy.goal import Goal, Light
from slepian_prt.accuracy.pilot import Pilot
from slepian_prt.accuracy.search import decide
from slepian_prt.accuracy.trials import MeasureTransport
from slepian_prt.accuracy.vertices import draw_vertices
from slepian_prt.compression.settings import CompressionSettings
from slepian_prt.evaluation.vertex_error import MapMetric
from slepian_prt.lighting.environment import make_environment
from slepian_prt.transport.planned import plan_scene
from slepian_prt.transport.settings import TransportSettings
from slepian_prt.transport.transfer import compute_transfer
from tests.conftest import ROOT, bumpy
from tests.relighting.mitsuba.test_integrator import sky

LIGHT = Light((make_environment(sky(), name="sky"),))
SETTINGS = CompressionSettings(clusters=16)


@pytest.fixture(scope="module")
def pilot():
    with plan_scene(bumpy(5), TransportSettings()) as planned:
        chosen, timed = draw_vertices(planned, 0, 3072)
        metric = MapMetric.of(planned, LIGHT.environments, chosen, 0.004)
        yield Pilot(planned, LIGHT, SETTINGS, metric, timed, lambda _: None)


@pytest.fixture(scope="module")
def table(pilot):
    """Explored as toward an error of 4 %."""
    goal = Goal(error=0.04)
    table = pilot.empty_table(goal)
    while isinstance(step := decide(table, goal, 0.0), MeasureTransport) and not step.candidate:
        table = pilot.measure(table, step)
    return table


def test_few_trials_tell_the_others(pilot, table):
    """Errors of rays and bandlimits that were not tried, within a fifth."""
    tried = {(trial.samples, trial.bandlimit) for trial in table.transport}
    assert len(tried) <= 6
    # Toward many more rays than were tried the table foretells too little: a third at (512, 7), as from there on errors
    # fall slowly, from 1.8e-3 to 1.4e-3 at 4,096 rays, whatever the noise of the reference or the bandlimit.
    for samples, bandlimit in ((128, 5), (512, 10), (512, 5), (128, 7), (128, 9)):
        assert (samples, bandlimit) not in tried
        expected = float(np.sqrt(table.squared_error(samples, bandlimit)[0]))
        vectors = pilot.source(samples, bandlimit).estimate(pilot.metric.vertices).vectors[:, 0]
        error = float(np.sqrt(pilot.metric.errors(vectors[:, None, :]).squared[bandlimit, 0]))
        assert expected == pytest.approx(error, rel=0.2)


def test_transport_of_a_pilot_is_that_of_the_whole_run(pilot):
    """To rounding (blocks of other sizes are other products), so that nothing but the choice of vertices separates
    what is expected from what comes."""
    whole = compute_transfer(pilot.planned.with_settings(bandlimit=6, samples=128)).vectors[pilot.metric.vertices, 0]
    vectors = pilot.source(128, 6).estimate(pilot.metric.vertices).vectors[:, 0]
    largest = float(np.abs(whole).max())
    np.testing.assert_allclose(vectors, whole, rtol=0.0, atol=64 * np.finfo(np.float32).eps * largest)


def test_candidates_are_traced_once_and_explored_combinations_twice(pilot, table):
    assert all(trial.noise is not None and trial.noise.shape == trial.error.squared.shape for trial in table.transport)
    candidate = pilot.measure(table, MeasureTransport(64, 4, 0.75, candidate=True)).transport[-1]
    assert candidate.noise is None
    assert candidate.cost > 0.0
    assert candidate.error.squared.shape == (5, 1)
    assert candidate.error.squared[4, 0] == pytest.approx(table.explored[64].error.squared[4, 0], rel=1e-4)


def test_where_vertices_depend_on_each_other_all_are_traced():
    """And fewer degrees are cut from more."""
    with plan_scene(ROOT / "scenes" / "cornell.xml", TransportSettings(samples=64)) as planned:
        chosen, timed = draw_vertices(planned, 0, 100)
        metric = MapMetric.of(planned, LIGHT.environments, chosen, 0.1)
        pilot = Pilot(planned, LIGHT, SETTINGS, metric, timed, lambda _: None)
        table = pilot.measure(pilot.empty_table(Goal(error=0.1)), MeasureTransport(64, 4))
        whole = compute_transfer(planned.with_settings(bandlimit=4))
    assert table.transport_seconds(64, 3) == 0.0
    cut = pilot.transfer(64, 3)
    assert cut.bandlimit == 3
    np.testing.assert_allclose(cut.vectors, whole.vectors[:, :, :16], rtol=1e-5, atol=1e-6)


def test_vertices_are_apart_and_all_over():
    with plan_scene(bumpy(5), TransportSettings()) as planned:
        chosen, held_out = draw_vertices(planned, 0, 3072)
        others, _ = draw_vertices(planned, 1, 3072)
        rest, _ = draw_vertices(planned, 0, 3072, np.union1d(chosen, held_out))
    assert np.intersect1d(chosen, held_out).size == 0
    assert np.intersect1d(rest, np.union1d(chosen, held_out)).size == 0
    assert np.unique(chosen).size == chosen.size == 3072
    assert np.setdiff1d(chosen, others).size > 0
    # As many on each side as there are vertices.
    positions = planned.scene.mesh.positions
    for axis in range(3):
        assert np.mean(positions[chosen, axis] > 0) == pytest.approx(np.mean(positions[:, axis] > 0), abs=0.03)
