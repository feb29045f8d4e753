"""Lighting of another bandlimit."""

import numpy as np
import pytest

from slepian_prt.errors import UserError
from slepian_prt.lighting import fitting
from slepian_prt.lighting.fitting import fit_lighting, is_lighting, one_light
from tests.numerics import assert_exact


@pytest.fixture(autouse=True)
def forget_remarks():
    """They are made once in a process."""
    fitting._remark.cache_clear()


def test_higher_degrees_are_cut(rng, caplog):
    light = rng.normal(size=(2, 3, 36))
    assert_exact(fit_lighting(light, 2), light[..., :9], "a copy")
    assert caplog.messages == ["lighting of bandlimit 5 is cut to 2, that of the transfer"]


def test_degrees_that_are_not_there_are_dark(rng, caplog):
    light = rng.normal(size=(3, 9)).astype(np.float32)
    fitted = fit_lighting(light, 4)
    assert fitted.dtype == np.float32
    assert_exact(fitted, np.concatenate([light, np.zeros((3, 16))], axis=1), "a copy")
    assert caplog.messages == [
        "lighting of bandlimit 2 counts as dark in degrees 3 to 4 of the transfer; project its map at bandlimit 4 for "
        "all of its light"
    ]


def test_lighting_that_fits_is_left_alone(rng, caplog):
    light = rng.normal(size=(3, 9))
    assert fit_lighting(light, 2) is light
    assert caplog.messages == []


def test_the_lights_of_an_animation_say_it_once(rng, caplog):
    for _ in range(5):
        fit_lighting(rng.normal(size=(3, 9)), 1)
    assert len(caplog.messages) == 1


@pytest.mark.parametrize("shape", [(3, 1), (3, 9), (1, 3, 4), (7, 3, 121)])
def test_shapes_of_lighting(shape):
    assert is_lighting(shape)


@pytest.mark.parametrize("shape", [(), (9,), (9, 3), (3, 8), (3, 0), (0, 3, 9), (2, 9), (1, 1, 3, 9), (16, 32, 3)])
def test_shapes_of_other_things(shape):
    assert not is_lighting(shape)
    with pytest.raises(UserError, match=r"lighting must have shape \(3, n²\)"):
        one_light(np.zeros(shape), 2)


def test_one_light_is_finite():
    with pytest.raises(UserError, match="lighting must be finite"):
        one_light(np.full((3, 9), np.nan), 2)
