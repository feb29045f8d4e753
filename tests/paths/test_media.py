"""Free flight through media against closed forms, and paths through them against Mitsuba's volumetric path tracer."""

import numpy as np
import pytest

from slepian_prt.lighting.projection import project_environment
from slepian_prt.paths.media import Media, media_of, medium_at
from slepian_prt.paths.tracer import PathTracer
from slepian_prt.renderer.variants import imported_mitsuba
from tests.paths.test_tracer import BANDLIMIT, DIFFUSE, RUNS, SAMPLES, SIZE, relit, smooth_map
from tests.statistics import assert_agree
from tests.variants import VARIANT

COUNT = 1 << 16
EXTINCTION, ALBEDO = np.array([0.2, 1.0, 3.0]), np.array([0.9, 0.5, 0.7])
NULL = {"type": "null"}


@pytest.fixture(scope="module")
def mi():
    module = imported_mitsuba()
    module.set_variant(VARIANT)
    return module


def rgb(values):
    return {"type": "rgb", "value": list(values)}


def grid(mi, values, low, high):
    """A volume of values (z, y, x, channels) in a box."""
    place = mi.ScalarTransform4f().translate(low).scale(list(np.subtract(high, low)))
    return {"type": "gridvolume", "grid": mi.VolumeGrid(np.float32(values)), "to_world": place, "raw": True}


def homogeneous(**others):
    return {"type": "homogeneous", "scale": 3.0, "sigma_t": rgb(EXTINCTION / 3.0), "albedo": rgb(ALBEDO), **others}


def density(position):
    """Of the smoke below, at places along x from 0 to 2: linear between the middles of eight cells."""
    return np.interp(position, (np.arange(8) + 0.5) / 4.0, CELLS)


CELLS = np.random.default_rng(3).random(8)


def heterogeneous(mi):
    values = np.broadcast_to((CELLS[None, None, :, None] * EXTINCTION / 3.0), (2, 2, 8, 3))
    volume = grid(mi, values, [0, -1, -1], [2, 1, 1])
    return {"type": "heterogeneous", "sigma_t": volume, "albedo": rgb(ALBEDO), "scale": 3.0}


MEDIA = {"homogeneous": lambda _mi: homogeneous(), "heterogeneous": heterogeneous}


def optical_depth(name, a, b):
    """Of unit extinction, between two places along x."""
    if name == "homogeneous":
        return b - a
    places = np.linspace(a, min(b, 2.0), 20001)
    return np.trapezoid(density(places), places)


def rays(mi, medium, count=COUNT):
    """Some that set out along x at 0.25, in a medium, and a sampler."""
    import drjit as dr

    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(1, count)
    origin = mi.Point3f(0.25, 0.1, 0.2) + dr.zeros(mi.Point3f, count)
    ray = mi.Ray3f(origin, mi.Vector3f(1, 0, 0) + dr.zeros(mi.Vector3f, count))
    return sampler, ray, mi.MediumPtr(medium) if medium is not None else dr.zeros(mi.MediumPtr, count)


@pytest.mark.parametrize("scale", [3.0, 60.0])
@pytest.mark.parametrize("name", MEDIA)
def test_light_is_weakened_as_beer_and_lambert_say(name, scale, mi):
    medium = mi.load_dict(MEDIA[name](mi) | {"scale": scale})
    sampler, ray, inside = rays(mi, medium)
    passed = np.array(Media(mi, [medium]).transmittance(sampler, ray, mi.Float(1.5), inside, mi.Bool(True)))
    expected = np.exp(-scale / 3.0 * EXTINCTION * optical_depth(name, 0.25, 1.75))
    if name == "homogeneous":
        np.testing.assert_allclose(
            passed.reshape(3, -1)[:, 0], expected, rtol=100 * np.finfo(np.float32).eps, atol=1e-30
        )
        return
    error = passed.std(axis=1) / np.sqrt(COUNT)
    assert np.all(np.abs(passed.mean(axis=1) - expected) <= 4.0 * error + 1e-6)


@pytest.mark.parametrize("name", MEDIA)
@pytest.mark.parametrize("throughput", [(1.0, 1.0, 1.0), (0.0, 0.1, 2.0)])
def test_what_flies_on_and_what_is_scattered(name, throughput, mi):
    """In the mean β e^(-τ) arrives at a surface and β a (1 - e^(-τ)) is scattered before; weights are Σ β at most."""
    medium = mi.load_dict(MEDIA[name](mi))
    sampler, ray, inside = rays(mi, medium)
    flight = Media(mi, [medium]).fly(sampler, ray, mi.Float(1.5), inside, mi.Color3f(*throughput), mi.Bool(True))
    weights, scattered = np.array(flight.throughput), np.array(flight.scattered)
    passed = np.exp(-EXTINCTION * optical_depth(name, 0.25, 1.75))
    for where, expected in [(~scattered, passed), (scattered, ALBEDO * (1.0 - passed))]:
        found = weights * where
        error = found.std(axis=1) / np.sqrt(COUNT)
        assert np.all(np.abs(found.mean(axis=1) - np.array(throughput) * expected) <= 4.0 * error + 1e-6)
    assert weights.sum(axis=0).max() <= sum(throughput) * (1.0 + 1e-5)
    place = np.array(flight.place.p)[0][scattered]
    assert place.min() >= 0.25
    assert place.max() <= 1.75


