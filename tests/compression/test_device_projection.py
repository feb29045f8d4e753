"""Coefficients that are made on the device, against those of `Projection.block`."""

from dataclasses import replace

import numpy as np
import pytest

from slepian_prt.compression.device_projection import can_project_on_device, project_on_device
from slepian_prt.compression.grouping import group_scene
from slepian_prt.compression.learning import learn_bases, pilot_of
from slepian_prt.compression.projection import choose_projection
from slepian_prt.compression.settings import CompressionSettings
from slepian_prt.lighting.spectrum import falling_prior
from slepian_prt.transport.planned import plan_scene
from slepian_prt.transport.settings import TransportSettings
from tests.numerics import assert_exact, assert_rounded
from tests.transport.device.scenes import all_kinds

L = 6
SETTINGS = {
    "coded": {},
    "numbers": {"terms": 9},
    "numbers that differ": {"truncate": "count", "basis": "slepian"},
    "harmonics": {"basis": "none"},
    "classes and a light": {"occlusion_classes": 2, "light_prior": falling_prior(L)},
}


@pytest.mark.parametrize("name", SETTINGS)
def test_a_block(name, rng):
    settings = CompressionSettings(clusters=12, **SETTINGS[name])
    with plan_scene(all_kinds(), TransportSettings(L, 100, effects="direct")) as planned:
        on_host = replace(planned.estimator(), on_device=False)
        on_device = replace(on_host, on_device=True)
        grouping, receivers = group_scene(settings, planned), planned.scene.receivers
        vectors = on_host.estimate(pilot_of(grouping, 0)).vectors
        projection = choose_projection(learn_bases(settings, receivers, grouping, L, 0, vectors))
        assert can_project_on_device(projection)
        piece = rng.permutation(len(receivers))[:300]
        (traced,), (left,) = on_host.blocks([piece]), on_device.blocks([piece])
        wanted, found = projection.block(traced), project_on_device(projection, left)
    if name == "numbers that differ":
        assert len({basis.count for basis in projection.bases}) > 1
    assert_exact(found.vertices, wanted.vertices, "whole numbers")
    assert (found.rays, found.vertices.dtype) == (wanted.rays, wanted.vertices.dtype)
    # The vectors are sums over nodes and triangles, of 49 terms in a coefficient then; no vector is longer than 1.
    for some, others in zip(
        (found.coefficients, *found.statistics), (wanted.coefficients, *wanted.statistics), strict=True
    ):
        assert some.dtype == np.float32
        assert_rounded(some, others, 4 * 100 + 2 * 49, size=1.0)


def test_means_of_caps_stay_on_the_host():
    """As clustered PCA has them; three channels too."""
    settings = CompressionSettings(clusters=4, terms=4)
    with plan_scene(all_kinds(), TransportSettings(2, 16, effects="direct")) as planned:
        grouping, receivers = group_scene(settings, planned), planned.scene.receivers
        vectors = planned.estimator().estimate(pilot_of(grouping, 0)).vectors
        learned = learn_bases(settings, receivers, grouping, 2, 0, vectors)
    projection = choose_projection(learned)
    mean = np.zeros((1, 9), dtype=np.float32)
    with_mean = replace(projection, bases=(replace(projection.bases[0], mean=mean), *projection.bases[1:]))
    assert can_project_on_device(projection)
    assert not can_project_on_device(with_mean)
    assert not can_project_on_device(replace(projection, learned=replace(learned, channels=3)))
