"""Rays over hemispheres: which ray is whose, and uploads in packets against NumPy."""

import numpy as np
import pytest

from slepian_prt.renderer.variants import mitsuba
from slepian_prt.scene.loading import open_scene
from slepian_prt.transport.directions import direction_set
from slepian_prt.transport.hemisphere import HemisphereRays, upload_frames, upload_vectors
from tests.hard.test_geometry import bumpy
from tests.numerics import assert_exact, assert_rounded


@pytest.mark.parametrize(("nodes", "count"), [(8, 1), (8, 131_072), (929, 1129), (1000, 1049), (8191, 1000)])
def test_lanes_are_divided_exactly(nodes, count):
    """As by whole numbers, next to every multiple too."""
    with open_scene(bumpy(1)) as scene:
        rays = HemisphereRays(scene, direction_set(8), 0)
        rays.directions = type("OfSize", (), {"size": nodes})  # a set of so many would take seconds to make
        place, direction = rays.to_nodes(count)
        expected = np.divmod(np.arange(count * nodes), nodes)
        assert_exact(np.array(place), expected[0], "whole numbers")
        assert_exact(np.array(direction), expected[1], "whole numbers")


def test_vectors_and_frames_come_from_their_places(rng):
    vectors, frames = rng.normal(size=(7, 3)), rng.normal(size=(7, 3, 3))
    chosen = rng.integers(0, 7, 100)
    local = rng.normal(size=(3, 100))
    with mitsuba() as mi:
        place = mi.UInt32(chosen)
        picked = np.array(upload_vectors(mi, vectors)(place)).T
        turned = np.array(upload_frames(mi, frames)(place, mi.Vector3f(local))).T
    assert_exact(picked, vectors[chosen].astype(np.float32), "copies")
    expected = np.einsum("nij,jn->ni", frames[chosen], local)
    assert_rounded(turned, expected, terms=6, size=3.0 * np.abs(frames).max() * np.abs(local).max())
