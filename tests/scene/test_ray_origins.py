"""Where rays start: contacts, leaves, details of large surfaces, and parts far away; against closed forms."""

import math

import numpy as np
import pytest
import trimesh

from slepian_prt.scene.loading import open_scene
from slepian_prt.scene.mesh import make_mesh
from slepian_prt.transport.transfer import precompute
from tests.hard.test_geometry import ambient, grid, joined


def bowl(subdivisions: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """The lower half of a sphere, facing inward: each of its points sees half of the sky."""
    ball = trimesh.creation.icosphere(subdivisions)
    lower = (ball.vertices[ball.faces][:, :, 2] <= 1e-9).all(axis=1)
    used, faces = np.unique(ball.faces[lower][:, ::-1], return_inverse=True)
    return ball.vertices[used], faces.reshape(-1, 3)


def drum(sections: int = 24) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A closed cylinder of radius 1 on the plane z = 0, welded; and which vertices are its lower rim."""
    profile = [(0, 0), (0.5, 0), *((1, z) for z in np.linspace(0, 2, 5)), (0.5, 2), (0, 2)]
    shape = trimesh.creation.revolve(profile, sections=sections)
    rim = (np.abs(shape.vertices[:, 2]) < 1e-9) & (np.linalg.norm(shape.vertices, axis=1) > 0.9)
    return np.array(shape.vertices), np.array(shape.faces), rim


def slab(size: float) -> tuple[np.ndarray, np.ndarray]:
    box = trimesh.creation.box((size, size, 1.0)).subdivide().subdivide().subdivide()
    return box.vertices - [0.0, 0.0, 0.5], box.faces


def rotation(rng) -> np.ndarray:
    q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return q * np.linalg.det(q)


@pytest.mark.parametrize("floor", ["sheet", "slab", "triangles"])
@pytest.mark.parametrize("turned", [False, True])
def test_a_drum_on_a_floor(floor, turned, rng):
    """Its rim leans down by the angle of its normal, and sees what of that hemisphere is above the floor."""
    positions, faces, rim = drum()
    ground = {"sheet": grid(40, 40.0), "slab": slab(40.0), "triangles": grid(1, 40.0)}[floor]
    p, f = joined((positions, faces), ground)
    mesh = make_mesh(p, f)
    down = mesh.normals[: len(rim)][rim][:, 2]
    if turned:
        mesh = make_mesh(p @ rotation(rng).T + [300.0, -200.0, 100.0], f)
    light = ambient(mesh, 512)[: len(rim)][rim]
    # Above the horizon of the floor a tilted hemisphere has (1 + cos)/2 of its light. The floor ends 20 away and lets
    # in 1/20 of the half that looks at it, in one plane of the sky; the horizon is known as in test_directions.
    np.testing.assert_allclose(light, 0.5 * (1.0 + down), atol=0.02)


@pytest.mark.parametrize("height", [-1e-3, -1e-6, 1e-6, 1e-5, 1e-3])
@pytest.mark.parametrize("floor", ["sheet", "slab"])
def test_a_drum_almost_on_a_floor(height, floor):
    """A little sunk or afloat, no light leaks in from below: there the rim would see most of the sky, 0.85."""
    positions, faces, rim = drum()
    ground = grid(40, 40.0) if floor == "sheet" else slab(40.0)
    light = ambient(make_mesh(*joined((positions + [0.0, 0.0, height], faces), ground)), 256)[: len(rim)][rim]
    assert light.min() > 0.12
    assert light.max() < 0.53  # sunk: as the next row, whose normals are level


def test_one_block_on_another():
    """At the edge between two blocks of one size both see past the other: three quarters of the sky and a quarter."""
    block = trimesh.creation.box().subdivide().subdivide().subdivide()
    upper = block.vertices + [0.0, 0.0, 1.0]
    p, f = joined((block.vertices, block.faces), (upper, block.faces))
    light = ambient(make_mesh(p, f), 512)
    middle = (np.abs(p[:, 2] - 0.5) < 1e-9) & (np.abs(np.abs(p[:, 0]) - 0.5) < 1e-9) & (np.abs(p[:, 1]) < 0.3)
    assert middle.sum() > 8
    # Beside one plane wall, tilted by 45° to it: (1 + cos 45°)/2.
    np.testing.assert_allclose(light[middle], 0.5 * (1.0 + math.sqrt(0.5)), atol=0.02)


@pytest.mark.parametrize("size", [20.0, 1000.0, 20000.0])
def test_a_trench_in_a_large_terrain(size):
    """In the middle of a long trench as deep as wide, sin(arctan 1/2) of the light comes in, whatever the rest."""
    w = 0.1
    edge = [(-size / 2, 0), (-size / 4, 0), (-0.06, 0), *((-w / 2, -w * k / 4) for k in range(5))]
    profile = np.array([*edge, (-w / 4, -w), (0, -w), (w / 4, -w), *((-x, z) for x, z in reversed(edge))])
    along = np.array([-size / 2, -size / 4, -5, -1, -0.5, 0, 0.5, 1, 5, size / 4, size / 2])
    p = np.array([[x, y, z] for x, z in profile for y in along])
    index = np.arange(len(p)).reshape(len(profile), len(along))
    a, b, c, d = (part.ravel() for part in (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]))
    f = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    light = ambient(make_mesh(p, f), 512)
    bottom = np.argmin(np.linalg.norm(p - [0.0, 0.0, -w], axis=1))
    assert light[bottom] == pytest.approx(math.sin(math.atan(0.5)), abs=0.015)


@pytest.mark.parametrize("angle", [0.0, 0.3, 1.0, 2.5])
@pytest.mark.parametrize("tilt", [0.0, 0.2])
def test_leaves_whose_normals_point_up(angle, tilt):
    """A plane sheet cannot shade itself, whatever way its normals look along it."""
    positions, faces = grid(6)
    card = positions[:, [0, 2, 1]] @ trimesh.transformations.rotation_matrix(angle, [0, 0, 1])[:3, :3].T
    across = np.cross(card[7] - card[0], [0.0, 0.0, 1.0])
    up = np.array([0.0, 0.0, 1.0]) + tilt * across / np.linalg.norm(across)
    np.testing.assert_allclose(
        ambient(make_mesh(card, faces, normals=np.tile(up, (len(card), 1))), 256), 1.0, atol=1e-5
    )


def test_tilted_normals_of_a_floor_do_not_look_through_it():
    """Only normals along the surface say nothing of its side: others keep what is behind it out."""
    positions, faces = grid(8)
    tilted = np.tile([math.sin(0.5), 0.0, math.cos(0.5)], (len(positions), 1))
    light = ambient(make_mesh(positions, faces, normals=tilted), 1024)
    inner = np.abs(positions).max(axis=1) < 0.1  # others see past the border
    np.testing.assert_allclose(light[inner], 0.5 * (1.0 + math.cos(0.5)), atol=5e-3)


@pytest.mark.parametrize("far", [1e3, 1e6, 1e9])
@pytest.mark.parametrize("used", [False, True])
def test_a_vertex_or_part_far_away(far, used, caplog):
    """What no face uses does not count; and a part far away does not make the rest coarse."""
    positions, faces = bowl()
    p, f = joined((positions, faces), (np.array([[far, 0, 0], [far, 1, 0], [far, 0, 1.0]]), np.array([[0, 1, 2]])))
    with caplog.at_level("INFO"):
        light = ambient(make_mesh(p, f if used else faces), 256)
    below = positions[:, 2] < -0.4  # at the rim normals lean
    np.testing.assert_allclose(light[: len(positions)][below], 0.5, atol=0.02)
    assert ("float32" in caplog.text) == (used and far > 1e5)


@pytest.mark.parametrize("at", [(0.0, 0.0, 0.0), (3000.0, 100.0, 4000.0), (500000.0, 100.0, 5400000.25)])
def test_a_scene_in_map_coordinates(at, tmp_path):
    """An .xml scene is traced about its own middle, and stands in the file where it was."""
    positions, faces = bowl()
    trimesh.Trimesh(positions, faces, process=False).export(tmp_path / "bowl.ply")
    x, y, z = at
    path = tmp_path / "scene.xml"
    path.write_text(
        f"""<scene version="3.0.0"><shape type="ply"><string name="filename" value="bowl.ply"/>
        <transform name="to_world"><translate x="{x}" y="{y}" z="{z}"/></transform><bsdf type="diffuse"/></shape>
        <sensor type="perspective"><transform name="to_world"><lookat origin="{x}, {y + 4}, {z}"
        target="{x}, {y}, {z}" up="0, 0, 1"/></transform></sensor></scene>"""
    )
    transfer = precompute(path, 2, 256, effects="direct")
    light = transfer.vectors[:, 0, 0] * math.sqrt(4.0 * math.pi)
    np.testing.assert_allclose(light[positions[:, 2] < -0.4], 0.5, atol=0.02)
    np.testing.assert_allclose(transfer.positions, positions + at, atol=3e-4)  # half a step of float32 at 4,000
    with open_scene(path) as scene:
        np.testing.assert_allclose(np.array(scene.view.to_world)[:3, 3], np.array(at) + [0.0, 4.0, 0.0], atol=1e-3)


def test_no_ray_starts_below_its_surface():
    """Of a convex shape no vertex is blocked, wherever it is and however fine."""
    for subdivisions, shift in ((2, 0.0), (4, 0.0), (4, 20.0)):
        ball = trimesh.creation.icosphere(subdivisions)
        mesh = make_mesh(ball.vertices.astype(np.float32).astype(np.float64) + shift, ball.faces)
        with open_scene(mesh) as scene:
            chosen = np.arange(len(mesh.positions))
            mi, origins = scene.mi, np.repeat(scene.ray_origins.front[chosen], 64, axis=0)
            local = np.random.default_rng(0).normal(size=(len(origins), 3))
            local *= np.sign(np.einsum("ij,ij->i", local, np.repeat(mesh.normals, 64, axis=0)))[:, None]
            local /= np.linalg.norm(local, axis=1, keepdims=True)
            rays = mi.Ray3f(mi.Point3f(origins.T.astype(np.float32)), mi.Vector3f(local.T.astype(np.float32)))
            assert not np.array(scene.geometry.ray_test(rays)).any()


def test_a_convex_scene_still_traces_no_ray():
    assert precompute(make_mesh(*slab(1.0)), 2, 64).rays_traced == 0
