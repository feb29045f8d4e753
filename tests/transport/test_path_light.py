"""Light by way of mirrors, glass, holes, leaves and fog, against Mitsuba's own path tracers, receiver by receiver."""

import math
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import t as student_t

import slepian_prt as sp
from slepian_prt.lighting.emitters import environment_emitter
from slepian_prt.lighting.environment import Environment, make_environment
from slepian_prt.paths.media import medium_at
from slepian_prt.scene.loading import open_scene
from slepian_prt.scene.scene import Scene, mitsuba_scene
from slepian_prt.transport.held_faces import PATHS
from slepian_prt.transport.hemisphere import upload_origins
from slepian_prt.transport.path_light import trace_paths
from tests.numerics import assert_exact

BANDLIMIT = 3
FLOOR = """<shape type="rectangle" id="floor"><transform name="to_world"><scale value="1.5"/></transform>
<bsdf type="diffuse"><rgb name="reflectance" value=".6, .5, .4"/></bsdf></shape>"""
BALL = """<shape type="sphere" id="ball"><point name="center" x="0" y="0" z="0.6"/>
<float name="radius" value="0.5"/>{}</shape>"""
SHEET = """<shape type="rectangle" id="sheet"><transform name="to_world"><scale value=".8"/><rotate y="1" angle="20"/>
<translate z=".7"/></transform>{}</shape>"""
CASE = """<shape type="cube" id="case"><transform name="to_world"><scale value=".5"/><translate z=".6"/></transform>
{}</shape>"""
INSIDE = """<shape type="sphere" id="inner"><point name="center" x="0" y="0" z="0.6"/>
<float name="radius" value="0.3"/><bsdf type="diffuse"><rgb name="reflectance" value=".2, .5, .8"/></bsdf></shape>"""
FOG = """<bsdf type="null"/><medium type="homogeneous" name="interior">
<rgb name="sigma_t" value=".5, .7, .9"/><float name="scale" value="3"/>
<rgb name="albedo" value="0.9, .8, .7"/><phase type="hg"><float name="g" value="0.4"/></phase></medium>"""
MILK = """<bsdf type="roughdielectric"><float name="alpha" value=".3"/></bsdf>
<medium type="homogeneous" name="interior"><float name="sigma_t" value="4"/>
<rgb name="albedo" value="0.9, .8, .7"/></medium>"""
DIFFUSE = '<bsdf type="twosided"><bsdf type="diffuse"><rgb name="reflectance" value=".7, .3, .2"/></bsdf></bsdf>'
MASK = f"""<bsdf type="mask"><texture name="opacity" type="checkerboard"><rgb name="color0" value=".2"/>
<rgb name="color1" value=".9"/></texture>{DIFFUSE}</bsdf>"""
LEAF = """<bsdf type="principledthin"><rgb name="base_color" value=".6, .8, .2"/><float name="diff_trans" value="1"/>
</bsdf>"""
SCENES = {
    "mirrors": BALL.format('<bsdf type="conductor"/>'),
    "gloss": BALL.format('<bsdf type="roughconductor"><string name="material" value="Au"/></bsdf>'),
    "gloss of a coat": BALL.format('<bsdf type="plastic"><rgb name="diffuse_reflectance" value=".2, .5, .8"/></bsdf>'),
    "glass": BALL.format('<bsdf type="dielectric"/>'),
    "glass, thin": SHEET.format('<bsdf type="thindielectric"/>'),
    "glass around something": INSIDE + CASE.format('<bsdf type="dielectric"/>'),
    "opacity": SHEET.format(MASK),
    "transmission": SHEET.format(LEAF),
    "media": CASE.format(FOG),
    "media around something": INSIDE + CASE.format(FOG),
    "glass with a medium": BALL.format(MILK),
}


def written(folder: Path, content: str) -> Path:
    (folder / "scene.xml").write_text(f'<scene version="3.0.0">{content}</scene>')
    return folder / "scene.xml"


