import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slepian_prt.sphere.caps import angular_distance, cap_area, cap_boundary, minimal_enclosing_cap
from slepian_prt.sphere.quadrature import spherical_fibonacci
from tests.conftest import random_directions


@given(st.integers(1, 60), st.floats(-9.0, 0.6), st.integers(0, 2**32 - 1))
@settings(max_examples=150, deadline=None)
def test_cap_encloses_and_cannot_be_smaller(n, log_spread, seed):
    rng = np.random.default_rng(seed)
    points = random_directions(rng, 1) + 10.0**log_spread * rng.normal(size=(n, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    cap = minimal_enclosing_cap(points)
    distances = angular_distance(points, cap.center)
    assert distances.max() <= cap.half_angle + 1e-15
    if n == 1:
        return
    # Optimal iff the centre cannot move away from all points of the rim at once. Any small move must push one out.
    moved = cap.center + cap.half_angle * 10.0 ** rng.uniform(-5, 0, size=(50, 1)) * rng.normal(size=(50, 3))
    moved /= np.linalg.norm(moved, axis=1, keepdims=True)
    for center in moved:
        assert angular_distance(points, center).max() >= cap.half_angle * (1 - 1e-9) - 2e-15


def test_brute_force_over_a_grid_of_centers(rng):
    points = random_directions(rng, 12)
    cap = minimal_enclosing_cap(points)  # 12 random directions: no hemisphere holds them
    centers = spherical_fibonacci(200_000)
    smallest = np.arccos((centers @ points.T).min(axis=1).max())
    assert cap.half_angle <= smallest + 1e-12
    assert cap.half_angle >= smallest - 0.01  # spacing of the grid


def test_antipodal_and_circles():
    cap = minimal_enclosing_cap([[0, 0, 1], [0, 0, -1]])
    assert cap.half_angle == pytest.approx(math.pi / 2, abs=1e-15)
    assert abs(cap.center[2]) < 1e-15
    circle = [[math.cos(t), math.sin(t), 0] for t in np.linspace(0, 2 * math.pi, 7)]
    cap = minimal_enclosing_cap(circle)
    assert cap.half_angle == pytest.approx(math.pi / 2, abs=1e-15)
    assert abs(cap.center[2]) == pytest.approx(1.0)


@pytest.mark.parametrize("half_angle", [1e-7, 0.2, 1.2, 1.9, 3.0])
def test_known_cap(half_angle, rng):
    axis = random_directions(rng, 1)[0]
    u = np.cross(axis, [0.2, 0.9, 0.4])
    u /= np.linalg.norm(u)
    v = np.cross(axis, u)
    rim = [
        math.cos(half_angle) * axis + math.sin(half_angle) * (math.cos(t) * u + math.sin(t) * v)
        for t in np.linspace(0, 2 * math.pi, 400, endpoint=False)
    ]
    # Beyond a hemisphere the rim alone has a smaller cap on its other side, so the inside is filled.
    inside = spherical_fibonacci(2000)
    inside = inside[angular_distance(inside, axis) < half_angle]
    cap = minimal_enclosing_cap(np.concatenate([rim, [axis], inside]))
    assert cap.half_angle == pytest.approx(half_angle, rel=1e-7, abs=1e-14)
    assert angular_distance(cap.center, axis) <= 1e-7 * max(half_angle, 1e-6) + 1e-13


def test_equal_and_nearly_equal_normals():
    assert minimal_enclosing_cap(np.tile([0.2, 0.3, -0.4], (9, 1))).half_angle <= 1e-16
    close = np.array([[0, 0, 1], [1e-15, 0, 1], [0, 1e-15, 1], [1e-16, 1e-16, 1]])
    assert minimal_enclosing_cap(close).half_angle == pytest.approx(math.sqrt(0.5) * 1e-15, rel=0.3)


def test_area_and_boundary_do_not_cancel():
    assert cap_area(1e-9) == pytest.approx(math.pi * 1e-18, rel=1e-15)
    assert cap_boundary(math.pi - 1e-9) == pytest.approx(2 * math.pi * 1e-9, rel=1e-6)
    assert cap_area(0.0) == 0.0
    assert cap_area(math.pi) == 4 * math.pi
    assert cap_boundary(math.pi) == 0.0


@pytest.mark.parametrize("half_angle", [-1e-9, 3.2, np.float32(3.1416), True, np.True_, "x", "1", None, 10**400])
def test_bad_half_angle(half_angle):
    with pytest.raises(ValueError, match=r"half_angle must be a number in \[0, pi\]"):
        cap_area(half_angle)


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64])
def test_a_half_angle_of_180_degrees_in_any_precision(dtype):
    # float32 rounds π up.
    assert cap_area(dtype(math.pi)) == pytest.approx(4 * math.pi, rel=1e-6)
    assert cap_area(np.radians(np.array(180.0, dtype))) == pytest.approx(4 * math.pi, rel=1e-6)


def test_no_direction():
    with pytest.raises(ValueError, match="at least one"):
        minimal_enclosing_cap(np.zeros((0, 3)))
