"""What the integrator says in Mitsuba's log, and refuses."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

import slepian_prt as sp
from slepian_prt.lighting.projection import project_environment
from slepian_prt.lighting.windowing import windowed
from slepian_prt.relighting.mitsuba.remarks import heard_remarks, log_warning
from slepian_prt.relighting.mitsuba.scene_integrator import scene_integrator
from slepian_prt.relighting.mitsuba.spectra import smooth_basis, smooth_spectra
from slepian_prt.relighting.relight import relight
from slepian_prt.transport.effects import Effect
from tests.conftest import bumpy
from tests.relighting.mitsuba.scenes import camera, envmap, loaded, packed_of, painted, picture, shape, sky
from tests.statistics import assert_same_picture
from tests.variants import sibling

# --- Remarks and refusals --------------------------------------------------------------------------------------------


def test_a_file_without_materials_is_told_of(mi, folder, tmp_path, log):
    mesh = bumpy(3)
    packed = sp.compress(sp.precompute(replace(mesh, name="bumpy"), bandlimit=4, samples=16), clusters=6)
    packed.save(tmp_path / "bare.prt")
    bare = {"type": "slepian_prt", "transfer": str(tmp_path / "bare.prt")}
    picture(mi, loaded(mi, folder), integrator=mi.load_dict(bare))
    assert [text for text in log if "'bumpy' reflects all light" in text and "reflects 0.50" in text]
    log.clear()
    picture(mi, loaded(mi, folder), integrator=mi.load_dict({**bare, "albedo": "scene"}))
    rough = shape(mi, folder) | {"bsdf": {"type": "roughplastic"}}
    picture(mi, loaded(mi, folder, bumpy=rough), integrator=mi.load_dict(bare))
    assert not log


FOG = {"type": "sphere", "bsdf": {"type": "null"}, "interior": {"type": "homogeneous"}}
GLASS = {"type": "sphere", "bsdf": {"type": "dielectric"}}


@pytest.mark.parametrize(
    ("source", "rows", "missing"),
    [
        ("bumpy.ply", {}, "fog, smoke and the like, glass"),
        ("bumpy.ply", {"media": "omitted", "glass": "simulated"}, None),
        ("bumpy.xml", {}, None),
        ("bumpy.xml", {"media": "simulated", "glass": "not simulated"}, "glass"),
        ("bumpy.xml", {"participating media inside shape 'fog'": "not simulated"}, "fog, smoke and the like, glass"),
    ],
    ids=["mesh", "planned", "scene", "failed", "before"],
)
def test_light_is_told_of_that_a_file_was_made_without(source, rows, missing, mi, folder, log):
    """Of files of meshes, and of scenes whose plan said so; where a plan has no word of it, nothing reaches them."""
    effects = [Effect(name, verdict, 0.1, 0.01, 1000, "") for name, verdict in rows.items()]
    packed = replace(packed_of(folder), effects=tuple(effects), source=source)
    scene = mi.load_dict(
        {"type": "scene", "bumpy": shape(mi, folder), "fog": FOG, "glass": GLASS, "sensor": camera(mi)}
    )
    picture(mi, scene, integrator=scene_integrator(mi, packed, lighting=np.ones((3, 49))), spp=1)
    told = f"slepian_prt: {source} was made without {missing}: what these send onto its shapes, or keep from them, is "
    told += "missing; precompute the scene"
    assert [text for text in log if "made without" in text] == ([told] if missing else [])


def test_remarks_are_bare_sentences_and_made_once(mi, folder, log):
    """Without the file, line and function of ours; not again for every picture of a model that moves."""
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "slepian_prt", "transfer": str(folder / "bumpy.prt")},
            "sensor": camera(mi),
            "bumpy": shape(mi, folder),
        }
    )
    parameters = mi.traverse(scene)
    for _ in range(3):
        mi.render(scene, spp=1)
        parameters["bumpy.vertex_positions"] *= 1.5
        parameters.update()
    assert log == ["slepian_prt: without light the shapes of bumpy.prt are black"]


@pytest.mark.parametrize("radiance", [0.0, 1.0])
def test_light_that_is_handed_over_is_light(radiance, mi, folder, log):
    """The shapes are lit by it whatever the scene has; they are black, and that is told, where it is zero."""
    scene = mi.load_dict({"type": "scene", "sensor": camera(mi), "bumpy": shape(mi, folder)})
    lighting = np.zeros((3, 49))
    lighting[:, 0] = radiance
    pixels = picture(mi, scene, integrator=scene_integrator(mi, packed_of(folder), lighting=lighting), spp=1)
    assert bool(pixels.any()) == bool(radiance)
    assert len([text for text in log if "without light" in text]) == (0 if radiance else 1)


def test_remarks_are_heard_where_they_are_not_shown(mi, log):
    level = mi.log_level()
    mi.set_log_level(mi.LogLevel.Error)
    try:
        with heard_remarks(mi) as remarks:
            log_warning(mi, "a sentence")
            mi.Log(mi.LogLevel.Warn, "one of Mitsuba's")
        assert mi.log_level() == mi.LogLevel.Error
    finally:
        mi.set_log_level(level)
    assert remarks == ["a sentence"]
    assert not log
    log_warning(mi, "afterwards")
    assert log == ["slepian_prt: afterwards"]


def test_remarks_follow_the_level_of_the_log(mi, log):
    level = mi.log_level()
    mi.set_log_level(mi.LogLevel.Error)
    log_warning(mi, "not wanted")
    mi.set_log_level(level)
    log_warning(mi, "wanted")
    assert log == ["slepian_prt: wanted"]
    errors = mi.logger().error_level()
    mi.logger().set_error_level(mi.LogLevel.Warn)
    try:
        with pytest.raises(RuntimeError, match="an error here"):
            log_warning(mi, "an error here")
    finally:
        mi.logger().set_error_level(errors)


def test_errors_are_in_the_log(mi, folder, tmp_path, log):
    other = bumpy(2)
    trimesh.Trimesh(other.positions, other.faces, process=False).export(tmp_path / "bumpy.ply")
    with pytest.raises(RuntimeError):
        mi.render(loaded(mi, folder, bumpy=shape(mi, tmp_path)))
    assert [text for text in log if "642 vertices there and 162 in the scene" in text]


def test_ringing_is_told_and_damped(mi, folder, log):
    texels = np.full((64, 128, 3), 1e-4, dtype=np.float32)
    texels[20:22, 30:32] = 500.0
    plain = picture(mi, loaded(mi, folder, envmap(mi, texels), {"hide_emitters": True}))
    assert plain.min() < 0.0
    assert [text for text in log if "negative under this light" in text]
    options = {"hide_emitters": True, "window": "hann", "window_width": 5.0}
    scene = loaded(mi, folder, envmap(mi, texels), options)
    lighting = windowed(project_environment(texels, 6), "hann", 5.0)
    expected = painted(mi, scene, relight(packed_of(folder), lighting))
    assert_same_picture(picture(mi, scene), expected, atol=1e-4 * expected.max())
    for wrong, wanted in [
        ({"window": "box", "window_width": 3.0}, "window must be one of"),
        ({"window": "hann"}, "width of the window must be larger"),
        ({"window_width": 3.0}, "needs a window"),
        ({"transfer": 3}, "must be the path of a file, not 3"),
    ]:
        with pytest.raises(RuntimeError, match=wanted):
            loaded(mi, folder, integrator=wrong)


def test_a_scaled_map_is_refused(mi, folder, log):
    emitter = envmap(mi) | {"to_world": mi.ScalarTransform4f().scale(2.0)}
    with pytest.raises(RuntimeError):
        mi.render(loaded(mi, folder, emitter))
    assert [text for text in log if "to_world scales or shears" in text]


def test_loading_beside_plugins_that_read_files(mi, folder):
    """Scenes load in parallel; the plugin must not disturb what others look for."""
    for _ in range(15):
        scene = loaded(mi, folder, {"type": "sunsky", "sun_direction": [0.4, 0.7, 0.3]})
        assert scene.environment() is not None
        assert "bumpy.prt" in str(scene.integrator())


def test_spectra_are_those_of_the_colour(mi):
    """Linear sRGB of the spectrum, integrated finely, is what it was made of."""
    mi.set_variant(sibling("ad_spectral"))
    weights = smooth_spectra(mi)
    wavelengths = np.arange(360.0, 830.5, 0.5)
    matching = np.array([np.array(part) for part in mi.cie1931_xyz(mi.Float(wavelengths.astype(np.float32)))])
    for colour in ([1.0, 1.0, 1.0], [0.2, 0.9, -0.1], [1.0, 0.0, 0.0]):
        spectrum = weights @ colour @ np.stack(smooth_basis(wavelengths))
        found = np.array(mi.xyz_to_srgb(mi.Color3f(*(matching @ spectrum * 0.5).tolist()))).ravel()
        np.testing.assert_allclose(found, colour, atol=2e-3)


@pytest.mark.parametrize("hide", [True, False])
def test_a_lamp_before_the_model(hide, mi, folder, log):
    """Drawn, or looked through, as `path` does; that the file does not know its light is told."""
    turn = mi.ScalarTransform4f().look_at([0.5, 1.0, 2.0], [1.0, 2.0, 4.0], [0, 1, 0]).scale(0.4)
    emitter = {"type": "area", "radiance": {"type": "rgb", "value": 7.0}}
    lamp = {"type": "rectangle", "to_world": turn, "emitter": emitter}
    scene = loaded(mi, folder, integrator={"hide_emitters": hide}, lamp=lamp)
    ours = picture(mi, scene)
    middle = ours[14:18, 14:18]
    if hide:
        radiance = relight(packed_of(folder), project_environment(sky(), 6))
        expected = painted(mi, loaded(mi, folder), radiance)
        np.testing.assert_allclose(middle, expected[14:18, 14:18], atol=1e-4)
    else:
        np.testing.assert_allclose(middle, 7.0, rtol=1e-5)
    assert [text for text in log if "bumpy.prt does not know the light of lamp" in text]
    theirs = picture(mi, scene, integrator=mi.load_dict({"type": "path", "hide_emitters": hide}), spp=64)
    assert ours[0, 0].any() == theirs[0, 0].any()
