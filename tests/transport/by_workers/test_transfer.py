"""Transport by two workers, against the same in one process."""

from dataclasses import fields

import numpy as np
import pytest

import slepian_prt as sp
from slepian_prt.compression.settings import CompressionSettings
from slepian_prt.compression.stream import compress_scene
from slepian_prt.transport.by_workers import exchange
from slepian_prt.transport.by_workers.scene import by_workers
from slepian_prt.transport.planned import plan_scene
from slepian_prt.transport.settings import TransportSettings
from slepian_prt.transport.transfer import compute_transfer
from tests.conftest import bumpy
from tests.numerics import assert_exact, assert_rounded

SAME = "the same rays in the same blocks, and sums in the same order, on the same machine"

# A floor that a lamp and the sky light, a mirror above it, and a ball.
SCENE = """<scene version="3.0.0">
<sensor type="perspective"><transform name="to_world"><lookat origin="0, -4, 3" target="0, 0, 0" up="0, 0, 1"/>
</transform></sensor>
<emitter type="point" id="lamp"><point name="position" x="1" y="0" z="2"/><rgb name="intensity" value="3, 2, 1"/>
</emitter>
<shape type="rectangle" id="floor"><transform name="to_world"><scale value="1.5"/></transform>
<bsdf type="diffuse"><rgb name="reflectance" value=".8, .5, .2"/></bsdf></shape>
<shape type="rectangle" id="glass"><transform name="to_world"><rotate x="1" angle="100"/><translate y="1" z=".5"/>
</transform><bsdf type="twosided"><bsdf type="conductor"/></bsdf></shape>
<shape type="sphere" id="ball"><point name="center" x="0" y="0" z=".5"/><float name="radius" value=".4"/>
<bsdf type="diffuse"><rgb name="reflectance" value=".2, .5, .8"/></bsdf></shape>
</scene>"""


@pytest.fixture
def room(tmp_path):
    (tmp_path / "room.xml").write_text(SCENE)
    return tmp_path / "room.xml"


def both(crew, source, **settings):
    """Here and by workers."""
    return sp.precompute(source, **settings), sp.precompute(source, client=crew.client, **settings)


def assert_same(here, there):
    assert np.ptp(here.vectors) > 0.0
    assert_exact(there.vectors, here.vectors, SAME)
    for field in fields(here.fixed) if here.fixed is not None else ():
        value = getattr(here.fixed, field.name)
        if isinstance(value, np.ndarray):
            assert_exact(getattr(there.fixed, field.name), value, SAME)
    assert (there.bounces, there.rays_traced, there.noise) == (here.bounces, here.rays_traced, here.noise)


def test_direct_light(crew):
    assert_same(*both(crew, bumpy(3), bandlimit=4, samples=64))


def test_bounces_by_columns(crew):
    here, there = both(crew, bumpy(3), bandlimit=4, samples=64, albedo=(0.9, 0.5, 0.1), effects="all")
    assert here.bounces > 2
    assert here.vectors.shape[1] == 3
    assert_same(here, there)


def test_bounces_by_rows(crew, monkeypatch):
    monkeypatch.setattr(exchange, "_PART_OF_MEMORY", 0.0)
    for albedo in (0.8, (0.9, 0.5, 0.1)):
        assert_same(*both(crew, bumpy(3), bandlimit=4, samples=64, albedo=albedo, effects="all"))
    assert_same(*both(crew, bumpy(3), bandlimit=4, samples=64, albedo=0.8, effects="all", bounces=0))


@pytest.mark.slow
def test_paths_and_lamps(crew, room, monkeypatch):
    here = sp.precompute(room, bandlimit=2, samples=32)
    assert here.fixed is not None
    assert np.any(here.fixed.bounced)
    assert {row.name for row in here.effects if row.verdict == "simulated"} >= {"interreflection", "mirrors"}
    for part in (0.25, 0.0):  # by columns, and by rows
        monkeypatch.setattr(exchange, "_PART_OF_MEMORY", part)
        there = sp.precompute(room, bandlimit=2, samples=32, client=crew.client)
        # Kernels of paths differ in the order of their callables, and so in the rounding of what they multiply.
        assert_rounded(there.vectors, here.vectors, 1 << 10)
        assert_rounded(there.fixed.direct, here.fixed.direct, 1 << 10)
        assert_rounded(there.fixed.bounced, here.fixed.bounced, 1 << 10)
        assert (there.bounces, there.rays_traced) == (here.bounces, here.rays_traced)


@pytest.mark.slow
def test_toward_a_camera(crew, room):
    here, there = both(crew, room, bandlimit=2, samples=32, view=0)
    assert here.toward_view
    assert_rounded(there.vectors, here.vectors, 1 << 10)
    assert there.rays_traced == here.rays_traced


def test_other_settings_of_a_scene_that_workers_have(crew):
    settings = TransportSettings(bandlimit=3, samples=64, effects="direct")
    with plan_scene(bumpy(2), settings) as here, by_workers(here, crew, here.scene.mesh) as there:
        for changes in ({"samples": 16}, {"bandlimit": 5, "seed": 3}, {}):
            one, two = here.with_settings(**changes), there.with_settings(**changes)
            assert_same(compute_transfer(one), compute_transfer(two))
            some = np.arange(0, 100, 7)
            estimated = [planned.estimator().estimate(some) for planned in (one, two)]
            assert_exact(estimated[1].vectors, estimated[0].vectors, SAME)
            assert estimated[1].rays == estimated[0].rays > 0


def test_rays_are_counted(crew):
    with plan_scene(bumpy(2), TransportSettings(2, 32)) as here, by_workers(here, crew, here.scene.mesh) as there:
        one, two = here.estimator(), there.estimator()
        blocks = [estimator.blocks(estimator.pieces(), lambda block: block.vertices) for estimator in (one, two)]
        for own, other in zip(*blocks, strict=True):
            assert_exact(other, own, "the same pieces, in the same order")
        assert two.rays == one.rays > 0


def test_compression_of_what_is_exchanged(crew):
    wanted = CompressionSettings(tolerance=0.05, clusters=8), TransportSettings(4, 64, albedo=0.8, effects="all")
    here, there = (compress_scene(bumpy(3), *wanted, crew=who) for who in (None, crew))
    assert here.bounces == there.bounces > 0
    assert_exact(there.reconstruct(), here.reconstruct(), SAME)
