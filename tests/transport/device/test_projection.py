"""Vectors that are made on the device, against those of `OcclusionTables` and of the estimator on the host."""

from dataclasses import replace

import numpy as np
import pytest

from slepian_prt.renderer.variants import is_on_device, mitsuba
from slepian_prt.transport.device.projection import DeviceBlock, DeviceTables
from slepian_prt.transport.device.rotation import angles_of
from slepian_prt.transport.device.visibility import DeviceVisibility
from slepian_prt.transport.directions import QUARTERS, direction_set
from slepian_prt.transport.estimator import TransferBlock
from slepian_prt.transport.hemisphere import turned_frames
from slepian_prt.transport.occlusion import OcclusionTables
from slepian_prt.transport.planned import plan_scene
from slepian_prt.transport.settings import TransportSettings
from slepian_prt.transport.visibility import VisibilitySamples
from tests.conftest import random_directions, sphere
from tests.numerics import assert_exact, assert_rounded
from tests.transport.device.scenes import all_kinds

NODES = 100
# Sums over nodes and triangles, of which there are two for each, then a rotation.
TERMS = 4 * NODES


def opened(mi, tables, bandlimit, blocked, quarter, axes, turns):
    """Vectors and blocked parts of receivers (nodes, n), (edges, n) that were all traced."""
    count = len(axes)
    found = DeviceVisibility(count, mi.Bool(blocked.T.ravel()), mi.UInt32(quarter.T.ravel().astype(np.uint32)))
    none = np.zeros(count, dtype=bool)
    vectors = DeviceTables(mi, tables, bandlimit).open(found, np.arange(count), none, none, angles_of(axes, turns))
    return vectors.numpy()[:, 0], np.array(vectors.blocked)


@pytest.mark.parametrize("bandlimit", [1, 2, 10])
@pytest.mark.parametrize("density", [0.03, 0.5, 0.97])
def test_any_pattern(density, bandlimit, rng):
    """Also ones that no surface makes: holes, islands, outlines that end at the border; and nothing, and everything."""
    directions, tables, count = direction_set(NODES), OcclusionTables(direction_set(NODES), bandlimit), 20
    blocked = rng.random((directions.size, count)) < density
    blocked[:, 0], blocked[:, 1], blocked[:, 2] = True, False, True
    blocked[5, 2] = False
    quarter = rng.integers(0, QUARTERS, (len(directions.edges), count)).astype(np.uint8)
    axes, turns = random_directions(rng, count), 2.0 * np.pi * rng.random(count)
    wanted, part = tables.open(VisibilitySamples(turned_frames(axes, turns), blocked, quarter))
    with mitsuba() as mi:
        found, blocked_part = opened(mi, tables, bandlimit, blocked, quarter, axes, turns)
    assert_rounded(found, wanted, TERMS, size=1.0)
    assert_rounded(blocked_part, part, TERMS, size=1.0)
    assert not found[0].any()
    assert blocked_part[0] == 1.0
    assert found[2].any()
    assert blocked_part[2] < 1.0


def test_the_same_bits_each_time(rng):
    """No sum is made in an order that chance decides."""
    directions, tables = direction_set(NODES), OcclusionTables(direction_set(NODES), 4)
    blocked = rng.random((directions.size, 50)) < 0.3
    quarter = rng.integers(0, QUARTERS, (len(directions.edges), 50)).astype(np.uint8)
    axes, turns = random_directions(rng, 50), np.zeros(50)
    with mitsuba() as mi:
        results = [opened(mi, tables, 4, blocked, quarter, axes, turns) for _ in range(3)]
    for result in results[1:]:
        for again, first in zip(result, results[0], strict=True):
            assert_exact(again, first, "the same kernels on the same machine")


@pytest.mark.parametrize("seed", [0, 1])
def test_all_kinds_of_receivers(seed):
    """Traced, unshadowed, hidden by a surface that goes through their edges, shut in, and without a side."""
    with plan_scene(all_kinds(), TransportSettings(6, 200, seed=seed, effects="direct")) as planned:
        on_host = replace(planned.estimator(), on_device=False)
        on_device = replace(on_host, on_device=True)
        scene = planned.scene
        assert scene.is_hidden.any()
        assert not scene.receivers.active.all()
        wanted, found = on_host.estimate(), on_device.estimate()
        blocks = list(on_device.blocks(on_device.pieces()))
    assert (wanted.blocked == 1.0).any()
    assert_rounded(found.vectors, wanted.vectors, 2 * TERMS, size=1.0)
    assert_rounded(found.blocked, wanted.blocked, 2 * TERMS, size=1.0)
    assert_exact(found.blocked == 1.0, wanted.blocked == 1.0, "closed receivers are exactly so")
    assert found.rays == wanted.rays
    assert all(isinstance(block, DeviceBlock) and isinstance(block, TransferBlock) for block in blocks)
    assert sum(block.rays for block in blocks) == found.rays


def test_where_no_ray_is_traced():
    with plan_scene(sphere(3), TransportSettings(5, 16)) as planned:
        on_host = replace(planned.estimator(), on_device=False)
        wanted, found = on_host.estimate(), replace(on_host, on_device=True).estimate()
    assert_rounded(found.vectors, wanted.vectors, 2 * (2 * 5 + 1) + 6, size=1.0)
    assert not found.blocked.any()
    assert found.rays == 0


def test_few_receivers_in_any_order():
    with plan_scene(all_kinds(), TransportSettings(3, 100, effects="direct")) as planned:
        on_host = replace(planned.estimator(), on_device=False)
        on_device = replace(on_host, on_device=True)
        vertices = np.array([600, 3, 77])
        assert_rounded(on_device.estimate(vertices).vectors, on_host.estimate(vertices).vectors, TERMS, size=1.0)
        assert on_device.estimate(vertices[:0]).vectors.shape == (0, 1, 16)


def test_blocks_of_a_device_are_larger():
    with plan_scene(all_kinds(), TransportSettings(3, 1024, effects="direct")) as planned:
        on_host = replace(planned.estimator(), on_device=False)
        on_device = replace(on_host, on_device=True)
        assert on_device.block_size > on_host.block_size
        assert on_device.stays_on_device
        assert not on_host.stays_on_device
        assert planned.estimator().stays_on_device == is_on_device(planned.scene.mi)
