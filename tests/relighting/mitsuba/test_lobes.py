"""What is left to a file and what goes on are together the material, whatever it is made of."""

import numpy as np
import pytest
import trimesh

import slepian_prt as sp
from slepian_prt.paths.lobes import LAMBERTIAN, NOT_DIFFUSE, PLAIN, SPLIT, WHOLE, material_kind
from slepian_prt.relighting.mitsuba.cache import Cached
from slepian_prt.relighting.mitsuba.lobes import Lobes
from tests.conftest import sphere
from tests.relighting.mitsuba.scenes import camera, runs
from tests.statistics import assert_agree, in_blocks

RED = {"type": "rgb", "value": [0.7, 0.3, 0.1]}
DIFFUSE = {"type": "diffuse", "reflectance": RED}
GOLD = {"type": "roughconductor", "alpha": 0.3}


def textured(mi, color0=0.2, color1=0.9):
    return {
        "type": "checkerboard",
        "color0": color0,
        "color1": color1,
        "to_uv": mi.ScalarTransform4f().scale([8, 8, 1]),
    }


def materials(mi):
    """Of all kinds."""
    plastic = {"type": "roughplastic", "diffuse_reflectance": RED, "int_ior": 1.9, "alpha": 0.4, "nonlinear": True}
    bumps = {"type": "bitmap", "raw": True, "data": mi.TensorXf(bump_normals())}
    return {
        "diffuse": (DIFFUSE, PLAIN),
        "twosided": ({"type": "twosided", "bsdf": DIFFUSE}, PLAIN),
        "texture": ({"type": "diffuse", "reflectance": textured(mi)}, LAMBERTIAN),
        "plastic": ({"type": "plastic", "diffuse_reflectance": RED}, SPLIT),
        "roughplastic": (plastic, SPLIT),
        "blend": ({"type": "blendbsdf", "weight": textured(mi), "a": DIFFUSE, "b": GOLD}, SPLIT),
        "mask": ({"type": "mask", "opacity": 0.4, "bsdf": {"type": "twosided", "bsdf": DIFFUSE}}, SPLIT),
        "principled": ({"type": "principled", "base_color": RED, "metallic": 0.4, "roughness": 0.4}, WHOLE),
        "thin": ({"type": "principledthin", "base_color": RED, "diff_trans": 0.7}, WHOLE),
        "normalmap": ({"type": "normalmap", "normalmap": bumps, "bsdf": DIFFUSE}, WHOLE),
        "bumpmap": ({"type": "bumpmap", "scale": 0.05, "texture": bumps, "bsdf": plastic}, WHOLE),
        "two_bumps": ({"type": "twosided", "bsdf": {"type": "bumpmap", "texture": bumps, "bsdf": DIFFUSE}}, WHOLE),
        "two_plastics": ({"type": "twosided", "a": DIFFUSE, "b": plastic}, SPLIT),
        "metal": (GOLD, NOT_DIFFUSE),
        "glass": ({"type": "dielectric"}, NOT_DIFFUSE),
    }  # fmt: skip


NAMES = [
    "diffuse", "twosided", "texture", "plastic", "roughplastic", "blend", "mask", "principled", "thin", "normalmap",
    "bumpmap", "two_bumps", "two_plastics", "metal", "glass",
]  # fmt: skip


def bump_normals():
    x = 0.4 * np.sin(np.arange(32) / 32 * 2.0 * np.pi * 4)[:, None] + np.zeros((32, 32))
    return (np.stack([x, 0 * x, np.sqrt(1 - x**2)], axis=-1) + 1).astype(np.float32) / 2


def points(mi, count: int, rng):
    """Surface interactions at random places of the texture, looked at from random directions above."""
    import drjit as dr

    si = dr.zeros(mi.SurfaceInteraction3f, count)
    si.wi = mi.warp.square_to_uniform_hemisphere(mi.Point2f(rng.random((2, count)).astype(np.float32)))
    si.uv = mi.Point2f(rng.random((2, count)).astype(np.float32))
    si.n, si.sh_frame = mi.Normal3f(0, 0, 1), mi.Frame3f(mi.Normal3f(0, 0, 1))
    si.dp_du, si.dp_dv = mi.Vector3f(1, 0, 0), mi.Vector3f(0, 1, 0)
    return si


