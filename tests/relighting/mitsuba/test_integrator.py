"""The integrator in Mitsuba scenes: the same pictures as vertex colours, and gradients as finite differences."""

import re
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import trimesh

import slepian_prt as sp
from slepian_prt.lighting.environment import about_up
from slepian_prt.lighting.projection import project_environment
from slepian_prt.lighting.windowing import windowed
from slepian_prt.relighting.mitsuba.bound_transfer import log_warning
from slepian_prt.relighting.mitsuba.spectra import smooth_basis, smooth_spectra
from slepian_prt.relighting.relight import relight
from slepian_prt.renderer.variants import imported_mitsuba, prepare_llvm
from slepian_prt.scene.mesh import make_mesh
from slepian_prt.sphere.harmonics import real_sh
from slepian_prt.sphere.rotation import rotate_sh
from tests.conftest import bumpy, sphere
from tests.lighting.test_environment import grid_directions
from tests.numerics import assert_exact, assert_rounded
from tests.statistics import assert_agree, assert_near, assert_same_picture, in_blocks

VARIANTS = [
    "llvm_ad_rgb",
    "llvm_ad_mono",
    "llvm_ad_mono_polarized",
    "llvm_ad_spectral",
    "llvm_ad_spectral_polarized",
]


@pytest.fixture
def mi():
    """Mitsuba in an LLVM variant with the integrator registered; the variant of before comes back."""
    module = imported_mitsuba()
    before = module.variant()
    prepare_llvm()
    module.set_variant("llvm_ad_rgb")
    sp.register()
    yield module
    module.set_variant(before or "scalar_rgb")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A mesh with colours, its file without vertex normals merged, and its transfer."""
    path = tmp_path_factory.mktemp("integrator")
    mesh = bumpy(3)
    rng = np.random.default_rng(0)
    mesh = replace(mesh, name="bumpy", albedo=(0.3 + 0.5 * rng.random((len(mesh.positions), 3))).astype(np.float32))
    packed = sp.compress(sp.precompute(mesh, bandlimit=6, samples=256), tolerance=0.02, clusters=12)
    packed.save(path / "bumpy.prt")
    trimesh.Trimesh(mesh.positions, mesh.faces, vertex_normals=mesh.normals, process=False).export(path / "bumpy.ply")
    return path


def sky(seed: int = 3, height: int = 32) -> np.ndarray:
    """A smooth positive map with a bright spot."""
    d = grid_directions(height)
    rng = np.random.default_rng(seed)
    texels = 0.2 + 0.1 * np.abs(
        np.einsum("hwm,cm->hwc", real_sh(3, d.reshape(-1, 3)).reshape(*d.shape[:2], 16), rng.normal(size=(3, 16)))
    )
    spot = d @ (np.array([0.6, 0.5, 0.3]) / np.linalg.norm([0.6, 0.5, 0.3]))
    return (texels + np.exp(20.0 * (spot - 1.0))[..., None] * [3.0, 2.0, 1.0]).astype(np.float32)


def camera(mi, width: int = 32, **film):
    return {
        "type": "perspective",
        "fov": 40,
        "to_world": mi.ScalarTransform4f().look_at([1.0, 2.0, 4.0], [0, 0, 0], [0, 1, 0]),
        "film": {"type": "hdrfilm", "width": width, "height": width, "rfilter": {"type": "box"}, **film},
        "sampler": {"type": "independent", "sample_count": 16},
    }


def shape(mi, folder, turn=None):
    made = {
        "type": "ply",
        "filename": str(folder / "bumpy.ply"),
        "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.8, 0.5, 0.2]}},
    }
    return made if turn is None else {**made, "to_world": mi.ScalarTransform4f(turn.tolist())}


def envmap(mi, texels=None, rotation=None, **others):
    matrix = np.eye(4)
    if rotation is not None:
        matrix[:3, :3] = rotation
    texels = sky() if texels is None else texels
    return {"type": "envmap", "bitmap": mi.Bitmap(texels), "to_world": mi.ScalarTransform4f(matrix.tolist()), **others}


def loaded(mi, folder, emitter=None, integrator=None, **others):
    return mi.load_dict({
        "type": "scene",
        "integrator": {"type": "slepian_prt", "transfer": str(folder / "bumpy.prt"), **(integrator or {})},
        "bumpy": shape(mi, folder),
        "emitter": envmap(mi) if emitter is None else emitter,
        "sensor": camera(mi),
        **others,
    })  # fmt: skip


SPP = 16  # samples, and so terms in the sum of a pixel


def picture(mi, scene, **options):
    return np.array(mi.render(scene, **{"spp": SPP, "seed": 1, **options}))


def runs(mi, scene, count: int = 24, **options):
    """Pictures with random numbers of their own each."""
    return np.stack([picture(mi, scene, **{**options, "seed": seed}) for seed in range(1, count + 1)])


def painted(mi, scene, radiance, name: str = "bumpy"):
    """The scene with Mitsuba's own interpolation of colours at the vertices of a shape; black elsewhere."""
    import drjit as dr

    mesh = next(s for s in scene.shapes() if s.id() == name)
    mesh.add_attribute("vertex_radiance", 3, np.ascontiguousarray(radiance, dtype=np.float32).ravel())

    class Painted(mi.SamplingIntegrator):
        def sample(self, scene, sampler, ray, medium=None, active=True):
            si = scene.ray_intersect(ray, active)
            front = si.is_valid() & (dr.dot(si.n, ray.d) < 0.0)
            return dr.select(front, si.shape.eval_attribute_3("vertex_radiance", si, front), 0.0), front, []

    return picture(mi, scene, integrator=Painted(mi.Properties()))


