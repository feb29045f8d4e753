"""What the plan says about mirrors, glass and the like, and that it keeps what it says."""

import gc
import logging
import math

import numpy as np
import pytest

import slepian_prt as sp
from slepian_prt.errors import UserError
from slepian_prt.scene.loading import open_scene
from slepian_prt.transport import path_plan
from slepian_prt.transport.effects import Estimate, wanted_effects
from slepian_prt.transport.interior import find_interior
from slepian_prt.transport.path_plan import PathPilot, decide
from tests.numerics import assert_exact
from tests.transport.test_path_light import BALL, CASE, DIFFUSE, FLOOR, FOG, MASK, SHEET, written

AMBIENT = math.sqrt(4.0 * math.pi)
MIRROR = '<bsdf type="conductor"/>'
FAR = """<shape type="sphere" id="far"><point name="center" x="0" y="0" z="20"/><float name="radius" value=".5"/>
<bsdf type="conductor"/></shape>"""
BUMPY = """<bsdf type="bumpmap"><texture type="checkerboard"/><bsdf type="roughconductor"/></bsdf>"""


def named(transfer):
    return {effect.name: effect for effect in transfer.effects}


def ambient(transfer) -> float:
    return float(transfer.vectors[:, :, 0].mean()) * AMBIENT


def test_a_plain_scene_is_not_looked_at(tmp_path, monkeypatch):
    def refuse(*_args, **_options):
        raise AssertionError("no path is followed")

    monkeypatch.setattr(path_plan, "PathRays", refuse)
    transfer = sp.precompute(written(tmp_path, FLOOR + BALL.format(DIFFUSE)), 1, 16, effects="all")
    assert not {"mirrors", "gloss", "glass", "opacity", "transmission", "media"} & set(named(transfer))
    assert transfer.noise is None


@pytest.mark.parametrize(
    ("effect", "body"),
    [
        ("mirrors", BALL.format(MIRROR)),
        ("glass", CASE.format('<bsdf type="dielectric"/>')),
        ("opacity", SHEET.format(MASK)),
        ("media", CASE.format(FOG)),
    ],
)
def test_left_out_it_changes_no_more_than_promised(effect, body, tmp_path):
    path = written(tmp_path, FLOOR + body)
    auto = sp.precompute(path, 1, 64)
    row = named(auto)[effect]
    assert row.verdict == "simulated"
    assert row.confidence > 0.0
    without = sp.precompute(path, 1, 64, effects="shadows,interreflection,colour")
    assert named(without)[effect].verdict == "omitted"
    assert without.noise is None
    light = ambient(auto)
    change = abs(light - ambient(without))
    # What is left out of media is their shadow, too; of the others it is light that is missing.
    assert change <= (row.contribution + row.confidence) * light
    if effect != "media":
        assert change > 0.2 * (row.contribution - row.confidence) * light
    spent = sum(other.rays for other in auto.effects if other.verdict == "simulated")
    assert auto.rays_traced == pytest.approx(spent, rel=0.3)


def test_what_is_too_little_is_left_out_with_all_that_belongs_to_it(tmp_path):
    path = written(tmp_path, FLOOR + FAR)
    auto = sp.precompute(path, 1, 64)
    row = named(auto)["mirrors"]
    assert row.verdict == "omitted"
    assert row.contribution + row.confidence < 0.005
    assert row.reason.startswith("at most")
    assert_exact(auto.vectors, sp.precompute(path, 1, 64, effects="direct").vectors, "as if nobody had looked")
    forced = sp.precompute(path, 1, 64, effects="shadows,mirrors")
    assert named(forced)["mirrors"].verdict == "simulated"
    # Some hundred rays of all those meet it.
    assert abs(ambient(forced) - ambient(auto)) <= 1.5 * (row.contribution + row.confidence)


def test_effects_by_name():
    assert wanted_effects("shadows, glass") == {"shadows", "glass"}
    with pytest.raises(UserError, match="glass needs shadows"):
        wanted_effects("glass")
    (row,), paths = decide(PathPilot.none(), Estimate(), 0.0, "shadows,glass", 64)
    assert (row.name, row.verdict, paths) == ("glass", "omitted", None)
    assert row.reason == "asked for, but nothing in the scene does it"


def test_materials_that_mitsuba_cannot_follow_are_told(tmp_path):
    """Mitsuba's checkerboards have no slopes: bump maps of them end in an exception, in its own integrators too."""
    transfer = sp.precompute(written(tmp_path, FLOOR + BALL.format(BUMPY)), 1, 16)
    gc.collect()  # while the material is alive, Dr.Jit follows no path in any scene of the process
    row = named(transfer)["gloss"]
    assert row.verdict == "not simulated"
    assert "eval_1_grad" in row.reason
    assert "\n" not in row.reason


def test_light_that_grows_is_told(tmp_path, caplog):
    """Between two mirrors that send back three times what they get."""
    bright = '<bsdf type="conductor"><spectrum name="specular_reflectance" value="3"/></bsdf>'
    with caplog.at_level(logging.INFO, "slepian_prt"):
        sp.precompute(written(tmp_path, FLOOR + SHEET.format(f'<bsdf type="twosided">{bright}</bsdf>')), 0, 32)
    assert "a material sends more than it gets" in caplog.text
    caplog.clear()
    with caplog.at_level(logging.INFO, "slepian_prt"):
        sp.precompute(written(tmp_path, FLOOR + CASE.format('<bsdf type="dielectric"/>')), 0, 32)
    assert "more than it gets" not in caplog.text


@pytest.mark.parametrize(("material", "filled"), [(MIRROR, True), ('<bsdf type="dielectric"/>', False)])
def test_who_is_under_glass_is_not_inside(material, filled, tmp_path):
    """A cube that stands on the floor, a little into it."""
    cube = """<shape type="cube" id="case"><transform name="to_world"><scale value=".5"/><translate z=".49"/>
    </transform>{}</shape>"""
    with open_scene(written(tmp_path, FLOOR + cube.format(material))) as scene:
        under = np.flatnonzero((np.abs(scene.traced_positions[:, :2]) < 0.45).all(axis=1))
        assert (find_interior(scene, under).vertices.size > 0) == filled
