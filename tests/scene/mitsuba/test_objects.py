"""Scenes and shapes of Mitsuba in memory, and dicts: used as they are, and the same afterwards."""

import subprocess
import sys

import numpy as np
import pytest

import slepian_prt as sp
from slepian_prt.errors import UserError
from slepian_prt.renderer.variants import imported_mitsuba, usable_variant
from slepian_prt.scene.loading import open_scene
from tests.numerics import assert_exact, assert_rounded
from tests.variants import sibling

SMALL = {"bandlimit": 2, "samples": 16}
SAMPLES = 4  # of a pixel
AMBIENT = np.sqrt(4.0 * np.pi)


@pytest.fixture
def mi():
    """Mitsuba in the variant for heavy work, and in that of before afterwards."""
    module = imported_mitsuba()
    before = module.variant()
    module.set_variant(usable_variant())
    yield module
    if before:
        module.set_variant(before)


def described(mi):
    """A ball on a floor, in a sky with a lamp, and a camera."""
    place = mi.ScalarTransform4f
    return {
        "type": "scene",
        "integrator": {"type": "path"},
        "camera": {
            "type": "perspective",
            "to_world": place().look_at([0, 2, 6], [0, 0, 0], [0, 1, 0]),
            "film": {"type": "hdrfilm", "width": 16, "height": 12},
        },
        "sky": {"type": "constant"},
        "lamp": {
            "type": "rectangle",
            "to_world": place().translate([0, 3, 0]).rotate([1, 0, 0], 90),
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 5.0}},
        },
        "ball": {
            "type": "sphere",
            "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.6, 0.3, 0.1]}},
        },
        "floor": {
            "type": "rectangle",
            "to_world": place().translate([0, -1, 0]).rotate([1, 0, 0], -90).scale(4),
            "bsdf": {"type": "twosided", "material": {"type": "diffuse"}},
        },
    }


def state_of(mi, scene):
    """All that one sees of a scene: the ids of its objects, its parameters, and a picture."""
    parameters = mi.traverse(scene)
    objects = [*scene.shapes(), *scene.emitters(), *scene.sensors()]
    picture = np.array(mi.render(scene, spp=SAMPLES, seed=3))
    return [thing.id() for thing in objects], [str(parameters[key]) for key in parameters.keys()], picture  # noqa: SIM118


@pytest.mark.parametrize("optimize", [False, True])
def test_a_scene_in_memory_is_the_same_afterwards(optimize, mi):
    scene = mi.load_dict(described(mi), optimize=optimize)
    before = state_of(mi, scene)
    transfer = sp.precompute(scene, **SMALL, effects="direct")
    after = state_of(mi, scene)
    assert after[:2] == before[:2]
    # The same paths, but threads add them to the film in any order: a pixel is a ratio of two sums over the samples of
    # the 5 x 5 pixels that its Gaussian reaches.
    assert_rounded(after[2], before[2], terms=2 * 25 * SAMPLES)
    assert transfer.source == "scene"
    assert {part.name for part in transfer.parts} >= {"ball", "floor"}
    assert scene.integrator().class_name() == "PathIntegrator"


def test_a_scene_in_memory_counts_as_it_is_now(mi):
    """Its parameters may have been changed since it was loaded, and be prepared for gradients."""
    import drjit as dr

    scene = mi.load_dict(described(mi), optimize=False)
    parameters = mi.traverse(scene)
    parameters["ball.bsdf.reflectance.value"] = mi.Color3f(0.2, 0.4, 0.8)
    dr.enable_grad(parameters["ball.bsdf.reflectance.value"])
    parameters.update()
    with open_scene(scene) as opened:
        (ball,) = (part for part in opened.parts if part.name == "ball")
        albedo = opened.mesh.albedo[ball.first : ball.end]
        points = dr.zeros(mi.SurfaceInteraction3f, 4)
        assert not dr.grad_enabled(scene.shapes()[1].bsdf().eval_diffuse_reflectance(points))  # nothing is recorded
    np.testing.assert_allclose(albedo, np.tile([0.2, 0.4, 0.8], (len(albedo), 1)), rtol=1e-6)
    assert dr.grad_enabled(parameters["ball.bsdf.reflectance.value"])


