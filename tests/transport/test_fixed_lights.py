"""Light of lamps in precomputed transfer: bounces, what the plan says, and what is refused."""

import logging
import math
from pathlib import Path

import numpy as np
import pytest
import trimesh

import slepian_prt as sp
from slepian_prt.compression.settings import CompressionSettings
from slepian_prt.compression.stream import compress_scene
from slepian_prt.errors import UserError
from slepian_prt.renderer.variants import bitmap_module
from slepian_prt.scene.loading import open_scene
from slepian_prt.scene.scene import Scene
from slepian_prt.transport.hemisphere import upload_origins
from slepian_prt.transport.settings import TransportSettings
from tests.numerics import assert_exact
from tests.scene.test_piercing import post
from tests.statistics import assert_agree
from tests.transport.test_lamp_light import AREA, point

BOX = """<shape type="rectangle" id="floor"><bsdf type="diffuse"><rgb name="reflectance" value=".6, .5, .4"/></bsdf>
</shape><shape type="rectangle" id="wall"><transform name="to_world"><rotate y="1" angle="90"/>
<translate x="-1" z="1"/></transform><bsdf type="diffuse"><rgb name="reflectance" value=".8, .2, .1"/></bsdf></shape>"""
SUN = """<emitter type="directional" id="sun"><vector name="direction" x="-1" y="0.5" z="-2"/>
<rgb name="irradiance" value="3"/></emitter>"""
SKY = '<emitter type="constant"><rgb name="radiance" value="1"/></emitter>'
LAMP = f"""<shape type="rectangle" id="lamp"><transform name="to_world"><scale value=".3"/><rotate x="1" angle="180"/>
<translate z="1.5"/></transform>{AREA}</shape>"""


def written(folder: Path, content: str) -> Path:
    (folder / "lit.xml").write_text(f'<scene version="3.0.0">{content}</scene>')
    return folder / "lit.xml"


def row(transfer: sp.Transfer):
    return next(effect for effect in transfer.effects if effect.name.startswith("light of lamp"))


@pytest.mark.slow
def test_integrating_sphere(tmp_path):
    """A point amid a sphere lights it by I/R² everywhere; surfaces add ρ/(1-ρ) of that, though no sky is seen."""
    inside = """<shape type="sphere" id="wall"><float name="radius" value="2"/>
    <boolean name="flip_normals" value="true"/>
    <bsdf type="diffuse"><rgb name="reflectance" value=".5"/></bsdf></shape>"""
    transfer = sp.precompute(written(tmp_path, inside + point("bulb", (0.0, 0.0, 0.0), 3.0)), 0, 256)
    assert not transfer.vectors.any()
    assert transfer.fixed is not None
    active = transfer.normals.any(axis=1)
    direct, bounced = transfer.fixed.direct[0, active], transfer.fixed.bounced[0, active]
    np.testing.assert_allclose(direct, 3.0 / 4.0 / math.pi, rtol=1e-4)  # rays start a little above the wall
    # Ninety-six chords round the sphere take (π/96)²/2 = 0.05 % of the distances, the series ends at 0.1 %.
    np.testing.assert_allclose(bounced.mean() / direct.mean(), 1.0, rtol=4e-3)
    assert bounced.std() < 0.02 * bounced.mean()
    once = sp.precompute(tmp_path / "lit.xml", 0, 256, bounces=1)
    assert once.fixed is not None
    np.testing.assert_allclose(once.fixed.bounced[0, active].mean() / direct.mean(), 0.5, rtol=4e-3)


def path_traced(scene: Scene, vertices: np.ndarray, samples: int, seed: int) -> np.ndarray:
    """(n, 3) radiance of unit albedo: emitters sampled at the vertex, all else by Mitsuba's path tracer."""
    import drjit as dr

    mi, loaded = scene.mi, scene.loaded
    place = dr.arange(mi.UInt32, len(vertices) * samples) // dr.opaque(mi.UInt32, samples)
    normals = mi.Normal3f(scene.receivers.normals[vertices].T.astype(np.float32))
    origin_of = upload_origins(mi, scene.ray_origins, vertices)
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, dr.width(place))
    it = dr.zeros(mi.SurfaceInteraction3f, dr.width(place))
    it.p, it.n = origin_of(place, mi.Vector3f(0.0)), dr.gather(mi.Normal3f, normals, place)
    ds, weight = loaded.sample_emitter_direction(it, sampler.next_2d(), False)
    cosine = dr.maximum(dr.dot(it.n, ds.d), 0.0)
    ray = mi.Ray3f(origin_of(place, ds.d), ds.d)
    ray.maxt = ds.dist * 0.999
    lit = (cosine > 0.0) & (ds.pdf > 0.0)
    light = dr.select(lit & ~loaded.ray_test(ray, lit), weight * cosine * dr.inv_pi, 0.0)
    outward = mi.Frame3f(it.n).to_world(mi.warp.square_to_cosine_hemisphere(sampler.next_2d()))
    integrator = mi.load_dict({"type": "path", "max_depth": 32, "hide_emitters": True})
    ray = mi.RayDifferential3f(mi.Ray3f(origin_of(place, outward), outward))
    light += integrator.sample(loaded, sampler, ray)[0]
    return np.stack([np.array(dr.block_sum(channel, samples)) / samples for channel in mi.Color3f(light)], axis=-1)


