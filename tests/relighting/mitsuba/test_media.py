"""Participating media in the pictures of the integrator, against Mitsuba's volumetric path tracers."""

from dataclasses import replace

import numpy as np
import pytest

from slepian_prt.relighting.mitsuba.scene_integrator import scene_integrator
from tests.relighting.mitsuba.scenes import VARIANTS, camera, runs
from tests.relighting.mitsuba.test_gathering import SHINE, above_floor, ball, constant_lighting, floor  # noqa: F401
from tests.statistics import assert_agree, in_blocks
from tests.variants import VARIANT

NULL = {"type": "null"}


def rgb(*values):
    return {"type": "rgb", "value": list(values)}


def smoke(mi, seed=0):
    """Coloured smoke within a cube that is twice as wide as the unit cube, around the origin."""
    density = np.random.default_rng(seed).random((4, 3, 5, 3)).astype(np.float32) ** 2
    place = mi.ScalarTransform4f().translate(-1.0).scale(2.0)
    grid = {"type": "gridvolume", "grid": mi.VolumeGrid(density), "to_world": place, "raw": True}
    phase = {"type": "hg", "g": -0.4}
    return {"type": "heterogeneous", "sigma_t": grid, "albedo": rgb(0.9, 0.6, 0.8), "scale": 5.0, "phase": phase}


FOG = {"type": "homogeneous", "scale": 2.0, "sigma_t": rgb(1.0, 0.5, 0.2), "albedo": rgb(0.9, 0.7, 0.8)}
FORWARD = {"type": "homogeneous", "sigma_t": 1.5, "albedo": 0.9, "phase": {"type": "hg", "g": 0.7}}
MIST = FORWARD | {"sigma_t": 0.15}
DYE = {"type": "homogeneous", "scale": 3.0, "sigma_t": rgb(0.1, 0.5, 1.0), "albedo": 0.0}
MILK = {"type": "homogeneous", "scale": 8.0, "sigma_t": rgb(0.5, 0.7, 1.0), "albedo": rgb(0.98, 0.9, 0.8)}


def cube(mi, **others):
    place = mi.ScalarTransform4f().translate([0, 0.75, 0]).scale(0.7)
    return {"type": "cube", "to_world": place, "bsdf": NULL, **others}


def sphere(radius, **others):
    return ball(NULL, **others) | {"radius": radius}


def lamp(mi, size=0.3, height=1.9, **others):
    place = mi.ScalarTransform4f().translate([0.4, height, 0.3]).rotate([1, 0, 0], 90).scale(size)
    emitter = {"type": "area", "radiance": rgb(9.0, 7.0, 5.0)}
    black = {"type": "diffuse", "reflectance": 0.0}
    return {"type": "rectangle", "to_world": place, "emitter": emitter, "bsdf": black, **others}


def pool(mi):
    """Of dye, above all of the floor."""
    place = mi.ScalarTransform4f().translate([0, 0.251, 0]).scale([1.9, 0.25, 1.9])
    return {"type": "cube", "to_world": place, "bsdf": NULL, "interior": DYE | {"scale": 15.0}}


def standing(mi):
    """A lamp from the floor up to the top of the pool."""
    place = mi.ScalarTransform4f().translate([0, 0.25, -0.5]).scale([1.0, 0.24, 1.0])
    return lamp(mi) | {"to_world": place, "exterior": DYE | {"scale": 15.0}}


POINT = {"type": "point", "position": [0.6, 1.2, 0.5], "intensity": rgb(2.0, 3.0, 4.0)}

# Things in the scene, and the medium that the camera is in.
SCENES = {
    "fog": lambda mi: ({"fog": cube(mi, interior=FOG)}, None),
    "smoke": lambda mi: ({"smoke": cube(mi, interior=smoke(mi))}, None),
    "milk": lambda mi: ({"milk": ball({"type": "roughdielectric", "alpha": 0.4}, interior=MILK), "lamp": POINT}, None),
    "dyed glass": lambda mi: ({"glass": ball({"type": "dielectric"}, interior=DYE)}, None),
    "a mirror in fog": lambda mi: (
        {"fog": cube(mi, interior=FORWARD), "mirror": ball({"type": "conductor"}, 0.7, 0.3)},
        None,
    ),
    "a camera in mist, where there is glass": lambda mi: (
        {"fog": sphere(9.0, interior=MIST), "glass": ball({"type": "dielectric"}, exterior=MIST)},
        MIST,
    ),
    "a lamp in fog": lambda mi: ({"fog": cube(mi, interior=FOG), "lamp": POINT}, None),
    "a lamp above smoke": lambda mi: ({"smoke": cube(mi, interior=smoke(mi)), "lamp": lamp(mi)}, None),
    "a wide lamp close to fog": lambda mi: (
        {"fog": cube(mi, interior=FORWARD), "lamp": lamp(mi, 0.8, 1.5)},
        None,
    ),
    "sheets of fog": lambda mi: (
        {
            "fog": cube(mi, interior=FOG),
            "sheet": ball({"type": "mask", "opacity": 0.5, "bsdf": {"type": "diffuse"}}, 0.7, 0.4),
            "lamp": lamp(mi),
        },
        None,
    ),
}


