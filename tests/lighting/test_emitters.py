"""Light of Mitsuba's emitters: a sky with its sun, and maps of any shape, against what the emitters themselves send."""

from types import SimpleNamespace

import numpy as np
import pytest

from slepian_prt.errors import UserError
from slepian_prt.evaluation.lights import lights_of
from slepian_prt.lighting import sky
from slepian_prt.lighting.emitters import (
    SkyEnvironment,
    emitted_environment,
    environment_emitter,
    evaluate,
    project_emitter,
)
from slepian_prt.lighting.environment import about_up, make_environment
from slepian_prt.lighting.projection import lighting_at, project_environment
from slepian_prt.lighting.texel_projection import TexelProjection
from slepian_prt.renderer.variants import imported_mitsuba, mitsuba
from slepian_prt.scene.mitsuba.files import silent
from slepian_prt.sphere.harmonics import num_coefficients, real_sh
from tests.numerics import assert_exact
from tests.variants import sibling

UP_Y = [1.0, 0.0, 0.0], -90.0  # from the z of skies to the y of maps


@pytest.fixture
def any_variant():
    """Mitsuba, for tests that set variants; that of before comes back."""
    module = imported_mitsuba()
    before = module.variant()
    yield module
    module.set_variant(before or "scalar_rgb")


def toward(elevation: float, azimuth: float = 40.0) -> np.ndarray:
    e, a = np.radians([elevation, azimuth])
    return np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])


def sunsky(mi, elevation: float = 45.0, turn=None, **others):
    direction = toward(elevation)
    if turn is not None:
        transform = mi.ScalarTransform4f().rotate(*turn)
        direction = np.array(transform.matrix)[:3, :3] @ direction
        others["to_world"] = transform
    return mi.load_dict({"type": "sunsky", "sun_direction": direction.tolist(), **others})


def sampled(mi, emitter, bandlimit: int, count: int = 1 << 18) -> np.ndarray:
    """Coefficients by the emitter's own sampling, as `direct` has it, with a lattice of two dimensions."""
    import drjit as dr

    n = np.arange(count)
    u, v = (n + 0.5) / count, (n * 0.6180339887498949) % 1.0
    point = mi.Point2f(u.astype(np.float32), v.astype(np.float32))
    sample, weight = emitter.sample_direction(dr.zeros(mi.Interaction3f, count), point)
    weights, directions = np.array(weight, dtype=np.float64), np.array(sample.d, dtype=np.float64).T
    return weights @ real_sh(bandlimit, directions) / count


def relative(found, expected) -> float:
    return float(np.linalg.norm(found - expected) / np.linalg.norm(expected))


# --- Sun and sky -----------------------------------------------------------------------------------------------------


SKIES = [
    (45.0, {}),
    (45.0, {"turn": UP_Y}),
    (45.0, {"turn": ([0.6, 0.0, 0.8], 67.0)}),
    (45.0, {"sun_aperture": 0.05}),
    (45.0, {"sun_aperture": 0.25, "complex_sun": True}),
    (45.0, {"complex_sun": True}),
    (45.0, {"sun_aperture": 20.0, "complex_sun": True}),
    (45.0, {"sun_scale": 0.0}),
    (45.0, {"sky_scale": 0.0}),
    (60.0, {"turbidity": 9.5}),
    (90.0, {}),
    (2.0, {}),
    (0.1, {}),  # the horizon cuts the disk
    (0.1, {"complex_sun": True}),
    (3.0, {"sun_aperture": 20.0, "complex_sun": True}),
]


@pytest.mark.slow
@pytest.mark.parametrize(("elevation", "options"), SKIES)
def test_a_sky_sends_what_its_own_sampling_finds(elevation, options):
    """The lattice's own error is 6e-4 at most, where the sun fills few or very many of its points."""
    with mitsuba() as mi:
        emitter = sunsky(mi, elevation, **options)
        assert relative(project_environment(emitter, 6), sampled(mi, emitter, 6)) < 1e-3


def test_a_sun_alone_is_a_zonal_disk():
    """Coefficients of a disk of constant radiance: by Legendre polynomials of its direction, and its power."""
    with mitsuba() as mi:
        emitter = sunsky(mi, 30.0, sky_scale=0.0, sun_aperture=4.0)
        radiance = evaluate(mi, emitter, toward(30.0)[None])[0]
        found = project_environment(emitter, 12)
    cosine = np.cos(np.radians(2.0))
    zonal = [1.0 - cosine]
    for l in range(1, 13):  # ∫_c^1 P_l = (P_(l-1)(c) - P_(l+1)(c)) / (2l + 1)
        below, above = (np.polynomial.legendre.legval(cosine, np.eye(14)[k]) for k in (l - 1, l + 1))
        zonal.append((below - above) / (2 * l + 1))
    degree = np.repeat(np.arange(13), 2 * np.arange(13) + 1)
    expected = 2.0 * np.pi * np.array(zonal)[degree] * real_sh(12, toward(30.0)[None])[0]
    # Single precision of Mitsuba: a direction to 1e-7, a radiance to 1e-6, the cosine of the rim to 6e-8 / 6e-4.
    np.testing.assert_allclose(found, radiance[:, None] * expected, atol=3e-4 * np.abs(radiance).max() * expected.max())


