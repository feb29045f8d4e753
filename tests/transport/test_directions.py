"""Direction sets and their tables against closed forms on the disk."""

import math

import numpy as np
import pytest

import slepian_prt.transport.directions as directions_module
from slepian_prt.slepian.kernels import cosine_lobe
from slepian_prt.sphere.harmonics import degrees, real_sh
from slepian_prt.sphere.quadrature import gauss_legendre
from slepian_prt.sphere.rotation import rotate_sh
from slepian_prt.transport.directions import direction_set
from slepian_prt.transport.occlusion import OcclusionTables
from slepian_prt.transport.visibility import VisibilitySamples
from tests.numerics import assert_rounded

MEAN = math.sqrt(4 * math.pi)


@pytest.mark.parametrize("nodes", [8, 100, 700])
def test_a_set_covers_the_hemisphere(nodes):
    directions = direction_set(nodes)
    assert directions.size == nodes
    assert directions.weights.sum() == pytest.approx(1.0, abs=1e-12)
    assert (directions.vectors[:, 2] > 0.0).all()
    np.testing.assert_allclose(np.linalg.norm(directions.vectors, axis=1), 1.0, atol=1e-12)
    # Euler's formula for a triangulated disk.
    assert directions.size - len(directions.edges) + len(directions.triangles) == 1


def test_all_blocked_is_exactly_the_unoccluded_lobe():
    directions = direction_set(200)
    nodes, _ = directions.tables(8)
    exact = (real_sh(8, [[0.0, 0.0, 1.0]]) * cosine_lobe(8)[degrees(8)])[0]
    # Sums of 200 float32 numbers.
    np.testing.assert_allclose(nodes.astype(np.float64).sum(axis=0), exact, atol=200 * 6e-8 * 0.3)


def test_a_corner_and_the_rest_make_a_triangle():
    directions = direction_set(150)
    thirds = directions.tables(0)[1][:, 0].reshape(-1, 3, 4, 4)
    # In barycentric coordinates the corner cut at u and v has the part u v of the triangle, wherever the triangle is.
    middle = (np.arange(4) + 0.5) / 4
    whole = np.repeat(triangle_areas(directions)[:, None], 3, axis=1)[..., None, None]
    expected = whole * (np.outer(middle, middle) - 1.0 / 3.0)
    # Without what hangs over the rim.
    interior = np.linalg.norm(directions.points[directions.triangles], axis=2).max(axis=1) < 0.9
    # The rule has about 64 points per node, 32 per triangle; a cut decides to within a few of them.
    scale = float(whole[interior].mean())
    np.testing.assert_allclose(thirds[interior] * MEAN, expected[interior], atol=0.12 * scale)
    assert abs((thirds[interior] * MEAN - expected[interior]).mean()) < 0.01 * scale


def triangle_areas(directions):
    a, b, c = (directions.points[directions.triangles[:, k]] for k in range(3))
    return 0.5 * np.abs((b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])) / np.pi


def blocked_by_half_plane(bandlimit: int, height: float) -> np.ndarray:
    """∫ y_lm over the part x > height of the unit disk, over π, by a product rule of Gauss and trapezoids."""
    rule = gauss_legendre(400)
    angle = math.acos(height)
    x_phi = 0.5 * angle * (rule.nodes + 1.0)  # substitution x = cos φ makes the integrand smooth at the rim
    x, dx = np.cos(x_phi), 0.5 * angle * rule.weights * np.sin(x_phi)
    y_phi = 0.5 * np.pi * rule.nodes
    y = np.sin(y_phi)[None, :] * np.sin(x_phi)[:, None]
    dy = 0.5 * np.pi * rule.weights[None, :] * np.cos(y_phi)[None, :] * np.sin(x_phi)[:, None]
    xx = np.broadcast_to(x[:, None], y.shape)
    z = np.sqrt(np.maximum(0.0, 1.0 - xx * xx - y * y))
    d = np.stack([xx, y, z], axis=-1).reshape(-1, 3)
    weight = (dx[:, None] * dy).ravel() / np.pi
    return weight @ real_sh(bandlimit, d / np.linalg.norm(d, axis=1, keepdims=True))