def packed_of(folder):
    return sp.load(folder / "bumpy.prt")


def messages(error: BaseException) -> str:
    """Mitsuba wraps what a plugin raises in errors of its own."""
    text = ""
    while error is not None:
        text += f"{error}\n"
        error = error.__cause__ or error.__context__
    return text


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


def test_what_is_not_in_the_file_is_drawn_as_direct_would(mi, folder):
    import drjit as dr

    others = {
        "floor": {"type": "rectangle", "to_world": mi.ScalarTransform4f().translate([0, -1.5, 0]).rotate([1, 0, 0], -90)
                  .scale(4.0)},
    }  # fmt: skip
    scene = loaded(mi, folder, **others)
    ours = runs(mi, scene)
    theirs = runs(mi, scene, integrator=mi.load_dict({"type": "direct"}))

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
def test_the_back_of_a_surface_is_drawn_as_direct_would(sides, mi, tmp_path):
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
    theirs = mi.load_dict({"type": "direct", "hide_emitters": True})
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


# --- Gradients -------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("key", ["emitter.data", "emitter.scale", "integrator.albedo"])
def test_gradients_are_those_of_finite_differences(key, mi, folder, rng):
    import drjit as dr

    scene = loaded(mi, folder, integrator={"hide_emitters": True})
    parameters = mi.traverse(scene)
    start = type(parameters[key])(parameters[key])
    weights = mi.TensorXf(rng.normal(size=(32, 32, 3)).astype(np.float32))
    along = rng.normal(size=np.shape(start)).astype(np.float32) * np.array(start)
    if key == "emitter.data":
        along[:, [0, -1]] = along[:, [-2, 1]]

    def set_to(value):
        parameters[key] = value
        parameters.update()

    def loss():
        # Gradients are taken with random numbers of their own.
        return dr.sum(mi.render(scene, parameters, spp=16, seed=1, seed_grad=2) * weights, axis=None)

    values = []
    for step in (0.1, -0.1):  # the picture is linear in each: large steps lose nothing
        set_to(type(start)(np.array(start) + step * along))
        pixels = np.array(mi.render(scene, spp=16, seed=2), dtype=np.float64)
        values.append(float(np.sum(pixels * np.array(weights))))
    expected = (values[0] - values[1]) / 0.2

    leaf = type(start)(start)
    dr.enable_grad(leaf)
    set_to(leaf)
    dr.backward(loss())
    gradient = np.array(dr.grad(leaf), dtype=np.float64)
    assert float(np.sum(gradient * along)) == pytest.approx(expected, rel=2e-3)

    leaf = type(start)(start)
    dr.enable_grad(leaf)
    dr.set_grad(leaf, type(start)(along))
    set_to(leaf)
    forward = dr.forward_to(loss())
    assert float(np.array(forward).ravel()[0]) == pytest.approx(expected, rel=2e-3)


