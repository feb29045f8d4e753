"""Light of lamps that goes straight through panes and masks onto surfaces that a file holds."""

from dataclasses import replace

import numpy as np
import pytest

from slepian_prt.paths.lobes import lets_straight_through
from slepian_prt.relighting.mitsuba.scene_integrator import scene_integrator
from tests.relighting.mitsuba.scenes import runs
from tests.relighting.mitsuba.test_gathering import SHINE, above_floor, constant_lighting, floor  # noqa: F401
from tests.relighting.mitsuba.test_media import POINT, lamp, rgb, sensor
from tests.statistics import assert_agree, in_blocks

BLACK = {"type": "diffuse", "reflectance": 0.0}
PANE = {"type": "thindielectric", "specular_transmittance": rgb(0.9, 0.4, 0.2), "specular_reflectance": 0.0}
SHEETS = {"mask": {"type": "mask", "opacity": 0.4, "bsdf": {"type": "twosided", "bsdf": BLACK}}, "pane": PANE}


def sheet(mi, bsdf, height):
    place = mi.ScalarTransform4f().translate([0, height, 0]).rotate([1, 0, 0], -90).scale(0.8)
    return {"type": "rectangle", "to_world": place, "bsdf": bsdf}


@pytest.mark.parametrize(("kind", "reference"), [("area", "volpath"), ("point", "path")])
@pytest.mark.parametrize("name", SHEETS)
def test_lamps_shine_through(name, kind, reference, mi, floor):  # noqa: F811
    """Area lamps as in ``volpath``, which finds with less noise what ``path`` does; point lamps as in ``path``: not.

    Sheets reflect nothing, so that all that falls on the floor comes straight.
    """
    file, packed = floor
    packed = replace(packed, mesh=replace(packed.mesh, albedo=np.tile(np.float32(SHINE), (4, 1))))
    light = lamp(mi) if kind == "area" else POINT | {"position": [0.3, 2.0, 0.2]}
    things = {"above": sheet(mi, SHEETS[name], 1.0), "below": sheet(mi, SHEETS[name], 0.5), "lamp": light}
    ours = scene_integrator(mi, packed, lighting=constant_lighting([0.0, 0.0, 0.0]), albedo="scene")
    scene = above_floor(mi, file, things, bsdf={"type": "diffuse", "reflectance": rgb(*SHINE)})
    view = sensor(mi, None)
    a = in_blocks(runs(mi, scene, 12, integrator=ours, spp=32, sensor=view), 4)
    b = in_blocks(runs(mi, scene, 12, integrator=mi.load_dict({"type": reference}), spp=64, sensor=view), 4)
    assert a.mean() > 0.005
    assert_agree(a, b)


def test_what_lets_light_straight_through(mi):
    wanted = {"null": True, "mask": True, "thindielectric": True, "hair": False, "diffuse": False, "dielectric": False}
    inner = {"mask": {"bsdf": {"type": "diffuse"}}}
    found = {name: lets_straight_through(mi, mi.load_dict({"type": name, **inner.get(name, {})})) for name in wanted}
    assert found == wanted
