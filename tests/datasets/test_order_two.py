"""Quick transfer of order 2, against closed forms and a dense reference."""

import numpy as np
import pytest

from slepian_prt.datasets.order_two import trace_order_two
from slepian_prt.scene.mesh import make_mesh
from slepian_prt.sphere.harmonics import degrees, real_sh
from slepian_prt.transport.transfer import precompute
from tests.conftest import bumpy, sphere
from tests.numerics import assert_exact


def relative(actual, expected) -> float:
    return float(np.linalg.norm(actual - expected) / np.linalg.norm(expected))


def test_a_convex_scan_is_exact():
    """A_l y_lm(n), l = 0, 1, 2: nothing is blocked."""
    ball = sphere(3)
    expected = np.array([1.0, 2.0 / 3.0, 0.25])[degrees(2)] * real_sh(2, ball.normals)
    traced = trace_order_two(ball)
    np.testing.assert_allclose(traced.vectors, expected, rtol=0.0, atol=1e-5)  # sums of tables in float32
    assert traced.error < 1e-5


@pytest.mark.slow
def test_error_is_as_told():
    """Against 4,096 rays."""
    mesh = bumpy(3)
    dense = precompute(mesh, bandlimit=2, samples=4096, effects="direct").vectors[:, 0]
    traced = trace_order_two(mesh)
    assert relative(traced.vectors, dense) < 0.02
    # Told from 128 vertices of 642, whose squared errors scatter by about as much as they are: 3 sigma of the root.
    assert traced.error == pytest.approx(relative(traced.vectors, dense), rel=1.5 / np.sqrt(128) * 3.0)
    assert traced.rays < 60 * len(mesh.positions) + 128 * 400


def test_more_rays_are_more_exact():
    mesh = bumpy(3)
    dense = precompute(mesh, bandlimit=2, samples=4096, effects="direct").vectors[:, 0]
    errors = [relative(trace_order_two(mesh, samples).vectors, dense) for samples in (30, 100, 400)]
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] < 0.01


def test_the_same_seed_gives_the_same_bits():
    mesh = bumpy(2)
    one, same, other = (trace_order_two(mesh, 64, seed).vectors for seed in (0, 0, 1))
    assert_exact(one, same, "the same rays, in the same order")
    assert relative(other, one) > 1e-4


def test_vertices_that_no_face_uses_are_dark():
    ball = sphere(1)
    mesh = make_mesh(np.append(ball.positions, [[9.0, 9.0, 9.0]], axis=0), ball.faces)
    vectors = trace_order_two(mesh).vectors
    assert np.all(vectors[-1] == 0.0)
    assert np.all(vectors[:-1, 0] > 0.0)


def test_a_scan_far_away_and_tiny():
    """Where it stands, and in which unit, changes nothing."""
    mesh = bumpy(2)
    expected = trace_order_two(mesh).vectors
    for scale, shift in ((1e-6, 0.0), (1e5, 0.0), (1.0, 1e4)):
        moved = make_mesh(mesh.positions * scale + shift * scale, mesh.faces, normals=mesh.normals)
        assert relative(trace_order_two(moved).vectors, expected) < 0.01
