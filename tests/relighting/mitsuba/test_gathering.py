"""Paths that end where a file holds the light, against `path` where the held surface shines by itself instead."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

import slepian_prt as sp
from slepian_prt.relighting.mitsuba.scene_integrator import scene_integrator
from slepian_prt.scene.mesh import make_mesh
from tests.conftest import sphere
from tests.relighting.mitsuba.scenes import VARIANTS, camera, picture, runs
from tests.statistics import assert_agree, in_blocks
from tests.variants import VARIANT

FLOOR = np.array([[-2.0, 0.0, -2.0], [-2.0, 0.0, 2.0], [2.0, 0.0, 2.0], [2.0, 0.0, -2.0]])
SQUARE = np.array([[0, 1, 2], [0, 2, 3]])

# Radiance that the floor sends back in all tests: of unit albedo under constant light.
SHINE = [0.9, 0.6, 0.2]


@pytest.fixture(scope="module")
def floor(tmp_path_factory):
    """A floor that reflects all of a constant light."""
    path = tmp_path_factory.mktemp("floor")
    mesh = make_mesh(FLOOR, SQUARE, name="floor")
    trimesh.Trimesh(mesh.positions, mesh.faces, vertex_normals=mesh.normals, process=False).export(path / "floor.ply")
    packed = sp.compress(sp.precompute(mesh, bandlimit=1, samples=16, effects="none"), clusters=1)
    return path / "floor.ply", packed


def constant_lighting(colour, bandlimit: int = 1):
    lighting = np.zeros((3, (bandlimit + 1) ** 2))
    lighting[:, 0] = np.array(colour) * np.sqrt(4.0 * np.pi)
    return lighting


def above_floor(mi, file, things, light=None, **floor):
    """A scene with things above the floor."""
    return mi.load_dict({
        "type": "scene", "floor": {"type": "ply", "filename": str(file), **floor},
        **things, **({} if light is None else {"light": light}),
        "sensor": camera(mi, 24) | {"to_world": mi.ScalarTransform4f().look_at([0, 2, 4], [0, 0.4, 0], [0, 1, 0])},
    })  # fmt: skip


def ball(material, y: float = 0.6, radius: float = 0.5, **others):
    return {"type": "sphere", "center": [0, y, 0], "radius": radius, "bsdf": material, **others}


THINGS = {
    "mirror": {"ball": ball({"type": "conductor"})},
    "metal": {"ball": ball({"type": "roughconductor", "alpha": 0.3})},
    "glass": {"ball": ball({"type": "dielectric"})},
    "rough glass": {"ball": ball({"type": "roughdielectric", "alpha": 0.2})},
    "diffuse": {"ball": ball({"type": "diffuse"})},
    "plastic beside a mirror": {
        "ball": ball({"type": "plastic"}),
        "mirror": ball({"type": "conductor"}) | {"center": [1.0, 0.5, 0.3], "radius": 0.4},
    },
    "a tube": {
        "tube": {"type": "cylinder", "p0": [0, 0.1, 0], "p1": [0, 0.9, 0], "radius": 0.6,
                 "bsdf": {"type": "twosided", "bsdf": {"type": "diffuse"}}},
    },
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", THINGS)
def test_what_is_not_held_is_lit_by_what_is(name, mi, floor):
    """A held floor that sends back the same everywhere is to all else an area light of that radiance."""
    file, packed = floor
    packed = replace(packed, mesh=replace(packed.mesh, albedo=np.tile(np.float32(SHINE), (4, 1))))
    light = {"type": "constant", "radiance": 0.5}
    shining = {"type": "area", "radiance": {"type": "rgb", "value": SHINE}}
    ours = scene_integrator(mi, packed, lighting=constant_lighting([1.0, 1.0, 1.0]))
    scene = above_floor(mi, file, THINGS[name], light)
    black = {"type": "diffuse", "reflectance": 0.0}
    reference = above_floor(mi, file, THINGS[name], light, emitter=shining, bsdf=black)
    a = in_blocks(runs(mi, scene, 12, integrator=ours, spp=64), 4)
    b = in_blocks(runs(mi, reference, 12, integrator=mi.load_dict({"type": "path"}), spp=64), 4)
    assert_agree(a, b, bias=1e-3)  # of coding


def test_a_white_furnace_with_glass_and_mirrors(mi, tmp_path):
    """Held and white within glass before a mirror, under light of 1 from everywhere: all is 1.

    In equilibrium radiance within glass is η² of that outside, which is what the file is made to hold.
    """
    mesh = sphere(3)
    trimesh.Trimesh(mesh.positions, mesh.faces, vertex_normals=mesh.normals, process=False).export(tmp_path / "a.ply")
    packed = sp.compress(sp.precompute(replace(mesh, name="a"), bandlimit=0, samples=16, effects="none"), clusters=1)
    scene = mi.load_dict({
        "type": "scene", "a": {"type": "ply", "filename": str(tmp_path / "a.ply"), "bsdf": {"type": "diffuse"}},
        "glass": {"type": "sphere", "radius": 1.4, "bsdf": {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0}},
        "mirror": {"type": "sphere", "center": [-1.0, 1.8, 0], "radius": 0.7, "bsdf": {"type": "conductor"}},
        "pane": {"type": "rectangle", "bsdf": {"type": "thindielectric"},
                 "to_world": mi.ScalarTransform4f().translate([0, 0, 2])},
        "light": {"type": "constant"}, "sensor": camera(mi),
    })  # fmt: skip
    own = scene_integrator(mi, packed, lighting=constant_lighting([1.5**2] * 3, 0), albedo="file")
    pixels = in_blocks(runs(mi, scene, 8, integrator=own, spp=64), 8)
    assert_agree(pixels, np.ones((1, *pixels.shape[1:])), bias=2e-3)  # of coding, where a path met the ball


def test_paths_may_be_short(mi, floor):
    """Of depth 2 a mirror shows a black floor, of depth 3 the floor's light."""
    file, packed = floor
    scene = above_floor(mi, file, THINGS["mirror"])
    lit = {"lighting": constant_lighting([1.0] * 3), "albedo": "file"}
    totals = [picture(mi, scene, integrator=scene_integrator(mi, packed, max_depth=n, **lit)) for n in (1, 2, 3, -1)]
    assert totals[0].max() == 0.0
    assert totals[1].max() > 0.9
    on_ball = (totals[3] - totals[1]).max(axis=2) > 0.5
    assert 10 < on_ball.sum() < 100
    np.testing.assert_allclose(totals[2][on_ball], totals[3][on_ball], atol=1e-3)


