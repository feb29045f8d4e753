import numpy as np
import pytest

from slepian_prt.relighting.mean_functions import MeanFunctions, shared_half_angle
from slepian_prt.slepian.kernels import cosine_lobe, zonal_vectors
from slepian_prt.sphere.caps import Cap
from slepian_prt.sphere.rotation import rotation_to


def normals_within(rng, half_angle: float, count: int = 400):
    """Evenly in a cap about z, its centre and its rim among them."""
    z = 1.0 - 2.0 * np.sin(half_angle / 2) ** 2 * np.concatenate([[0.0, 1.0], rng.random(count)])
    angle = rng.random(z.size) * 2.0 * np.pi
    return np.column_stack([np.sqrt(1.0 - z * z) * np.cos(angle), np.sqrt(1.0 - z * z) * np.sin(angle), z])


@pytest.mark.parametrize("half_angle", [1e-6, 0.01, 0.25, 1.2, np.pi])
@pytest.mark.parametrize("bandlimit", [0, 1, 10, 20])
def test_coefficients_and_functions_give_the_mean_transfer(bandlimit, half_angle, rng):
    kernel = cosine_lobe(bandlimit) / (1.0 + np.arange(bandlimit + 1))
    normals = normals_within(rng, half_angle)
    mean = MeanFunctions.of_cap(kernel, shared_half_angle(normals))
    expected = zonal_vectors(kernel, normals).astype(np.float64)
    found = mean.along(normals).astype(np.float64) @ mean.functions
    # Left out are 1e-5 over the cap as a whole; at its rim, which is a small part of it, more.
    assert np.linalg.norm(found - expected) <= 3e-5 * np.linalg.norm(expected)


def test_each_coefficient_is_the_projection_within_the_bound(rng):
    kernel = cosine_lobe(10)
    normals = normals_within(rng, 0.4)
    mean = MeanFunctions.of_cap(kernel, 0.4)
    vectors = zonal_vectors(kernel, normals).astype(np.float64)
    np.testing.assert_allclose(mean.functions @ mean.functions.T, np.eye(len(mean.functions)), rtol=0.0, atol=1e-12)
    # Cut off is 1e-7 of the norm; the vectors and the result are rounded to float32.
    bound = (1e-7 + 4 * np.finfo(np.float32).eps) * np.linalg.norm(vectors[0])
    np.testing.assert_allclose(mean.along(normals), vectors @ mean.functions.T, rtol=0.0, atol=bound)
    assert 2 < len(mean.polynomials) < 11  # fewer than a polynomial of degree L asks for


def test_few_half_angles_hold_all_normals(rng):
    widths = np.geomspace(1e-4, np.pi, 200)
    found = {shared_half_angle(normals_within(rng, width, 5)) for width in widths}
    assert len(found) < 30
    assert max(found) == np.pi
    for width in widths:
        assert shared_half_angle(normals_within(rng, width, 5)) >= width
    assert shared_half_angle(np.zeros((0, 3))) > 0.0
    tilted = Cap(rotation_to([0.1, 0.2, 1.0])[:, 2], 0.0)
    assert shared_half_angle(tilted.center[None]) >= np.arccos(tilted.center[2])
