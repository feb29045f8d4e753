"""What chords round outlines cut off is given back: areas of regions of the disk, in the mean over their places."""

import math

import numpy as np
import pytest

from slepian_prt.transport.directions import QUARTERS, direction_set
from slepian_prt.transport.occlusion import OcclusionTables
from slepian_prt.transport.visibility import VisibilitySamples
from tests.numerics import assert_rounded

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


def summed_one_by_one(tables: OcclusionTables, blocked: np.ndarray, quarter: np.ndarray) -> np.ndarray:
    """The projection as it is defined, for one receiver: triangle after triangle, and turns by what is counted."""
    directions = direction_set(NODES)
    triangles, edges = directions.triangles, directions.edges
    total = blocked @ tables.nodes.astype(np.float64)
    for t, corners in enumerate(triangles):
        if not 0 < blocked[corners].sum() < 3:
            continue
        lone = next(k for k in range(3) if (blocked[corners] == blocked[corners[k]]).sum() == 1)
        row = 3 * t + lone
        for side in (lone, (lone + 2) % 3):  # to the next corner, and to the one before
            edge = directions.triangle_edges[t, side]
            counted = int(quarter[edge])
            row = row * QUARTERS + (counted if edges[edge, 0] == corners[lone] else QUARTERS - 1 - counted)
        total += (1.0 if blocked[corners[lone]] else -1.0) * tables.corners[row].astype(np.float64)
    begin, end = blocked[edges].T
    euler = blocked.sum() - (begin & end).sum() + blocked[triangles].all(axis=1).sum()
    border = np.bincount(directions.triangle_edges.ravel(), minlength=len(edges)) == 1
    lengths = np.linalg.norm(np.diff(directions.points[edges[border]], axis=1)[:, 0], axis=1)
    along = 0.5 * (begin + 0.0 + end)[border] @ lengths / lengths.sum()
    lost = (euler - along - 0.25 * (begin != end)[border].sum()) / (2.0 * len(triangles))
    closed = total[0] * AMBIENT
    wider, narrower = max(lost, 0.0) / max(closed, 1e-6), max(-lost, 0.0) / max(1.0 - closed, 1e-6)
    wider, narrower = min(wider, 0.5), min(narrower, 0.5)
    total[:4] = (1.0 + wider + narrower) * total[:4] - narrower * tables.nodes[:, :4].sum(axis=0)
    return total


@pytest.mark.parametrize("density", [0.03, 0.5, 0.9])
def test_sums_of_rows_are_those_of_a_loop(density, rng):
    """Any pattern, also ones that no surface makes: holes, islands, outlines that end at the border."""
    directions, tables = direction_set(NODES), OcclusionTables(direction_set(NODES), 4)
    blocked = rng.random((directions.size, 12)) < density
    quarter = rng.integers(0, QUARTERS, (len(directions.edges), 12)).astype(np.uint8)
    expected = [summed_one_by_one(tables, blocked[:, i], quarter[:, i]) for i in range(12)]
    samples = VisibilitySamples(np.tile(np.eye(3), (12, 1, 1)), blocked, quarter)
    assert_rounded(tables.blocked_in_frames(samples), np.array(expected), terms=4 * directions.size, size=1.0)
    vectors, part = tables.open(samples)
    sky = tables.nodes.astype(np.float64).sum(axis=0)
    assert_rounded(vectors, sky - np.array(expected), terms=4 * directions.size, size=1.0)
    assert_rounded(part, np.array(expected)[:, 0] * AMBIENT, terms=4 * directions.size, size=AMBIENT)


def test_what_is_closed_is_exactly_dark():
    """Beside receivers that see something, whatever rounding does."""
    directions, tables = direction_set(NODES), OcclusionTables(direction_set(NODES), 3)
    blocked = np.ones((directions.size, 3), dtype=bool)
    blocked[5, 1] = False
    samples = VisibilitySamples(np.tile(np.eye(3), (3, 1, 1)), blocked, np.zeros((len(directions.edges), 3), np.uint8))
    vectors, part = tables.open(samples)
    assert not vectors[[0, 2]].any()
    assert (part[[0, 2]] == 1.0).all()
    assert 0.9 < part[1] < 1.0
    assert vectors[1].any()
