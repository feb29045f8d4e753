"""Scales of lamps, and directional ones that turn."""

import numpy as np
import pytest

from slepian_prt.errors import UserError
from slepian_prt.lighting.fixed_lights import FixedLights, lamp_scales
from slepian_prt.sphere.harmonics import real_sh
from slepian_prt.sphere.rotation import rotate_sh
from tests.numerics import assert_exact

LIGHT = np.arange(18, dtype=np.float32).reshape(2, 3, 3)
SUN_AND_LAMP = FixedLights(
    ("sun", "lamp"),
    ("directional", "area"),
    np.array([[1.0, 2.0, 3.0], [5.0, 5.0, 5.0]]),
    LIGHT,
    2.0 * LIGHT,
    np.array([[0.6, 0.0, 0.8], [0.0, 0.0, 0.0]]),
)


@pytest.mark.parametrize(
    ("asked", "expected"),
    [
        (1.0, [1.0, 1.0]),
        (0, [0.0, 0.0]),
        ({"lamp": 3.0}, [1.0, 3.0]),
        ({"*": 0.0, "lamp": 0.5}, [0.0, 0.5]),
        ({}, [1.0, 1.0]),
    ],
)
def test_scales(asked, expected):
    assert_exact(lamp_scales(SUN_AND_LAMP, asked), expected, "as asked")


def test_without_lamps_there_are_no_scales():
    assert lamp_scales(None, 2.0).size == 0
    with pytest.raises(UserError, match="names 'sun', which is no lamp of the transfer; it has: none"):
        lamp_scales(None, {"sun": 1.0})


@pytest.mark.parametrize("scale", [-1.0, float("nan"), float("inf"), "bright", None])
def test_scales_that_are_none(scale):
    with pytest.raises(UserError, match="must be a finite number from 0 on, not"):
        lamp_scales(SUN_AND_LAMP, scale)
    with pytest.raises(UserError, match="of 'lamp' must be"):
        lamp_scales(SUN_AND_LAMP, {"lamp": scale})


def test_names_that_no_lamp_has():
    with pytest.raises(UserError, match="names 'key', which is no lamp of the transfer; it has: 'sun', 'lamp'"):
        lamp_scales(SUN_AND_LAMP, {"key": 1.0})


def test_radiance_is_the_sum():
    radiance = SUN_AND_LAMP.radiance(np.array([2.0, 0.5]))
    assert_exact(radiance, 6.0 * LIGHT[0] + 1.5 * LIGHT[1], "small integers and halves")


def test_turned_light_is_a_delta():
    """Rotating the lamp is rotating its coefficients, E y_lm(d)."""
    assert SUN_AND_LAMP.can_turn.tolist() == [True, False]
    still = SUN_AND_LAMP.turned(np.array([2.0, 9.0]), np.eye(3), 4)
    np.testing.assert_allclose(still, 2.0 * np.outer([1, 2, 3], real_sh(4, np.array([[0.6, 0.0, 0.8]]))[0]), atol=1e-14)
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    turned = SUN_AND_LAMP.turned(np.array([2.0, 9.0]), about_x, 4)
    np.testing.assert_allclose(turned, rotate_sh(still, about_x), atol=1e-13)


def test_directions_may_be_left_out():
    lights = FixedLights(("a", "b"), ("point", "point"), np.ones((2, 3)), LIGHT, LIGHT)
    assert not lights.can_turn.any()
    assert not lights.turned(np.ones(2), np.eye(3), 2).any()
