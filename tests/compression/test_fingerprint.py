"""Finished work is found again by all that it depends on, whatever the shapes of a scene."""

from types import SimpleNamespace

import numpy as np
import pytest

from slepian_prt.compression.fingerprint import fingerprint, shape_arrays
from slepian_prt.compression.settings import CompressionSettings
from slepian_prt.compression.stream import compress_scene
from slepian_prt.renderer.variants import mitsuba
from slepian_prt.transport.planned import plan_scene
from slepian_prt.transport.settings import TransportSettings

# A hair over a floor, with its middle here or there inside the same box.
HAIR = "-1 1 0 0.05\n0 1 {} 0.05\n0 1 -0.5 0.05\n0 1 0.5 0.05\n1 1 0 0.05\n"


@pytest.fixture
def hair(tmp_path):
    def write(middle: float = 0.2) -> str:
        (tmp_path / "hair.txt").write_text(HAIR.format(middle))
        return str(tmp_path / "hair.txt")

    return write


def digest(mi, **shape) -> bytes:
    arrays = shape_arrays(mi, mi.load_dict(shape))
    assert not [array for array in arrays if array.dtype.hasobject]  # they would be addresses
    return b"".join(array.tobytes() for array in arrays)


@pytest.mark.parametrize("kind", ["bsplinecurve", "linearcurve"])
def test_curves_are_told_apart(kind, hair):
    with mitsuba() as mi:
        first, again, other = (digest(mi, type=kind, filename=hair(middle)) for middle in (0.2, 0.2, 0.3))
    assert first == again
    assert first != other


def test_what_a_material_leaves_unset_does_not_matter(hair):
    """A hair BSDF shows None for the pigments that it is not given, which Mitsuba's own iteration fails at."""
    with mitsuba() as mi:
        plain, pigmented = (
            digest(mi, type="linearcurve", filename=hair(), bsdf={"type": "hair", **more})
            for more in ({}, {"eumelanin": 0.5, "pheomelanin": 0.2})
        )
    assert plain == pigmented


@pytest.mark.parametrize("kind", ["sphere", "cylinder", "disk", "rectangle", "cube"])
def test_shapes_with_a_transform_are_told_apart(kind):
    """Turned by a right angle, in the same box."""
    with mitsuba() as mi:
        turn = mi.ScalarTransform4f().rotate([0, 0, 1], 90.0)
        first, again, other = (digest(mi, type=kind, **more) for more in ({}, {}, {"to_world": turn}))
    assert first == again
    assert first != other


def test_ellipsoids_are_told_apart():
    def ellipsoid(mi, x: float) -> bytes:
        numbers = {"centers": [0, 0, 0], "scales": [1, 1, 1], "quaternions": [x, 0, 0, 1]}
        arrays = {name: mi.TensorXf(np.array([values], dtype=np.float32)) for name, values in numbers.items()}
        return digest(mi, type="ellipsoids", **arrays)

    with mitsuba() as mi:
        assert ellipsoid(mi, 0.0) == ellipsoid(mi, 0.0)
        assert ellipsoid(mi, 0.0) != ellipsoid(mi, 1.0)


def test_a_curve_shades_what_is_lit(tmp_path, hair):
    (tmp_path / "scene.xml").write_text(
        f"""<scene version="3.0.0"><shape type="rectangle"><transform name="to_world"><rotate x="1" angle="-90"/>
        <scale value="2"/></transform><bsdf type="diffuse"/></shape><shape type="bsplinecurve">
        <string name="filename" value="{hair()}"/><bsdf type="conductor"/></shape></scene>"""
    )
    settings = CompressionSettings(tolerance=0.05, clusters=1)
    packed = compress_scene(tmp_path / "scene.xml", settings, TransportSettings(3, 64))
    assert packed.effects[0].name == "shadows"
    assert packed.effects[0].contribution > 0.0


def test_what_instances_are_made_of_counts(tmp_path):
    """A hair in a group, with its middle here or there inside the same box."""
    floor = '<shape type="rectangle"><bsdf type="diffuse"/></shape>'
    curve = '<shape type="bsplinecurve"><string name="filename" value="hair.txt"/></shape>'
    group = f'<shape type="shapegroup" id="g">{curve}</shape><shape type="instance"><ref id="g"/></shape>'
    path = tmp_path / "scene.xml"
    path.write_text(f'<scene version="3.0.0">{floor}{group}</scene>')
    learned = SimpleNamespace(normals=np.zeros(1), clusters=SimpleNamespace(index=np.zeros(1)), pilot=None)
    found = []
    for middle in (0.2, 0.2, 0.3):
        (tmp_path / "hair.txt").write_text(HAIR.format(middle))
        with plan_scene(path, TransportSettings(1, 16)) as planned:
            found.append(fingerprint(planned, SimpleNamespace(learned=learned, bases=[]), []))
    assert found[0] == found[1] != found[2]