def test_a_dict_is_the_scene_that_it_describes(mi, tmp_path):
    """The same as a file and as a dict, unoptimised: shapes keep their names."""
    path = tmp_path / "scene.xml"
    path.write_text(
        '<scene version="3.0.0"><shape type="sphere" id="ball"><bsdf type="diffuse"/></shape><shape type="cube" '
        'id="box"><transform name="to_world"><translate y="-2"/></transform><bsdf type="diffuse"/></shape></scene>'
    )
    gray = {"type": "diffuse"}
    place = mi.ScalarTransform4f().translate([0, -2, 0])
    description = {
        "type": "scene",
        "ball": {"type": "sphere", "bsdf": gray},
        "box": {"type": "cube", "to_world": place, "bsdf": gray},
    }
    with open_scene(path) as from_file, open_scene(description) as from_dict:
        assert from_dict.path == "scene"
        assert from_dict.parts == from_file.parts
        one, other = from_dict.mesh, from_file.mesh
    assert_exact(one.positions, other.positions, "made by Mitsuba from the same numbers")
    assert_exact(one.albedo, other.albedo, "made by Mitsuba from the same numbers")


def test_a_dict_far_from_the_origin_is_moved(mi):
    far = [5e6, 0.0, 100.0]
    ball = {"type": "sphere", "center": far}
    for description in ({"type": "scene", "ball": ball}, ball):
        with open_scene(description) as opened:
            np.testing.assert_allclose(opened.origin, far)
            np.testing.assert_allclose(np.linalg.norm(opened.mesh.positions - far, axis=1), 1.0, atol=1e-6)


def test_a_dict_that_holds_shapes_is_not_moved(mi):
    """Only a part of it could be: a shape that is made stays where it is."""
    ball = mi.load_dict({"type": "sphere", "center": [1000.0, 0.0, 0.0]})
    description = {"type": "scene", "one": ball, "other": {"type": "sphere", "center": [1000.0, 0.0, 3.0]}}
    with open_scene(description) as opened:
        places = [opened.mesh.positions[part.first : part.end] for part in opened.parts]
    assert ball.id() == ""
    middle = [0.5 * (points.min(axis=0) + points.max(axis=0)) for points in places]
    np.testing.assert_allclose(middle, [[1000.0, 0.0, 0.0], [1000.0, 0.0, 3.0]], atol=1e-3)


def test_a_mesh_of_mitsuba_alone(mi):
    triangle = mi.Mesh("triangle", 3, 1)
    parameters = mi.traverse(triangle)
    parameters["vertex_positions"] = [0, 0, 0, 1, 0, 0, 0, 1, 0]
    parameters["faces"] = [0, 1, 2]
    parameters.update()
    names, keys = triangle.id(), list(mi.traverse(triangle).keys())
    transfer = sp.precompute(triangle, **SMALL)
    assert (triangle.id(), list(mi.traverse(triangle).keys())) == (names, keys)
    np.testing.assert_allclose(transfer.normals[:3], np.tile([0.0, 0.0, 1.0], (3, 1)), atol=1e-6)
    np.testing.assert_allclose(transfer.vectors[:3, 0, 0] * AMBIENT, 1.0, rtol=1e-6)  # nothing blocks any light


def test_the_names_of_shapes_alone(mi):
    disk = mi.load_dict({"type": "disk"})
    for name, shown in (("", "scene"), ("plate", "plate")):
        disk.set_id(name)
        with open_scene(disk) as opened:
            assert (opened.path, opened.mesh.name) == (shown, shown)
        assert disk.id() == name


def test_shapes_in_groups_keep_their_names(mi):
    """Groups do not list what they are made of; the keys of parameters tell."""
    moved = mi.ScalarTransform4f().translate([3, 0, 0])
    scene = mi.load_dict(
        {
            "type": "scene",
            "balls": {"type": "shapegroup", "small": {"type": "sphere"}, "box": {"type": "cube", "to_world": moved}},
            "copy": {"type": "instance", "group": {"type": "ref", "id": "balls"}, "to_world": moved},
            "floor": {"type": "disk"},
        },
        optimize=False,
    )
    keys = list(mi.traverse(scene).keys())
    assert "balls.small.to_world" in keys
    sp.precompute(scene, **SMALL)
    assert list(mi.traverse(scene).keys()) == keys


# A process of its own, as Mitsuba would end it.
MOVED_LAMP = """
import gc
import numpy as np
import slepian_prt as sp
from slepian_prt.renderer.variants import imported_mitsuba, usable_variant
mi = imported_mitsuba()
mi.set_variant(usable_variant())
picture = mi.Bitmap(np.ones((4, 4, 3), dtype=np.float32))
radiance = {"type": "bitmap", "bitmap": picture, "raw": True}
lamp = {"type": "cube", "emitter": {"type": "area", "radiance": radiance}}
floor = {"type": "disk", "to_world": mi.ScalarTransform4f().translate([0, 0, -3]).scale(4)}
scene = mi.load_dict({"type": "scene", "lamp": lamp, "floor": floor}, optimize=False)
integrator, film = mi.load_dict({"type": "path"}), {"type": "hdrfilm", "width": 8, "height": 8}
camera = mi.load_dict({"type": "perspective", "film": film})
mi.render(scene, integrator=integrator, sensor=camera, spp=1)
for _ in range(3):
    sp.precompute(scene, bandlimit=1, samples=16)
    gc.collect()
parameters = mi.traverse(scene)
parameters["lamp.vertex_positions"] = 1.5 * parameters["lamp.vertex_positions"]
parameters.update()
mi.render(scene, integrator=integrator, sensor=camera, spp=1)
print(scene.bbox().max.x)
"""


