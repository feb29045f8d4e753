"""The integrator in Mitsuba scenes: the same pictures as vertex colours, in all variants."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import trimesh

import slepian_prt as sp
from slepian_prt.lighting.environment import about_up
from slepian_prt.lighting.projection import project_environment
from slepian_prt.relighting.relight import relight
from slepian_prt.scene.mesh import make_mesh
from slepian_prt.sphere.rotation import rotate_sh
from tests.conftest import sphere
from tests.numerics import assert_rounded
from tests.relighting.mitsuba.scenes import (
    SPP,
    VARIANTS,
    camera,
    envmap,
    loaded,
    packed_of,
    painted,
    picture,
    runs,
    shape,
    sky,
)
from tests.statistics import assert_agree, assert_same_picture, in_blocks
from tests.variants import VARIANT, sibling

# --- Pictures --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rotate", [0.0, 50.0])
def test_the_picture_is_that_of_relit_vertices(rotate, mi, folder):
    emitter = envmap(mi, rotation=about_up(rotate), scale=2.5)
    scene = loaded(mi, folder, emitter, {"hide_emitters": True})
    packed = packed_of(folder)
    radiance = relight(packed, 2.5 * project_environment(sky(), 6, rotate=rotate))
    expected = painted(mi, scene, radiance)
    assert expected.max() > 0.5
    assert_same_picture(picture(mi, scene), expected, atol=1e-4 * expected.max())


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["constant", "sunsky"])
def test_other_distant_lights(kind, mi, folder):
    emitter = {"constant": {"type": "constant", "radiance": {"type": "rgb", "value": [0.4, 0.7, 1.0]}},
               "sunsky": {"type": "sunsky", "sun_direction": [0.4, 0.7, 0.3], "turbidity": 4.0}}[kind]  # fmt: skip
    scene = loaded(mi, folder, emitter, {"hide_emitters": True})
    lighting = project_environment(scene.environment(), 6)
    expected = painted(mi, scene, relight(packed_of(folder), lighting))
    assert_same_picture(picture(mi, scene), expected, atol=1e-4 * expected.max())


@pytest.mark.slow
def test_one_hot_texels_light_the_same_side_as_direct(mi, tmp_path):
    """A convex mesh, so that `direct` differs by the bandlimit and noise alone: the centroid of the light agrees."""
    ball = replace(sphere(4), name="ball")
    sp.compress(sp.precompute(ball, bandlimit=8, samples=16), tolerance=0.01, clusters=12).save(tmp_path / "ball.prt")
    trimesh.Trimesh(ball.positions, ball.faces, vertex_normals=ball.normals, process=False).export(
        tmp_path / "ball.ply"
    )
    white = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 1.0}}
    rng = np.random.default_rng(4)
    for row, column in zip([3, 12, *rng.integers(3, 13, 12)], rng.integers(0, 32, 14), strict=True):
        texels = np.zeros((16, 32, 3), dtype=np.float32)
        texels[row, column] = 10.0
        scene = mi.load_dict({
            "type": "scene",
            "ball": {"type": "ply", "filename": str(tmp_path / "ball.ply"), "bsdf": white},
            "emitter": envmap(mi, texels, about_up(25.0)),
            "sensor": camera(mi, 48),
        })  # fmt: skip
        ours = mi.load_dict({"type": "slepian_prt", "transfer": str(tmp_path / "ball.prt"), "hide_emitters": True})
        theirs = mi.load_dict({"type": "direct", "hide_emitters": True, "bsdf_samples": 0, "emitter_samples": 4})
        a, b = (
            picture(mi, scene, integrator=ours, spp=64)[..., 0],
            picture(mi, scene, integrator=theirs, spp=64)[..., 0],
        )
        # Seen by the camera or not, light falls on the same pixels: within noise and ringing of 8 degrees, against what
        # the light sends to a surface that faces it.
        facing = project_environment(texels, 0)[0, 0] * np.sqrt(4.0 * np.pi) / np.pi
        assert np.sqrt(np.mean((a - b) ** 2)) <= 0.01 * facing, (row, column, np.sqrt(np.mean((a - b) ** 2)) / facing)


def test_what_is_not_in_the_file_is_drawn_as_path_would(mi, folder):
    import drjit as dr

    others = {
        "floor": {"type": "rectangle", "to_world": mi.ScalarTransform4f().translate([0, -1.5, 0]).rotate([1, 0, 0], -90)
                  .scale(4.0)},
    }  # fmt: skip
    # Without bounces, in which the light of the file's degrees and that of the map differ.
    scene = loaded(mi, folder, integrator={"max_depth": 2}, **others)
    ours = runs(mi, scene)
    theirs = runs(mi, scene, integrator=mi.load_dict({"type": "path", "max_depth": 2}))

    class OnMesh(mi.SamplingIntegrator):
        def sample(self, scene, sampler, ray, medium=None, active=True):
            si = scene.ray_intersect(ray, active)
            return dr.select(si.shape == mi.ShapePtr(scene.shapes()[names.index("bumpy")]), mi.Spectrum(1), 0), True, []

    names = [s.id() for s in scene.shapes()]
    covered = picture(mi, scene, integrator=OnMesh(mi.Properties()))[..., 0]
    assert 0.2 < np.mean(covered > 0) < 0.8
    away = (covered == 0)[:, :, None]
    assert_agree(in_blocks(away * ours, 4), in_blocks(away * theirs, 4))
    black = picture(mi, loaded(mi, folder, integrator={"hide_emitters": True}))
    assert np.median(black[:4]) == 0.0


@pytest.mark.slow
@pytest.mark.parametrize("sides", [1, 2])
def test_the_back_of_a_surface_is_drawn_as_path_would(sides, mi, tmp_path):
    """A bowl looked into: transfer knows light on its outside only, and a material with two sides is lit within."""
    ball = trimesh.creation.icosphere(3)
    lower = (ball.vertices[ball.faces][:, :, 2] <= 1e-9).all(axis=1)
    bowl = make_mesh(ball.vertices, ball.faces[lower], name="bowl")
    sp.compress(sp.precompute(bowl, bandlimit=2, samples=16), clusters=4).save(tmp_path / "bowl.prt")
    trimesh.Trimesh(bowl.positions, bowl.faces, vertex_normals=bowl.normals, process=False).export(
        tmp_path / "bowl.ply"
    )
    diffuse = {"type": "diffuse"}
    scene = mi.load_dict({
        "type": "scene",
        "bowl": {"type": "ply", "filename": str(tmp_path / "bowl.ply"),
                 "bsdf": diffuse if sides == 1 else {"type": "twosided", "bsdf": diffuse}},
        "emitter": envmap(mi),
        "sensor": camera(mi) | {"to_world": mi.ScalarTransform4f().look_at([0, 0, 4], [0, 0, 0], [0, 1, 0])},
    })  # fmt: skip
    ours = mi.load_dict({"type": "slepian_prt", "transfer": str(tmp_path / "bowl.prt"), "hide_emitters": True})
    theirs = mi.load_dict({"type": "path", "hide_emitters": True})
    pictures = [in_blocks(runs(mi, scene, integrator=integrator), 4) for integrator in (ours, theirs)]
    assert (pictures[1].max() > 0.2) == (sides == 2)
    assert_agree(*pictures)


def test_materials_of_the_scene_on_request(mi, folder):
    scene = loaded(mi, folder, integrator={"hide_emitters": True, "albedo": "scene"})
    bare = relight(packed_of(folder), project_environment(sky(), 6)) / packed_of(folder).mesh.albedo
    expected = painted(mi, scene, bare * [0.8, 0.5, 0.2])
    assert_same_picture(picture(mi, scene), expected, atol=1e-4 * expected.max())


# --- Updates ---------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_changes_of_the_emitter_need_no_reload(mi, folder):
    scene = loaded(mi, folder)
    first = picture(mi, scene)
    assert_rounded(picture(mi, scene), first, terms=SPP)
    parameters = mi.traverse(scene)

    halo = np.concatenate([sky(9)[:, -1:], sky(9), sky(9)[:, :1]], axis=1)
    turn = mi.ScalarTransform4f().rotate([0, 1, 0], 70.0)
    for key, value, fresh in [
        ("emitter.data", mi.TensorXf(halo), {"texels": sky(9)}),
        ("emitter.to_world", mi.Transform4f(turn), {"texels": sky(9), "rotation": about_up(70.0)}),
        ("emitter.scale", 0.25, {"texels": sky(9), "rotation": about_up(70.0), "scale": 0.25}),
    ]:
        parameters[key] = value
        parameters.update()
        again = picture(mi, scene)
        assert np.abs(again - first).max() > 0.05
        wanted = picture(mi, loaded(mi, folder, envmap(mi, **fresh)))
        assert_same_picture(again, wanted, atol=1e-5 * wanted.max())
        first = again
    parameters["integrator.albedo"] = mi.TensorXf(np.zeros((len(packed_of(folder).mesh.positions), 3), np.float32))
    parameters.update()
    assert np.abs(picture(mi, scene) - first).max() > 0.05
    parameters["integrator.albedo"] = mi.TensorXf(np.zeros((4, 3), np.float32))
    with pytest.raises(Exception, match=r"albedo of bumpy.prt must have shape \(642, 3\)"):
        parameters.update()


def test_one_integrator_in_two_scenes(mi, folder):
    a, b = loaded(mi, folder), loaded(mi, folder, envmap(mi, sky(9)))
    own = picture(mi, b)
    integrator = a.integrator()
    first = picture(mi, a, integrator=integrator)
    assert_rounded(picture(mi, b, integrator=integrator), own, terms=SPP + 49)
    assert_rounded(picture(mi, a, integrator=integrator), first, terms=SPP + 49)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.7, 2.0 * np.pi])
def test_turning_the_light_is_turning_the_scene_back(angle, mi, folder, rng):
    """Also moved and scaled: what was precomputed holds for a model anywhere under distant light."""
    axis = rng.normal(size=3)
    turn = np.eye(4)
    turn[:3, :3] = trimesh.transformations.rotation_matrix(angle, axis)[:3, :3]
    moved = turn.copy()
    moved[:3, :3] *= 2.0
    moved[:3, 3] = [3.0, -1.0, 2.0]
    lighting = rotate_sh(project_environment(sky(), 6), turn[:3, :3].T)
    scene = loaded(
        mi,
        folder,
        integrator={"hide_emitters": True},
        bumpy=shape(mi, folder, moved),
        sensor=camera(mi) | {"to_world": mi.ScalarTransform4f().look_at([3, 1, 10], [3, -1, 2], [0, 1, 0])},
    )
    expected = painted(mi, scene, relight(packed_of(folder), lighting))
    assert_same_picture(picture(mi, scene), expected, atol=1e-4 * expected.max())


# --- Variants --------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_switching_variants_back_and_forth(mi, folder):
    """In colour the same picture; in one channel its luminance."""
    reference = None
    for variant in [*VARIANTS, "scalar_rgb", *VARIANTS[::-1]]:
        mi.set_variant(variant)
        if variant.startswith("scalar"):
            with pytest.raises(Exception, match=r"needs an llvm_\* or cuda_\* variant"):
                loaded(mi, folder)
            continue
        level = mi.log_level()
        mi.set_log_level(mi.LogLevel.Error)
        scene = loaded(mi, folder, integrator={"hide_emitters": True})
        pixels = np.array(mi.render(scene, spp=1024, seed=1))
        mi.set_log_level(level)
        if reference is None:
            reference = pixels
        if mi.is_monochromatic:
            # The light and the albedo become luminance, each by itself.
            assert np.linalg.norm(pixels[..., 0] - reference.mean(axis=2)) < 0.1 * np.linalg.norm(pixels)
        elif mi.is_spectral:
            # What differs is the noise of wavelengths, which another picture tells.
            noise = np.linalg.norm(pixels - np.array(mi.render(scene, spp=1024, seed=2))) / np.sqrt(2.0)
            assert noise < 0.1 * np.linalg.norm(reference)
            assert np.linalg.norm(pixels - reference) < 1.1 * noise
            np.testing.assert_allclose(pixels.mean(axis=(0, 1)), reference.mean(axis=(0, 1)), rtol=0.01)
        else:
            np.testing.assert_allclose(pixels, reference, atol=1e-5)


def test_a_variant_switched_between_load_and_render(mi, folder):
    scene = loaded(mi, folder)
    before = picture(mi, scene)
    mi.set_variant(sibling("ad_mono"))
    mi.set_variant(VARIANT)
    assert_rounded(picture(mi, scene), before, terms=SPP)


def test_registering_before_a_variant_is_set():
    code = f"""
import slepian_prt
slepian_prt.register()
slepian_prt.register()
import mitsuba as mi
for variant in {(VARIANT, sibling("ad_mono"), VARIANT)}:
    mi.set_variant(variant)
    try:
        mi.load_dict({{"type": "slepian_prt"}})
    except RuntimeError as error:
        print("needs a parameter 'transfer'" in str(error))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["True"] * 3
