"""What emitters of Mitsuba are called, and what they are set to."""

import gc
from pathlib import Path

import numpy as np
import pytest
import trimesh

from slepian_prt.errors import UserError
from slepian_prt.lighting.lamps import Lamp, lamps_of, scale_lamps
from slepian_prt.renderer.variants import bitmap_module, mitsuba

AREA = '<emitter type="area"><rgb name="radiance" value="1, 2, 3"/></emitter>'


def lamps(content: str, folder: Path) -> list[Lamp]:
    (folder / "lit.xml").write_text(f'<scene version="3.0.0">{content}</scene>')
    with mitsuba() as mi:
        return lamps_of(mi, mi.load_file(str(folder / "lit.xml"), optimize=False), "lit.xml")


def test_names(tmp_path):
    """Ids of emitters and of shapes; kinds where there are none, told apart by numbers."""
    point = '<emitter type="point"><rgb name="intensity" value="1"/></emitter>'
    named = '<emitter type="spot" id="key"><rgb name="intensity" value="1"/></emitter>'
    shapes = f'<shape type="sphere" id="globe">{AREA}</shape><shape type="disk"/><shape type="disk">{AREA}</shape>'
    found = lamps(shapes + point + point + named + '<emitter type="constant"/>', tmp_path)
    assert [lamp.name for lamp in found] == ["globe", "shape_2", "point", "point_2", "key"]
    assert [lamp.kind for lamp in found] == ["area", "area", "point", "point", "spot"]
    assert [lamp.place for lamp in found] == [0, 1, 2, 3, 4]


def test_what_is_emitted(tmp_path):
    """The value, or the mean over what varies: colours of a checkerboard, texels in linear light."""
    texels = np.random.default_rng(0).integers(0, 256, size=(8, 8, 3), dtype=np.uint8)
    bitmap_module().Bitmap(texels).write(str(tmp_path / "texels.png"))
    linear = np.where(texels / 255 <= 0.04045, texels / 255 / 12.92, ((texels / 255 + 0.055) / 1.055) ** 2.4)
    bitmap = '<texture type="bitmap" name="{}"><string name="filename" value="texels.png"/></texture>'
    checks = """<texture type="checkerboard" name="radiance"><rgb name="color0" value="1, 0, 0"/>
    <rgb name="color1" value="0, .5, 0"/></texture>"""
    spot = f'<emitter type="spot"><rgb name="intensity" value="4, 5, 6"/>{bitmap.format("texture")}</emitter>'
    slide = f'<emitter type="projector">{bitmap.format("irradiance")}<float name="scale" value="3"/></emitter>'
    sun = """<emitter type="directional"><vector name="direction" x="0" y="-3" z="4"/>
    <rgb name="irradiance" value="7"/></emitter>"""
    found = lamps(
        f"""<shape type="rectangle">{AREA}</shape>
        <shape type="rectangle"><emitter type="area">{checks}</emitter></shape>
        <shape type="rectangle"><emitter type="area">{bitmap.format("radiance")}</emitter></shape>{spot}{slide}{sun}""",
        tmp_path,
    )
    expected = [[1, 2, 3], [0.5, 0.25, 0], linear.mean(axis=(0, 1)), [4, 5, 6], 3 * linear.mean(axis=(0, 1)), [7, 7, 7]]
    # Textures are averaged at 64² points; Mitsuba interpolates between texels, which are eight to the side.
    for lamp, value, tolerance in zip(found, expected, (1e-6, 1e-6, 0.02, 1e-6, 1e-5, 1e-6), strict=True):
        np.testing.assert_allclose(lamp.emitted, value, rtol=tolerance, atol=1e-7)
    np.testing.assert_allclose(found[-1].direction, [0.0, 0.6, -0.8], atol=1e-6)
    assert not any(lamp.direction.any() for lamp in found[:-1])


def test_a_texture_on_a_mesh_without_coordinates(tmp_path):
    trimesh.creation.icosphere(1).export(tmp_path / "ball.ply")
    bitmap_module().Bitmap(np.ones((2, 2, 3), dtype=np.float32)).write(str(tmp_path / "texels.exr"))
    bad = """<shape type="ply" id="bad"><string name="filename" value="ball.ply"/><emitter type="area">
    <texture type="bitmap" name="radiance"><string name="filename" value="texels.exr"/></texture></emitter></shape>"""
    with pytest.raises(UserError, match=r"^lit\.xml: lamp 'bad' cannot be sampled \(.*\); correct it or remove it$"):
        lamps(bad, tmp_path)
    gc.collect()  # Dr.Jit would look at this emitter with all others as long as it is there


@pytest.mark.parametrize(("value", "problem"), [("-1, 0, 0", "negative"), ("nan", "NaN"), ("1e30", "more than can be")])
def test_what_cannot_be(value, problem, tmp_path):
    bad = f'<emitter type="point" id="bad"><rgb name="intensity" value="{value}"/></emitter>'
    with pytest.raises(UserError, match=rf"^lit\.xml: lamp 'bad': its .*{problem}"):
        lamps(bad, tmp_path)


@pytest.mark.parametrize(
    ("scales", "expected"),
    [
        (0.5, [1.0, 1.0]),
        ({"key": 0.0}, [0.0, 2.0]),
        ({"key": 3.0, "*": 0.25}, [6.0, 0.5]),
        ({"2 other lights": 2.0}, [4.0, 4.0]),
    ],
)
def test_lamps_of_the_scene_are_dimmed_by_name(tmp_path, scales, expected):
    key = '<emitter type="point" id="key"><rgb name="intensity" value="2"/></emitter>'
    other = key.replace(' id="key"', "")
    (tmp_path / "lit.xml").write_text(f'<scene version="3.0.0">{key}{other}</scene>')
    with mitsuba() as mi:
        loaded = mi.load_file(str(tmp_path / "lit.xml"), optimize=False)
        scale_lamps(mi, loaded, scales)
        found = [float(np.ravel(mi.traverse(lamp)["intensity.value"])[0]) for lamp in loaded.emitters()]
    np.testing.assert_allclose(found, expected, rtol=1e-6)