@pytest.mark.slow
def test_a_textured_lamp_can_be_moved_afterwards():
    """Mitsuba's meshes point to the last scene that they were in, whether it is there or not."""
    run = subprocess.run([sys.executable, "-c", MOVED_LAMP], capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    assert float(run.stdout) == 4.0


# --- Variants --------------------------------------------------------------------------------------------------------


def test_the_variant_of_a_scene_is_used_and_that_of_the_user_comes_back(mi, monkeypatch):
    scene, variant = mi.load_dict(described(mi)), mi.variant()
    mi.set_variant("scalar_rgb")
    monkeypatch.setattr("slepian_prt.renderer.variants.usable_variant", lambda: "another")
    with open_scene(scene) as opened:
        assert opened.mi.variant() == variant
    assert mi.variant() == "scalar_rgb"


@pytest.mark.parametrize("variant", ["scalar_rgb", sibling("ad_mono"), sibling("ad_spectral")])
def test_variants_that_cannot_be_used(variant, mi):
    mi.set_variant(variant)
    scene = mi.load_dict({"type": "scene", "ball": {"type": "sphere"}})
    with pytest.raises(UserError) as told:
        sp.precompute(scene)
    assert str(told.value) == (
        f"the scene was loaded in the variant {variant}, and transport is traced in llvm_ad_rgb or cuda_ad_rgb: load "
        "it after mitsuba.set_variant('llvm_ad_rgb')"
    )
    assert mi.variant() == variant
    with open_scene({"type": "scene", "ball": {"type": "sphere"}}) as opened:  # a mere description
        assert opened.mi.variant() == usable_variant()


def test_objects_of_several_variants(mi):
    here = mi.load_dict({"type": "sphere"})
    mi.set_variant("scalar_rgb")
    there = mi.load_dict({"type": "sphere"})
    with pytest.raises(UserError, match=r"of different variants, .*scalar_rgb; make them all in one"):
        sp.precompute({"type": "scene", "here": here, "there": there})


# --- Mistakes --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("description", "message"),
    [
        ({"type": "diffuse"}, r"^scene: is a BSDF of Mitsuba, and light needs surfaces; give a scene or a shape"),
        ({"type": "constant"}, r"^scene: is an Emitter of Mitsuba"),
        ({}, r"^scene: nothing in the scene can be lit \(it has no shapes\)"),
        ({"type": "scene", "a": {"kind": "sphere"}}, r"\('a': missing 'type' attribute\)"),
        ({"type": "scene", "a": {"type": "teapot"}}, r"\('a': 'teapot': Mitsuba has no such plugin"),
        (
            {"type": "scene", "a": {"type": "ply", "filename": "gone.ply"}},
            r"\('a': shape 'ply': gone.ply: no such file",
        ),
        ({"type": "scene", "a": {"type": "sphere", "b": {"type": "diffuse", "gloss": 1.0}}}, r"\('a.b': .* 'gloss'\)"),
        ({"type": 5}, r"the type or id of something is no string"),
        ({1: {"type": "sphere"}}, r"Dictionary keys must be strings"),
    ],
)
def test_dicts_that_are_wrong(description, message, mi):
    with pytest.raises(UserError, match=message) as told:
        sp.precompute(description)
    assert "\n" not in str(told.value)


def test_what_a_scene_of_mitsuba_says_itself(mi):
    scene = mi.load_dict(described(mi))
    for options, message in (
        ({"albedo": 0.5}, "scene: its materials say what it reflects; leave out the albedo"),
        ({"crease_angle": 30.0}, "scene: its shapes say themselves which edges are hard"),
        ({"parameters": {"r": 1}}, "scene: is no Mitsuba .xml scene, and no other takes parameters"),
        ({"view": "other"}, r"scene: no camera 'other'; name one by number or id: 0 \('camera'\)"),
    ):
        with pytest.raises(UserError, match=message):
            sp.precompute(scene, **options)
    with pytest.raises(UserError, match="is a BSDF of Mitsuba"):
        sp.precompute(scene.shapes()[0].bsdf())
