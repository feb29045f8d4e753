"""What a trial of some caps foresees of compression, against compression."""

import numpy as np
import pytest
from slepian_prt.accuracy.transport_pilot import SAMPLES, TransportPilot, pilot_vertices

from slepian_prt.accuracy.coding_pilot import CodingPilot
from slepian_prt.compression.encoder import Encoder
from slepian_prt.compression.grouping import group_transfer
from slepian_prt.compression.settings import CompressionSettings
from slepian_prt.compression.stream import compress
from slepian_prt.compression.tolerance_sweep import ToleranceSweep
from slepian_prt.evaluation.vertex_error import MapMetric
from slepian_prt.lighting.environment import make_environment
from slepian_prt.lighting.projection import project_environment
from slepian_prt.lighting.spectrum import measured_prior
from slepian_prt.sphere.harmonics import degrees
from slepian_prt.transport.planned import plan_scene
from slepian_prt.transport.settings import TransportSettings
from slepian_prt.transport.transfer import compute_transfer, precompute
from tests.conftest import bumpy
from tests.relighting.mitsuba.test_integrator import sky

SKY = make_environment(sky(), name="sky")


@pytest.fixture(scope="module")
def shadowed():
    return precompute(bumpy(4), bandlimit=6, samples=256)


def test_errors_of_coefficients_under_a_light(shadowed, rng):
    """Mean squares of radiance, cap by cap as each stands, from products of the coefficients' errors."""
    settings = CompressionSettings(tolerance=0.05, clusters=12)
    work = Encoder(settings, shadowed.mesh, group_transfer(settings, shadowed), 6, 0)
    work.learn(lambda vertices: shadowed.vectors[vertices])
    light = project_environment(SKY, 6)
    off = rng.normal(size=(500, work.bases[0].count)) @ np.diag(rng.random(work.bases[0].count))
    missed = rng.random(7) * 1e-3
    brute = np.zeros(3)
    for basis, size in zip(work.bases, work.clusters.sizes, strict=True):
        radiance = off @ basis.synthesis @ light.T
        brute += size / len(shadowed.mesh.positions) * np.mean(radiance**2, axis=0)
    brute += [np.sum((missed / (2 * np.arange(7) + 1))[degrees(6)] * one**2) for one in light]
    np.testing.assert_allclose(work.under(off.T @ off / 500, missed, light), brute, rtol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("part", [0.02, 0.06])
def test_a_trial_foresees_what_coding_adds(part):
    """Tolerance, error and bytes of the whole mesh, from caps of a pilot."""
    with plan_scene(bumpy(5), TransportSettings()) as planned:
        chosen, timed = pilot_vertices(planned, 0)
        yardstick = MapMetric.of(planned, [SKY], chosen, 0.004)
        look = TransportPilot(planned, yardstick, timed, SAMPLES, (8,), lambda _: None).look(256, 8)
        transfer = compute_transfer(planned.with_settings(bandlimit=8, samples=256))
        prior = measured_prior([project_environment(SKY, 8)], 8, "sky")
        grouping = group_transfer(CompressionSettings(clusters=40), transfer)
        pilot = CodingPilot(planned, look, CompressionSettings(clusters=40), grouping, lambda _: prior, yardstick)
        coded = pilot.within(np.array([part**2]))
        settings = CompressionSettings(tolerance=coded.tolerance, light_prior=prior, clusters=40)
        packed = compress(transfer, **{**vars(settings), "clusters": grouping})
        found = yardstick.errors(packed.reconstruct(chosen)[:, None, :]).squared[8, 0]
    assert coded.squared[0] <= part**2 * (1.0 + 1e-9)
    added = found - look.error.squared[8, 0]
    assert np.sqrt(added) == pytest.approx(np.sqrt(coded.squared[0]), rel=0.2)
    assert packed.bytes_per_vertex == pytest.approx(coded.bytes_per_vertex, rel=0.3)
    assert coded.seconds > 0.0


def test_coding_again_from_the_same_blocks(shadowed):
    """A review that is not content gets a finer tolerance without another projection."""
    from slepian_prt.compression.stream import compressed

    settings = CompressionSettings(tolerance=0.1, clusters=12)
    work = Encoder(settings, shadowed.mesh, group_transfer(settings, shadowed), 6, 0)
    work.learn(lambda vertices: shadowed.vectors[vertices])
    asked = iter([0.07, None])
    errors = []

    def review(packed):
        errors.append(np.linalg.norm(packed.reconstruct() - shadowed.vectors[:, 0]) / np.linalg.norm(shadowed.vectors))
        return next(asked)

    packed = compressed(shadowed, work, lambda _: None, 0.0, review)
    assert len(errors) == 2
    assert errors[0] <= 0.1 * (1 + 1e-6)
    assert errors[1] <= 0.07 * (1 + 1e-6)
    alone = ToleranceSweep(shadowed, settings, group_transfer(settings, shadowed)).compressed(0.07)
    assert packed.bytes_per_vertex == pytest.approx(alone.bytes_per_vertex, rel=0.05)
