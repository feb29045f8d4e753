"""Direct light of Mitsuba's emitters at receivers, against closed forms."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from slepian_prt.scene.loading import open_scene
from slepian_prt.scene.scene import Scene
from slepian_prt.transport.lamp_light import LampTracer
from slepian_prt.transport.lamps import Lamps, find_lamps
from tests.numerics import assert_exact

FLOOR = """<shape type="obj" id="floor"><string name="filename" value="floor.obj"/><bsdf type="diffuse"/></shape>"""
EPSILON = float(np.finfo(np.float32).eps)


def plane(places: np.ndarray) -> str:
    """An .obj of small triangles facing up, one about each of ``places`` (n, 2) of the plane z = 0."""
    corners = 1e-3 * np.array([[1.0, 0.0], [-0.5, 0.75**0.5], [-0.5, -(0.75**0.5)]])
    points = (places[:, None] + corners).reshape(-1, 2)
    lines = [f"v {x:.9g} {y:.9g} 0" for x, y in points]
    return "\n".join([*lines, *(f"f {3 * i + 1} {3 * i + 2} {3 * i + 3}" for i in range(len(places)))])


@contextmanager
def opened(folder: Path, lamps: str, places: np.ndarray | None = None) -> Iterator[tuple[Scene, Lamps]]:
    """A floor of receivers with lamps above it."""
    if places is None:
        places = np.random.default_rng(0).uniform(-1.0, 1.0, size=(100, 2))
    (folder / "floor.obj").write_text(plane(places))
    (folder / "lit.xml").write_text(f'<scene version="3.0.0">{FLOOR}{lamps}</scene>')
    with open_scene(folder / "lit.xml") as scene:
        yield scene, find_lamps(scene, 0)


def light_on_floor(scene: Scene, lamps: Lamps, samples: int = 1024) -> tuple[np.ndarray, np.ndarray, float, float]:
    """Positions (V, 3), radiance (n, V, 3), told relative noise over all, and how high rays start."""
    part = next(part for part in scene.parts if part.name == "floor")
    vertices = np.arange(part.first, part.end)
    found = LampTracer(scene, lamps.groups, samples, 0).trace(vertices, shadows=True)
    noise = math.sqrt(found.squared_noise.sum() / (found.radiance.astype(np.float64) ** 2).sum())
    height = float(np.abs(scene.ray_origins.front - scene.traced_positions)[vertices].max())
    return scene.mesh.positions[vertices], found.radiance, noise, height


def polygon_form_factor(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Lambert's formula: the part of the light of a hemisphere about z that a polygon above z = 0 sends to points.

    E / (π L) = Σ θ_i γ_i·n / 2π over its edges, with θ_i the angle that an edge spans and γ_i the normal of its fan
    (Lambert 1760; Baum et al. 1989, eq. 5). Corners counter-clockwise from the points.
    """
    total = np.zeros(len(points))
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        u, v = a - points, b - points
        cross = np.cross(u, v)
        length = np.linalg.norm(cross, axis=1)
        angle = np.arctan2(length, np.einsum("ij,ij->i", u, v))
        total += angle * cross[:, 2] / length
    return np.abs(total) / (2.0 * math.pi)


def point(name: str, place: tuple[float, float, float], intensity: object) -> str:
    """A lamp that is a point."""
    x, y, z = place
    return f"""<emitter type="point" id="{name}"><point name="position" x="{x}" y="{y}" z="{z}"/>
    <rgb name="intensity" value="{intensity}"/></emitter>"""


def relative_rms(actual: np.ndarray, expected: np.ndarray) -> float:
    return float(np.linalg.norm(actual - expected) / np.linalg.norm(expected))


def test_point(tmp_path):
    """I cos θ / (π r²), but for the height that rays start at."""
    lamp = point("p", (0.3, -0.2, 0.8), "1, 2, 4")
    with opened(tmp_path, lamp) as (scene, lamps):
        assert (lamps.names, lamps.kinds) == (("p",), ("point",))
        x, light, _, height = light_on_floor(scene, lamps)
    way = np.array([0.3, -0.2, 0.8]) - x
    r = np.linalg.norm(way, axis=1)
    expected = (way[:, 2] / r**3 / math.pi)[:, None] * [1.0, 2.0, 4.0]
    np.testing.assert_allclose(light[0], expected, rtol=4.0 * height / r.min() + 20.0 * EPSILON)


def test_directional(tmp_path):
    lamp = """<emitter type="directional" id="sun"><vector name="direction" x="1" y="2" z="-2"/>
    <rgb name="irradiance" value="3"/></emitter>"""
    with opened(tmp_path, lamp) as (scene, lamps):
        _, light, _, _ = light_on_floor(scene, lamps)
    np.testing.assert_allclose(light[0], 3.0 * (2.0 / 3.0) / math.pi, rtol=10.0 * EPSILON)
    np.testing.assert_allclose(lamps.directions, [[-1 / 3, -2 / 3, 2 / 3]], atol=4.0 * EPSILON)
    np.testing.assert_allclose(lamps.emitted, [[3.0, 3.0, 3.0]], rtol=EPSILON)


