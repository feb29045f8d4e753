"""Arrays as users give them: numbers, or one line about what they are instead."""

import math

import numpy as np
import pytest

from slepian_prt.arrays import real_numbers, whole_numbers
from slepian_prt.errors import UserError
from tests.numerics import assert_exact

NO_NUMBERS = {
    "complex": [1j],
    "an array that is complex": np.ones(2, dtype=complex),
    "text": ["x"],
    "an array of text": np.array(["1.5"]),
    "None": None,
    "ragged": [[1.0], [1.0, 2.0]],
    "an integer beyond float64": [10**400],
    "an object": object(),
}


@pytest.mark.parametrize("name", NO_NUMBERS)
@pytest.mark.parametrize("check", [real_numbers, whole_numbers])
def test_what_is_no_number(check, name):
    with pytest.raises(UserError, match=r"^weights must be (real|whole) numbers, not ") as told:
        check(NO_NUMBERS[name], "weights")
    assert len(str(told.value)) < 120


@pytest.mark.parametrize("kind", ["?", "i1", "u8", "f2", ">f4", "f8"])
def test_real_numbers_of_every_type(kind):
    given = np.array([0, 1, 0], dtype=kind)
    assert_exact(real_numbers(given, "x"), [0.0, 1.0, 0.0], "copied")
    assert real_numbers(given, "x").dtype == np.float64


def test_nan_is_for_the_caller_to_tell_and_objects_may_be_numbers():
    assert math.isnan(real_numbers(math.nan, "x"))
    assert real_numbers([10**30, 1], "x")[0] == 1e30


def test_a_copy_is_one():
    given = np.ones(3)
    assert real_numbers(given, "x") is given or np.shares_memory(real_numbers(given, "x"), given)
    assert not np.shares_memory(real_numbers(given, "x", copy=True), given)


@pytest.mark.parametrize("wrong", [0.5, math.nan, math.inf, 1e30, 10**30, 1 << 63])
def test_numbers_that_are_not_whole(wrong):
    with pytest.raises(UserError, match="faces must be whole numbers"):
        whole_numbers([0, wrong], "faces")


def test_whole_numbers_of_any_type():
    for given in ([1, 2], [1.0, 2.0], np.array([1, 2], dtype=np.uint64), np.array([True])):
        assert whole_numbers(given, "faces").dtype == np.int64
    assert whole_numbers([], "faces").size == 0
