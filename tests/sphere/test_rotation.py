import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from slepian_prt.errors import UserError
from slepian_prt.sphere.harmonics import real_sh
from slepian_prt.sphere.rotation import rotate_sh, rotation_to
from tests.conftest import random_directions

EXTREME = [
    Rotation.identity(),
    Rotation.from_rotvec([np.pi, 0, 0]),
    Rotation.from_rotvec([0, np.pi, 0]),
    Rotation.from_rotvec([0, 0, np.pi]),
    Rotation.from_rotvec([1e-8, 0, 0]),
    Rotation.from_rotvec([0, 1e-8, 2e-8]),
    Rotation.from_rotvec([0, np.pi - 1e-8, 0]),
    Rotation.from_rotvec([0.3, -1.2, 2.0]),
]


@given(st.integers(0, 25), st.integers(0, 2**32 - 1))
@settings(max_examples=40, deadline=None)
def test_rotated_function_is_the_function_of_rotated_directions(bandlimit, seed):
    rng = np.random.default_rng(seed)
    matrix = Rotation.random(random_state=rng).as_matrix()
    f = rng.normal(size=(bandlimit + 1) ** 2)
    d = random_directions(rng, 20)
    values = real_sh(bandlimit, d) @ rotate_sh(f, matrix)
    expected = real_sh(bandlimit, d @ matrix) @ f
    # A value sums (L+1)² terms of size up to √((2L+1)/4π); rounding grows with their root sum of squares.
    np.testing.assert_allclose(values, expected, atol=1e-14 * (bandlimit + 1) ** 2 * 10, rtol=0)


@pytest.mark.parametrize("rotation", EXTREME)
def test_round_trip_at_bandlimit_200(rotation, rng):
    f = rng.normal(size=201**2)
    matrix = rotation.as_matrix()
    there = rotate_sh(f, matrix)
    back = rotate_sh(there, matrix.T)
    assert np.abs(back - f).max() <= 1e-12
    assert abs(np.linalg.norm(there) / np.linalg.norm(f) - 1) <= 1e-13


@pytest.mark.parametrize("second", EXTREME)
def test_composition_at_bandlimit_200(second, rng):
    f = rng.normal(size=201**2)
    first = Rotation.from_rotvec([1.0, 0.4, -0.9])
    in_steps = rotate_sh(rotate_sh(f, first.as_matrix()), second.as_matrix())
    at_once = rotate_sh(f, (second * first).as_matrix())
    # The product of the matrices is itself rounded by up to 2e-16, which degree 200 magnifies by 200.
    assert np.abs(in_steps - at_once).max() <= 1e-12


def test_identity_is_exact_to_rounding(rng):
    f = rng.normal(size=51**2)
    np.testing.assert_allclose(rotate_sh(f, np.eye(3)), f, atol=2e-14, rtol=0)


def test_tiny_rotation_has_the_right_derivative(rng):
    bandlimit, angle = 30, 1e-8
    d = random_directions(rng, 50)
    f = rng.normal(size=(bandlimit + 1) ** 2)
    turned = real_sh(bandlimit, d) @ rotate_sh(f, Rotation.from_rotvec([angle, 0, 0]).as_matrix())
    # d/dα f(Rᵀω) about x, by central differences with a large step in extended form.
    h = 1e-5
    plus, minus = (real_sh(bandlimit, d @ Rotation.from_rotvec([s * h, 0, 0]).as_matrix()) @ f for s in (1, -1))
    change = turned - real_sh(bandlimit, d) @ f
    np.testing.assert_allclose(change, angle * (plus - minus) / (2 * h), atol=2e-12)


def test_batches_broadcast(rng):
    f = rng.normal(size=(4, 49))
    matrices = Rotation.random(4, random_state=1).as_matrix()
    pairwise = rotate_sh(f, matrices)
    one_by_many = rotate_sh(f[0], matrices)
    many_by_one = rotate_sh(f, matrices[0])
    for i in range(4):
        np.testing.assert_allclose(pairwise[i], rotate_sh(f[i], matrices[i]), atol=1e-14)
        np.testing.assert_allclose(one_by_many[i], rotate_sh(f[0], matrices[i]), atol=1e-14)
        np.testing.assert_allclose(many_by_one[i], rotate_sh(f[i], matrices[0]), atol=1e-14)


def test_against_pyshtools(rng):
    pyshtools = pytest.importorskip("pyshtools")
    bandlimit = 12
    f = rng.normal(size=(bandlimit + 1) ** 2)
    packed = np.zeros((2, bandlimit + 1, bandlimit + 1))
    for l in range(bandlimit + 1):
        for m in range(-l, l + 1):
            packed[int(m < 0), l, abs(m)] = f[l * l + l + m]
    matrix = Rotation.from_euler("ZYZ", [0.5, 1.1, -2.0]).as_matrix()
    coeffs = pyshtools.SHCoeffs.from_array(packed, normalization="ortho", csphase=-1)
    rotated = coeffs.rotate(0.5, 1.1, -2.0, degrees=False, convention="y", body=False).to_array(
        normalization="ortho", csphase=-1
    )
    theirs = np.array([rotated[int(m < 0), l, abs(m)] for l in range(bandlimit + 1) for m in range(-l, l + 1)])
    # body=False turns the coordinates, by angles in the order of the product; we turn the function: the inverse.
    np.testing.assert_allclose(theirs, rotate_sh(f, matrix.T), atol=1e-12)


@pytest.mark.parametrize("center", [[0, 0, 1], [0, 0, -1], [1, 0, 0], [0.6, -0.48, 0.64], [1e-9, 0, 1], [0, 1e-9, -1]])
def test_rotation_to_takes_z_to_the_center(center):
    matrix = rotation_to(center)
    np.testing.assert_allclose(matrix @ [0, 0, 1], np.array(center) / np.linalg.norm(center), atol=1e-15)
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(3), atol=1e-15)
    assert np.linalg.det(matrix) == pytest.approx(1.0, abs=1e-14)


def test_refuses_what_is_no_rotation():
    with pytest.raises(ValueError, match="proper rotation"):
        rotate_sh(np.ones(9), -np.eye(3))
    with pytest.raises(ValueError, match="proper rotation"):
        rotate_sh(np.ones(9), np.full((3, 3), np.nan))
    with pytest.raises(ValueError, match=r"\(L\+1\)\^2"):
        rotate_sh(np.ones(8), np.eye(3))
    with pytest.raises(ValueError, match=r"shape \(\.\.\., 3, 3\)"):
        rotate_sh(np.ones(9), np.eye(2))


def test_numbers_that_are_not_real():
    with pytest.raises(UserError, match="coefficients must be real numbers, not complex128"):
        rotate_sh(np.ones(9, dtype=complex), np.eye(3))
