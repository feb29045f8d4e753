"""How opaque pictures of scenes are where light goes straight through, and cameras that are in media."""

import numpy as np
import pytest

from slepian_prt.lighting.environment import make_environment
from slepian_prt.relighting.drawing.render import render_picture
from tests.numerics import assert_rounded
from tests.relighting.drawing.test_scene_pictures import BALL, packed_scene, write_scene

# Beside the ball, looked at from the front: the middle of the picture is a unit square.
LOOK = ((40.0, 0.0, -4.0), (40.0, 0.0, 0.0))
SHEET = (
    '<shape type="{}" id="sheet"><transform name="to_world"><scale value="2"/><translate x="40"/></transform>{}</shape>'
)
FOG = (
    '<medium type="homogeneous" name="{}"><float name="sigma_t" value="{}"/><float name="albedo" value="{}"/></medium>'
)


@pytest.fixture(scope="module")
def ball(tmp_path_factory):
    return packed_scene(write_scene(tmp_path_factory.mktemp("scenes") / "ball.xml", BALL))


@pytest.fixture(scope="module")
def white():
    return make_environment(np.ones((8, 16, 3)), name="white")


def middle(ball, white, path, *shapes, **options):
    """Mean of the middle of a picture of a scene: radiance and opacity."""
    room = write_scene(path, BALL, *shapes)
    asked = {"width": 16, "look_at": LOOK, "fov": 20.0, "spp": 256, "scene_linear": True, **options}
    return render_picture(ball, white, scene=room, **asked)[4:-4, 4:12].mean(axis=(0, 1))


MASK = (
    '<bsdf type="mask"><float name="opacity" value="0.3"/>'
    '<bsdf type="twosided"><bsdf type="diffuse"><rgb name="reflectance" value="1"/></bsdf></bsdf></bsdf>'
)
TINTED = (
    '<bsdf type="thindielectric"><float name="specular_transmittance" value="0.5"/>'
    '<float name="specular_reflectance" value="0"/></bsdf>'
)
GLASS = '<bsdf type="thindielectric"><float name="int_ior" value="1.5"/></bsdf>'


def test_what_lets_light_through_is_not_opaque(ball, white, tmp_path):
    """Under white light from everywhere, all that a surface does not let through it sends back, or swallows."""
    reflected = 2.0 * 0.04 / 1.04  # of a pane of index 1.5, with all its inner reflections, head on; here within 1 %
    for name, bsdf, opacity, sent in [
        ("mask", MASK, 0.3, 0.3),
        ("glass", GLASS, reflected, reflected),
        ("tinted", TINTED, 1.0 - 0.5 * (1.0 - reflected), 0.0),
    ]:
        *radiance, alpha = middle(ball, white, tmp_path / f"{name}.xml", SHEET.format("rectangle", bsdf))
        # 16,384 samples, of deviation .5 at most: four deviations of their mean.
        assert abs(alpha - opacity) < 0.016, name
        assert np.abs(np.array(radiance) - sent).max() < 0.016, name


def test_the_map_is_behind_what_lets_light_through(ball, white, tmp_path):
    shown = middle(ball, white, tmp_path / "a.xml", SHEET.format("rectangle", MASK), background="map")
    np.testing.assert_allclose(shown, 1.0, atol=1e-3)


def test_fog_is_as_opaque_as_it_is_thick(ball, white, tmp_path):
    """A cube four units deep, e^(-4 σ) of which is passed; what scatters is as bright as all around."""
    shape = SHEET.format("cube", '<bsdf type="null"/>' + FOG.format("interior", 0.2, 1.0))
    *radiance, alpha = middle(ball, white, tmp_path / "fog.xml", shape, fov=5.0)
    assert abs(alpha - (1.0 - np.exp(-0.8))) < 0.016
    # Light is looked for and met by chance: of deviation .5 at most.
    np.testing.assert_allclose(radiance, alpha, atol=0.016)


@pytest.mark.parametrize("declared", [True, False])
def test_a_camera_may_be_in_a_medium(declared, ball, white, tmp_path):
    """As the scene says, or where somebody looks from: all is white in fog that absorbs nothing, and opaque by it."""
    camera = (
        '<sensor type="perspective"><float name="fov" value="5"/><transform name="to_world">'
        '<lookat origin="40, 0, -4" target="40, 0, 0" up="0, 1, 0"/></transform>'
        f"{FOG.format('fog', 0.05, 1.0)}</sensor>"
    )
    fog = FOG.format("interior", 0.05, 1.0)
    around = f'<shape type="sphere"><float name="radius" value="60"/><bsdf type="null"/>{fog}</shape>'
    asked = {"look_at": None, "fov": None} if declared else {"look_at": LOOK, "fov": 5.0}
    *radiance, alpha = middle(ball, white, tmp_path / "fog.xml", camera if declared else around, **asked)
    if declared:  # fog that never ends
        assert_rounded(alpha, 1.0, 2)
        return
    ahead = 4.0 + np.sqrt(60.0**2 - 40.0**2)
    # 16,384 samples, of deviation .3: four deviations of their mean. A field of 5 degrees is 0.1 % longer at its sides.
    assert abs(alpha - (1.0 - np.exp(-0.05 * ahead))) < 0.01
    np.testing.assert_allclose(radiance, alpha, atol=0.016)