def on_material(mi, bsdf, si):
    """The material at points on a rectangle that a file of albedo 1 holds, and the rectangle."""
    rectangle = mi.load_dict({"type": "rectangle", "bsdf": bsdf})
    si.shape = mi.ShapePtr(rectangle)
    lobes = Lobes(mi, [rectangle.bsdf()], "scene", None)
    held = Cached(mi.Bool(True), mi.Color3f(1.0), mi.Color3f(1.0), mi.Color3f(1.0), mi.Bool(False))
    return lobes.at(si, held, mi.Bool(True)), rectangle


@pytest.mark.parametrize("name", NAMES)
def test_kinds_of_materials(name, mi):
    material, kind = materials(mi)[name]
    assert material_kind(mi, mi.load_dict(material)) == kind


def test_a_material_that_is_not_known_is_not_split(mi):
    class Own(mi.BSDF):
        def __init__(self, properties):
            super().__init__(properties)
            self.m_components = [mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.FrontSide]
            self.m_flags = self.m_components[0]

        def to_string(self):
            return "Own[]"

    mi.register_bsdf("own_material", Own)
    assert material_kind(mi, mi.load_dict({"type": "own_material"})) == WHOLE


@pytest.mark.parametrize("name", NAMES)
def test_held_and_other_lobes_are_the_whole_material(name, mi, rng):
    count = 512
    si = points(mi, count, rng)
    wo = mi.warp.square_to_uniform_sphere(mi.Point2f(rng.random((2, count)).astype(np.float32)))
    material, rectangle = on_material(mi, materials(mi)[name][0], si)
    held = material.held_from(wo, mi.Bool(True))
    others, _ = material.evaluate(wo, mi.Bool(True))
    whole = np.array(rectangle.bsdf().eval(mi.BSDFContext(), si, wo)) + np.zeros((3, count))
    # A sum of three numbers of float32, the largest of which is the whole.
    np.testing.assert_allclose(np.array(held) + np.array(others), whole, atol=4e-6 * max(1.0, whole.max()))


@pytest.mark.parametrize("name", ["plastic", "roughplastic", "blend", "principled", "normalmap", "thin"])
def test_directions_are_drawn_with_the_density_that_is_told(name, mi, rng):
    """∫ f cos dω of the lobes that go on, by their own directions and by uniform ones."""
    count = 1 << 17
    si = points(mi, 1, rng)
    material, _ = on_material(mi, materials(mi)[name][0], si)
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(1, count)
    drawn, weight = material.sample(sampler)
    smooth = ~np.array(mi.has_flag(drawn.sampled_type, mi.BSDFFlags.Delta))
    ours = np.array(weight)[0] * smooth
    wo = mi.warp.square_to_uniform_sphere(sampler.next_2d())
    others, _ = material.evaluate(wo, mi.Bool(True))
    theirs = np.broadcast_to(np.array(others)[0] * 4.0 * np.pi, count)
    error = np.hypot(ours.std(), theirs.std()) / np.sqrt(count)
    assert abs(ours.mean() - theirs.mean()) < 4.0 * error + 1e-6


@pytest.fixture(scope="module")
def ball(tmp_path_factory):
    """A ball, which sends no light to itself: under constant light of 1 all that a file can hold is known, 1."""
    path = tmp_path_factory.mktemp("ball")
    mesh = sphere(4)
    sp.compress(sp.precompute(mesh, bandlimit=1, samples=16, effects="none"), tolerance=1e-3).save(path / "ball.prt")
    colours = np.arctan2(mesh.positions[:, 1], mesh.positions[:, 0]) / (2.0 * np.pi), 0.5 * mesh.positions[:, 2]
    ball = trimesh.Trimesh(mesh.positions, mesh.faces, vertex_normals=mesh.normals, process=False)
    ball.visual = trimesh.visual.TextureVisuals(uv=np.stack(colours, axis=1))
    ball.export(path / "ball.obj")
    return path


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_every_material_of_a_ball_under_constant_light_is_as_path_has_it(name, mi, ball):
    scene = mi.load_dict({
        "type": "scene",
        "ball": {"type": "obj", "filename": str(ball / "ball.obj"), "bsdf": materials(mi)[name][0]},
        "emitter": {"type": "constant"},
        "sensor": camera(mi, 16),
    })  # fmt: skip
    ours = mi.load_dict({"type": "slepian_prt", "transfer": str(ball / "ball.prt"), "albedo": "scene"})
    pictures = [
        in_blocks(runs(mi, scene, 12, integrator=one, spp=64), 4) for one in (ours, mi.load_dict({"type": "path"}))
    ]
    assert_agree(*pictures, bias=2e-3)  # what coding left of the file's 1
