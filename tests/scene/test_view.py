"""Cameras as plain data, against projections worked out by hand and Mitsuba's own."""

import numpy as np
import pytest

from slepian_prt.errors import UserError
from slepian_prt.renderer.variants import bitmap_module
from slepian_prt.scene.view import Aim, View, aimed_view, look_matrix, up_rotation

OWN = View(
    "eye", look_matrix(np.array([0.0, 0.0, 5.0]), np.array([0.0, 0.0, -1.0]), "y").tolist(), 40.0, 80, 60, 0.1, 99.0
)


def project(view: View, points: np.ndarray) -> np.ndarray:
    """(n, 2) places in the picture: x to the right and y up, the edges at -1 and 1."""
    matrix = np.array(view.to_world)
    local = (points - matrix[:3, 3]) @ matrix[:3, :3]
    slope = np.tan(np.radians(view.fov / 2.0))
    assert (local[:, 2] > 0.0).all()
    return np.stack([-local[:, 0], local[:, 1] * view.width / view.height], axis=1) / local[:, 2:] / slope


@pytest.mark.parametrize("up", ["y", "z"])
@pytest.mark.parametrize(
    ("origin", "target"), [([3.0, 4.0, 5.0], [0.5, 1.0, -2.0]), ([-7.0, 1e-3, 2.0], [1.0, 0.0, 0.0])]
)
def test_a_look_is_mitsubas_look(up, origin, target):
    mi = bitmap_module()
    theirs = mi.ScalarTransform4f().look_at(origin=origin, target=target, up=[float(up == axis) for axis in "xyz"])
    ours = look_matrix(np.array(origin), np.subtract(target, origin), up)
    np.testing.assert_allclose(ours, np.array(theirs.matrix), atol=1e-5)  # theirs is in float32


@pytest.mark.parametrize("up", ["y", "z"])
@pytest.mark.parametrize("fov", [None, 20.0, 120.0])
@pytest.mark.parametrize(
    "size", [(1.0, 1.0, 1.0), (5.0, 1.0, 1.0), (0.2, 4.0, 1.0), (1.0, 1.0, 9.0), (1e-5, 1e-5, 1e-5)]
)
def test_the_whole_model_is_in_the_frame_and_fills_it(up, fov, size, rng):
    points = rng.uniform(-0.5, 0.5, (500, 3)) * size + [4.0e5, -3.0, 12.0]
    view = aimed_view(Aim(fov=fov, up=up), None, points, 2000)
    places = project(view, points)
    assert np.abs(places).max() < 0.93  # a margin of 4 % on each side is 0.92
    matrix = np.array(view.to_world)
    distance = np.linalg.norm(matrix[:3, 3] - points, axis=1)
    assert view.near < distance.min()
    assert view.far > distance.max()
    if fov is None:  # from a wide angle the box around the model would be left otherwise
        assert np.ptp(places, axis=0).max() > 1.2


@pytest.mark.parametrize(("up", "ahead"), [("y", [0.0, 0.0, -1.0]), ("z", [0.0, 1.0, 0.0])])
def test_the_default_is_the_front_a_little_from_above(up, ahead):
    corners = np.array(np.meshgrid(*[[-1.0, 1.0]] * 3)).reshape(3, -1).T
    matrix = np.array(aimed_view(Aim(up=up if up == "z" else None), None, corners, 100).to_world)
    axis = up_rotation(up)[:, 1]
    assert matrix[:3, 2] @ ahead > 0.98  # 10 degrees down
    assert -0.2 < matrix[:3, 2] @ axis < -0.1
    np.testing.assert_allclose(matrix[:3, 0] @ axis, 0.0, atol=1e-15)
    assert matrix[:3, 1] @ axis > 0.98


def test_standing_up_takes_the_sky_to_z_and_the_front_to_minus_y():
    turn = up_rotation("z")
    np.testing.assert_allclose(turn @ [0.0, 1.0, 0.0], [0.0, 0.0, 1.0])
    np.testing.assert_allclose(turn @ [0.0, 0.0, 1.0], [0.0, -1.0, 0.0])
    np.testing.assert_allclose(np.linalg.det(turn), 1.0)


def test_what_is_asked_for_wins_over_the_scenes_camera():
    points = np.eye(3)
    assert aimed_view(Aim(), OWN, points, 10) == OWN
    assert aimed_view(Aim(fov=70.0), OWN, points, 10).fov == 70.0
    moved = aimed_view(Aim(look_at=([1.0, 2.0, 3.0], [0.0, 0.0, 0.0])), OWN, points, 10)
    np.testing.assert_allclose(np.array(moved.to_world)[:3, 3], [1.0, 2.0, 3.0])
    assert (moved.fov, moved.width, moved.height) == (40.0, 80, 60)
    rolled = np.array(aimed_view(Aim(up="z"), View(**{**OWN.as_dict(), "to_world": look_matrix(
        np.array([5.0, 0.0, 0.0]), np.array([-1.0, 0.0, 0.0]), "y").tolist()}), points, 10).to_world)  # fmt: skip
    np.testing.assert_allclose(rolled[:3, 1], [0.0, 0.0, 1.0], atol=1e-15)
    np.testing.assert_allclose(rolled[:3, 2:], [[-1.0, 5.0], [0.0, 0.0], [0.0, 0.0]], atol=1e-15)


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({"look_at": ([1, 2, 3], [1, 2, 3])}, "origin and target are both"),
        ({"look_at": ([1e6, 2, 3], [1e6, 2, 3 + 1e-10])}, "origin and target are both"),
        ({"look_at": ([1, 2, 3], [1, np.inf, 3])}, "three finite numbers"),
        ({"look_at": ([1, 2], [1, 3])}, "three finite numbers"),
        ({"look_at": ("here", "there")}, "three finite numbers"),
        ({"look_at": ([0, 5, 0], [0, 0, 0])}, "looks along the axis y"),
        ({"look_at": ([0, 0, -5], [0, 0, 0]), "up": "z"}, "looks along the axis z"),
        ({"fov": 0.0}, "between 0 and 180"),
        ({"fov": 180.0}, "between 0 and 180"),
        ({"fov": float("nan")}, "between 0 and 180"),
        ({"fov": "wide"}, "between 0 and 180"),
        ({"up": "x"}, "up must be one of y, z"),
    ],
)
def test_views_that_make_no_sense(asked, message):
    with pytest.raises(UserError, match=message) as error:
        Aim(**asked)
    assert "\n" not in str(error.value)