def test_particles_are_where_the_medium_is_dense(mi):
    """Of grey smoke, by quarters of the way, against the integral of density times transmittance."""
    volume = grid(mi, np.broadcast_to(CELLS[:, None], (2, 2, 8, 1)), [0, -1, -1], [2, 1, 1])
    medium = mi.load_dict({"type": "heterogeneous", "sigma_t": volume, "scale": 4.0, "albedo": 1.0})
    sampler, ray, inside = rays(mi, medium)
    flight = Media(mi, [medium]).fly(sampler, ray, mi.Float(9.0), inside, mi.Color3f(1.0), mi.Bool(True))
    edges = np.linspace(0.25, 2.0, 5)
    counts, _ = np.histogram(np.array(flight.place.p)[0][np.array(flight.scattered)], edges)
    depth = [4.0 * optical_depth("heterogeneous", 0.25, edge) if edge > 0.25 else 0.0 for edge in edges]
    expected = -np.diff(np.exp(-np.array(depth))) * COUNT
    assert np.all(np.abs(counts - expected) <= 4.0 * np.sqrt(expected))


def test_without_a_medium_rays_go_on_as_they_are(mi):
    medium = mi.load_dict(homogeneous())
    sampler, ray, inside = rays(mi, None)
    media = Media(mi, [medium])
    flight = media.fly(sampler, ray, mi.Float(1.5), inside, mi.Color3f(0.3, 0.2, 0.1), mi.Bool(True))
    assert not np.array(flight.scattered).any()
    weights = np.array(flight.throughput).reshape(3, -1)
    np.testing.assert_allclose(weights, np.broadcast_to([[0.3], [0.2], [0.1]], weights.shape), rtol=1e-7)
    assert media.know(medium)
    assert media.know(None)
    assert not media.know(mi.load_dict(homogeneous()))
    assert not Media(mi, []).present


def test_points_lie_in_the_medium_of_the_nearest_boundary(mi):
    """A ball of one within a cube of another, beside a wall that parts nothing and before the void."""
    inner, outer = (mi.load_dict({"type": "homogeneous", "sigma_t": sigma}) for sigma in (1.0, 2.0))
    scene = mi.load_dict({
        "type": "scene",
        "cube": {"type": "cube", "bsdf": NULL, "interior": outer},
        "ball": {"type": "sphere", "radius": 0.5, "bsdf": NULL, "interior": inner, "exterior": outer},
        "wall": {"type": "rectangle", "to_world": mi.ScalarTransform4f().translate([0, 0, 0.2]).scale(0.1)},
    })  # fmt: skip
    points = [[0, 0, 0], [0, 0, 0.3], [0.7, 0.7, 0.7], [0, 0, -0.9], [0, 0, 1.5], [-5, 3, 1]]
    found = medium_at(mi, scene, mi.Point3f(np.array(points, dtype=np.float32).T))
    expected = [inner, inner, outer, outer, None, None]
    assert [one and one.ptr for one in found] == [one and one.ptr for one in expected]
    assert {one.ptr for one in media_of(mi, scene)} == {inner.ptr, outer.ptr}


def test_the_nearest_boundary_counts(mi):
    """A sheet in one of the directions that are looked in, before a shell that says otherwise."""
    inner, outer = (mi.load_dict({"type": "homogeneous", "sigma_t": sigma}) for sigma in (1.0, 2.0))
    ahead = np.array([0.36, 0.48, 0.8])
    for distance, expected in [(2.0, outer), (20.0, inner)]:
        place = mi.ScalarTransform4f().look_at((distance * ahead).tolist(), [0, 0, 0], [0, 1, 0])
        scene = mi.load_dict({
            "type": "scene",
            "shell": {"type": "sphere", "radius": 10.0, "interior": inner},
            "sheet": {"type": "rectangle", "to_world": place, "exterior": outer},
        })  # fmt: skip
        assert medium_at(mi, scene, mi.Point3f(0.0))[0].ptr == expected.ptr


# --- Whole paths -----------------------------------------------------------------------------------------------------

FOG = homogeneous(scale=2.0)
MILK = {"type": "homogeneous", "scale": 12.0, "sigma_t": rgb([0.5, 0.75, 1.0]), "albedo": rgb([0.98, 0.9, 0.8])}
MIXED = {"type": "blendphase", "weight": 0.3, "a": {"type": "hg", "g": 0.8}, "b": {"type": "rayleigh"}}