@pytest.mark.slow
def test_a_sky_that_changes_is_taken_at_time_zero():
    with mitsuba() as mi:
        emitter = mi.load_dict({"type": "timed_sunsky", "start_month": 6, "window_start_time": 10.0})
        assert relative(project_environment(emitter, 6), sampled(mi, emitter, 6)) < 1e-3


def test_a_sun_below_the_horizon_lights_nothing():
    with mitsuba() as mi:
        with silent(mi):
            emitter = sunsky(mi, -3.0)
        assert not project_environment(emitter, 4).any()
        assert not emitted_environment(mi, emitter, "test").texels.any()


@pytest.mark.parametrize(("elevation", "aperture"), [(45.0, 0.5358), (45.0, 20.0), (5.0, 0.25), (89.9, 0.5358)])
def test_texels_have_the_power_of_the_sun(elevation, aperture):
    """Spread on four texels each, points keep their power and centroid; degree l loses up to (lΔ)²/8, Δ = π/511."""
    bandlimit = 20
    with mitsuba() as mi:
        emitter = sunsky(mi, elevation, UP_Y, sun_aperture=aperture)
        environment = emitted_environment(mi, emitter, "test")
    assert isinstance(environment, SkyEnvironment)
    assert environment.texels.min() >= 0.0
    exact = environment.project(bandlimit, np.eye(3))
    drawn = TexelProjection(512, 1024, bandlimit, environment.to_world)(environment.texels)
    assert relative(drawn[:, 0], exact[:, 0]) < 3e-4
    assert relative(drawn, exact) < (bandlimit * np.pi / 511) ** 2 / 8


def test_a_sky_turns_with_its_map():
    with mitsuba() as mi:
        environment = emitted_environment(mi, sunsky(mi, 30.0, UP_Y), "test")
    turned = environment.rotated(70.0)
    expected = project_environment(environment, 6, rotate=70.0)
    np.testing.assert_allclose(project_environment(turned, 6), expected, atol=1e-9 * np.abs(expected).max())
    np.testing.assert_allclose(turned.to_world, about_up(70.0) @ environment.to_world, atol=1e-15)


def test_a_reference_is_traced_with_the_sky_itself(rng):
    with mitsuba() as mi:
        emitter = sunsky(mi, 30.0, UP_Y)
        environment = emitted_environment(mi, emitter, "test")
        assert environment_emitter(mi, environment) is emitter
        assert environment_emitter(mi, environment.turned(np.eye(3))) is emitter
        for other in (
            environment.rotated(10.0),
            environment.turned(about_up(10.0)),
            make_environment(rng.random((4, 8, 3))),
        ):
            assert environment_emitter(mi, other)["type"] == "envmap"


def test_a_mirrored_sky():
    with mitsuba() as mi:
        mirror = mi.ScalarTransform4f().scale([1.0, -1.0, 1.0])
        emitter = mi.load_dict({"type": "sunsky", "sun_direction": toward(30.0).tolist(), "to_world": mirror})
        assert relative(project_environment(emitter, 6), sampled(mi, emitter, 6)) < 1e-3
        wide = mi.load_dict({"type": "sunsky", "to_world": mi.ScalarTransform4f().scale(2.0)})
        with pytest.raises(UserError, match="to_world scales or shears"):
            project_environment(wide, 3)


@pytest.mark.parametrize(
    ("elevation", "bandlimit"), [(45.0, 4), (0.1, 12), pytest.param(45.0, 165, marks=pytest.mark.slow)]
)
def test_adjoint_of_a_sky_is_the_transpose(elevation, bandlimit, rng):
    with mitsuba() as mi:
        emitter = sunsky(mi, elevation)
        quadrature = sky.sky_quadrature(mi, emitter, lambda d: evaluate(mi, emitter, d), "test")
    samples = rng.normal(size=(len(quadrature.directions), 3))
    coefficients = rng.normal(size=(3, num_coefficients(bandlimit)))
    turn = about_up(33.0)
    there = np.sum(quadrature.project(samples, bandlimit, turn) * coefficients)
    assert np.sum(samples * quadrature.adjoint(coefficients, turn)) == pytest.approx(there, rel=1e-9)


