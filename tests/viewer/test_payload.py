"""What a page carries: numbers that relight as Python does, read by a plain reader and by a browser."""

from __future__ import annotations

import base64
import gzip
import json
from dataclasses import replace

import numpy as np
import pytest

import slepian_prt as sp
from slepian_prt.errors import UserError
from slepian_prt.lighting.environment import make_environment
from slepian_prt.relighting.drawing.camera import relit_view
from slepian_prt.relighting.drawing.pictures import Picture, exposure
from slepian_prt.scene.mesh import make_mesh
from slepian_prt.scene.view import Aim, up_rotation
from slepian_prt.viewer.pages import PageWish, page_content
from slepian_prt.viewer.payload import make_payload
from tests.numerics import assert_exact
from tests.viewer.page_reader import read_payload
from tests.viewer.tiny import HEIGHT, WIDTH, lamplit, tiny, tiny_film, traced

STORED = "stored as it is"


@pytest.fixture(scope="module")
def sky():
    """A map of few texels, brighter above."""
    rows = np.linspace(2.0, 0.1, 8)[:, None, None]
    return make_environment(rows * np.linspace(0.5, 1.0, 16)[None, :, None] * [1.0, 0.8, 0.6], name="sky")


def payload_of(transfer, maps=(), other=None, **wish):
    """The payload as a plain reader has it, and what was put in."""
    content = page_content(transfer, PageWish(tuple(maps), **wish), other)
    return read_payload(make_payload(content)), content


def radiance_in(model, coefficients: np.ndarray) -> np.ndarray:
    """(N, 3) as docs/runtime-format.md has it, from a model of a payload."""
    caps, count, channels = model["caps"], model["functions"], model["channels"]
    functions = model["table"].reshape(caps, count, channels, -1)
    zeros, vertices = model["zeros"].reshape(caps, count - 1), model["bytes"].reshape(-1, count)
    size = functions.shape[-1]
    light = coefficients.reshape(3, -1)[:, :size]
    result = np.zeros((len(vertices), 3))
    for row, vertex in zip(result, vertices, strict=True):
        cap = vertex[-1]
        vector = functions[cap, 0] + np.einsum("k,kcm->cm", vertex[:-1] / 255 - zeros[cap], functions[cap, 1:])
        row[:] = (np.broadcast_to(vector, (3, size)) * light).sum(axis=1)
    return result


@pytest.mark.parametrize("channels", [1, 3])
def test_a_page_relights_as_the_run_time_format_does(channels, sky):
    read, content = payload_of(tiny(channels), [sky])
    model, light = read["models"][0], read["lights"][0]
    wanted = content.models[0].transfer.relight(sp.project_environment(sky, 2))
    # Sums of 9 products in float32, of 16 functions.
    found = radiance_in(model, light["coefficients"])
    np.testing.assert_allclose(found, wanted[content.drawn[0].receivers], atol=16 * 9 * 2.0**-24 * np.abs(wanted).max())
    assert model["channels"] == channels
    assert read["bandlimit"] == 2
    assert read["film"] is None


def test_functions_lose_nothing():
    read, content = payload_of(tiny(3))
    table = content.models[0].transfer.functions
    assert_exact(read["models"][0]["table"].reshape(table.shape), table, STORED)


def test_functions_of_all_magnitudes_lose_nothing(sky):
    content = page_content(tiny(), PageWish((sky,)))
    table = np.zeros_like(content.models[0].transfer.functions)
    table.ravel()[:4] = [65504.0, 2.0**-24, -3.0, 1000.0]
    extreme = replace(content.models[0], transfer=replace(content.models[0].transfer, functions=table))
    read = read_payload(make_payload(replace(content, models=[extreme])))
    assert_exact(read["models"][0]["table"].reshape(table.shape), table, STORED)


def test_lights_are_those_of_all_texels_and_stand_as_in_pictures(sky):
    read, _ = payload_of(tiny(), [sky], aim=Aim(up="z"), rotate=30.0)
    light = read["lights"][0]
    turned = sky.turned(up_rotation("z"))
    assert read["display"]["turn"] == 30.0
    wanted = sp.project_environment(turned, 2)
    np.testing.assert_allclose(light["coefficients"].reshape(3, -1), wanted, atol=1e-12 * np.abs(wanted).max())
    np.testing.assert_allclose(light["to_world"], turned.to_world, atol=1e-15)
    assert (light["name"], light["suffix"], light["own"], light["clamped"]) == ("sky", ".exr", False, 0)
    assert read["up"] == "z"
    assert read["display"]["background"] == "map"