@pytest.mark.parametrize("hide", [False, True])
def test_what_is_covered_is_as_path_has_it(hide, mi, floor):
    file, packed = floor
    things = {**THINGS["glass"], "sheet": ball({"type": "mask", "opacity": 0.0, "bsdf": {"type": "diffuse"}}, 1.2, 0.2)}
    film = {"type": "hdrfilm", "width": 24, "height": 24, "pixel_format": "rgba", "rfilter": {"type": "box"}}
    scene = above_floor(mi, file, things, {"type": "constant"})
    sensor = mi.load_dict(
        camera(mi) | {"film": film, "to_world": mi.ScalarTransform4f().look_at([0, 2, 4], [0, 0.4, 0], [0, 1, 0])}
    )
    ours = scene_integrator(mi, packed, hide_emitters=hide)
    theirs = mi.load_dict({"type": "path", "hide_emitters": hide})
    a, b = (picture(mi, scene, integrator=one, sensor=sensor, spp=256)[..., 3] for one in (ours, theirs))
    assert (a.min() < 0.01) == hide
    np.testing.assert_allclose(a, b, atol=0.15)
    np.testing.assert_allclose(a.mean(), b.mean(), atol=0.005)


@pytest.mark.slow
@pytest.mark.parametrize("variant", VARIANTS)
def test_gathering_in_all_variants(variant, mi, floor):
    """White light, and surfaces without colour: the same in each."""
    file, packed = floor
    things = {**THINGS["glass"], "metal": ball({"type": "roughconductor", "alpha": 0.2}, 1.6, 0.3)}
    mi.set_variant(variant)
    scene = above_floor(mi, file, things, {"type": "constant"})
    own = scene_integrator(mi, packed, albedo="scene")
    pixels = np.array(mi.render(scene, integrator=own, spp=256, seed=1))[..., :3].mean(axis=(0, 1))
    mi.set_variant(VARIANT)
    scene = above_floor(mi, file, things, {"type": "constant"})
    wanted = np.array(mi.render(scene, integrator=scene_integrator(mi, packed, albedo="scene"), spp=256, seed=1))
    np.testing.assert_allclose(pixels, np.resize(wanted.mean(axis=(0, 1)), pixels.shape), rtol=0.02)


def test_lighting_that_is_wrong(mi, floor):
    for lighting, wanted in [(np.zeros((3, 8)), r"must have shape \(3, n²\)"), (np.full((3, 4), np.nan), "be finite")]:
        with pytest.raises(sp.UserError, match=wanted):
            scene_integrator(mi, floor[1], lighting=lighting)
    for options, wanted in [({"fixed_lights": -1.0}, "fixed_lights"), ({"max_depth": -2}, "max_depth")]:
        with pytest.raises(sp.UserError, match=f"{wanted} of integrator slepian_prt must be"):
            scene_integrator(mi, floor[1], **options)
