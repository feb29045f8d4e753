import math

import numpy as np
import pytest

from slepian_prt.evaluation.baselines import cube_texels, haar_faces, haar_transfer
from slepian_prt.sphere.harmonics import real_sh
from slepian_prt.transport.transfer import precompute
from tests.conftest import bumpy


@pytest.fixture(scope="module")
def shadowed():
    return precompute(bumpy(4), bandlimit=6, samples=256)


def error(vectors, reference) -> float:
    return float(np.linalg.norm(vectors - reference) / np.linalg.norm(reference))


@pytest.mark.parametrize("side", [2, 8, 16])
def test_texels_cover_the_sphere(side):
    directions, solid_angles = cube_texels(side)
    assert solid_angles.sum() == pytest.approx(4.0 * math.pi, rel=1e-12)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0)
    np.testing.assert_allclose(solid_angles @ directions, 0.0, atol=1e-12)
    assert len(np.unique(directions.round(9), axis=0)) == 6 * side * side


def test_texels_integrate(rng):
    directions, solid_angles = cube_texels(64)
    y = real_sh(3, directions)
    np.testing.assert_allclose(y.T @ (solid_angles[:, None] * y), np.eye(16), atol=2e-3)


def test_haar_is_orthonormal():
    basis = haar_faces(np.eye(6 * 16).reshape(6, 4, 4, 96)).reshape(96, 96)
    np.testing.assert_allclose(basis @ basis.T, np.eye(96), atol=1e-14)
    constant = haar_faces(np.ones((6, 8, 8)))
    assert np.count_nonzero(np.abs(constant) > 1e-12) == 6


def test_all_wavelets_give_all(shadowed):
    reference = shadowed.vectors[:, 0]
    whole = haar_transfer(shadowed.vectors, 6 * 64, shadowed.mesh.albedo)
    assert error(whole.reconstruct()[:, 0], reference) < 0.02  # 8 bits each
    errors = [
        error(haar_transfer(shadowed.vectors, k, shadowed.mesh.albedo).reconstruct()[:, 0], reference)
        for k in (4, 16, 64)
    ]
    assert errors[0] > errors[1] > errors[2]
    # Values of 8 bits, places of 9 (384 wavelets), and one scale.
    assert haar_transfer(shadowed.vectors, 16, shadowed.mesh.albedo).bytes_per_vertex == (16 * 17 + 16) / 8


def test_wavelets_relight(shadowed, rng):
    packed = haar_transfer(shadowed.vectors, 20, shadowed.mesh.albedo)
    light = rng.normal(size=(3, 49))
    expected = packed.reconstruct()[:, 0] @ light.T.astype(np.float32)
    np.testing.assert_allclose(packed.radiance(light), expected, atol=1e-5 * np.abs(expected).max())