def test_spot(tmp_path):
    """Full in the beam, falling linearly in the angle to the cutoff."""
    lamp = """<emitter type="spot" id="s"><rgb name="intensity" value="2"/><float name="cutoff_angle" value="40"/>
    <float name="beam_width" value="20"/><transform name="to_world"><lookat origin="0,0,1" target="0,0,0" up="0,1,0"/>
    </transform></emitter>"""
    with opened(tmp_path, lamp) as (scene, lamps):
        x, light, _, height = light_on_floor(scene, lamps)
    r = np.linalg.norm(x - [0.0, 0.0, 1.0], axis=1)
    profile = np.clip((40.0 - np.degrees(np.arccos(1.0 / r))) / 20.0, 0.0, 1.0)
    assert np.ptp(profile) == 1.0
    # The arc cosine loses half of the digits, of an angle of which 20 degrees are one.
    np.testing.assert_allclose(light[0, :, 0], 2.0 * profile / r**3 / math.pi, atol=4.0 * (height + EPSILON**0.5))


def sphere_light(x: np.ndarray) -> np.ndarray:
    """L sin²(angle) cos θ of a ball that is above the horizon."""
    way = np.array([0.2, 0.1, 0.9]) - x
    squared = np.sum(way * way, axis=1)
    return 0.25 / squared * way[:, 2] / np.sqrt(squared)


def disk_light(x: np.ndarray) -> np.ndarray:
    """Of a disk parallel to the floor (Howell, A Catalog of Radiation Heat Transfer Configuration Factors, B-12)."""
    a, h, r = np.sum(x[:, :2] ** 2, axis=1), 0.7, 0.6
    return 0.5 * (1.0 - (a + h * h - r * r) / np.sqrt((a + h * h + r * r) ** 2 - 4.0 * r * r * a))


def wall_light(x: np.ndarray) -> np.ndarray:
    """Of a wall that stands on the floor, a hand's breadth from some of the receivers."""
    return polygon_form_factor(x, np.array([[-1.01, -1, 0], [-1.01, 1, 0], [-1.01, 1, 2], [-1.01, -1, 2]], dtype=float))


def tiled_light(x: np.ndarray) -> np.ndarray:
    """Of a checkerboard of four squares above."""
    return sum(
        value * polygon_form_factor(x, np.array([[u, v, 0.8], [u + 1, v, 0.8], [u + 1, v + 1, 0.8], [u, v + 1, 0.8]]))
        for u, v, value in ((-1.0, -1.0, 0.25), (0.0, 0.0, 0.25), (-1.0, 0.0, 0.75), (0.0, -1.0, 0.75))
    )