def smooth_light() -> Environment:
    """Of degrees 0 and 1, but for what texels are interpolated to."""
    v, u = np.pi * np.arange(64)[:, None] / 63, 2 * np.pi * (np.arange(128)[None] + 0.5) / 128
    x, y, z = np.sin(v) * np.sin(u), np.cos(v) + 0 * u, -np.sin(v) * np.cos(u)
    return make_environment(np.stack([1 + 0.5 * z + 0.3 * x, 1 + 0.6 * z + 0.2 * y, 1 + 0.7 * z - 0.3 * y], -1))


def traced(scene: Scene, light: Environment, vertices: np.ndarray, samples: int, seed: int) -> np.ndarray:
    """(n, 3) radiance of unit albedo: rays by the cosine at random, all else by Mitsuba."""
    scene = scene.with_media
    media = [shape.interior_medium() for shape in scene.shapes if shape.interior_medium() is not None]
    start = scene.mi.Point3f(scene.ray_origins.front[vertices].T.astype(np.float32))
    within = np.array(medium_at(scene.mi, scene.geometry, start) != scene.mi.MediumPtr(None)) & bool(media)
    result = np.empty((len(vertices), 3))
    for inside, medium in ((False, None), *((True, medium) for medium in media)):
        some = np.flatnonzero(within == inside)
        result[some] = traced_within(scene, light, vertices[some], medium, samples, seed)
    return result


def traced_within(scene: Scene, light: Environment, vertices, medium, samples: int, seed: int) -> np.ndarray:
    """The same of receivers that are all in one medium; Mitsuba cannot be given several."""
    import drjit as dr

    if len(vertices) == 0:
        return np.zeros((0, 3))
    mi, lit = scene.mi, mitsuba_scene(scene, emitter=environment_emitter(scene.mi, light))
    place = dr.arange(mi.UInt32, len(vertices) * samples) // dr.opaque(mi.UInt32, samples)
    normals = mi.Normal3f(scene.receivers.normals[vertices].T.astype(np.float32))
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, dr.width(place))
    up = mi.Frame3f(dr.gather(mi.Normal3f, normals, place))
    outward = up.to_world(mi.warp.square_to_cosine_hemisphere(sampler.next_2d()))
    origin_of = upload_origins(mi, scene.ray_origins, vertices)
    integrator = mi.load_dict({"type": "volpath", "max_depth": 64})
    ray = mi.RayDifferential3f(mi.Ray3f(origin_of(place, outward), outward))
    found = integrator.sample(lit, sampler, ray, medium)[0]
    return np.stack([np.array(dr.block_sum(channel, samples)) / samples for channel in mi.Color3f(found)], axis=-1)


def relit(transfer: sp.Transfer, light: Environment) -> np.ndarray:
    """(V, 3) for unit albedo."""
    return np.einsum("vcm,cm->vc", np.broadcast_to(transfer.vectors, (len(transfer.vectors), 3, 16)),
                     sp.project_environment(light, BANDLIMIT))  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
def test_each_effect_alone_agrees_with_the_path_tracer(name, tmp_path):
    """Differences are noise, as large as runs of ours (two, so their mean counts) and of the reference tell."""
    path, light = written(tmp_path, FLOOR + SCENES[name]), smooth_light()
    with open_scene(path) as scene:
        lit = np.flatnonzero(scene.receivers.active & ~scene.is_hidden)
        vertices = np.random.default_rng(1).choice(lit, 150, replace=False)
        reference = np.stack([traced(scene, light, vertices, 256, seed) for seed in range(8)])
    runs = [sp.precompute(path, BANDLIMIT, 512, effects="all", seed=seed) for seed in range(2)]
    ours = np.stack([relit(run, light)[vertices] for run in runs])
    means, errors = zip(
        *((x.mean(axis=0), x.std(axis=0, ddof=1) / math.sqrt(len(x))) for x in (ours, reference)), strict=True
    )
    difference, noise = means[0] - means[1], np.hypot(errors[0].mean(), errors[1])
    # What is bounced between diffuse surfaces is taken between vertices, and visibility from a grid of directions.
    # All by paths, media agree with volpath to a ten thousandth; with the grid half a thousandth is missing in the mean
    # over all vertices, and two over those that are drawn here with something within.
    known = (4e-3 if name.startswith("media") else 2e-3) * means[1].mean()
    z = difference / np.hypot(noise, known)
    of_mean = math.sqrt(np.sum(np.mean(errors[0], axis=1) ** 2 + np.mean(errors[1], axis=1) ** 2)) / vertices.size
    assert abs(difference.mean()) < 0.75 * known + 3.0 * of_mean
    if not name.startswith("media"):  # there the known part is most of it
        assert abs(z.mean()) < 0.3
    assert np.mean(np.abs(z) > 3.0) < 2.0 * student_t.sf(3.0, 7) + 0.01


