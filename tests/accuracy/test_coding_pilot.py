"""What a trial of some caps lets expect of compression, against compression."""

from dataclasses import replace

import numpy as np
import pytest

from slepian_prt.accuracy.coding_pilot import draw_caps, expected_error
from slepian_prt.accuracy.goal import Goal, Light
from slepian_prt.accuracy.pilot import Pilot
from slepian_prt.accuracy.trials import MeasureCoding, MeasureTransport
from slepian_prt.accuracy.tuning import TUNING
from slepian_prt.accuracy.vertices import draw_vertices
from slepian_prt.compression.checkpoint import MemoryStore
from slepian_prt.compression.grouping import group_scene, group_transfer
from slepian_prt.compression.learning import learn_bases, pilot_of
from slepian_prt.compression.projection import choose_projection
from slepian_prt.compression.settings import CompressionSettings
from slepian_prt.compression.stream import compress
from slepian_prt.compression.trial import try_caps
from slepian_prt.evaluation.reference import ReferenceVertices
from slepian_prt.evaluation.vertex_error import MapMetric, SpectrumMetric
from slepian_prt.lighting.environment import make_environment
from slepian_prt.lighting.projection import project_environment
from slepian_prt.lighting.spectrum import light_power
from slepian_prt.sphere.harmonics import degrees
from slepian_prt.transport.estimator import TransferBlock
from slepian_prt.transport.planned import plan_scene
from slepian_prt.transport.settings import TransportSettings
from slepian_prt.transport.transfer import compute_transfer, precompute
from tests.conftest import bumpy
from tests.relighting.mitsuba.test_integrator import sky

SKY = make_environment(sky(), name="sky")


@pytest.fixture(scope="module")
def shadowed():
    return precompute(bumpy(4), bandlimit=6, samples=256)


@pytest.fixture(scope="module")
def trial(shadowed):
    """All caps coded."""
    settings = CompressionSettings(tolerance=0.05, clusters=12)
    grouping = group_transfer(settings, shadowed)
    vectors = shadowed.vectors[pilot_of(grouping, 0)]
    projection = choose_projection(learn_bases(settings, shadowed.mesh.receivers, grouping, 6, 0, vectors))
    store, count = MemoryStore(), len(shadowed.vectors)
    block = TransferBlock(np.arange(count), shadowed.vectors, np.zeros(count, dtype=np.float32), 0)
    store.add(0, projection.block(block))
    return try_caps(projection, projection.caps(store), range(len(projection.bases)))


def test_errors_of_coefficients_under_a_light(trial, rng):
    """Mean squares of radiance, cap by cap as each stands, from products of the coefficients' errors."""
    light = project_environment(SKY, 6)
    bases, clusters = trial.projection.bases, trial.projection.learned.clusters
    count = bases[0].count
    off = rng.normal(size=(500, count)) @ np.diag(rng.random(count))
    missed = rng.random(7) * 1e-3
    brute = np.zeros(3)
    for basis, size in zip(bases, clusters.sizes, strict=True):
        radiance = off @ basis.synthesis @ light.T
        brute += size / clusters.sizes.sum() * np.mean(radiance**2, axis=0)
    brute += [np.sum((missed / (2 * np.arange(7) + 1))[degrees(6)] * one**2) for one in light]
    made_up = replace(trial, errors=off.T @ off / 500, missed=missed)
    np.testing.assert_allclose(made_up.error_under(light), brute, rtol=1e-9)


def test_expected_errors_under_maps_and_spectra(trial, shadowed):
    """Of radiance at all vertices, from what a trial of all caps lost."""
    light, count = project_environment(SKY, 6), len(shadowed.vectors)
    radiance = shadowed.vectors[:, 0] @ light.T
    reference = ReferenceVertices(radiance.astype(np.float32), 0.0, 1, 0.0)
    metric = MapMetric(("sky",), (light,), np.arange(count), (reference,), np.full((count, 3), 0.5))
    expected = 0.25 * trial.error_under(light).sum() / np.mean(np.sum(radiance**2, axis=1))
    assert expected_error(metric, trial)[0] == pytest.approx(expected, rel=1e-5)
    power = light_power(light[0])
    spectrum = SpectrumMetric("sky", np.arange(count), power, (shadowed.vectors, shadowed.vectors), 0.0)
    energy = np.bincount(degrees(6), np.mean(shadowed.vectors[:, 0].astype(np.float64) ** 2, axis=0))
    assert expected_error(spectrum, trial)[0] == pytest.approx(power @ trial.expected.lost / (power @ energy), rel=1e-5)


@pytest.fixture(scope="module")
def pilot():
    with plan_scene(bumpy(5), TransportSettings()) as planned:
        chosen, timed = draw_vertices(planned, 0, TUNING.pilot_vertices)
        metric = MapMetric.of(planned, [SKY], chosen, 0.004)
        yield Pilot(planned, Light((SKY,)), CompressionSettings(clusters=40), metric, timed, lambda _: None)


@pytest.mark.slow
@pytest.mark.parametrize("part", [0.02, 0.06])
def test_a_trial_foresees_what_coding_adds(pilot, part):
    """Tolerance, error and bytes of the whole mesh, from caps of a pilot."""
    table = pilot.measure(pilot.empty_table(Goal(error=0.1)), MeasureTransport(256, 8, 0.75, candidate=True))
    table = pilot.measure(table, MeasureCoding(256, 8, np.array([part**2]), 0.75))
    coded, metric = table.choices[0].coded, pilot.metric
    transfer = compute_transfer(pilot.planned.with_settings(bandlimit=8, samples=256))
    grouping = group_scene(CompressionSettings(clusters=40), pilot.planned)
    packed = compress(transfer, **{**vars(coded.learned.settings), "clusters": grouping})
    squared = metric.errors(packed.reconstruct(metric.vertices)).squared[8, 0]
    assert coded.squared[0] <= part**2 * (1.0 + 1e-9)
    added = squared - table.squared_error(256, 8)[0]
    assert np.sqrt(added) == pytest.approx(np.sqrt(coded.squared[0]), rel=0.2)
    assert packed.bytes_per_vertex == pytest.approx(coded.bytes_per_vertex, rel=0.3)
    assert coded.seconds > 0.0


def test_caps_are_thinned_to_neighbours(pilot, rng):
    clusters = group_scene(CompressionSettings(clusters=4), pilot.planned).clusters
    positions = pilot.planned.scene.traced_positions
    parts = draw_caps(clusters, positions, 0, replace(TUNING, tried_caps=3, vertices_of_cap=50))
    assert len(set(parts.caps)) == 3
    assert parts.vertices.size == 150
    for c in parts.caps:
        assert np.isin(parts.members[c], clusters.members[c]).all()
        own, scattered = (positions[chosen] for chosen in (parts.members[c], rng.choice(clusters.members[c], 50)))
        near, far = (np.median(np.linalg.norm(p[:, None] - p, axis=2)) for p in (own, scattered))
        assert near < 0.7 * far
