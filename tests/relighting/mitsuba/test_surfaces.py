"""Which surface of a file a pixel shows: each is told by the albedo that the test gives it."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy.ndimage import binary_erosion

import slepian_prt as sp
from slepian_prt.compression.stored_mesh.stored import store_mesh
from slepian_prt.relighting.mitsuba.scene_integrator import scene_integrator
from slepian_prt.scene.mesh import make_mesh
from slepian_prt.scene.scene import Part
from tests.relighting.mitsuba.scenes import camera, messages, picture

SQUARE = np.array([[-1.0, 0.0, -1.0], [-1.0, 0.0, 1.0], [1.0, 0.0, 1.0], [1.0, 0.0, -1.0]])
FACES = np.array([[0, 1, 2], [0, 2, 3]])
WIDTH = 64
LIGHT = np.sqrt(4.0 * np.pi) * np.eye(1, 4).repeat(3, axis=0)


def file_of(*parts):
    """A file of parts (name, vertices, faces, albedo, sides) that all get light of 1."""
    positions = np.concatenate([vertices for _, vertices, _, _, _ in parts])
    firsts = np.cumsum([0, *(len(vertices) for _, vertices, _, _, _ in parts)])
    faces = np.concatenate([some + first for (_, _, some, _, _), first in zip(parts, firsts, strict=False)])
    packed = sp.compress(sp.precompute(make_mesh(positions, faces), 1, 16, effects="none"), clusters=1)
    albedo = np.concatenate([np.broadcast_to(one, (len(vertices), 3)) for _, vertices, _, one, _ in parts])
    named = tuple(
        Part(name, int(first), len(vertices) // sides, sides)
        for (name, vertices, _, _, sides), first in zip(parts, firsts, strict=False)
    )
    stored = store_mesh(replace(packed.mesh, albedo=albedo.astype(np.float32)), named)
    return replace(packed, mesh=stored.mesh, stored=stored, parts=named)


def written(path, vertices, faces):
    trimesh.Trimesh(vertices, faces, process=False).export(path)
    return {"type": "ply", "filename": str(path), "face_normals": True}


def drawn(mi, packed, shapes, origin=(0.0, 2.0, 3.0), optimize=False, **lookat):
    """Linear radiance, black but for what the file holds, and where its pixels lie."""
    target = lookat.get("target", [0, 0, 0])
    scene = mi.load_dict({
        "type": "scene", **shapes,
        "sensor": camera(mi, WIDTH) | {"to_world": mi.ScalarTransform4f().look_at(origin, target, [0, 1, 0])},
    }, optimize=optimize)  # fmt: skip
    middle = (np.arange(WIDTH, dtype=np.float32) + 0.5) / WIDTH
    x, y = (axis.ravel() for axis in np.meshgrid(middle, middle))
    ray, _ = scene.sensors()[0].sample_ray(0.0, 0.5, mi.Point2f(x, y), mi.Point2f(0.5, 0.5))
    si = scene.ray_intersect(ray)
    places = np.where(np.array(si.is_valid()), np.array(si.p), np.nan).T.reshape(WIDTH, WIDTH, 3)
    own = scene_integrator(mi, packed, lighting=LIGHT, albedo="file")
    return picture(mi, scene, integrator=own, spp=16), places


def inside(values):
    """Where a pixel and all around it, two each way, are ``True``."""
    return np.asarray(binary_erosion(values, np.ones((5, 5))))


@pytest.mark.parametrize("merged", [False, True])
@pytest.mark.parametrize("gap", [1e-3, 0.05, 0.3])
def test_a_table_is_not_the_floor_under_it(merged, gap, mi, tmp_path):
    """However large their faces are, and in whatever mesh Mitsuba has put them."""
    top = SQUARE * 0.5 + [0, gap, 0]
    packed = file_of(("floor", SQUARE, FACES, 0.9, 1), ("top", top, FACES, 0.3, 1))
    both = np.concatenate([SQUARE, top]), np.concatenate([FACES, FACES + 4])
    shapes = {
        "floor": written(tmp_path / "floor.ply", SQUARE, FACES),
        "top": written(tmp_path / "top.ply", top, FACES),
    }
    if merged:
        shapes = {"any": written(tmp_path / "both.ply", *both)}
    pixels, places = drawn(mi, packed, shapes)
    on_top, on_floor = (inside(np.abs(places[..., 1] - y) < 0.3 * gap) for y in (gap, 0.0))
    assert min(on_top.sum(), on_floor.sum()) > 20
    np.testing.assert_allclose(pixels[on_top], 0.3, atol=2e-3)
    np.testing.assert_allclose(pixels[on_floor], 0.9, atol=2e-3)


def test_what_lies_on_a_held_surface_is_not_held(mi, tmp_path):
    """A rug that the file does not know, on a floor of two faces whose shape was renamed."""
    packed = file_of(("floor", SQUARE, FACES, 0.9, 1))
    rug = written(tmp_path / "rug.ply", *trimesh.remesh.subdivide(SQUARE * 0.5 + [0, 0.01, 0], FACES))
    rug["bsdf"] = {"type": "diffuse", "reflectance": 0.0}
    floor = written(tmp_path / "floor.ply", *trimesh.remesh.subdivide(SQUARE, FACES))
    pixels, places = drawn(
        mi, packed, {"renamed": floor, "rug": rug | {"bsdf": {"type": "diffuse", "reflectance": 0.0}}}
    )
    on_rug, on_floor = inside(places[..., 1] > 0.005), inside(places[..., 1] < 0.005)
    assert min(on_rug.sum(), on_floor.sum()) > 20
    np.testing.assert_allclose(pixels[on_rug], 0.0, atol=1e-6)
    np.testing.assert_allclose(pixels[on_floor], 0.9, atol=2e-3)


@pytest.mark.parametrize("moved", [False, True])
def test_a_mesh_that_the_file_has_cut_finer(moved, mi, tmp_path):
    """Its first vertices are those of the scene; between all of them what is held is interpolated."""
    cut, faces = trimesh.remesh.subdivide(*trimesh.remesh.subdivide(SQUARE, FACES))
    assert np.allclose(cut[:4], SQUARE)
    across = 0.5 + 0.4 * cut[:, [0, 0, 2]]
    packed = file_of(("floor", cut, faces, across, 1))
    floor = written(tmp_path / "floor.ply", SQUARE, FACES)
    offset = np.array([5.0, -1.0, 2.0]) if moved else np.zeros(3)
    if moved:
        floor["to_world"] = mi.ScalarTransform4f().translate(offset.tolist())
    pixels, places = drawn(mi, packed, {"floor": floor}, (offset + [0, 2, 3]).tolist(), target=offset.tolist())
    there = inside(np.isfinite(places[..., 0]))
    assert there.sum() > 100
    expected = 0.5 + 0.4 * (places - offset)[..., [0, 0, 2]]
    # A pixel is its mean over 16 places, and is 0.05 wide.
    np.testing.assert_allclose(pixels[there], expected[there], atol=0.02)


@pytest.mark.parametrize("by_place", [False, True])
@pytest.mark.parametrize("above", [True, False])
def test_both_sides_of_a_surface(above, by_place, mi, tmp_path):
    """The back is held by vertices of its own."""
    two = np.concatenate([SQUARE, SQUARE]), np.concatenate([FACES, FACES[:, ::-1] + 4])
    albedo = np.repeat([[0.9], [0.3]], 4, axis=0)
    packed = file_of(("sheet", *two, albedo, 2))
    material = {"bsdf": {"type": "twosided", "bsdf": {"type": "diffuse"}}}
    shape = written(tmp_path / "sheet.ply", SQUARE, FACES) | material
    other = {"other": written(tmp_path / "other.ply", SQUARE + [0, 50, 0], FACES)}
    shapes = {"renamed": shape, **other} if by_place else {"sheet": shape}
    pixels, places = drawn(mi, packed, shapes, (0.0, 2.0 if above else -2.0, 3.0))
    there = inside(np.isfinite(places[..., 0]))
    assert there.sum() > 100
    np.testing.assert_allclose(pixels[there], 0.9 if above else 0.3, atol=2e-3)


def test_instances(mi, tmp_path):
    """Parts of instances are found by where they are."""
    left, right = SQUARE * 0.4 + [-0.6, 0, 0], SQUARE * 0.4 + [0.6, 0, 0]
    packed = file_of(("a/sheet", left, FACES, 0.9, 1), ("b/sheet", right, FACES, 0.3, 1))
    of = {"type": "ref", "id": "group"}
    turn = mi.ScalarTransform4f()
    group = {"type": "shapegroup", "sheet": written(tmp_path / "sheet.ply", SQUARE, FACES)}
    shapes = {"group": group} | {
        name: {
            "type": "instance",
            "to_world": turn.translate([x, 0, 0]).scale(0.4),
            "of": of,
        }
        for name, x in (("a", -0.6), ("b", 0.6))
    }
    pixels, places = drawn(mi, packed, shapes)
    for side, wanted in ((places[..., 0] < 0.0, 0.9), (places[..., 0] > 0.0, 0.3)):
        there = inside(side)
        assert there.sum() > 20
        np.testing.assert_allclose(pixels[there], wanted, atol=2e-3)


@pytest.mark.parametrize("cuts", [8, 24])
def test_a_sphere_is_held_everywhere(cuts, mi):
    """The file's faces lie up to the height of an arc under it."""
    ball = trimesh.creation.uv_sphere(radius=1.0, count=[cuts, 2 * cuts])
    packed = file_of(("ball", ball.vertices, ball.faces, 0.9, 1))
    pixels, places = drawn(mi, packed, {"ball": {"type": "sphere"}}, target=[0, 0, 0])
    there = inside(np.isfinite(places[..., 0]))
    np.testing.assert_allclose(pixels[there], 0.9, atol=2e-3)


