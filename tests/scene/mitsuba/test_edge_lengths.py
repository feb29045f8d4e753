"""How long edges may be, against a search through all points of all things."""

import numpy as np

from slepian_prt.scene.mitsuba.edge_lengths import Things, lengths_alone
from tests.numerics import assert_rounded

BIG = np.array([[0.0, 0.0, 0.0], [100.0, 0.0, 0.0], [0.0, 100.0, 0.0]])


def test_the_shortest_that_anything_asks_for(rng):
    low = rng.uniform(0, 100, (30, 3))
    boxes = np.stack([low, low + rng.uniform(0.1, 8.0, (30, 1)) * rng.uniform(0.2, 1.0, (30, 3))], axis=1)
    points = rng.uniform(0, 100, (500, 3))
    found = Things(boxes).lengths(BIG, 5.0).at(points)
    size = np.linalg.norm(boxes[:, 1] - boxes[:, 0], axis=1)
    octave = np.floor(np.log2(size))
    smallest = np.array([size[octave == value].min() for value in octave])  # they are treated alike
    grid = np.stack(np.meshgrid([0, 0.5, 1], [0, 0.5, 1], [0, 0.5, 1]), axis=-1).reshape(-1, 3)
    places = boxes[:, None, 0] + (boxes[:, None, 1] - boxes[:, None, 0]) * grid
    distance = np.linalg.norm(points[:, None, None] - places, axis=3).min(axis=2)
    expected = np.minimum((smallest / 12.0 + 0.25 * distance).min(axis=1), 5.0)
    assert (expected < 5.0).mean() > 0.5
    assert_rounded(found, expected, 8)


def test_larger_things_ask_for_nothing():
    """Nor those of its own size: walls around a table, the next of a row of chairs."""
    box = np.array([[[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]]])
    things = Things(np.concatenate([box, 3.0 * box]))
    for scale, near in ((1.0, 0), (1.9, 0), (2.1, 1), (5.9, 1), (6.1, 2)):
        own = scale * np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]])
        lengths = things.lengths(own, 10.0)
        assert len(lengths.near) == near
        assert_rounded(lengths.most, scale * np.sqrt(3.0) / 6.0, 4)


def test_what_has_no_size(rng):
    """Shapes without an extent, or without an end."""
    flat = np.zeros((1, 2, 3))
    endless = np.array([[[-np.inf] * 3, [np.inf] * 3]])
    lengths = Things(np.concatenate([flat, endless])).lengths(BIG, 5.0)
    assert_rounded(lengths.at(rng.uniform(0, 9, (4, 3))), np.full(4, 5.0), 0)
    assert_rounded(lengths_alone(BIG, 1e9).least, 100.0 * np.sqrt(2.0) / 6.0, 4)
    assert_rounded(Things(np.zeros((0, 2, 3))).lengths(BIG, 5.0).least, 5.0, 0)
