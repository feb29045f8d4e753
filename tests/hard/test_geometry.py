"""Geometry that breaks renderers: transport stays finite, right where the answer is known, and says what it mended."""

import math

import numpy as np
import pytest
import trimesh

from slepian_prt.relighting.relight import relight
from slepian_prt.scene.mesh import make_mesh
from slepian_prt.sphere.rotation import rotate_sh
from slepian_prt.transport.transfer import precompute
from tests.conftest import bumpy, inside_out, sphere
from tests.numerics import assert_rounded

AMBIENT = math.sqrt(4 * math.pi)


def ambient(mesh, samples: int = 1024, **options) -> np.ndarray:
    transfer = precompute(mesh, 2, samples, **options)
    assert np.isfinite(transfer.vectors).all()
    return transfer.vectors[:, 0, 0].astype(np.float64) * AMBIENT


def grid(n: int, size: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """A square in the plane z = 0 about the origin, facing up."""
    x, y = np.meshgrid(*2 * [np.linspace(-size / 2, size / 2, n + 1)], indexing="ij")
    index = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    a, b, c, d = (part.ravel() for part in (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]))
    positions = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    return positions, np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])


def joined(*parts: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    positions = np.concatenate([p for p, _ in parts])
    starts = np.cumsum([0, *(len(p) for p, _ in parts[:-1])])
    return positions, np.concatenate([f + start for (_, f), start in zip(parts, starts, strict=True)])


def test_a_sharp_concave_edge_sees_half():
    """Two walls at a right angle: at their common edge, each fills half of the other's sky, whatever their size."""
    floor_p, faces = grid(40, 20.0)
    wall_p = floor_p[:, [0, 2, 1]] * [1, 1, 1] + [0.0, 10.0, 10.0]
    positions, both = joined((floor_p, faces), (wall_p, faces))  # the wall at y = 10 faces -y
    light = ambient(make_mesh(positions, both))
    on_edge = np.abs(positions[:, 1] - 10.0) + np.abs(positions[:, 2]) < 1e-9
    middle = on_edge & (np.abs(positions[:, 0]) < 1.0)
    assert middle.sum() >= 4
    # Rays start 3e-3 inside; beyond the wall's ends, 10 away, lies less than (3e-3 / 10) of the sky. The horizon of the
    # wall is a straight line through the middle of the disk: see test_directions for 900 nodes, times three.
    np.testing.assert_allclose(light[middle], 0.5, atol=3e-3)


def test_a_welded_concave_edge():
    """The same edge with one vertex for both walls: its normal leans, and it sees what lies between them."""
    positions, faces = grid(20, 2.0)
    folded = positions.copy()
    behind = positions[:, 1] > 0
    folded[behind, 2], folded[behind, 1] = positions[behind, 1], 0.0
    light = ambient(make_mesh(folded, faces))
    inner = (np.abs(positions[:, 1]) < 1e-9) & (np.abs(positions[:, 0]) < 0.3)
    # Walls 45° to either side of the normal leave, cosine-weighted, (sin 45° - sin -45°)/2.
    np.testing.assert_allclose(light[inner], math.sin(math.pi / 4), atol=5e-3)


def test_inside_a_crack():
    """Two walls 1e-3 apart: their inner sides are dark but not black at the rim, and nothing leaks through."""
    n = 24
    positions, faces = grid(n)
    left = positions[:, [2, 0, 1]] + [0.0, 0.0, 0.0]  # in the plane x = 0, facing +x
    right = left * [1, 1, 1] + [1e-3, 0.0, 0.0]
    p, f = joined((left, faces), (right, faces[:, ::-1]))
    light = ambient(make_mesh(p, f))
    inner = (np.abs(p[:, 1:]) < 0.3).all(axis=1)
    assert light[inner].max() < 0.01


def test_duplicated_vertices_keep_their_own_normals():
    box = trimesh.creation.box()
    split = make_mesh(box.vertices[box.faces].reshape(-1, 3), np.arange(36).reshape(-1, 3))
    transfer = precompute(split, 2, 64)
    assert transfer.rays_traced == 0
    np.testing.assert_allclose(np.abs(transfer.normals).max(axis=1), 1.0)  # hard edges


@pytest.mark.parametrize("spoil", ["inverted", "zero", "nan", "some inverted"])
def test_bad_normals(spoil):
    mesh = bumpy(3)
    normals = mesh.normals.copy()
    if spoil == "inverted":
        normals = -normals
    elif spoil == "some inverted":
        normals[::7] *= -1
    else:
        normals[::3] = 0.0 if spoil == "zero" else np.nan
    light = ambient(make_mesh(mesh.positions, mesh.faces, normals=normals), 256)
    assert (light >= -1e-5).all()
    assert (light <= 1.0 + 1e-5).all()
    if spoil in ("zero", "nan"):  # mended: as if they had not been given
        np.testing.assert_allclose(light, ambient(make_mesh(mesh.positions, mesh.faces), 256), atol=0.05)
    elif spoil == "inverted":  # from inside, a closed surface sees no light
        assert np.abs(light).max() < 0.02


def test_a_two_sided_thin_sheet():
    """Two sheets back to back at the same place: neither shadows the other."""
    positions, faces = grid(12)
    p, f = joined((positions, faces), (positions, faces[:, ::-1]))
    np.testing.assert_allclose(ambient(make_mesh(p, f), 256), 1.0, atol=1e-4)


def test_interpenetrating_parts():
    """What of one ball lies inside the other is dark; the rest is as if it were alone, but for the other's shadow."""
    a, b = trimesh.creation.icosphere(4), trimesh.creation.icosphere(4)
    shift = np.array([1.0, 0.0, 0.0])
    p, f = joined((a.vertices, a.faces), (b.vertices + shift, b.faces))
    light = ambient(make_mesh(p, f), 512)
    first, second = light[: len(a.vertices)], light[len(a.vertices) :]
    inside = np.linalg.norm(a.vertices - shift, axis=1) < 0.9  # those at the border borrow light from outside
    assert inside.any()
    assert first[inside].max() < 0.01
    away = a.vertices[:, 0] < -0.2
    np.testing.assert_allclose(first[away], 1.0, atol=2e-3)
    # Mirror images see mirror images.
    assert first.mean() == pytest.approx(second.mean(), abs=2e-3)


def test_no_teeth_around_a_block_on_a_floor():
    """Floor vertices under the block borrow from outside, so that nothing dark shows beside it."""
    positions, faces = grid(40, 4.0)
    block = trimesh.creation.box(extents=(1.0, 1.0, 1.0))
    block.apply_transform(trimesh.transformations.rotation_matrix(0.4, [0, 0, 1]))
    block = block.subdivide().subdivide().subdivide()
    p, f = joined((positions, faces), (block.vertices + [0.0, 0.0, 0.5], block.faces))
    light = ambient(make_mesh(p, f, normals=None), 512)[: len(positions)]
    turned = np.abs(positions[:, :2] @ np.array([[math.cos(0.4), -math.sin(0.4)], [math.sin(0.4), math.cos(0.4)]]))
    outside = (turned > 0.5).any(axis=1)
    seen = np.zeros(len(positions), dtype=bool)  # vertices of triangles that reach out from under the block
    seen[faces[outside[faces].any(axis=1)]] = True
    assert (seen & ~outside).sum() > 20
    assert light[seen].min() > 0.3  # beside a wall at least half is open, less what its height closes
    deep = (turned < 0.3).all(axis=1)
    assert light[deep].max() == 0.0


def test_needles_slivers_and_empty_triangles():
    base = trimesh.creation.icosphere(3)
    v = len(base.vertices)
    extra = np.array([[1.5, 0, 0], [1.5 + 1e-7, 2, 0], [1.5, 4, 0], [2, 2, 2], [2, 2, 2], [2, 2, 2]])
    faces = np.concatenate([base.faces, [[v, v + 1, v + 2], [v + 3, v + 4, v + 5], [0, 0, 1]]])
    light = ambient(make_mesh(np.concatenate([base.vertices, extra]), faces), 256)
    assert (light[:v] > 0.9).all()
    assert light[v + 3] == 0.0  # of no area: receives nothing


def test_a_small_model_beside_a_large_floor():
    """1e-4 beside 1e4 is as 1 beside 1e3: offsets follow the model, not the box around everything."""
    small = bumpy(3)

    def beside_floor(model: float, floor: float) -> np.ndarray:
        floor_p, floor_f = grid(4, floor)
        p, f = joined((floor_p, floor_f), (model * (small.positions + [0.0, 0.0, 2.0]), small.faces))
        return ambient(make_mesh(p, f), 1024)[len(floor_p) :]

    np.testing.assert_allclose(beside_floor(0.5e-4, 1e4), beside_floor(0.5, 1e3), atol=0.02)


@pytest.mark.slow
def test_closed_geometry_around_is_exactly_dark():
    """Not one leaking ray, whatever shape the room has."""
    for room in (inside_out(sphere(4)), inside_out(bumpy(4))):
        assert not precompute(room, 3, 1024).vectors.any()
    # A ball in a closed box of outward faces.
    ball, box = trimesh.creation.icosphere(3), trimesh.creation.box(extents=(3, 3, 3))
    p, f = joined((ball.vertices, ball.faces), (box.vertices, box.faces))
    assert not precompute(make_mesh(p, f), 3, 256).vectors[: len(ball.vertices)].any()


# --- Invariance ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("scale", "shift"), [(1e-3, 0.0), (1e4, 0.0), (1.0, 1e4), (1e-3, 1e1)])
def test_scale_and_translation(scale, shift):
    mesh = bumpy(3)
    moved = make_mesh(mesh.positions * scale + shift * np.array([1.0, -2.0, 0.5]), mesh.faces)
    base, other = (precompute(m, 4, 256, albedo=0.6).vectors for m in (mesh, moved))
    # float64 positions lose 1e-16 of the shift; a ray that grazes an edge may still change its mind.
    assert (np.abs(base - other).max(axis=(1, 2)) > 1e-4).mean() < 0.03
    assert np.linalg.norm(base - other) <= 2e-3 * np.linalg.norm(base)


def test_vertex_order(rng):
    """Another numbering turns the direction sets otherwise: the same within sampling error, in the mean far better."""
    mesh = bumpy(4)
    order = rng.permutation(len(mesh.positions))
    inverse = np.argsort(order)
    shuffled = make_mesh(mesh.positions[order], inverse[mesh.faces][rng.permutation(len(mesh.faces))])
    base, other = (precompute(m, 4, 512, albedo=0.5).vectors for m in (mesh, shuffled))
    assert np.linalg.norm(base[order] - other) < 0.01 * np.linalg.norm(base)
    assert base[:, 0, 0].mean() == pytest.approx(other[:, 0, 0].mean(), rel=3e-4)


def test_rotation_of_scene_and_light_together(rng):
    mesh = bumpy(3)
    q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    q *= np.linalg.det(q)
    turned = make_mesh(mesh.positions @ q.T, mesh.faces)
    light = rng.normal(size=(3, 25))
    light[:, 0] += 5.0
    still = relight(precompute(mesh, 4, 1024), light)
    moved = relight(precompute(turned, 4, 1024), rotate_sh(light, q))
    assert np.linalg.norm(still - moved) < 0.01 * np.linalg.norm(still)


def test_threads_do_not_matter():
    """Blocks are finished in order, and the sums in them do not depend on who computes them."""
    import drjit as dr

    mesh = bumpy(3)
    many = precompute(mesh, 4, 256, albedo=0.5)
    before = dr.thread_count()
    try:
        dr.set_thread_count(1)
        one = precompute(mesh, 4, 256, albedo=0.5)
    finally:
        dr.set_thread_count(before)
    assert many.rays_traced == one.rays_traced
    assert_rounded(many.vectors, one.vectors, terms=256 + 64 * one.bounces, size=1.0)