def sensor(mi, medium):
    around = {} if medium is None else {"medium": medium}
    place = mi.ScalarTransform4f().look_at([0, 2, 4], [0, 0.4, 0], [0, 1, 0])
    return mi.load_dict(camera(mi, 24) | {"to_world": place} | around)


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
def test_light_comes_through_media_and_from_them(name, mi, floor):  # noqa: F811
    """A held floor that sends back the same everywhere is to all else an area light; that reflects no lamps."""
    file, packed = floor
    packed = replace(packed, mesh=replace(packed.mesh, albedo=np.tile(np.float32(SHINE), (4, 1))))
    things, medium = SCENES[name](mi)
    light = {"type": "constant", "radiance": 0.5}
    shining = {"type": "area", "radiance": rgb(*SHINE)}
    ours = scene_integrator(mi, packed, lighting=constant_lighting([1.0, 1.0, 1.0]), fixed_lights=0.0)
    scene = above_floor(mi, file, things, light)
    black = {"type": "diffuse", "reflectance": 0.0}
    reference = above_floor(mi, file, things, light, emitter=shining, bsdf=black)
    view = sensor(mi, medium)
    theirs = mi.load_dict({"type": "volpathmis"})
    a = in_blocks(runs(mi, scene, 12, integrator=ours, spp=64, sensor=view), 4)
    b = in_blocks(runs(mi, reference, 12, integrator=theirs, spp=64, sensor=view), 4)
    assert_agree(a, b, bias=1e-3)  # of coding


LIT = {
    "dye before a lamp": lambda mi: ({"dye": cube(mi, interior=DYE), "lamp": lamp(mi)}, None),
    "dye before a wide lamp": lambda mi: ({"dye": cube(mi, interior=DYE), "lamp": lamp(mi, 1.5)}, None),
    "dye before a point": lambda mi: (
        {"dye": cube(mi, interior=DYE), "lamp": POINT | {"position": [0.5, 2.0, 0.5]}},
        None,
    ),
    "a lamp that stands in dye": lambda mi: ({"dye": pool(mi), "lamp": standing(mi)}, None),
    "smoke that absorbs": lambda mi: ({"dye": cube(mi, interior=smoke(mi) | {"albedo": 0.0}), "lamp": lamp(mi)}, None),
    "all in dye": lambda mi: (
        {"dye": sphere(9.0, interior=DYE | {"scale": 0.2}), "lamp": lamp(mi)},
        DYE | {"scale": 0.2},
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", LIT)
def test_lamps_light_held_surfaces_through_media(name, mi, floor):  # noqa: F811
    """Media that scatter nothing, so that all that falls on the floor comes straight from the lamp."""
    file, packed = floor
    packed = replace(packed, mesh=replace(packed.mesh, albedo=np.tile(np.float32(SHINE), (4, 1))))
    things, medium = LIT[name](mi)
    ours = scene_integrator(mi, packed, lighting=constant_lighting([0.0, 0.0, 0.0]), albedo="scene")
    scene = above_floor(mi, file, things, bsdf={"type": "diffuse", "reflectance": rgb(*SHINE)})
    view = sensor(mi, medium)
    theirs = mi.load_dict({"type": "volpathmis"})
    a = in_blocks(runs(mi, scene, 12, integrator=ours, spp=64, sensor=view), 4)
    b = in_blocks(runs(mi, scene, 12, integrator=theirs, spp=64, sensor=view), 4)
    assert a.mean() > 0.01
    assert_agree(a, b, bias=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("variant", VARIANTS)
def test_media_in_all_variants(variant, mi, floor):  # noqa: F811
    """White light and fog without colour: the same in each."""
    file, packed = floor
    grey = {"type": "homogeneous", "sigma_t": 2.0, "albedo": 0.8, "phase": {"type": "rayleigh"}}
    density = np.random.default_rng(0).random((3, 3, 3, 1)).astype(np.float32)

    def mean(name):
        mi.set_variant(name)
        grid = {"type": "gridvolume", "grid": mi.VolumeGrid(density), "raw": True}
        cloud = {"type": "heterogeneous", "sigma_t": grid | {"to_world": mi.ScalarTransform4f().translate([-1, 1, 0])}}
        things = {
            "fog": cube(mi, interior=grey),
            "cloud": {"type": "sphere", "center": [-0.9, 1.5, 0.5], "radius": 0.7, "bsdf": NULL, "interior": cloud},
        }
        scene = above_floor(mi, file, things, {"type": "constant"})
        own = scene_integrator(mi, packed, albedo="scene")
        return np.array(mi.render(scene, integrator=own, spp=256, seed=1))[..., :3].mean(axis=(0, 1))

    wanted = mean(VARIANT)
    found = mean(variant)
    np.testing.assert_allclose(found, np.resize(wanted, found.shape), rtol=0.02)