def test_the_scenes_own_light_has_no_map():
    own = np.arange(27.0).reshape(3, 9)
    read, _ = payload_of(replace(tiny(), lighting=own))
    light = read["lights"][0]
    np.testing.assert_allclose(light["coefficients"].reshape(3, -1), own, atol=1e-12 * 27)
    assert (light["map"], light["own"], light["name"]) == (None, True, "light of the scene")
    assert read["display"]["background"] == "transparent"


def test_lamps_shine_alone_where_they_are_all_there_is():
    read, content = payload_of(lamplit(), fixed_lights={"desk": 2.0})
    model, fixed = read["models"][0], lamplit().fixed
    wanted = (fixed.direct + fixed.bounced)[0] + 2.0 * (fixed.direct + fixed.bounced)[1]
    np.testing.assert_allclose(model["fixed"], wanted[content.drawn[0].receivers], rtol=2.0**-11)
    assert model["lampNames"] == ["ceiling", "desk"]
    assert not read["lights"][0]["coefficients"].any()
    assert any("stand still" in note for note in read["notes"])


def test_lamps_that_are_off_are_not_there(sky):
    read, _ = payload_of(lamplit(), [sky], fixed_lights=0.0)
    assert read["models"][0]["fixed"] is None


def test_without_any_light_the_shipped_sky_shines():
    told = []
    content = page_content(tiny(), PageWish(), report=told.append)
    assert [light.name for light in content.lights] == ["sky"]
    assert told[0].startswith("the scene has no light of its own; the page has the sky that is shipped")


def test_the_camera_is_that_of_pictures(sky):
    aim = Aim(((0.0, 1.0, 4.0), (0.0, 0.0, 0.0)), 30.0)
    read, _ = payload_of(tiny(), [sky], aim=aim)
    view = relit_view(tiny(), aim)
    assert read["camera"]["to_world"] == view.to_world
    assert (read["camera"]["fov"], read["camera"]["locked"]) == (30.0, False)
    places = np.array(read["antialias"])
    assert places.shape == (64, 3)
    # The film's filter is a box: each 64th of both sides has one place.
    for side in (0, 1):
        assert_exact(np.floor((places[:, side] + 0.5) * 64).astype(int)[np.argsort(places[:, side])], np.arange(64), "")
    np.testing.assert_allclose(places.sum(axis=0), [0.0, 0.0, 1.0], atol=1e-4)


def test_the_exposure_is_that_of_pythons_picture(sky):
    read, _ = payload_of(tiny(), [sky], exposure=1.5)
    linear = sp.render_picture(tiny(), sky, scene_linear=True)
    wanted = exposure(Picture(linear[..., :3], linear[..., 3]))
    # Of 16 bytes per vertex: what they lose of radiance is below a hundredth.
    assert read["display"]["scale"] == pytest.approx(wanted, rel=0.01)
    assert read["display"]["exposure"] == 1.5


def test_light_toward_a_camera_is_drawn_from_there_only(sky):
    view = relit_view(tiny())
    toward = replace(tiny(), view=view, toward_view=True)
    read, _ = payload_of(toward, [sky])
    assert read["camera"]["locked"] is True
    with pytest.raises(UserError, match="leave out `look_at`"):
        payload_of(toward, [sky], aim=Aim(((0.0, 0.0, 9.0), (0.0, 0.0, 0.0))))


def test_a_film_is_pixels_row_by_row(sky):
    read, content = payload_of(tiny_film(), [sky])
    film, model = tiny_film().film, read["models"][0]
    assert (read["film"]["width"], read["film"]["height"]) == (WIDTH, HEIGHT)
    assert (read["geometries"], read["camera"], model["geometry"]) == ([], None, None)
    assert_exact(model["bytes"], content.models[0].transfer.vertices, STORED)
    np.testing.assert_allclose(read["film"]["background"], film.background, atol=0.51 / 65535)
    np.testing.assert_allclose(read["film"]["coverage"].ravel(), film.coverage, atol=0.51 / 65535)
    directions = read["film"]["directions"]
    shape = directions["looks"], directions["rows"], directions["columns"], 3
    assert_exact(directions["values"].reshape(shape), film.directions, STORED)


def test_a_film_has_no_other_camera(sky):
    with pytest.raises(UserError, match="which only light can change; leave out `fov`"):
        payload_of(tiny_film(), [sky], aim=Aim(fov=30.0))


def test_what_is_compared_lies_on_the_same_mesh(sky):
    other = sp.compress(traced(), "none", clusters=5, coding="float32")
    read, _ = payload_of(tiny(), [sky], other)
    assert len(read["geometries"]) == 1
    assert [model["geometry"] for model in read["models"]] == [0, 0]
    found = [radiance_in(model, read["lights"][0]["coefficients"]) for model in read["models"]]
    # Both lose less than a hundredth.
    assert np.linalg.norm(found[0] - found[1]) < 0.02 * np.linalg.norm(found[0])


