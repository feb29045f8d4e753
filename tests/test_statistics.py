"""The Z-test itself: right pictures pass, biased ones do not, and then they are kept."""

import numpy as np
import pytest

from tests import statistics
from tests.statistics import assert_agree, assert_near, assert_same_picture, in_blocks


def test_what_agrees_and_what_does_not(tmp_path, monkeypatch):
    monkeypatch.setattr(statistics, "OUTPUT", tmp_path)
    rng = np.random.default_rng(1)
    truth = rng.random((16, 16, 3))
    ours, reference = (truth + 0.1 * rng.normal(size=(8, 16, 16, 3)) for _ in range(2))
    assert_agree(ours, reference)
    assert_agree(truth[None], reference)
    assert_agree(truth[None] + 0.2, reference, bias=0.2)
    with pytest.raises(AssertionError, match=r"differ by more than chance .*; see "):
        assert_agree(in_blocks(ours + 0.1, 4), in_blocks(reference, 4))
    (folder,) = tmp_path.iterdir()
    assert sorted(path.name for path in folder.iterdir()) == [
        "error.exr", "error.png", "picture.exr", "picture.png", "reference.exr", "reference.png",
    ]  # fmt: skip
    with pytest.raises(AssertionError, match="pixels are off by up to"):
        assert_same_picture(truth + 0.5, truth, atol=0.1)
    assert_near(1.01 * truth, truth, 0.0101)
    with pytest.raises(AssertionError, match="relative RMS difference"):
        assert_near(1.02 * truth, truth, 0.0101)


def test_a_right_program_hardly_ever_fails():
    """At a level of one in a thousand, of 300 tests of 300 values each, with noise estimated from four runs."""
    failures = 0
    for seed in range(300):
        runs = np.random.default_rng(seed).normal(size=(2, 4, 300))
        try:
            assert_agree(*runs)
        except AssertionError:
            failures += 1
    assert failures <= 4  # a mean of 0.3
