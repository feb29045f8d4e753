"""Vectors turned on the device, against those that NumPy turns in float64."""

import numpy as np
import pytest

from slepian_prt.renderer.variants import mitsuba
from slepian_prt.sphere.rotation import rotate_sh
from slepian_prt.transport.device.rotation import DeviceRotation, angles_of, padded, padded_rows
from slepian_prt.transport.hemisphere import turned_frames
from tests.conftest import random_directions
from tests.numerics import assert_rounded


def axes_of(rng):
    """At random, and where angles are not determined, zeros of either sign among them."""
    poles = [[0, 0, 1], [0, 0, -1], [-0.0, 0.0, 1], [0.0, -0.0, -1], [1, 0, 0], [-1, -0.0, 0], [0, -1, 0], [1e-9, 0, 1]]
    return np.concatenate([np.array(poles, dtype=np.float64), random_directions(rng, 50)])


@pytest.mark.parametrize("bandlimit", [0, 1, 2, 10, 20])
def test_frames_of_receivers(bandlimit, rng):
    axes = axes_of(rng)
    turns = 2.0 * np.pi * rng.random(len(axes))
    vectors = rng.normal(size=(len(axes), (bandlimit + 1) ** 2)).astype(np.float32)
    with mitsuba() as mi:
        rotation = DeviceRotation(mi, bandlimit)
        flat = mi.Float(padded_rows(vectors, rotation.columns).ravel())
        found = np.array(rotation.into_world(flat, angles_of(axes, turns))).reshape(len(axes), -1)
    wanted = rotate_sh(vectors.astype(np.float64), turned_frames(axes, turns))
    # Two products of 2l + 1 terms and three turns of two each; rows of J have unit norm, so that no sum of products
    # exceeds the norm of a degree.
    norms = [np.linalg.norm(vectors[:, l * l : (l + 1) ** 2], axis=1).max() for l in range(bandlimit + 1)]
    assert_rounded(found[:, : vectors.shape[1]], wanted.astype(np.float32), 2 * (2 * bandlimit + 1) + 6, max(norms))
    assert not found[:, vectors.shape[1] :].any()


def test_rows_are_padded_to_packets():
    assert [padded(size) for size in (1, 4, 9, 121, 441)] == [4, 4, 12, 124, 444]
