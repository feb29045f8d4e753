"""What diffuse lobes reflect, against Fresnel's formulas, Mitsuba's own sampling, and sums over random directions."""

import math

import numpy as np
import pytest

from slepian_prt.renderer.variants import mitsuba
from slepian_prt.scene.reflectance.bsdf_parts import is_textured
from slepian_prt.scene.reflectance.diffuse_lobe import diffuse_albedo
from tests.numerics import assert_exact

COLOUR = (0.9, 0.5, 0.2)
PAIRS = 1 << 16


@pytest.fixture(scope="module")
def mi():
    with mitsuba() as module:
        yield module


def rgb(*value: float) -> dict:
    return {"type": "rgb", "value": list(value)}


def points(mi, count: int = 4):
    import drjit as dr

    si = dr.zeros(mi.SurfaceInteraction3f, count)
    si.t, si.wi = mi.Float(0.0), mi.Vector3f(0.0, 0.0, 1.0)
    si.uv = mi.Point2f((np.arange(count) + 0.5) / count, 0.25)
    return si


def albedo(mi, bsdf: dict, side: int = 1) -> np.ndarray:
    """(3,) of a material that is the same everywhere."""
    found = diffuse_albedo(mi, mi.load_dict(bsdf), points(mi), side=side)
    np.testing.assert_allclose(found, np.broadcast_to(found[0], found.shape), rtol=1e-6)
    return found[0]


def random_directions(mi, count: int, seed: int):
    u = np.random.default_rng(seed).random((2, count)).astype(np.float32)
    return mi.warp.square_to_cosine_hemisphere(mi.Point2f(u))


def assert_is_mean(expected, values) -> None:
    """``values`` (n, 3) have the mean expected, to 5 standard errors and float32."""
    error = values.std(axis=0) / math.sqrt(len(values))
    assert (np.abs(values.mean(axis=0) - expected) <= 5.0 * error + 1e-5).all()


def test_a_lambertian_material_reflects_its_own_number(mi):
    found = albedo(mi, {"type": "diffuse", "reflectance": rgb(*COLOUR)})
    assert_exact(np.float32(found), np.float32(COLOUR), "the parameter itself is what is reflected")


def transmitted(eta: float) -> float:
    """Mean over the hemisphere, cosine-weighted, of what Fresnel's formulas let into a medium."""
    node, weight = np.polynomial.legendre.leggauss(400)
    outside = 0.5 * (node + 1.0)
    inside = np.sqrt(1.0 - (1.0 - outside**2) / eta**2)
    parallel = (inside - eta * outside) / (inside + eta * outside)
    across = (outside - eta * inside) / (outside + eta * inside)
    return float(np.sum(0.5 * weight * 2.0 * outside * (1.0 - 0.5 * (parallel**2 + across**2))))


@pytest.mark.parametrize("nonlinear", [False, True])
@pytest.mark.parametrize("eta", [1.3, 1.9])
def test_plastic(eta, nonlinear, mi):
    """ρ T² / (η² (1 - ρ' R)): T into the coat, and R = 1 - T/η² back from below it; ρ' is 1, or ρ if nonlinear.

    Mitsuba has R by a fit that is good to three digits.
    """
    plastic = {"type": "plastic", "int_ior": eta, "ext_ior": 1.0, "nonlinear": nonlinear}
    found = albedo(mi, {**plastic, "diffuse_reflectance": rgb(*COLOUR)})
    through, colour = transmitted(eta), np.array(COLOUR)
    below = (colour if nonlinear else 1.0) * (1.0 - through / eta**2)
    np.testing.assert_allclose(found, colour * through**2 / eta**2 / (1.0 - below), rtol=5e-3)


SAMPLED = {
    "plastic": {"type": "plastic", "nonlinear": True, "diffuse_reflectance": rgb(*COLOUR)},
    "roughplastic": {"type": "roughplastic", "int_ior": 1.9, "alpha": 0.4, "diffuse_reflectance": rgb(*COLOUR)},
    "blend": {
        "type": "blendbsdf",
        "weight": 0.3,
        "first": {"type": "plastic", "diffuse_reflectance": rgb(*COLOUR)},
        "second": {"type": "roughconductor", "material": "Au"},
    },
    "two-sided": {"type": "twosided", "nested": {"type": "roughplastic", "nonlinear": True}},
}