@pytest.mark.slow
def test_agrees_with_the_path_tracer(tmp_path):
    """All kinds of lamps at once, in a corner whose walls tint each other's light."""
    spot = """<emitter type="spot" id="spot"><rgb name="intensity" value="2"/><transform name="to_world">
    <lookat origin="0.8,0.8,2" target="-0.2,-0.2,0" up="0,1,0"/></transform></emitter>"""
    ball = """<shape type="sphere" id="ball"><point name="center" x="0.3" y="0.2" z="0.35"/>
    <float name="radius" value="0.35"/>
    <bsdf type="diffuse"><rgb name="reflectance" value=".2, .3, .7"/></bsdf></shape>"""
    mi = bitmap_module()
    checks = np.kron(np.random.default_rng(1).random((4, 4)), np.ones((8, 8)))[..., None] * np.ones(3)
    mi.Bitmap(checks.astype(np.float32)).write(str(tmp_path / "checks.exr"))
    slide = """<emitter type="projector" id="slide"><texture type="bitmap" name="irradiance">
    <string name="filename" value="checks.exr"/></texture><float name="scale" value="5"/><transform name="to_world">
    <lookat origin="0.9,-0.9,1" target="-0.2,0.2,0" up="0,0,1"/></transform></emitter>"""
    bulb = point("bulb", (-0.5, -0.5, 1.0), "1, 2, 4")
    path = written(tmp_path, BOX + ball + LAMP + SUN + spot + slide + bulb)
    vertices = np.random.default_rng(0).choice(6000, 150, replace=False)
    ours = []
    for seed in range(3):
        transfer = sp.precompute(path, 1, 512, seed=seed)
        assert transfer.fixed is not None
        assert transfer.fixed.names == ("lamp", "sun", "spot", "slide", "bulb")
        assert transfer.fixed.kinds == ("area", "directional", "spot", "projector", "point")
        ours.append((transfer.fixed.direct + transfer.fixed.bounced).sum(axis=0)[vertices])
    with open_scene(path) as scene:
        assert len(scene.receivers) > 6000
        reference = np.stack([path_traced(scene, vertices, 512, seed) for seed in range(8)])
    # What is bounced, about a fifth, is taken between vertices, and from balls cut into faces: some per cent of it.
    assert_agree(np.stack(ours), reference, bias=0.01 * reference.mean())


def test_lamps_beside_a_sky(tmp_path):
    """Transfer is that of the scene without them, and the plan tells their share of unshadowed light."""
    dark = sp.precompute(written(tmp_path, BOX + SKY), 2, 64)
    assert dark.fixed is None
    lit = sp.precompute(written(tmp_path, BOX + SKY + SUN), 2, 64)
    assert_exact(lit.vectors, dark.vectors, "the same rays")
    # E cos θ / π on the floor (z) and on the wall (x) beside the 1 of the sky, with as many vertices on both.
    cosines = np.array([2.0, 1.0]) / math.sqrt(5.25)
    expected = (3.0 * cosines / math.pi).mean()
    assert row(lit).verdict == "simulated"
    assert row(lit).contribution == pytest.approx(expected / (expected + 1.0), rel=0.1)  # of 256 vertices
    assert "1 directional" in row(lit).reason


@pytest.mark.slow
def test_blocks_give_the_same_light(tmp_path):
    """Compressed as it is traced, or from all vectors."""
    path = written(tmp_path, BOX + LAMP + SUN)
    whole = sp.precompute(path, 2, 64, effects="direct")
    packed = compress_scene(path, CompressionSettings(), TransportSettings(2, 64, "direct"))
    assert whole.fixed is not None
    assert packed.fixed is not None
    assert_exact(packed.fixed.direct, whole.fixed.direct, "the same rays")
    assert not packed.fixed.bounced.any()
    assert packed.fixed.names == ("lamp", "sun")