def test_gradient_of_a_material_of_the_scene(mi, folder):
    import drjit as dr

    scene = loaded(mi, folder, integrator={"hide_emitters": True, "albedo": "scene"})
    parameters = mi.traverse(scene)
    key = "bumpy.bsdf.reflectance.value"
    leaf = mi.Color3f(0.8, 0.5, 0.2)
    dr.enable_grad(leaf)
    parameters[key] = leaf
    parameters.update()
    image = mi.render(scene, parameters, spp=16, seed=1, seed_grad=2)
    dr.backward(dr.sum(image, axis=None))
    total = picture(mi, scene, seed=2).sum(axis=(0, 1))
    np.testing.assert_allclose(np.array(dr.grad(leaf)).ravel(), total / [0.8, 0.5, 0.2], rtol=1e-3)


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
    mi.set_variant("llvm_ad_mono")
    mi.set_variant("llvm_ad_rgb")
    assert_rounded(picture(mi, scene), before, terms=SPP)


def test_registering_before_a_variant_is_set():
    code = """
import slepian_prt
slepian_prt.register()
slepian_prt.register()
import mitsuba as mi
for variant in ("llvm_ad_rgb", "llvm_ad_mono", "llvm_ad_rgb"):
    mi.set_variant(variant)
    try:
        mi.load_dict({"type": "slepian_prt"})
    except RuntimeError as error:
        print("needs a parameter 'transfer'" in str(error))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["True"] * 3


# --- Scenes ----------------------------------------------------------------------------------------------------------


SCENE = """
<scene version="3.0.0">
  <sensor type="perspective"><float name="fov" value="45"/>
    <transform name="to_world"><lookat origin="1, 3, 5" target="0, 0.5, 0" up="0, 1, 0"/></transform>
    <film type="hdrfilm"><integer name="width" value="40"/><integer name="height" value="40"/>
      <rfilter type="box"/></film></sensor>
  <emitter type="constant"><rgb name="radiance" value="1, 0.9, 0.8"/></emitter>
  <bsdf type="diffuse" id="gray"><rgb name="reflectance" value="0.5"/></bsdf>
  <shape type="rectangle" id="floor"><ref id="gray"/>
    <transform name="to_world"><scale value="2"/><rotate x="1" angle="-90"/></transform></shape>
  <shape type="cube" id="box"><transform name="to_world"><scale value="0.4"/><translate x="-0.7" y="0.4"/></transform>
    <ref id="gray"/></shape>
  <shape type="sphere" id="ball"><point name="center" x="0.6" y="0.5" z="0"/><float name="radius" value="0.5"/>
    <bsdf type="diffuse"><rgb name="reflectance" value="0.2, 0.4, 0.6"/></bsdf></shape>
