"""Remarks on captures: light that cannot be right, lamps that light nothing, media without an end."""

import logging

import pytest

from slepian_prt.errors import UserError
from slepian_prt.transport.capturing.capture import capture
from tests.transport.capturing.scenes import camera, film, llvm_mitsuba, open_box


@pytest.fixture(scope="module")
def mi():
    return llvm_mitsuba()


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("SLEPIAN_PRT_CACHE", str(tmp_path / "cache"))


@pytest.fixture
def told(caplog):
    """What is told of a scene."""

    def capture_it(description, **settings):
        caplog.set_level(logging.INFO, logger="slepian_prt")
        caplog.clear()
        capture(description, bandlimit=1, samples=16, **settings)
        return " ".join(record.getMessage() for record in caplog.records)

    return capture_it


def mirrors(mi, reflectance):
    """Two parallel mirrors, open in front and above, that reflect so much of the light."""
    metal = {"type": "conductor", "material": "none", "specular_reflectance": {"type": "uniform", "value": reflectance}}
    place = mi.ScalarTransform4f
    return {
        "type": "scene",
        "eye": camera(mi, film_of=film(12)),
        **{
            name: {
                "type": "rectangle",
                "to_world": place().translate([x, 1, 0]).rotate([0, 1, 0], -90 * x),
                "bsdf": {"type": "twosided", "metal": metal},
            }
            for name, x in (("left", -1), ("right", 1))
        },
    }


def test_light_that_grows_between_mirrors_is_told(mi, told):
    assert "a material sends more than it gets" in told(mirrors(mi, 1.3))
    assert "sends more" not in told(mirrors(mi, 1.0))


def test_light_without_bounds_is_refused_in_one_line(mi):
    with pytest.raises(UserError, match="pixels is not finite: a material sends more than it gets"):
        capture(mirrors(mi, 1e30), bandlimit=1, samples=16)


def test_lamp_in_a_ball_of_glass_is_told_to_light_nothing(mi, told):
    lamp = {"type": "point", "position": [0.45, 0.4, 0.35], "intensity": 3.0}
    assert "lamp 'lamp' lights nothing that camera 'eye' sees" in told(open_box(mi, lamp=lamp))
    assert "lights nothing" not in told(open_box(mi, lamp={**lamp, "position": [0, 1.8, 0]}))


def test_camera_in_a_closed_room_is_told_that_no_light_gets_in(mi, told):
    walls = {"type": "sphere", "radius": 20.0, "bsdf": {"type": "twosided", "plain": {"type": "diffuse"}}}
    room = {"type": "scene", "eye": camera(mi, film_of=film(8)), "walls": walls}
    assert "no path from camera 'eye' gets out to distant light" in told(room)
    lamp = {"type": "point", "position": [0, 2, 2], "intensity": 3.0}
    assert told({**room, "lamp": lamp}) == ""


@pytest.mark.parametrize(("kind", "ends"), [("rectangle", False), ("cube", True), ("sphere", True)])
def test_medium_that_nothing_closes_is_told(mi, told, kind, ends):
    fog = {
        "type": kind,
        "to_world": mi.ScalarTransform4f().translate([0, 1, 0]).scale(0.5),
        "bsdf": {"type": "null"},
        "interior": {"type": "homogeneous", "sigma_t": 1.0, "albedo": 0.5},
    }
    words = told({"type": "scene", "eye": camera(mi, film_of=film(8)), "fog": fog})
    assert ("the medium within 'fog' has no end" in words) is not ends


def test_water_that_a_basin_closes_has_an_end(mi, told):
    place = mi.ScalarTransform4f
    basin = {"type": "cube", "bsdf": {"type": "twosided", "plain": {"type": "diffuse"}}, "to_world": place().scale(3)}
    water = {
        "type": "rectangle",
        "to_world": place().rotate([1, 0, 0], -90).scale(3),
        "bsdf": {"type": "dielectric"},
        "interior": {"type": "homogeneous", "sigma_t": 1.0, "albedo": 0.5},
    }
    assert "has no end" not in told({"type": "scene", "eye": camera(mi, film_of=film(8)), "a": basin, "b": water})


def test_fog_around_a_camera_that_nothing_closes_is_told(mi, told):
    fog = {"type": "homogeneous", "id": "fog", "sigma_t": 0.1, "albedo": 0.5}
    same = {"type": "ref", "id": "fog"}
    floor = {
        "type": "rectangle",
        "to_world": mi.ScalarTransform4f().rotate([1, 0, 0], -90).scale(2),
        "exterior": same,
    }
    scene = {"type": "scene", "fog": fog, "eye": camera(mi, film_of=film(8), medium=same), "floor": floor}
    words = told(scene)
    assert "the medium around the camera has no end" in words
    assert "the medium around 'floor' has no end" in words
    room = {"type": "sphere", "radius": 20.0, "bsdf": {"type": "null"}, "interior": same}
    assert told({**scene, "room": room}) == ""