def test_a_sphere_close_under_another(mi):
    """Its faces, turned by half of one, come nearer to the outer sphere than some of that one's own."""
    ball = trimesh.creation.uv_sphere(radius=1.0, count=[8, 16])
    turned = trimesh.transform_points(ball.vertices, trimesh.transformations.rotation_matrix(np.pi / 32, [0, 0, 1]))
    packed = file_of(("ball", ball.vertices, ball.faces, 0.9, 1), ("core", 0.998 * turned, ball.faces, 0.3, 1))
    pixels, places = drawn(mi, packed, {"ball": {"type": "sphere"}, "core": {"type": "sphere", "radius": 0.998}})
    off = np.abs(pixels[inside(np.isfinite(places[..., 0]))] - 0.9) > 2e-3
    assert off.mean() < 1e-3  # where both meet to rounding, a sample may find neither, and is gathered


def test_a_part_that_is_elsewhere(mi, tmp_path):
    packed = file_of(("floor", SQUARE, FACES, 0.9, 1), ("top", SQUARE * 0.5 + [0, 1, 0], FACES, 0.3, 1))
    with pytest.raises(RuntimeError) as caught:
        drawn(mi, packed, {"floor": written(tmp_path / "floor.ply", SQUARE, FACES)})
    assert "its shape 'top' (4 vertices) is not in the scene, which has the shapes 'floor'" in messages(caught.value)


