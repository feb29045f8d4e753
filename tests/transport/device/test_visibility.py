"""The same rays find the same, whether hits stay on the device or not."""

import numpy as np
import pytest

from slepian_prt.scene.loading import open_scene
from slepian_prt.transport.device.visibility import DeviceTracer
from slepian_prt.transport.directions import direction_set
from slepian_prt.transport.visibility import VisibilityTracer
from tests.numerics import assert_exact
from tests.transport.device.scenes import all_kinds

SAME = "the same rays, whose hits are counted by whole numbers"


@pytest.mark.parametrize("nodes", [8, 100])
@pytest.mark.parametrize("receivers", [1, 37, 400])
def test_what_is_blocked(nodes, receivers, rng):
    with open_scene(all_kinds()) as scene:
        directions = direction_set(nodes)
        vertices = rng.permutation(np.flatnonzero(scene.receivers.active))[:receivers]
        host, device = (kind(scene, directions, 3) for kind in (VisibilityTracer, DeviceTracer))
        wanted, found = host.trace(vertices), device.trace(vertices)
    assert found.count == vertices.size
    assert_exact(np.array(found.blocked).reshape(vertices.size, -1).T, wanted.blocked, SAME)
    assert_exact(np.array(found.quarter).reshape(vertices.size, -1).T, wanted.quarter, SAME)
    assert (device.rays, device.changes) == (host.rays, host.changes)


def test_nothing_changes_along_an_edge():
    """No edge to bisect: a convex body sees everything."""
    with open_scene(all_kinds()) as scene:
        alone = np.flatnonzero(scene.receivers.active & (np.abs(scene.receivers.positions[:, 0] - 9.0) < 1.0))
        found = DeviceTracer(scene, direction_set(50), 0).trace(alone)
    assert np.array(found.blocked).all()
    assert not np.array(found.quarter).any()


def test_leaks_are_closed(monkeypatch):
    """A direction of a closed room in which a ray slipped through is looked at again, and others as open stay so."""
    with open_scene(all_kinds()) as scene:
        directions = direction_set(50)
        inside = np.flatnonzero(scene.receivers.active & (np.abs(scene.receivers.positions[:, 0] - 9.0) < 1.0))
        tracer = DeviceTracer(scene, directions, 0)
        slipped = np.ones((inside.size, directions.size), dtype=bool)
        slipped[1, 7] = slipped[2, [3, 9]] = slipped[3, :20] = False
        leaks = scene.mi.Bool(slipped.ravel())
        closed = np.array(tracer._without_leaks(inside, tracer.frames(inside), leaks)).reshape(slipped.shape)
    assert closed[:3].all()
    assert_exact(closed[3], slipped[3], "too many to be leaks")
    assert tracer.rays == 3
