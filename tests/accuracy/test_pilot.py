"""What a pilot foresees of transport, against transport itself."""

import numpy as np
import pytest
from slepian_prt.accuracy.transport_pilot import BANDLIMITS, PILOT, SAMPLES, TransportPilot, pilot_vertices

from slepian_prt.evaluation.vertex_error import MapMetric
from slepian_prt.lighting.environment import make_environment
from slepian_prt.transport.planned import plan_scene
from slepian_prt.transport.settings import TransportSettings
from slepian_prt.transport.transfer import compute_transfer
from tests.conftest import bumpy
from tests.numerics import assert_rounded
from tests.relighting.mitsuba.test_integrator import sky


@pytest.fixture(scope="module")
def pilot():
    with plan_scene(bumpy(5), TransportSettings()) as planned:
        chosen, timed = pilot_vertices(planned, 0)
        yardstick = MapMetric.of(planned, [make_environment(sky(), name="sky")], chosen, 0.004)
        made = TransportPilot(planned, yardstick, timed, SAMPLES, BANDLIMITS, lambda _: None)
        made.explore(0.03, 0.0)
        yield made


def test_vertices_are_apart_and_all_over():
    with plan_scene(bumpy(5), TransportSettings()) as planned:
        chosen, held_out = pilot_vertices(planned, 0)
        others, _ = pilot_vertices(planned, 1)
    assert np.intersect1d(chosen, held_out).size == 0
    assert np.unique(chosen).size == chosen.size == PILOT
    assert np.setdiff1d(chosen, others).size > 0
    # As many on each side as there are vertices.
    positions = planned.scene.mesh.positions
    for axis in range(3):
        assert np.mean(positions[chosen, axis] > 0) == pytest.approx(np.mean(positions[:, axis] > 0), abs=0.03)


@pytest.mark.slow
def test_few_combinations_tell_the_others(pilot):
    """Errors of rays and bandlimits that were not looked at, within a fifth."""
    looked = {(s, look.bandlimit) for s, look in pilot._looks.items()}
    assert len(looked) <= 6
    for samples, bandlimit in ((128, 5), (512, 10), (512, 7), (128, 9)):
        assert (samples, bandlimit) not in looked
        foreseen = float(np.sqrt(pilot.squared(samples, bandlimit)[0]))
        source = pilot.source(samples, bandlimit)
        vectors = source.estimate(pilot.yardstick.vertices).vectors[:, 0]
        found = float(np.sqrt(pilot.yardstick.errors(vectors[:, None, :]).squared[bandlimit, 0]))
        assert foreseen == pytest.approx(found, rel=0.2)


@pytest.mark.slow
def test_feasible_is_what_meets_the_error(pilot):
    found = pilot.feasible(0.05)
    assert found
    assert all(pilot.squared(*c)[0] <= 0.05**2 for c in found)
    # More of anything stays feasible.
    samples, bandlimit = found[0]
    assert (4 * samples, bandlimit) in found


@pytest.mark.slow
def test_a_pilot_s_transport_is_that_of_the_whole_run(pilot):
    """So that nothing but the choice of vertices separates what is foreseen from what comes."""
    planned = pilot.planned
    whole = compute_transfer(planned.with_settings(bandlimit=6, samples=128)).vectors[pilot.yardstick.vertices, 0]
    # The same rays, added up in blocks of other vertices: of a net's nodes no more than there are rays, then a rotation
    # of up to 2 L + 1 numbers. By Cauchy-Schwarz (1/π) ∫ (n·ω)₊ |y_lm| dω is at most 1/√π.
    found = pilot.source(128, 6).estimate(pilot.yardstick.vertices).vectors[:, 0]
    assert_rounded(found, whole, terms=128 + 13, size=1.0 / np.sqrt(np.pi))


@pytest.mark.slow
def test_more_takes_longer(pilot):
    assert pilot.seconds(256, 10) > pilot.seconds(64, 10)
    assert pilot.seconds(64, 20) > pilot.seconds(64, 10)
    assert not pilot.fits(SAMPLES[-1], 50)