def test_a_furnace_of_glass_and_a_mirror(tmp_path):
    """Nothing absorbs: where all surroundings shine by 1, by way of glass and mirrors comes what they hide."""
    import drjit as dr

    mirror = '<shape type="disk"><transform name="to_world"><rotate y="1" angle="120"/><translate x="-1.2" z="0.5"/>'
    body = (
        FLOOR
        + BALL.format('<bsdf type="dielectric"/>')
        + mirror
        + '</transform><bsdf type="twosided"><bsdf type="conductor"/></bsdf></shape>'
    )
    with open_scene(written(tmp_path, body)) as scene:
        some = np.flatnonzero(scene.receivers.active & ~scene.is_hidden)[::40]
        paths = trace_paths(scene, some, 256, PATHS, 0, 1, 0)
        some = paths.rows
        mi = scene.mi
        place = dr.arange(mi.UInt32, some.size * 256) // 256
        normals = dr.gather(mi.Normal3f, mi.Normal3f(scene.receivers.normals[some].T.astype(np.float32)), place)
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(5, dr.width(place))
        outward = mi.Frame3f(normals).to_world(mi.warp.square_to_cosine_hemisphere(sampler.next_2d()))
        origin = upload_origins(mi, scene.ray_origins, some)(place, outward)
        hit = scene.geometry.ray_intersect_preliminary(mi.Ray3f(origin, outward))
        glass = np.array(hit.is_valid() & (scene.hit_faces(hit) < 0)).reshape(some.size, 256).mean(axis=1)
    escaped = paths.escaped[:, 0, 0] * math.sqrt(4.0 * math.pi)
    received = escaped + np.asarray(paths.met[0].sum(axis=1)).ravel()
    np.testing.assert_allclose(received, glass, atol=5.0 * 0.5 / 16.0)
    # The mean over receivers of two estimates of 256 samples each.
    assert received.mean() == pytest.approx(glass.mean(), abs=4.0 * 0.5 / math.sqrt(256 * some.size))


def test_halves_tell_the_noise(tmp_path):
    """The mean square of half their difference is the variance between seeds; ours to a tenth, of 150 receivers."""
    with open_scene(written(tmp_path, FLOOR + SCENES["glass"])) as scene:
        some = np.random.default_rng(2).choice(len(scene.receivers), 150, replace=False)
        runs = [trace_paths(scene, some, 64, ("glass",), 4, 3, seed) for seed in range(12)]
        escaped = np.stack([run.escaped[np.argsort(run.rows)] for run in runs]).astype(np.float64)
        told = np.mean([np.square(run.escaped_error, dtype=np.float64).sum() for run in runs])
        varied = escaped.var(axis=0, ddof=1).sum()
        assert told == pytest.approx(varied, rel=0.1)
        again = trace_paths(scene, some, 64, ("glass",), 4, 3, 3)
        assert_exact(again.escaped, runs[3].escaped, "the same seed, the same bits")


LAMPS = """<shape type="rectangle" id="lamp"><transform name="to_world"><scale value=".4"/>
<rotate x="1" angle="180"/><translate x=".9" z="2"/></transform><bsdf type="diffuse"/><emitter type="area">
<rgb name="radiance" value="8, 6, 4"/></emitter></shape><emitter type="point" id="bulb">
<point name="position" x="-1" y="0.3" z="1.5"/><rgb name="intensity" value="1, 2, 4"/></emitter>"""
LAMP_SCENES = {
    "caustics and something inside": INSIDE + CASE.format('<bsdf type="roughdielectric"/>'),
    "leaf": SHEET.format(LEAF),
    "holes": SHEET.format(MASK),
    "fog": CASE.format(FOG),
    "coat": BALL.format('<bsdf type="roughplastic"><float name="alpha" value=".3"/></bsdf>'),
}