</scene>
"""


@pytest.mark.slow
@pytest.mark.parametrize("optimize", [True, False])
def test_shapes_with_a_formula_and_merged_ones(optimize, mi, tmp_path):
    """Where transport cut shapes finely, and where Mitsuba merged them: against the path tracer."""
    (tmp_path / "scene.xml").write_text(SCENE)
    packed = sp.compress(sp.precompute(tmp_path / "scene.xml", bandlimit=6, samples=1024), tolerance=0.005)
    packed.save(tmp_path / "scene.prt")
    scene = mi.load_file(str(tmp_path / "scene.xml"), optimize=optimize)
    ids = [shape.id() for shape in scene.shapes()]
    assert ("floor" in ids) != optimize
    ours = picture(
        mi, scene, integrator=mi.load_dict({"type": "slepian_prt", "transfer": str(tmp_path / "scene.prt")}), spp=1024
    )
    path = mi.load_dict({"type": "path", "max_depth": packed.bounces + 2})
    theirs = picture(mi, scene, integrator=path, spp=1024)
    # Constant light needs no more than degree 0, so that what differs is noise, coding, and interpolation.
    assert_near(ours, theirs, 0.02)
    assert np.quantile(np.abs(ours - theirs), 0.99) < 0.05
    nothing = mi.load_dict({"type": "scene", "emitter": {"type": "constant"}, "sensor": camera(mi)})
    with pytest.raises(RuntimeError) as caught:
        mi.render(nothing, integrator=mi.load_dict({"type": "slepian_prt", "transfer": str(tmp_path / "scene.prt")}))
    assert "its shape 'floor'" in messages(caught.value)


def test_two_files_in_one_scene(mi, folder, tmp_path):
    ball = replace(sphere(3), name="ball", positions=sphere(3).positions + [2.5, 0.0, 0.0])
    packed = sp.compress(sp.precompute(ball, bandlimit=4, samples=16), clusters=8)
    packed.save(tmp_path / "ball.prt")
    trimesh.Trimesh(ball.positions, ball.faces, vertex_normals=ball.normals, process=False).export(
        tmp_path / "ball.ply"
    )
    scene = loaded(
        mi, folder, integrator={"hide_emitters": True, "transfer_ball": str(tmp_path / "ball.prt")},
        ball={"type": "ply", "filename": str(tmp_path / "ball.ply")},
        sensor=camera(mi) | {"fov": 80},
    )  # fmt: skip
    expected = painted(mi, scene, relight(packed_of(folder), project_environment(sky(), 6)))
    second = painted(mi, scene, relight(packed, project_environment(sky(), 4)), "ball")
    ours = picture(mi, scene)
    assert {"integrator.albedo", "integrator.albedo_ball"} <= set(mi.traverse(scene).keys())
    # Where one is painted the other is black.
    assert expected.max() > 0.3
    assert second.max() > 0.3
    np.testing.assert_allclose(ours, np.maximum(expected, second), atol=0.02)
    assert np.mean(np.abs(ours - np.maximum(expected, second)) > 1e-3) < 0.01


@pytest.mark.parametrize("change", ["remeshed", "reordered", "mirrored", "gone"])
def test_shapes_that_are_not_those_of_the_file_are_refused_by_name(change, mi, folder, tmp_path):
    mesh = bumpy(2) if change == "remeshed" else bumpy(3)
    positions, faces = mesh.positions.copy(), mesh.faces
    if change == "reordered":
        order = np.random.default_rng(1).permutation(len(positions))
        positions, faces = positions[order], np.argsort(order)[faces]
    if change == "mirrored":
        positions[:, 0] *= -1.0
    trimesh.Trimesh(positions, faces, process=False).export(tmp_path / "bumpy.ply")
    if change == "gone":
        scene = mi.load_dict({
            "type": "scene", "integrator": {"type": "slepian_prt", "transfer": str(folder / "bumpy.prt")},
            "other": {"type": "sphere", "radius": 0.1}, "emitter": {"type": "constant"}, "sensor": camera(mi),
        })  # fmt: skip
    else:
        scene = loaded(mi, folder, bumpy=shape(mi, tmp_path))
    with pytest.raises(RuntimeError) as caught:
        mi.render(scene)
    wanted = {
        "remeshed": "shape 'bumpy' has 642 vertices there and 162 in the scene",
        "reordered": "shape 'bumpy' of the scene .* in another order",
        "mirrored": "shape 'bumpy' of the scene .* at other places",
        "gone": r"shape 'bumpy' \(642 vertices\) is not in the scene, which has the shapes 'other'",
    }[change]
    assert re.search(wanted, messages(caught.value)), messages(caught.value)


def test_a_mesh_of_another_name_is_found_by_its_vertices(mi, folder):
    scene = mi.load_dict({
        "type": "scene", "integrator": {"type": "slepian_prt", "transfer": str(folder / "bumpy.prt")},
        "whatever": shape(mi, folder), "emitter": envmap(mi), "sensor": camera(mi),
    })  # fmt: skip
    assert_rounded(picture(mi, scene), picture(mi, loaded(mi, folder)), terms=SPP + 49)


def test_parameters_that_are_wrong(mi, folder, tmp_path):
    for given, wanted in [
        ({"colour": 3.0}, "unreferenced property"),
        ({"albedo": "both"}, "must be 'file' or 'scene', not 'both'"),
        ({"transfer": str(tmp_path / "none.prt")}, "no such file"),
    ]:
        with pytest.raises(RuntimeError, match=wanted):
            loaded(mi, folder, integrator=given)


def test_texels_that_are_not_finite(mi, folder):
    scene = loaded(mi, folder)
    parameters = mi.traverse(scene)
    texels = np.array(parameters["emitter.data"])
    texels[5, 6] = np.nan
    parameters["emitter.data"] = mi.TensorXf(texels)
    parameters.update()
    with pytest.raises(RuntimeError) as caught:
        mi.render(scene)
    assert "NaN or infinite" in messages(caught.value)


def test_a_black_map_and_no_light(mi, folder):
    black = loaded(mi, folder, envmap(mi, np.zeros((16, 32, 3), np.float32)))
    assert_exact(picture(mi, black), 0.0, because="nothing adds light")
    scene = mi.load_dict({
        "type": "scene", "integrator": {"type": "slepian_prt", "transfer": str(folder / "bumpy.prt")},
        "bumpy": shape(mi, folder), "sensor": camera(mi),
    })  # fmt: skip
    level = mi.log_level()
    mi.set_log_level(mi.LogLevel.Error)
    assert_exact(picture(mi, scene), 0.0, because="nothing adds light")
    mi.set_log_level(level)


def test_inside_an_aov_integrator(mi, folder):
    """Which calls `sample` but not `render`."""
    scene = loaded(mi, folder)
    nested = mi.load_dict(
        {"type": "aov", "aovs": "d:depth", "own": {"type": "slepian_prt", "transfer": str(folder / "bumpy.prt")}}
    )
    np.testing.assert_allclose(picture(mi, scene, integrator=nested)[..., :3], picture(mi, scene), atol=1e-5)


# --- Remarks and refusals --------------------------------------------------------------------------------------------


@pytest.fixture
def log(mi):
    """What Mitsuba logs."""
    texts = []

    class Kept(mi.Appender):
        def append(self, level, text):
            texts.append(text)

        def log_progress(self, *_):
            pass

    logger = mi.logger()
    kept, before = Kept(), [logger.appender(i) for i in range(logger.appender_count())]
    logger.clear_appenders()
    logger.add_appender(kept)
    yield texts
    logger.clear_appenders()
    for appender in before:
        logger.add_appender(appender)


def test_what_materials_say_and_is_not_drawn_is_told(mi, folder, tmp_path, log):
    mesh = bumpy(3)
    packed = sp.compress(sp.precompute(replace(mesh, name="bumpy"), bandlimit=4, samples=16), clusters=6)
    packed.save(tmp_path / "bare.prt")
    bare = {"type": "slepian_prt", "transfer": str(tmp_path / "bare.prt")}
    picture(mi, loaded(mi, folder), integrator=mi.load_dict(bare))
    assert [text for text in log if "'bumpy' reflects all light" in text and "reflects 0.50" in text]
    log.clear()
    picture(mi, loaded(mi, folder), integrator=mi.load_dict({**bare, "albedo": "scene"}))
    assert not log
    rough = shape(mi, folder) | {"bsdf": {"type": "roughplastic"}}
    picture(mi, loaded(mi, folder, bumpy=rough), integrator=mi.load_dict({**bare, "albedo": "scene"}))
    assert [text for text in log if "not drawn: glossy reflection of shape 'bumpy'" in text]


def test_remarks_are_bare_sentences_and_made_once(mi, folder, log):
    """Without the file, line and function of ours; not again for every picture of a model that moves."""
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "slepian_prt", "transfer": str(folder / "bumpy.prt")},
            "sensor": camera(mi),
            "bumpy": shape(mi, folder),
        }
    )
    parameters = mi.traverse(scene)
    for _ in range(3):
        mi.render(scene, spp=1)
        parameters["bumpy.vertex_positions"] *= 1.5
        parameters.update()
    assert log == ["slepian_prt: without distant light the shapes of bumpy.prt are black"]


def test_remarks_follow_the_level_of_the_log(mi, log):
    level = mi.log_level()
    mi.set_log_level(mi.LogLevel.Error)
    log_warning(mi, "not wanted")
    mi.set_log_level(level)
    log_warning(mi, "wanted")
    assert log == ["slepian_prt: wanted"]
    errors = mi.logger().error_level()
    mi.logger().set_error_level(mi.LogLevel.Warn)
    try:
        with pytest.raises(RuntimeError, match="an error here"):
            log_warning(mi, "an error here")
    finally:
        mi.logger().set_error_level(errors)


def test_errors_are_in_the_log(mi, folder, tmp_path, log):
    other = bumpy(2)
    trimesh.Trimesh(other.positions, other.faces, process=False).export(tmp_path / "bumpy.ply")
    with pytest.raises(RuntimeError):
        mi.render(loaded(mi, folder, bumpy=shape(mi, tmp_path)))
    assert [text for text in log if "642 vertices there and 162 in the scene" in text]


def test_ringing_is_told_and_damped(mi, folder, log):
    texels = np.full((64, 128, 3), 1e-4, dtype=np.float32)
    texels[20:22, 30:32] = 500.0
    plain = picture(mi, loaded(mi, folder, envmap(mi, texels), {"hide_emitters": True}))
    assert plain.min() < 0.0
    assert [text for text in log if "negative under this light" in text]
    options = {"hide_emitters": True, "window": "hann", "window_width": 5.0}
    scene = loaded(mi, folder, envmap(mi, texels), options)
    lighting = windowed(project_environment(texels, 6), "hann", 5.0)
    expected = painted(mi, scene, relight(packed_of(folder), lighting))
    assert_same_picture(picture(mi, scene), expected, atol=1e-4 * expected.max())
    for wrong, wanted in [
        ({"window": "box", "window_width": 3.0}, "window must be one of"),
        ({"window": "hann"}, "width of the window must be larger"),
        ({"window_width": 3.0}, "needs a window"),
        ({"transfer": 3}, "must be the path of a file, not 3"),
    ]:
        with pytest.raises(RuntimeError, match=wanted):
            loaded(mi, folder, integrator=wrong)


def test_a_scaled_map_is_refused(mi, folder, log):
    emitter = envmap(mi) | {"to_world": mi.ScalarTransform4f().scale(2.0)}
    with pytest.raises(RuntimeError):
        mi.render(loaded(mi, folder, emitter))
    assert [text for text in log if "to_world scales or shears" in text]


def test_loading_beside_plugins_that_read_files(mi, folder):
    """Scenes load in parallel; the plugin must not disturb what others look for."""
    for _ in range(15):
        scene = loaded(mi, folder, {"type": "sunsky", "sun_direction": [0.4, 0.7, 0.3]})
        assert scene.environment() is not None
        assert "bumpy.prt" in str(scene.integrator())


def test_spectra_are_those_of_the_colour(mi):
    """Linear sRGB of the spectrum, integrated finely, is what it was made of."""
    mi.set_variant("llvm_ad_spectral")
    weights = smooth_spectra(mi)
    wavelengths = np.arange(360.0, 830.5, 0.5)
    matching = np.array([np.array(part) for part in mi.cie1931_xyz(mi.Float(wavelengths.astype(np.float32)))])
    for colour in ([1.0, 1.0, 1.0], [0.2, 0.9, -0.1], [1.0, 0.0, 0.0]):
        spectrum = weights @ colour @ np.stack(smooth_basis(wavelengths))
        found = np.array(mi.xyz_to_srgb(mi.Color3f(*(matching @ spectrum * 0.5).tolist()))).ravel()
        np.testing.assert_allclose(found, colour, atol=2e-3)


@pytest.mark.parametrize("hide", [True, False])
def test_a_lamp_before_the_model(hide, mi, folder, log):
    """Drawn, or looked through, as `direct` does; its light does not reach the model, which is told."""
    turn = mi.ScalarTransform4f().look_at([0.5, 1.0, 2.0], [1.0, 2.0, 4.0], [0, 1, 0]).scale(0.4)
    emitter = {"type": "area", "radiance": {"type": "rgb", "value": 7.0}}
    lamp = {"type": "rectangle", "to_world": turn, "emitter": emitter}
    scene = loaded(mi, folder, integrator={"hide_emitters": hide}, lamp=lamp)
    ours = picture(mi, scene)
    middle = ours[14:18, 14:18]
    if hide:
        radiance = relight(packed_of(folder), project_environment(sky(), 6))
        expected = painted(mi, loaded(mi, folder), radiance)
        np.testing.assert_allclose(middle, expected[14:18, 14:18], atol=1e-4)
    else:
        np.testing.assert_allclose(middle, 7.0, rtol=1e-5)
    assert [text for text in log if "does not reach shapes of bumpy.prt" in text]
    theirs = picture(mi, scene, integrator=mi.load_dict({"type": "direct", "hide_emitters": hide}), spp=64)
    assert ours[0, 0].any() == theirs[0, 0].any()