def test_where_the_sun_is_has_no_gradient():
    """Rather refused than without the part of the moving rim."""
    import drjit as dr

    from slepian_prt.relighting.mitsuba.emission import distant_light

    with mitsuba() as mi:
        emitter = sunsky(mi, 45.0)
        plain = np.array(distant_light(mi, emitter, 2, np.eye(3))).reshape(3, -1)
        np.testing.assert_allclose(plain, project_environment(emitter, 2), rtol=1e-4, atol=1e-5)
        dr.enable_grad(mi.traverse(emitter)["sun_direction"])
        with pytest.raises(UserError, match="gradients do not go to sun_direction"):
            distant_light(mi, emitter, 2, np.eye(3))


# --- Maps of other shapes --------------------------------------------------------------------------------------------


def as_mitsuba_pads(texels: np.ndarray) -> np.ndarray:
    """At least two columns and three rows, the last repeated."""
    padded = np.repeat(texels, 2, axis=1) if texels.shape[1] == 1 else texels
    return np.concatenate([padded, *[padded[-1:]] * max(0, 3 - len(padded))])


def interpolated(texels: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """(n, 3) bilinear lookup: columns at their middle and wrapped, rows from pole to pole."""
    height, width = texels.shape[:2]
    column = np.arctan2(directions[:, 0], -directions[:, 2]) / (2.0 * np.pi) * width - 0.5
    row = np.arccos(directions[:, 1]) / np.pi * (height - 1)
    left, top = np.floor(column).astype(int), np.minimum(row.astype(int), height - 2)
    x, y = (column - left)[:, None], (row - top)[:, None]
    rows = [(1 - x) * texels[r, left % width] + x * texels[r, (left + 1) % width] for r in (top, top + 1)]
    return (1 - y) * rows[0] + y * rows[1]


SHAPES = [(1, 1), (1, 2), (2, 1), (2, 4), (3, 3), (1, 64), (16, 64), (32, 32), (64, 16), (256, 1), (256, 2), (5, 10)]


@pytest.mark.parametrize("shape", SHAPES)
def test_maps_of_any_shape_light_as_mitsuba_interpolates_them(shape, rng):
    texels = rng.uniform(0.2, 2.0, (*shape, 3)).astype(np.float32)
    theta, phi = np.pi * (np.arange(1000) + 0.5) / 1000, 2.0 * np.pi * (np.arange(256) + 0.5) / 256
    axes = [np.outer(np.sin(theta), np.sin(phi)), np.outer(np.cos(theta), np.ones(256)),
            np.outer(np.sin(theta), -np.cos(phi))]  # fmt: skip
    directions = np.stack([axis.ravel() for axis in axes], axis=1)
    solid_angles = np.repeat(np.sin(theta) * np.pi / 1000 * 2.0 * np.pi / 256, 256)
    brute = (interpolated(as_mitsuba_pads(texels), directions) * solid_angles[:, None]).T @ real_sh(3, directions)
    with mitsuba() as mi:
        emitter = mi.load_dict({"type": "envmap", "bitmap": mi.Bitmap(texels)})
        environment = emitted_environment(mi, emitter, "test")
        found = project_environment(emitter, 3)
        sent = evaluate(mi, emitter, directions[::997])
    np.testing.assert_allclose(
        sent, interpolated(as_mitsuba_pads(texels), directions[::997]), atol=1e-3
    )  # acos near a pole
    # Interpolated to 8 rows per degree: off by (LΔ)²/12 of the part in degree L, and kinks by as little.
    assert relative(found, brute) < 2e-3
    np.testing.assert_allclose(project_environment(environment, 3), found, atol=1e-12)


@pytest.mark.parametrize(("height", "width"), [(33, 7), (9, 4), (3, 50), (200, 2)])
def test_adjoint_for_maps_of_any_shape(height, width, rng):
    projection = TexelProjection(height, width, 6, about_up(33.0))
    texels, coefficients = rng.normal(size=(height, width, 3)), rng.normal(size=(3, 49))
    there = np.sum(projection(texels) * coefficients)
    assert np.sum(texels * projection.adjoint(coefficients)) == pytest.approx(there, rel=1e-10)


def test_a_map_of_one_column_in_the_integrator():
    """The light of the integrator is that of the same emitter projected."""
    from slepian_prt.relighting.mitsuba.emission import distant_light

    texels = np.linspace(2.0, 0.1, 96).reshape(32, 1, 3).astype(np.float32)
    with mitsuba() as mi:
        emitter = mi.load_dict({"type": "envmap", "bitmap": mi.Bitmap(texels)})
        found = np.array(distant_light(mi, emitter, 4, np.eye(3))).reshape(3, -1)
        np.testing.assert_allclose(found, project_environment(emitter, 4), atol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("variant", [sibling("ad_mono"), sibling("ad_spectral")])
def test_other_variants(variant, any_variant, rng):
    """The integrator and the projection take the same light from a map, and from a sky where there is one."""
    from slepian_prt.relighting.mitsuba.emission import distant_light

    mi = any_variant
    mi.set_variant(variant)
    emitters = [{"type": "envmap", "bitmap": mi.Bitmap(rng.random((8, 8, 3)).astype(np.float32))}]
    if variant == sibling("ad_spectral"):
        emitters.append({"type": "sunsky", "sun_direction": toward(40.0).tolist(), "turbidity": 4.0})
    for emitter in map(mi.load_dict, emitters):
        found = np.array(distant_light(mi, emitter, 4, np.eye(3))).reshape(3, -1)
        expected = project_environment(emitter, 4)
        np.testing.assert_allclose(found, expected, atol=1e-5 * np.abs(expected).max())


# --- Bad light, and light of any kind --------------------------------------------------------------------------------


@pytest.mark.parametrize(("value", "words"), [(np.inf, "NaN or infinite"), (np.nan, "NaN or infinite"),
                                              (1e38, "more than can be computed with")])  # fmt: skip
def test_radiance_that_cannot_be_computed_with(value, words):
    texels = np.ones((8, 8, 3), dtype=np.float32)
    texels[3, 4] = value
    with mitsuba() as mi:
        emitters = [{"type": "envmap", "bitmap": mi.Bitmap(texels)}]
        if not np.isnan(value):
            emitters.append({"type": "constant", "radiance": {"type": "rgb", "value": float(value)}})
        if value == 1e38:
            emitters.append({"type": "sunsky", "sun_direction": toward(40.0).tolist(), "sky_scale": 1e25})
        for emitter in emitters:
            for use in (project_environment, lambda e, _: emitted_environment(mi, e, "a.xml")):
                with pytest.raises(UserError, match=words) as caught:
                    use(mi.load_dict(emitter), 3)
                assert "\n" not in str(caught.value)


def test_a_black_light_of_a_scene_is_nothing_to_compare_under():
    with mitsuba() as mi:
        black = emitted_environment(mi, mi.load_dict({"type": "constant", "radiance": 0.0}), "a.xml")
    with pytest.raises(UserError, match=r"a.xml: the scene's own distant light is black"):
        lights_of(SimpleNamespace(path="a.xml", environment=black), ())


def test_negative_texels_of_an_emitter_follow_the_rule_for_maps():
    """As of a file: what amounts to little is set to zero and counted, what matters is refused."""
    texels = np.ones((8, 8, 3), dtype=np.float32)
    texels[3, 4] = -0.01
    with mitsuba() as mi:
        emitter = mi.load_dict({"type": "envmap", "bitmap": mi.Bitmap(texels)})
        lighting, clamped = project_emitter(mi, emitter, 2, np.eye(3), "test")
        assert clamped == 1
        np.testing.assert_allclose(lighting, TexelProjection(8, 8, 2)(np.maximum(texels, 0.0)), atol=1e-6)
        texels[3, 4] = -0.5
        emitter = mi.load_dict({"type": "envmap", "bitmap": mi.Bitmap(texels)})
        with pytest.raises(UserError, match="are negative"):
            project_emitter(mi, emitter, 2, np.eye(3), "test")
        assert project_emitter(mi, emitter, 2, np.eye(3), "test", clamp_negative=True)[1] == 1


def test_light_of_any_kind_at_a_bandlimit(tmp_path, rng):
    texels = rng.random((32, 64, 3)).astype(np.float32)
    expected = project_environment(texels, 3)
    with mitsuba() as mi:
        mi.Bitmap(texels).write(str(tmp_path / "map.exr"))
        emitter = mi.load_dict({"type": "envmap", "bitmap": mi.Bitmap(texels)})
        for light in (tmp_path / "map.exr", str(tmp_path / "map.exr"), texels, make_environment(texels), emitter):
            np.testing.assert_allclose(lighting_at(light, 3), expected, atol=1e-6)
    assert_exact(lighting_at(expected, 3), expected, because="a copy")
    assert lighting_at(np.stack([expected, expected]), 3).shape == (2, 3, 16)
    for wrong, words in [
        (expected[:, :15], "(3, n²)"),
        (object(), "not object"),
        (np.inf * expected[:, :16], "finite"),
    ]:
        with pytest.raises(UserError) as caught:
            lighting_at(wrong, 3)
        assert words in str(caught.value)