def ray_from_above(scene: Scene, vertices: np.ndarray, count: int = 1):
    """Rays that meet the surfaces under receivers after two heights of rays, and these heights."""
    mi = scene.mi
    normals, heights = scene.receivers.normals[vertices], scene.ray_heights[vertices]
    start = scene.ray_origins.feet[vertices] + 2.0 * heights[:, None] * normals
    start, normals = (np.repeat(values, count, axis=0).T.astype(np.float32) for values in (start, normals))
    return mi.RayDifferential3f(mi.Ray3f(mi.Point3f(start), mi.Vector3f(-normals))), heights


def seen(scene: Scene, vertices: np.ndarray) -> np.ndarray:
    """(n,) whether the surface under receivers is there in the scene as loaded, and is no lamp."""
    ray, heights = ray_from_above(scene, vertices)
    si = scene.loaded.ray_intersect(ray)
    near = np.array(si.t) < 4.0 * heights + 1e-4
    return near & np.array(si.emitter(scene.loaded) == scene.mi.EmitterPtr(None))


def seen_from_above(scene: Scene, vertices: np.ndarray, integrator: str, samples: int, seed: int) -> np.ndarray:
    """(n, 3) radiance of unit albedo, by nothing but an integrator of Mitsuba's."""
    import drjit as dr

    mi, (ray, _) = scene.mi, ray_from_above(scene, vertices, samples)
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, dr.width(ray.o))
    found = mi.load_dict({"type": integrator, "max_depth": 64}).sample(scene.loaded, sampler, ray)[0]
    means = [np.array(dr.block_sum(channel, samples)) / samples for channel in mi.Color3f(found)]
    return np.stack(means, axis=-1) / scene.mesh.albedo[vertices]


@pytest.mark.slow
@pytest.mark.parametrize("name", LAMP_SCENES)
def test_light_of_lamps_agrees_with_the_path_tracer(name, tmp_path):
    """By mirrors, glass, leaves and fog, what surfaces reflect onto each other included, that of the lamp too."""
    path = written(tmp_path, FLOOR + LAMP_SCENES[name] + LAMPS)
    with open_scene(path) as scene:
        diffuse = [part for part in scene.parts if part.name in ("floor", "inner")]
        some = np.concatenate([np.arange(part.first, part.first + part.count) for part in diffuse])
        vertices = np.random.default_rng(1).choice(some[~scene.is_hidden[some]], 120, replace=False)
        vertices = vertices[seen(scene, vertices)]
        assert vertices.size > 80
        integrator = "volpath" if name == "fog" else "path"
        reference = np.stack([seen_from_above(scene, vertices, integrator, 256, seed) for seed in range(8)])
    runs = [sp.precompute(path, 0, 256, effects="all", seed=seed) for seed in range(2)]
    ours = np.stack([(run.fixed.direct + run.fixed.bounced).sum(axis=0)[vertices] for run in runs])
    means = [values.mean(axis=0) for values in (ours, reference)]
    errors = [values.std(axis=0, ddof=1) / math.sqrt(len(values)) for values in (ours, reference)]
    # Caustics are what few paths find, so that their noise is best known from all receivers together.
    noise = math.sqrt(np.mean(errors[0] ** 2) + np.mean(errors[1] ** 2))
    z = (means[0] - means[1]) / np.hypot(noise, errors[1])
    assert np.mean(np.abs(z) > 3.0) < 0.02
    of_mean = float(np.sqrt(np.sum(errors[0] ** 2) + np.sum(errors[1] ** 2)) / errors[0].size)
    whole = float(np.mean(means[1]))
    assert float(np.mean(means[0])) == pytest.approx(whole, abs=4.0 * of_mean + 0.004 * whole)