@pytest.mark.parametrize("flipped", [False, True])
@pytest.mark.parametrize("scale", [0.5, -0.5])
def test_a_mirrored_ball_is_seen_from_outside(scale, flipped, mi, tmp_path):
    """Its faces turn round, its normals do not: under light of 1 it shows its albedo, as ``path`` has it."""
    ball = trimesh.creation.icosphere(3)
    normals = -ball.vertices if flipped else ball.vertices
    trimesh.Trimesh(ball.vertices, ball.faces, vertex_normals=normals, process=False).export(
        tmp_path / "ball.ply", vertex_normal=True
    )
    shape = {
        "type": "ply", "filename": str(tmp_path / "ball.ply"), "flip_normals": flipped,
        "to_world": mi.ScalarTransform4f().scale([scale, 0.5, 0.5]),
        "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.6, 0.3, 0.2]}},
    }  # fmt: skip
    packed = sp.compress(sp.precompute({"type": "scene", "ball": dict(shape)}, 1, 16, effects="none"), clusters=1)
    pixels, places = drawn(mi, packed, {"ball": shape})
    on_ball = inside(np.isfinite(places[..., 0]))
    assert on_ball.sum() > 50
    np.testing.assert_allclose(pixels[on_ball], np.tile([0.6, 0.3, 0.2], (on_ball.sum(), 1)), rtol=2e-2)