@pytest.mark.parametrize("name", SAMPLED)
def test_samples_of_the_lobe_weigh_as_much(name, mi):
    bsdf, side = mi.load_dict(SAMPLED[name]), -1 if name == "two-sided" else 1
    si, rng = points(mi, PAIRS), np.random.default_rng(7)
    si.wi = random_directions(mi, PAIRS, 1)
    si.wi.z *= side
    context = mi.BSDFContext()
    context.type_mask = mi.BSDFFlags.DiffuseReflection
    u = rng.random((3, PAIRS)).astype(np.float32)
    _, weight = bsdf.sample(context, si, mi.Float(u[0]), mi.Point2f(u[1:]))
    assert_is_mean(albedo(mi, SAMPLED[name], side), np.array(weight).T)


# Without specular reflection or metal, all that these reflect is their diffuse lobe.
PRINCIPLED = {"base_color": rgb(0.3, 0.5, 0.7), "roughness": 0.8}
ALONE = {
    "plain": {"type": "principled", "specular": 0.0, **PRINCIPLED},
    "flat": {"type": "principled", "specular": 0.0, "flatness": 0.7, **PRINCIPLED},
    "sheen": {"type": "principled", "specular": 0.0, "sheen": 0.6, "sheen_tint": 0.5, **PRINCIPLED},
    "thin": {"type": "principledthin", "flatness": 0.4, "sheen": 0.5, "diff_trans": 0.6, **PRINCIPLED},
}


@pytest.mark.parametrize("name", ALONE)
def test_principled_lobes_integrate_to_as_much(name, mi):
    """Midpoint rule in the squared cosines and in azimuth: its error falls with the square of the 64 steps."""
    u, v, turn = (index.ravel() for index in np.indices((64, 64, 16)))
    toward, outward = (np.sqrt((k + 0.5) / 64) for k in (u, v))
    phi = 2.0 * math.pi * (turn + 0.5) / 16
    bsdf, si = mi.load_dict(ALONE[name]), points(mi, u.size)
    si.wi = mi.Vector3f(np.float32([np.sqrt(1 - toward**2), 0 * toward, toward]))
    out = np.float32([np.sqrt(1 - outward**2) * np.cos(phi), np.sqrt(1 - outward**2) * np.sin(phi), outward])
    values = math.pi * np.array(bsdf.eval(mi.BSDFContext(), si, mi.Vector3f(out))) / out[2]
    np.testing.assert_allclose(albedo(mi, ALONE[name]), values.mean(axis=1), rtol=2 / 64**2)


def test_metal_and_glass_are_parts_of_a_principled_material_that_reflect_nothing_diffusely(mi):
    whole = albedo(mi, {"type": "principled", **PRINCIPLED})
    part = albedo(mi, {"type": "principled", "metallic": 0.25, "spec_trans": 0.4, **PRINCIPLED})
    np.testing.assert_allclose(part, 0.75 * 0.6 * whole, rtol=1e-6)
    white = {"type": "principled", "base_color": rgb(1, 1, 1), "roughness": 1.0, "sheen": 1.0}
    assert albedo(mi, white).max() <= 1.0


def test_wrappers(mi):
    """A mask leaves what its opacity says, bumps leave all, and the other side is another material's."""
    plastic = {"type": "plastic", "diffuse_reflectance": rgb(*COLOUR)}
    whole = albedo(mi, plastic)
    np.testing.assert_allclose(albedo(mi, {"type": "mask", "opacity": 0.3, "nested": plastic}), 0.3 * whole, rtol=1e-6)
    bumpy = {"type": "bumpmap", "texture": {"type": "checkerboard"}, "nested": plastic}
    np.testing.assert_allclose(albedo(mi, bumpy), whole, rtol=1e-6)
    sides = {"type": "twosided", "front": plastic, "back": {"type": "diffuse", "reflectance": rgb(0.1, 0.2, 0.3)}}
    np.testing.assert_allclose(albedo(mi, sides), whole, rtol=1e-6)
    np.testing.assert_allclose(albedo(mi, sides, side=-1), [0.1, 0.2, 0.3], rtol=1e-6)
    for one_sided in (plastic, {"type": "diffuse"}, {"type": "principled"}, {"type": "roughconductor"}):
        assert not albedo(mi, one_sided, side=-1).any()
    thin = {"type": "principledthin", **PRINCIPLED}
    np.testing.assert_allclose(albedo(mi, thin, side=-1), albedo(mi, thin), rtol=1e-6)


