"""Light where things touch, cross or coincide, against brute force in float64 from the side that is seen."""

import math

import numpy as np
import pytest
import trimesh

from slepian_prt.scene.mesh import make_mesh
from tests.hard.test_geometry import ambient, grid, joined

SAMPLES = 512
# The coarse horizon of a few facets, with 512 rays that find it to a quarter of an edge, and as many of brute force.
NOISE = 0.025


def slab(size: float) -> tuple[np.ndarray, np.ndarray]:
    box = trimesh.creation.box((size, size, 1.0)).subdivide().subdivide().subdivide()
    return box.vertices - [0.0, 0.0, 0.5], box.faces


def floor_of(kind: str) -> tuple[np.ndarray, np.ndarray]:
    return {"sheet": grid(8, 20.0), "triangles": grid(1, 20.0), "slab": slab(20.0)}[kind]


def brute_force(mesh, vertices, beside) -> np.ndarray:
    """Cosine-weighted part of the sky that points near vertices see; rays meet triangles as of Möller and Trumbore."""
    k = np.arange(SAMPLES) + 0.5
    radius, phi = np.sqrt(k / SAMPLES), math.pi * (1.0 + math.sqrt(5.0)) * k
    local = np.column_stack([radius * np.cos(phi), radius * np.sin(phi), np.sqrt(1.0 - radius**2)])
    corner = mesh.positions[mesh.faces]
    first, second = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    result = []
    for vertex, origin in zip(vertices, mesh.positions[vertices] + beside, strict=True):
        z = mesh.normals[vertex]
        x = np.cross(z, np.eye(3)[np.argmin(np.abs(z))])
        x /= np.linalg.norm(x)
        d = local @ np.array([x, np.cross(z, x), z])
        p = np.cross(d[:, None], second[None])
        determinant = np.einsum("fc,dfc->df", first, p)
        apart = origin - corner[:, 0]
        q = np.cross(apart, first)
        with np.errstate(divide="ignore", invalid="ignore"):
            u = np.einsum("fc,dfc->df", apart, p) / determinant
            v = d @ q.T / determinant
            t = np.einsum("fc,fc->f", second, q) / determinant
            hit = (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (t > 0.0)
        result.append(1.0 - hit.any(axis=1).mean())
    return np.array(result)


def light_of(mesh) -> np.ndarray:
    return ambient(mesh, SAMPLES, effects="direct")


@pytest.mark.slow
@pytest.mark.parametrize("floor", ["sheet", "triangles", "slab"])
@pytest.mark.parametrize("hard", [False, True])
def test_legs_of_a_table(floor, hard):
    """The lowest vertices of the legs see what is above the floor and beside the leg; none sees under the floor."""

    def box(size, at):
        shape = trimesh.creation.box(size).subdivide()
        if hard:
            shape.unmerge_vertices()
        return shape.vertices + at, shape.faces

    legs = [box((0.2, 0.2, 2.0), [x, y, 1.0]) for x in (-1.0, 1.0) for y in (-1.0, 1.0)]
    mesh = make_mesh(*joined(*legs, box((3.0, 3.0, 0.2), [0.0, 0.0, 2.1]), floor_of(floor)))
    count = sum(len(p) for p, _ in legs)
    p, normals = mesh.positions[:count], mesh.normals[:count]
    low = np.flatnonzero((np.abs(p[:, 2]) < 1e-9) & (normals[:, 2] > -0.9))[:: 3 if hard else 2]
    out = p[low, :2] - np.sign(p[low, :2])
    at_side = np.abs(np.abs(out) - 0.1) < 1e-9
    own = np.abs(normals[low, :2]) > 0.5  # the side that a vertex of a hard edge belongs to
    beside = np.where(at_side & (own if hard else True), 1e-5, np.where(at_side, -1e-5, 0.0)) * np.sign(out)
    expected = brute_force(mesh, low, np.column_stack([beside, np.full(low.size, 1e-6)]))
    np.testing.assert_allclose(light_of(mesh)[low], expected, atol=NOISE)


@pytest.mark.slow
@pytest.mark.parametrize("floor", ["sheet", "slab"])
def test_a_wheel_on_a_floor(floor):
    """A torus that stands on a single vertex."""
    wheel = trimesh.creation.torus(1.0, 0.3, 24, 12)
    v = wheel.vertices[:, [0, 2, 1]] * [1.0, -1.0, 1.0]
    mesh = make_mesh(*joined((v - [0.0, 0.0, v[:, 2].min()], wheel.faces), floor_of(floor)))
    low = np.flatnonzero(mesh.positions[: len(v), 2] < 0.3)
    beside = 1e-6 * mesh.normals[low]
    beside[:, 2] = np.maximum(beside[:, 2], 1e-7 - mesh.positions[low, 2])
    light, expected = light_of(mesh)[low], brute_force(mesh, low, beside)
    touching = np.argmin(mesh.positions[low, 2])
    assert expected[touching] == 0.0
    assert light[touching] < 0.06  # it takes the mean of its neighbours
    np.testing.assert_allclose(np.delete(light, touching), np.delete(expected, touching), atol=NOISE)


@pytest.mark.slow
def test_a_vase_on_a_table():
    """Its wall leans out over the foot's rim: the wedge between them is no gap."""
    profile = [(0, 0), (0.5, 0), (0.6, 0.2), (1, 0.8), (0.9, 1.5), (0.85, 1.5), (0.9, 0.85), (0.5, 0.2), (0, 0.1)]
    vase = trimesh.creation.revolve(np.array(profile), sections=20)
    mesh = make_mesh(*joined((vase.vertices, vase.faces), slab(8.0)))
    p = mesh.positions[: len(vase.vertices)]
    rim = np.flatnonzero((np.abs(p[:, 2]) < 1e-9) & (np.linalg.norm(p[:, :2], axis=1) > 0.4))
    others = np.flatnonzero(p[:, 2] > 0.1)[::4]
    light = light_of(mesh)
    np.testing.assert_allclose(light[rim], brute_force(mesh, rim, p[rim] * 1e-5 + [0.0, 0.0, 1e-7]), atol=NOISE)
    np.testing.assert_allclose(light[others], brute_force(mesh, others, 1e-6 * mesh.normals[others]), atol=NOISE)


@pytest.mark.slow
@pytest.mark.parametrize("thickness", [0.2, 0.01])
def test_a_plank_that_leans_on_a_wall(thickness):
    """It touches floor and wall along edges: there it sees one of the wedges that are left, and nothing behind them."""
    angle, length = math.radians(60.0), 2.0
    plank = trimesh.creation.box((length, 1.0, thickness)).subdivide().subdivide()
    v = plank.vertices + [length / 2, 0.0, thickness / 2]
    up, across = [-math.cos(angle), 0.0, math.sin(angle)], [math.sin(angle), 0.0, math.cos(angle)]
    v = v @ np.array([up, [0.0, 1.0, 0.0], across]) + [length * math.cos(angle), 0.0, 0.0]
    ground, faces = grid(8, 8.0)
    wall = ground[:, [2, 1, 0]] + [0.0, 0.0, 4.0], faces[:, ::-1]
    mesh = make_mesh(*joined((v, plank.faces[:, ::-1]), (ground, faces), wall))  # the axes are left-handed
    assert np.einsum("ij,ij->i", mesh.normals[: len(v)], v - v.mean(axis=0)).min() > 0.0
    light = light_of(mesh)
    touches = np.minimum(v[:, 0], v[:, 2]) < 1e-9
    free = np.flatnonzero(~touches)[::3]
    np.testing.assert_allclose(light[free], brute_force(mesh, free, 1e-6 * mesh.normals[free]), atol=NOISE)
    for axis, wedges in ((2, ([-1e-5, 0.0, 1e-6], [1e-5, 0.0, 1e-6])), (0, ([1e-6, 0.0, -1e-5], [1e-6, 0.0, 1e-5]))):
        inner = np.flatnonzero((v[:, axis] < 1e-9) & (np.abs(v[:, 1]) < 0.4))
        sides = [brute_force(mesh, inner, np.tile(beside, (inner.size, 1))) for beside in wedges]
        assert inner.size == 3
        assert (light[inner] > np.min(sides, axis=0) - NOISE).all()
        assert (light[inner] < np.max(sides, axis=0) + NOISE).all()


@pytest.mark.parametrize("kind", ["twice", "patch", "turned patch", "patch on triangles", "back to back", "1e-7 above"])
def test_what_lies_in_one_plane_does_not_darken_itself(kind):
    """Decals, and faces that a file has twice: each sees all of its sky."""
    ground, faces = grid(10, 2.0)
    patch, pieces = grid(7, 1.0)
    turned = patch @ trimesh.transformations.rotation_matrix(0.3, [0, 0, 1])[:3, :3].T
    p, f = {
        "twice": lambda: joined((ground, faces), (ground, faces)),
        "patch": lambda: joined((ground, faces), (patch, pieces)),
        "turned patch": lambda: joined((ground, faces), (turned, pieces)),
        "patch on triangles": lambda: joined(grid(1, 2.0), (patch, pieces)),
        "back to back": lambda: joined((ground, faces), (ground, faces[:, ::-1])),
        "1e-7 above": lambda: joined((ground, faces), (patch + [0.0, 0.0, 1e-7], pieces)),
    }[kind]()
    ball = trimesh.creation.icosphere(1, 0.1)  # so that rays are traced at all; it takes (0.1 / 30)² of the light
    light = light_of(make_mesh(*joined((p, f), (ball.vertices + [0.0, 0.0, 30.0], ball.faces))))
    np.testing.assert_allclose(light[: len(p)], 1.0, atol=2e-3)


@pytest.mark.parametrize("cells", [7, 8])
def test_cards_that_cross_at_right_angles(cells):
    """Vertices beside the line see past the other card; those on it, one quarter of all directions of two."""
    square, faces = grid(cells)
    mesh = make_mesh(*joined((square[:, [0, 2, 1]], faces), (square[:, [2, 0, 1]], faces)))
    p, light = mesh.positions, light_of(mesh)
    on_line = (np.abs(p[:, :2]) < 1e-9).all(axis=1)
    inner = on_line & (np.abs(p[:, 2]) < 0.49)
    # The other card reaches as far on both sides; beyond its edge, and above and below it, its plane would be open,
    # but for a point on it, it fills the whole half of the sky.
    np.testing.assert_allclose(light[inner], 0.5, atol=NOISE)
    some = np.flatnonzero(~on_line)[::3]
    np.testing.assert_allclose(light[some], brute_force(mesh, some, 1e-6 * mesh.normals[some]), atol=NOISE)


@pytest.mark.parametrize("height", [0.3, 1.0])
def test_a_crumpled_sheet(height, rng):
    """Within it; at its border other faces than the nearest are ambiguous."""
    flat, faces = grid(16, 2.0)
    p = flat + rng.normal(size=flat.shape) * np.array([0.02, 0.02, 0.125 * height])
    mesh = make_mesh(p, faces)
    some = np.flatnonzero((np.abs(flat[:, :2]) < 0.9).all(axis=1))[::5]
    np.testing.assert_allclose(light_of(mesh)[some], brute_force(mesh, some, 1e-6 * mesh.normals[some]), atol=NOISE)


@pytest.mark.parametrize("length", [10.0, 1e3, 1e5])
def test_a_needle(length):
    """Nothing of a tetrahedron is above the tangent planes of its vertices, however thin it is."""
    corners = np.array([[0, 0, length], [1, 0, 0], [-0.5, 0.75**0.5, 0], [-0.5, -(0.75**0.5), 0.0]])
    np.testing.assert_allclose(
        light_of(make_mesh(corners, [[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]])), 1.0, atol=1e-6
    )