@pytest.mark.slow
@pytest.mark.parametrize("nodes", [100, 400])
def test_straight_boundaries_are_found_to_second_order(nodes):
    """Half planes at many heights and angles: the error is that of quantised crossings, far below a node's share."""
    directions = direction_set(nodes)
    tables = OcclusionTables(directions, 5)
    heights = np.linspace(-0.8, 0.8, 33)
    angles = np.linspace(0.0, 2.0 * np.pi, 33)
    normals = np.column_stack([np.cos(angles), np.sin(angles)])
    side = directions.vectors[:, :2] @ normals.T > heights  # (directions, 33)
    hit, inner = side[: directions.size], side[directions.size :].reshape(len(directions.edges), 3, -1)
    begin = hit[directions.edges[:, 0]]
    second = inner[:, 1] == begin
    last = np.where(second, inner[:, 2], inner[:, 0]) == begin
    quarter = np.where(begin != hit[directions.edges[:, 1]], 2 * second + last, 0).astype(np.uint8)
    projected = tables.blocked_in_frames(VisibilitySamples(np.zeros((33, 3, 3)), hit, quarter))
    errors, sizes = [], []
    for k, (height, angle) in enumerate(zip(heights, angles, strict=True)):
        turn = np.array([[math.cos(angle), -math.sin(angle), 0], [math.sin(angle), math.cos(angle), 0], [0, 0, 1.0]])
        exact = rotate_sh(blocked_by_half_plane(5, height), turn)
        errors.append(np.sum((projected[k] - exact) ** 2))
        sizes.append(2.0 * math.sqrt(1.0 - height**2))
    # In a triangular lattice of edge a, a line crosses an edge every a/2.2. Each crossing is known to a quarter of an
    # edge, a standard deviation of a/8√3, and moves that much of the boundary; y(ω) has the norm √(M/4π) everywhere.
    edge = math.sqrt(2.0 / math.sqrt(3.0) * np.pi / nodes)
    deviation = edge / (8.0 * math.sqrt(3.0)) * math.sqrt(np.mean(sizes) * edge / 2.2) / np.pi
    expected = deviation * math.sqrt(36 / (4.0 * np.pi))
    assert math.sqrt(np.mean(errors)) < 1.5 * expected


def test_tables_are_sums_over_the_points_of_the_rule():
    """As their docstring has it, one corner after the other."""
    directions = direction_set(20)
    nodes, corners = directions.tables(3)
    rule, triangle, barycentric = directions._rule
    harmonics = real_sh(3, np.column_stack([rule, np.sqrt(1.0 - np.sum(rule * rule, axis=1))])) / len(rule)
    exact = (real_sh(3, [[0.0, 0.0, 1.0]]) * cosine_lobe(3)[degrees(3)])[0]
    missing = (exact - harmonics.sum(axis=0)) / len(rule)  # goes to triangles by their share of the points
    expected = np.zeros((directions.size, 16))
    for t, ends in enumerate(directions.triangles):
        inside = triangle == t
        third = (harmonics[inside].sum(axis=0) + inside.sum() * missing) / 3.0
        expected[ends] += third
        for k, i, j in np.ndindex(3, 4, 4):
            to_next, to_last = barycentric[:, (k + 1) % 3], barycentric[:, (k + 2) % 3]
            cut = inside & (to_next / ((i + 0.5) / 4) + to_last / ((j + 0.5) / 4) < 1.0)
            row = ((3 * t + k) * 4 + i) * 4 + j
            assert_rounded(
                corners[row],
                (harmonics[cut].sum(axis=0) - third).astype(np.float32),
                300,
                1.0 / len(directions.triangles),
            )
    assert_rounded(nodes, expected.astype(np.float32), 300, 1.0)


def test_tables_of_many_sets_are_kept():
    """Whatever is asked for in turn is made once, unless it takes too much memory."""
    sets = [direction_set(nodes) for nodes in (20, 30, 40)]
    first = [[directions.tables(bandlimit) for bandlimit in (1, 2)] for directions in sets]
    again = [[directions.tables(bandlimit) for bandlimit in (1, 2)] for directions in sets]
    assert all(a is b for one, other in zip(first, again, strict=True) for a, b in zip(one, other, strict=True))


def test_tables_do_not_fill_the_memory(monkeypatch):
    monkeypatch.setattr(directions_module, "_MOST_BYTES", 1)
    directions = direction_set(20)
    kept = directions.tables(1)
    directions.tables(2)
    assert directions.tables(1) is kept  # the last two always
    directions.tables(2)
    directions.tables(3)
    assert directions.tables(1) is not kept