def test_textures_scale_lobes(mi):
    plastic = {"type": "plastic", "nonlinear": True}
    board = {"type": "checkerboard", "color0": rgb(*COLOUR), "color1": rgb(0.1, 0.1, 0.1)}
    found = diffuse_albedo(mi, mi.load_dict({**plastic, "diffuse_reflectance": board}), points(mi))
    for value, row in ((COLOUR, found[0]), ((0.1, 0.1, 0.1), found[-1])):
        np.testing.assert_allclose(row, albedo(mi, {**plastic, "diffuse_reflectance": rgb(*value)}), rtol=1e-5)


def plugin(mi, value, flags):
    """A BSDF of someone else whose reflected light, (1/π) cos θ_o times value(u, cos θ_o), is all in one lobe."""

    class Made(mi.BSDF):
        def __init__(self):
            super().__init__(mi.Properties())
            self.m_components, self.m_flags = [flags], flags

        def eval(self, context, si, wo, active=True):
            import drjit as dr

            up = (mi.Frame3f.cos_theta(wo) > 0.0) & (mi.Frame3f.cos_theta(si.wi) > 0.0)
            return mi.Color3f(dr.select(up, value(si.uv.x, wo.z) * wo.z / math.pi, 0.0))

        def traverse(self, callback):
            pass

        def class_name(self):
            return "Made"

    return Made()


def test_lobes_whose_shape_varies_are_integrated_everywhere(mi):
    """(1-u) + u cos θ_o: the mean of cos θ over a cosine-weighted hemisphere is 2/3."""
    flags = mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.FrontSide
    bsdf, si = plugin(mi, lambda u, z: 1.0 - u + u * z, flags), points(mi, 100)
    u = np.array(si.uv.x)
    expected = np.repeat((1.0 - u / 3.0)[:, None], 3, axis=1)
    np.testing.assert_allclose(diffuse_albedo(mi, bsdf, si), expected, rtol=1e-5)


def test_a_plugin_that_ignores_types_has_what_it_says(mi):
    """By default that is its value straight up, times π."""
    flags = mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide
    bsdf = plugin(mi, lambda u, z: 0.3 * z + 0.0 * u, flags)
    np.testing.assert_allclose(diffuse_albedo(mi, bsdf, points(mi)), 0.3, rtol=1e-6)


def test_what_is_textured(mi):
    board = {"type": "checkerboard"}
    nested = {"type": "twosided", "nested": {"type": "plastic", "diffuse_reflectance": board}}
    attribute = {"type": "diffuse", "reflectance": {"type": "mesh_attribute", "name": "vertex_color"}}
    for bsdf in (nested, attribute, {"type": "mask", "opacity": board, "nested": {"type": "diffuse"}}):
        assert is_textured(mi, mi.load_dict(bsdf))
    for bsdf in (
        {"type": "diffuse", "reflectance": rgb(*COLOUR)},
        {"type": "principled"},
        {"type": "bumpmap", "texture": board, "nested": {"type": "diffuse"}},
    ):
        assert not is_textured(mi, mi.load_dict(bsdf))


def test_the_material_stays_as_it_was(mi):
    bsdf = mi.load_dict(SAMPLED["blend"])
    before = {name: str(value) for name, value in mi.traverse(bsdf)}
    diffuse_albedo(mi, bsdf, points(mi))
    assert {name: str(value) for name, value in mi.traverse(bsdf)} == before