def test_what_is_compared_may_number_its_vertices_otherwise(sky):
    order = np.random.default_rng(2).permutation(len(traced().mesh.positions))
    mesh = traced().mesh
    shuffled = make_mesh(mesh.positions[order], np.argsort(order)[mesh.faces])
    vectors, axes = traced().vectors[order], traced().axes[order]
    read, content = payload_of(tiny(), [sky], replace(traced(), mesh=shuffled, vectors=vectors, axes=axes))
    assert len(read["geometries"]) == 1
    same, other = (drawn.receivers for drawn in content.drawn)
    assert_exact(order[other], same, "whole numbers")
    found = [radiance_in(model, read["lights"][0]["coefficients"]) for model in read["models"]]
    assert np.linalg.norm(found[0] - found[1]) < 0.02 * np.linalg.norm(found[0])


def test_lamps_count_in_the_exposure():
    read, _ = payload_of(lamplit())
    linear = sp.render_picture(lamplit(), None, scene_linear=True)
    assert read["display"]["scale"] == pytest.approx(exposure(Picture(linear[..., :3], linear[..., 3])), rel=1e-3)


def test_transfer_in_memory_is_full_sh_with_more_functions(sky):
    read, _ = payload_of(tiny(), [sky], traced())
    assert [model["functions"] for model in read["models"]] == [16, 64]
    labels = [model["label"] for model in read["models"]]
    assert all(label.startswith("full SH, ") for label in labels)
    assert labels[0] != labels[1]


def test_another_model_has_a_mesh_of_its_own_and_another_bandlimit(sky):
    from tests.conftest import sphere

    other = sp.precompute(sphere(1), bandlimit=3, samples=16)
    read, content = payload_of(tiny(), [sky], other)
    assert [model["geometry"] for model in read["models"]] == [0, 1]
    assert [model["bandlimit"] for model in read["models"]] == [2, 3]
    assert read["bandlimit"] == 3
    light = read["lights"][0]["coefficients"].reshape(3, -1)
    assert light.shape == (3, 16)
    # One table of lit functions for each, whatever its bandlimit: those of the lower one have zeros behind.
    for model, given, drawn in zip(read["models"], content.models, content.drawn, strict=True):
        assert model["table"].size == model["caps"] * model["functions"] * 16
        size = (given.transfer.bandlimit + 1) ** 2
        wanted = given.transfer.relight(light[:, :size])[drawn.receivers]
        np.testing.assert_allclose(radiance_in(model, light), wanted, atol=16 * 16 * 2.0**-24 * wanted.max())


def test_what_is_told_is_text(sky):
    read, _ = payload_of(tiny(), [sky])
    told = {title: dict(rows) for title, rows in read["statistics"]}
    assert told["Model"]["vertices"] == f"{len(tiny().mesh.positions):,}"
    assert told["Bytes"]["on the graphics card"].endswith("bytes, 16 per vertex")
    assert "together" in told["Error"]
    assert "shadows" in told["Light transport"]
    assert all(isinstance(text, str) for rows in told.values() for pair in rows.items() for text in pair)


def test_a_browser_reads_what_a_plain_reader_does(modules, sky):
    payload = make_payload(page_content(lamplit(), PageWish((sky,))))
    packed = base64.b64encode(gzip.compress(payload)).decode()
    body = 'const { readPayload } = await import("#payload"); return readPayload(packed);'
    read, wanted = modules.run(body, packed=packed), read_payload(payload)

    def compare(found, expected, where="payload"):
        if isinstance(expected, np.ndarray):
            # Scaled numbers are float32 there.
            np.testing.assert_allclose(found, expected.ravel(), rtol=2.0**-23, atol=1e-7, err_msg=where)
        elif isinstance(expected, dict):
            assert found.keys() == expected.keys(), where
            for name, value in expected.items():
                compare(found[name], value, f"{where}.{name}")
        elif isinstance(expected, list):
            assert len(found) == len(expected), where
            for number, value in enumerate(expected):
                compare(found[number], value, f"{where}[{number}]")
        else:
            assert json.dumps(found) == json.dumps(expected) or found == expected, where

    compare(read, wanted)


@pytest.mark.parametrize(("wish", "message"), [
    ({"functions": 12}, "functions must be one of 8, 16, 24, 32, not 12"),
    ({"background": "map"}, "the light of the scene is kept as spherical harmonics, which are no background"),
    ({"background": "no colour"}, "background must be transparent, map, a colour"),
    ({"exposure": "bright"}, "exposure must be a number of stops"),
])  # fmt: skip
def test_wishes_that_make_no_sense(wish, message):
    with pytest.raises(UserError, match=message):
        PageWish(**wish)