def smoke(mi):
    rng = np.random.default_rng(0)
    volume, colour = (grid(mi, rng.random((4, 5, 3, 3)), [-0.5, 0.1, -0.5], [0.5, 1.1, 0.5]) for _ in range(2))
    return {"type": "heterogeneous", "sigma_t": volume, "albedo": colour, "scale": 6.0, "phase": MIXED}


# Material and inner medium of the ball, and the medium around all.
BALLS = {
    "fog": lambda mi: (NULL, FOG, None),
    "smoke": lambda mi: (NULL, smoke(mi), None),
    "milk": lambda mi: ({"type": "roughdielectric", "alpha": 0.2}, MILK, None),
    "dyed glass": lambda mi: ({"type": "dielectric"}, FOG | {"albedo": 0.0}, None),
    "mist around glass": lambda mi: ({"type": "dielectric"}, None, FOG | {"scale": 0.1, "albedo": 0.95}),
    "smoke in mist": lambda mi: (NULL, smoke(mi), FOG | {"scale": 0.1, "albedo": 0.95}),
}


def scene_of(mi, bsdf, inner, around):
    place = mi.ScalarTransform4f
    beside = {} if around is None else {"exterior": around}
    inside = {} if inner is None else {"interior": inner}
    boundary = {"type": "sphere", "radius": 8.0, "bsdf": NULL, "interior": around}
    return mi.load_dict({
        "type": "scene",
        "sky": {"type": "envmap", "bitmap": mi.Bitmap(smooth_map())},
        "camera": {
            "type": "perspective",
            "fov": 35,
            "to_world": place().look_at([0, 2.2, 4.5], [0, 0.3, 0], [0, 1, 0]),
            "film": {"type": "hdrfilm", "width": SIZE, "height": SIZE, "rfilter": {"type": "box"}},
            **({} if around is None else {"medium": around}),
        },
        "floor": {"type": "rectangle", "to_world": place().rotate([1, 0, 0], -90).scale(2), "bsdf": DIFFUSE, **beside},
        "ball": {"type": "sphere", "center": [0, 0.6, 0], "radius": 0.5, "bsdf": bsdf, **inside, **beside},
        **({} if around is None else {"mist": boundary}),
    })  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", BALLS)
def test_paths_bring_the_light_that_comes_through_media(name, mi):
    """As those of ``volpathmis``, in the pixels of a camera."""
    scene = scene_of(mi, *BALLS[name](mi))
    tracer = PathTracer(mi, scene, [shape.bsdf() for shape in scene.shapes()])
    assert tracer.has_media
    medium = scene.sensors()[0].get_medium()
    texels = smooth_map()
    lighting = project_environment(texels, BANDLIMIT)
    ours = np.stack([relit(mi, scene, tracer, lighting, seed, medium=medium) for seed in range(RUNS)])
    theirs = mi.load_dict({"type": "volpathmis"})
    reference = [mi.render(scene, integrator=theirs, spp=4 * SAMPLES, seed=100 + seed) for seed in range(RUNS)]
    assert_agree(ours, np.stack([np.array(picture) for picture in reference]), bias=1e-3 * texels.max())


def test_a_white_furnace_of_media(mi):
    """Under light of 1 from everywhere, what neither absorbs nor bends sends back 1 from everywhere, in the mean."""
    white = {"type": "homogeneous", "sigma_t": 3.0, "albedo": 1.0, "phase": {"type": "hg", "g": 0.5}}
    scene = mi.load_dict({
        "type": "scene",
        "cloud": {"type": "sphere", "bsdf": NULL, "interior": white},
        "mirror": {"type": "sphere", "center": [1.5, 0, 0], "bsdf": {"type": "conductor"}},
        "glass": {"type": "sphere", "center": [0.2, 0.1, 0], "radius": 0.4, "bsdf": {"type": "thindielectric"},
                  "interior": white, "exterior": white},
    })  # fmt: skip
    tracer = PathTracer(mi, scene, [shape.bsdf() for shape in scene.shapes()])
    sampler, ray, _ = rays(mi, None)
    ray.o.x -= 3.0
    ends = tracer.follow(sampler, ray)
    assert not np.array(ends.held).any()
    weights = np.array(ends.throughput)[0]
    assert abs(weights.mean() - 1.0) <= 4.0 * weights.std() / np.sqrt(COUNT)
    assert weights.std() < 1.0


def test_nothing_escapes_from_a_medium_that_never_ends(mi):
    medium = mi.load_dict(homogeneous(scale=0.1))
    scene = mi.load_dict({"type": "scene", "ball": {"type": "sphere", "bsdf": NULL, "exterior": medium}})
    tracer = PathTracer(mi, scene, [shape.bsdf() for shape in scene.shapes()])
    sampler, ray, inside = rays(mi, medium, 1 << 10)
    ray.o.x += 2.0
    ends = tracer.follow(sampler, ray, medium=inside)
    assert not np.array(ends.escaped).any()
    assert not np.array(ends.throughput).any()
