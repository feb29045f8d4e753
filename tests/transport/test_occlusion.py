"""What chords round outlines cut off is given back: areas of regions of the disk, in the mean over their places."""

import math

import numpy as np
import pytest

from slepian_prt.transport.directions import QUARTERS, direction_set
from slepian_prt.transport.occlusion import OcclusionTables
from slepian_prt.transport.visibility import VisibilitySamples

NODES, PLACES = 100, 3000
AMBIENT = math.sqrt(4.0 * math.pi)


def sample(inside) -> VisibilitySamples:
    """A region as adaptive visibility finds it: at the nodes, and in which quarter of an edge it begins or ends."""
    directions = direction_set(NODES)
    blocked = inside(directions.points)
    first, second = directions.edges.T
    quarter = np.zeros((len(directions.edges), blocked.shape[1]), dtype=np.uint8)
    for k in range(1, QUARTERS):
        part = k / QUARTERS
        along = inside((1.0 - part) * directions.points[first] + part * directions.points[second])
        quarter += along == blocked[first]
    return VisibilitySamples(np.tile(np.eye(3), (blocked.shape[1], 1, 1)), blocked, quarter)


def disk(centers, radius):
    return lambda points: np.linalg.norm(points[:, None] - centers, axis=2) < radius


def caps_of_lines(distance):
    """(n,) parts of the unit disk beyond lines at a distance from its centre."""
    return (np.arccos(distance) - distance * np.sqrt(1.0 - distance**2)) / math.pi


def regions(rng):
    angle, radius = 2.0 * math.pi * rng.random(PLACES), 0.55 * np.sqrt(rng.random(PLACES))
    centers = radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    whole = disk(centers, 0.4)
    opposite = disk(-centers / np.maximum(radius, 1e-9)[:, None] * 0.6, 0.25)
    here = disk(centers / np.maximum(radius, 1e-9)[:, None] * 0.6, 0.25)
    distance = rng.uniform(-0.7, 0.7, PLACES)
    normal = np.column_stack([np.cos(angle), np.sin(angle)])
    return {
        "disk": (whole, np.full(PLACES, 0.16)),
        "all but a disk": (lambda points: ~whole(points), np.full(PLACES, 0.84)),
        "two disks": (lambda points: here(points) | opposite(points), np.full(PLACES, 0.125)),
        "ring": (lambda points: whole(points) & ~disk(centers, 0.2)(points), np.full(PLACES, 0.12)),
        "half plane": (lambda points: points @ normal.T > distance, caps_of_lines(distance)),
    }


@pytest.mark.parametrize("name", ["disk", "all but a disk", "two disks", "ring", "half plane"])
def test_areas_are_right_in_the_mean(name, rng):
    """Without it a disk would lose 1/2T of the unit disk for T triangles, 3e-3; lines and rings nothing."""
    inside, area = regions(rng)[name]
    tables = OcclusionTables(direction_set(NODES), 1)
    errors = tables.blocked_in_frames(sample(inside))[:, 0] * AMBIENT - area
    # The formulas are those for chords that are short beside the radius: here a half of it, which leaves a fifth.
    allowed = 0.2 / (2.0 * len(direction_set(NODES).triangles)) * (2.0 if name == "two disks" else 1.0)
    assert abs(errors.mean()) < allowed + 4.0 * errors.std() / math.sqrt(PLACES)


@pytest.mark.parametrize("everything", [False, True])
def test_nothing_and_everything_are_exact(everything):
    inside = lambda points: np.full((len(points), 2), everything)  # noqa: E731
    tables = OcclusionTables(direction_set(NODES), 2)
    blocked = tables.blocked_in_frames(sample(inside))
    np.testing.assert_allclose(blocked, tables.nodes.sum(axis=0) * everything + np.zeros((2, 1)), atol=1e-6)