def block_light(x: np.ndarray) -> np.ndarray:
    """Of a block of half-width 0.3 about (0, 0, 1): what its faces send that a point is in front of."""
    total = np.zeros(len(x))
    for axis in range(3):
        for side in (-1.0, 1.0):
            normal = np.eye(3)[axis] * side
            first, second = np.eye(3)[(axis + 1) % 3], np.eye(3)[(axis + 2) % 3]
            center = np.array([0.0, 0.0, 1.0]) + 0.3 * normal
            corners = np.stack(
                [center + 0.3 * (i * first + j * second) for i, j in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
            )
            before = (x - center) @ normal > 0.0
            total[before] += polygon_form_factor(x[before], corners)
    return total


AREA = '<emitter type="area"><rgb name="radiance" value="1"/></emitter>'
SURFACES: dict[str, tuple[str, Any]] = {
    "sphere": (
        f"""<shape type="sphere" id="lamp"><point name="center" x=".2" y=".1" z=".9"/>
        <float name="radius" value=".5"/>{AREA}</shape>""",
        sphere_light,
    ),
    "disk": (
        f"""<shape type="disk" id="lamp"><transform name="to_world"><scale value=".6"/><rotate x="1" angle="180"/>
        <translate z=".7"/></transform>{AREA}</shape>""",
        disk_light,
    ),
    "rectangle": (
        f"""<shape type="rectangle" id="lamp"><transform name="to_world"><rotate y="1" angle="90"/>
        <translate x="-1.01" z="1"/></transform>{AREA}</shape>""",
        wall_light,
    ),
    "textured": (
        """<shape type="rectangle" id="lamp"><transform name="to_world"><rotate x="1" angle="180"/><translate z=".8"/>
        </transform><emitter type="area"><texture type="checkerboard" name="radiance"><rgb name="color0" value=".75"/>
        <rgb name="color1" value=".25"/></texture></emitter></shape>""",
        tiled_light,
    ),
    "mesh": (
        f"""<shape type="cube" id="lamp"><transform name="to_world"><scale value=".3"/><translate z="1"/></transform>
        {AREA}</shape>""",
        block_light,
    ),
}


@pytest.mark.parametrize("kind", SURFACES)
def test_surfaces(kind, tmp_path):
    """The error is the noise that is told, near large lamps too, and small."""
    shape, closed_form = SURFACES[kind]
    with opened(tmp_path, shape) as (scene, lamps):
        assert (lamps.names, lamps.kinds) == (("lamp",), ("area",))
        x, light, noise, height = light_on_floor(scene, lamps)
    expected = closed_form(x)
    # Beside noise there is the height that rays start at, which near the wall is much of the distance.
    assert relative_rms(light[0, :, 0], expected) < 1.3 * noise + 4.0 * height
    assert noise < 0.02
    near = expected > np.quantile(expected, 0.9)
    assert relative_rms(light[0, near, 0], expected[near]) < 0.03
    np.testing.assert_allclose(light[0].mean(), expected.mean(), rtol=4.0 * noise / math.sqrt(len(x)) + 4.0 * height)


def test_a_sphere_that_shines_inward_is_a_sky(tmp_path):
    """What is in it receives its radiance from all sides; no chord of its faces stands before it."""
    shape = f"""<shape type="sphere" id="dome"><float name="radius" value="3"/>
    <boolean name="flip_normals" value="true"/>{AREA}</shape>"""
    with opened(tmp_path, shape) as (scene, lamps):
        _, light, noise, _ = light_on_floor(scene, lamps)
    np.testing.assert_allclose(light[0].mean(), 1.0, rtol=4.0 * noise / math.sqrt(light.shape[1]))
    assert noise < 0.01


def test_shadows_are_sharp(tmp_path):
    """A square under a point halfway above the floor casts one twice as large."""
    lid = """<shape type="rectangle" id="lid"><transform name="to_world"><scale value=".2"/><translate z=".5"/>
    </transform><bsdf type="twosided"><bsdf type="diffuse"/></bsdf></shape>"""
    with opened(tmp_path, point("p", (0.0, 0.0, 1.0), 1.0) + lid) as (scene, lamps):
        x, light, _, _ = light_on_floor(scene, lamps)
        vertices = np.arange(len(x))
        open_light = LampTracer(scene, lamps.groups, 16, 0).trace(vertices, shadows=False).radiance
    inside = np.abs(x[:, :2]).max(axis=1)
    clear = np.abs(inside - 0.4) > 2e-3
    assert np.all((light[0, clear, 0] > 0.0) == (inside[clear] > 0.4))
    assert np.all(open_light > 0.0)
    assert 0 < np.sum(inside < 0.4) < len(x)


def test_the_same_seed_gives_the_same_bits(tmp_path):
    with opened(tmp_path, SURFACES["disk"][0]) as (scene, lamps):
        vertices = np.flatnonzero(scene.receivers.active)
        runs = [LampTracer(scene, lamps.groups, 64, 3).trace(vertices, shadows=True).radiance for _ in range(2)]
        some = LampTracer(scene, lamps.groups, 64, 3).trace(vertices[5:50], shadows=True).radiance
    assert_exact(runs[0], runs[1], "the same rays, summed in the same order")
    assert_exact(some, runs[0][:, 5:50], "a receiver's samples do not depend on which others are asked for")


def test_many_lamps_are_joined(tmp_path):
    """The brightest fifteen by their own; the others as one, with all their light."""
    rng = np.random.default_rng(1)
    places, powers = rng.uniform([-1, -1, 0.8], [1, 1, 1.2], size=(24, 3)), np.geomspace(1.0, 0.02, 24)
    lamps_text = "".join(point(f"p{i}", tuple(places[i]), powers[i]) for i in range(24))
    with opened(tmp_path, lamps_text) as (scene, lamps):
        assert len(lamps.names) == 16
        assert lamps.names[-1] == "9 other lights"
        assert lamps.kinds == ("point",) * 16
        x, light, _, _ = light_on_floor(scene, lamps, 4096)
    np.testing.assert_allclose(lamps.reached, light.mean(axis=(1, 2)), rtol=0.3)  # of a pilot
    kept = [int(name[1:]) for name in lamps.names[:-1]]
    assert set(range(8)) <= set(kept)
    way = places[:, None] - x
    r = np.linalg.norm(way, axis=2)
    each = powers[:, None] * way[:, :, 2] / r**3 / math.pi
    np.testing.assert_allclose(light[:-1, :, 0], each[kept], rtol=1e-3)
    others = np.delete(each, kept, axis=0).sum(axis=0)
    # Nine lamps, chosen by their light in the mean: at a receiver their ratios differ by less than about four.
    np.testing.assert_allclose(light[-1, :, 0], others, rtol=4.0 / math.sqrt(2048))
    np.testing.assert_allclose(light[-1, :, 0].mean(), others.mean(), rtol=4.0 / math.sqrt(2048 * 300))