def test_without_shadows(tmp_path):
    """What is in a shadow is lit, and so is the foot of a pole that is sunk into the floor."""
    lid = """<shape type="rectangle" id="lid"><transform name="to_world"><translate z="0.5"/></transform>
    <bsdf type="twosided"><bsdf type="diffuse"/></bsdf></shape>"""
    trimesh.Trimesh(*post(0.1), process=False).export(tmp_path / "pole.ply")
    pole = """<shape type="ply" id="pole"><string name="filename" value="pole.ply"/><bsdf type="diffuse"/></shape>"""
    path = written(tmp_path, BOX + lid + pole + point("bulb", (0.8, 0.0, 1.0), 1.0))
    bulb = np.array([0.8, 0.0, 1.0])
    with open_scene(path) as scene:
        facing = np.einsum("ij,ij->i", scene.mesh.normals, bulb - scene.mesh.positions) > 0.0
        sunk = scene.is_hidden & facing
        assert sunk.any()
        floor = slice(scene.parts[0].first, scene.parts[0].end)
    shadowed, plain = (sp.precompute(path, 1, 32, effects=effects).fixed for effects in ("direct", "none"))
    assert shadowed is not None
    assert plain is not None
    assert not shadowed.direct[0, floor].any()
    assert (plain.direct[0, floor] > 0.0).all()
    assert (plain.direct[0, sunk] > 0.0).all()


def test_toward_a_camera_lamps_are_named(tmp_path):
    eye = '<sensor type="perspective" id="eye"><transform name="to_world"><translate z="9"/></transform></sensor>'
    transfer = sp.precompute(written(tmp_path, eye + BOX + SUN), 1, 32, view="eye")
    assert transfer.fixed is None
    assert row(transfer).verdict == "not simulated"


def remarks(path: Path, caplog) -> str:
    with caplog.at_level(logging.INFO, logger="slepian_prt"):
        transfer = sp.precompute(path, 1, 32)
    assert transfer.fixed is None or np.isfinite(transfer.fixed.direct).all()
    return "\n".join(caplog.messages)


def test_a_lamp_in_a_closed_shape(tmp_path, caplog):
    globe = """<shape type="sphere" id="globe"><point name="center" x="0" y="0" z="1"/>
    <float name="radius" value="0.2"/><bsdf type="diffuse"/></shape>"""
    told = remarks(written(tmp_path, BOX + globe + point("bulb", (0.0, 0.0, 1.0), 1.0)), caplog)
    assert "lamp 'bulb' lights no vertex: it is inside a closed shape" in told


def test_a_lamp_that_shines_past_all(tmp_path, caplog):
    away = """<emitter type="spot" id="away"><rgb name="intensity" value="2"/><transform name="to_world">
    <lookat origin="0,0,1" target="0,0,2" up="0,1,0"/></transform></emitter>"""
    assert "lamp 'away' lights no vertex: it shines past all of them" in remarks(written(tmp_path, BOX + away), caplog)


def test_a_lamp_that_is_off(tmp_path, caplog):
    path = written(tmp_path, BOX + point("off", (0.0, 0.0, 1.0), 0.0))
    assert "lamp 'off' is set to 0 and left out" in remarks(path, caplog)
    assert sp.precompute(path, 1, 32).fixed is None


def test_a_lamp_that_no_sample_finds_is_named(tmp_path):
    beam = LAMP.replace('type="area"', 'type="directionalarea"')
    transfer = sp.precompute(written(tmp_path, BOX + beam), 1, 32)
    assert transfer.fixed is None
    assert row(transfer).verdict == "not simulated"
    assert "'lamp' (directionalarea)" in row(transfer).name


@pytest.mark.parametrize(("value", "problem"), [("-1", "negative"), ("nan", "NaN or"), ("inf", "or infinite")])
@pytest.mark.parametrize("kind", ["point", "area"])
def test_light_that_is_none(kind, value, problem, tmp_path):
    bad = point("bad", (0.0, 0.0, 1.0), value) if kind == "point" else LAMP.replace('value="1"', f'value="{value}"')
    name = "bad" if kind == "point" else "lamp"
    with pytest.raises(UserError, match=rf"lit\.xml: lamp '{name}': its .* {problem}.*repair the light"):
        sp.precompute(written(tmp_path, BOX + bad), 1, 16)
