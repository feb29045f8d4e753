"""Lamps: their light on held surfaces at every pixel, and what the file holds of their bounces."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

import slepian_prt as sp
from slepian_prt.lighting.fixed_lights import FixedLights
from slepian_prt.relighting.mitsuba.scene_integrator import scene_integrator
from slepian_prt.scene.mesh import make_mesh
from tests.relighting.mitsuba.scenes import camera, picture, runs
from tests.statistics import assert_agree, assert_same_picture, in_blocks

FLOOR = np.array([[-2.0, 0.0, -2.0], [-2.0, 0.0, 2.0], [2.0, 0.0, 2.0], [2.0, 0.0, -2.0]])
ALBEDO = [0.8, 0.5, 0.2]
BLACK = {"type": "diffuse", "reflectance": 0.0}
DIFFUSE = {"type": "diffuse", "reflectance": {"type": "rgb", "value": ALBEDO}}


@pytest.fixture(scope="module")
def floor(tmp_path_factory):
    path = tmp_path_factory.mktemp("lit") / "floor.ply"
    mesh = make_mesh(FLOOR, [[0, 1, 2], [0, 2, 3]], name="floor", albedo=np.tile(ALBEDO, (4, 1)))
    trimesh.Trimesh(mesh.positions, mesh.faces, vertex_normals=mesh.normals, process=False).export(path)
    return path, sp.compress(sp.precompute(mesh, bandlimit=1, samples=16, effects="none"), clusters=1)


def lamps(mi):
    aimed = mi.ScalarTransform4f().look_at([-1, 2, 0.5], [0, 0, 0], [0, 0, 1])
    colour = {"type": "rgb", "value": [3.0, 2.0, 1.0]}
    return {
        "point": {"type": "point", "position": [1.0, 1.5, 0.5], "intensity": colour},
        "spot": {"type": "spot", "to_world": aimed, "intensity": colour, "cutoff_angle": 25},
        "directional": {"type": "directional", "direction": [0.5, -1.0, -0.3], "irradiance": colour},
        "area": {"type": "sphere", "center": [-1.0, 1.6, -0.5], "radius": 0.6,
                 "emitter": {"type": "area", "radiance": colour}},
        "cube": {"type": "cube", "to_world": mi.ScalarTransform4f().translate([-1, 0.25, 0.5]).scale(0.25),
                 "emitter": {"type": "area", "radiance": colour}},
    }  # fmt: skip


def lit_floor(mi, file, bsdf=DIFFUSE, **lights):
    """A floor under a black ball."""
    return mi.load_dict({
        "type": "scene", "floor": {"type": "ply", "filename": str(file), "bsdf": bsdf},
        "ball": {"type": "sphere", "center": [0, 0.7, 0], "radius": 0.4, "bsdf": BLACK},
        "sensor": camera(mi, 24) | {"to_world": mi.ScalarTransform4f().look_at([0, 3, 4], [0, 0, 0], [0, 1, 0])},
        **lights,
    })  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("material", ["diffuse", "plastic"])
@pytest.mark.parametrize("kind", ["point", "spot", "directional", "area", "cube", "all, and a sky"])
def test_light_of_lamps_is_sharp(kind, material, mi, floor):
    """As `path` draws it, shadows and gloss too; the floor sends light only to a ball that reflects none."""
    file, packed = floor
    bsdf = DIFFUSE if material == "diffuse" else {"type": "roughplastic", "alpha": 0.2}
    black = {"type": "constant", "radiance": 0.0}  # the file knows nothing of the ball between floor and sky
    lights = {kind: lamps(mi)[kind]} if kind in lamps(mi) else {**lamps(mi), "sky": black}
    scene = lit_floor(mi, file, bsdf, **lights)
    ours = scene_integrator(mi, packed, lighting=np.zeros((3, 4)), max_depth=2)
    theirs = mi.load_dict({"type": "path", "max_depth": 2})
    a, b = (in_blocks(runs(mi, scene, 12, integrator=one, spp=32), 2) for one in (ours, theirs))
    assert b.max() > 0.05
    assert_agree(a, b)


@pytest.mark.parametrize("kind", ["cube", "all"])
def test_light_of_lamps_has_less_noise_than_paths(kind, mi, floor):
    """Half of a cube's points are on its back, of several lamps most are dim: single points have their noise.

    Measured: 0.20 and 0.14 of that of paths. Six runs tell a standard deviation of 240 pixels to a few percent.
    """
    file, packed = floor
    scene = lit_floor(mi, file, **({kind: lamps(mi)[kind]} if kind in lamps(mi) else lamps(mi)))
    ours = scene_integrator(mi, packed, lighting=np.zeros((3, 4)), max_depth=2)
    theirs = mi.load_dict({"type": "path", "max_depth": 2})
    noise = [np.median(runs(mi, scene, 6, integrator=one, spp=8)[:, 14:].std(axis=0)) for one in (ours, theirs)]
    assert noise[0] < 0.4 * noise[1]


def with_bounces(packed, name: str, bounced: float):
    values = np.full((1, 4, 3), bounced, dtype=np.float32)
    emitted = np.array([[3.0, 2.0, 1.0]])
    return replace(packed, fixed=FixedLights((name,), ("point",), emitted, np.zeros_like(values), values))


def middle(pixels):
    """On the floor."""
    return pixels[18:22, 4:8].mean(axis=(0, 1))


def test_bounces_of_a_lamp_follow_it(mi, floor, log):
    """What the file holds is added, times the albedo; twice as much of a lamp that is twice as bright."""
    file, packed = floor
    scene = lit_floor(mi, file, point=lamps(mi)["point"])
    dark = {"lighting": np.zeros((3, 4))}
    alone = picture(mi, scene, integrator=scene_integrator(mi, packed, **dark))
    assert [text for text in log if "floor does not know the light of point" in text]
    log.clear()
    held = with_bounces(packed, "point", 0.25)
    ours = scene_integrator(mi, held, **dark)
    np.testing.assert_allclose(middle(picture(mi, scene, integrator=ours) - alone), np.array(ALBEDO) / 4, rtol=1e-5)
    assert not log
    parameters = mi.traverse(scene)
    parameters["point.intensity.value"] *= mi.Color3f(2.0, 3.0, 1.0)
    parameters.update()
    more = middle(picture(mi, scene, integrator=ours))
    np.testing.assert_allclose(more, middle(alone + np.array(ALBEDO) / 4) * [2.0, 3.0, 1.0], rtol=1e-5)


def test_another_lamp_on_the_same_shapes(mi, floor):
    """Scenes may share their objects; an integrator that drew one draws the other as a new one does."""
    file, packed = floor
    shared = lit_floor(mi, file).shapes()
    scenes = [
        mi.load_dict({"type": "scene", **{f"s{i}": one for i, one in enumerate(shared)}, kind: lamps(mi)[kind],
                      "sensor": camera(mi, 24)})
        for kind in ("point", "directional")
    ]  # fmt: skip
    dark = {"lighting": np.zeros((3, 4))}
    ours = scene_integrator(mi, packed, **dark)
    drawn = [picture(mi, scene, integrator=ours) for scene in scenes]
    assert_same_picture(drawn[1], picture(mi, scenes[1], integrator=scene_integrator(mi, packed, **dark)), atol=1e-6)
    assert np.abs(drawn[0] - drawn[1]).max() > 0.1


@pytest.mark.parametrize("factor", [0.0, 0.5, 3.0])
def test_lamps_may_be_dimmed(factor, mi, floor):
    """On held surfaces."""
    file, packed = floor
    scene = lit_floor(mi, file, point=lamps(mi)["point"])
    held = with_bounces(packed, "point", 0.25)
    full, dimmed = (
        picture(mi, scene, integrator=scene_integrator(mi, held, lighting=np.zeros((3, 4)), fixed_lights=one))
        for one in (1.0, factor)
    )
    assert full.max() > 0.2
    assert_same_picture(dimmed, factor * full, atol=1e-5 * full.max())


def test_lamps_and_distant_light_add_up(mi, floor):
    file, packed = floor
    sky = {"type": "constant", "radiance": {"type": "rgb", "value": [0.2, 0.4, 0.6]}}
    lamp = lamps(mi)["point"]
    held = scene_integrator(mi, with_bounces(packed, "point", 0.1), hide_emitters=True)
    both, one, other = (
        middle(picture(mi, lit_floor(mi, file, **lights), integrator=held))
        for lights in ({"point": lamp, "sky": sky}, {"point": lamp}, {"sky": sky})
    )
    np.testing.assert_allclose(both, one + other, rtol=1e-5)
    assert other.min() > 0.05
