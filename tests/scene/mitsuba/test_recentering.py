"""Scenes far from the origin: everything stands where it would stand near it."""

import numpy as np
import pytest
import trimesh

from slepian_prt.paths.media import media_of
from slepian_prt.renderer.variants import mitsuba
from slepian_prt.scene.loading import open_scene
from slepian_prt.scene.mitsuba.files import load_xml
from slepian_prt.scene.mitsuba.recentering import coarse_receivers
from slepian_prt.scene.receivers import Receivers
from tests.numerics import assert_exact

FAR = np.array([500000.0, 100.0, 5400000.0])
NEAR = np.zeros(3)
FILM = '<film type="hdrfilm"><integer name="width" value="1"/><integer name="height" value="1"/></film>'


def point(name: str, at, kind: str = "point") -> str:
    x, y, z = (f"{value:.17g}" for value in at)
    return f'<{kind} name="{name}" x="{x}" y="{y}" z="{z}"/>'


def moved(at) -> str:
    x, y, z = (f"{value:.17g}" for value in at)
    return f'<transform name="to_world"><translate x="{x}" y="{y}" z="{z}"/></transform>'


def looking(origin, target) -> str:
    a, b = (", ".join(f"{value:.17g}" for value in at) for at in (origin, target))
    return f'<transform name="to_world"><lookat origin="{a}" target="{b}" up="0, 0, 1"/></transform>'


GRAY = '<bsdf type="diffuse"/>'

# Beside a floor of 8 x 8; what each of them adds to the scene, given where the middle of the floor is.
THINGS = {
    "sphere": lambda o: f'<shape type="sphere">{point("center", o + [1, 0, 2.25])}{GRAY}</shape>',
    "sphere with both": lambda o: (
        f'<shape type="sphere">{point("center", [1, 0, 0.25])}{moved(o + [0, 0, 2])}{GRAY}</shape>'
    ),
    "cylinder": lambda o: (
        f'<shape type="cylinder">{point("p0", o)}{point("p1", o + [0, 1, 2])}'
        f'<float name="radius" value=".5"/>{GRAY}</shape>'
    ),
    "rectangle": lambda o: f'<shape type="rectangle">{moved(o + [0, 1, 0.5])}{GRAY}</shape>',
    "disk": lambda o: f'<shape type="disk">{moved(o + [0, 1, 0.5])}{GRAY}</shape>',
    "cube": lambda o: f'<shape type="cube">{moved(o + [0, 1, 0.5])}{GRAY}</shape>',
    "mesh": lambda o: (
        f'<shape type="ply"><string name="filename" value="ball.ply"/>{moved(o + [0, 1, 0.5])}{GRAY}</shape>'
    ),
    "merged": lambda o: (
        f'<shape type="merge"><shape type="ply"><string name="filename" value="ball.ply"/>{moved(o + [0, 1, 0.5])}'
        f"{GRAY}</shape></shape>"
    ),
    "instance": lambda o: (
        f'<shape type="shapegroup" id="g"><shape type="ply"><string name="filename" value="ball.ply"/>{GRAY}</shape>'
        f'</shape><shape type="instance"><ref id="g"/>{moved(o + [0, 0, 2])}</shape>'
    ),
    "occluder": lambda o: f'<shape type="sphere">{point("center", o + [0, 0, 2])}<bsdf type="conductor"/></shape>',
    "area light": lambda o: f'<shape type="rectangle">{moved(o + [0, 0, 3])}{GRAY}<emitter type="area"/></shape>',
    "point light": lambda o: f'<emitter type="point">{point("position", o + [0, 0, 3])}</emitter>',
    "spot light": lambda o: f'<emitter type="spot">{looking(o + [0, 1, 3], o)}</emitter>',
    "directional light": lambda o: f'<emitter type="directional">{point("direction", [0, 0, -1], "vector")}</emitter>',
    "turned light": lambda o: f'<emitter type="directional">{looking([0, 1, 3], [0, 0, 0])}</emitter>',
    "far camera": lambda o: f'<sensor type="distant">{point("direction", [0, 0, -1], "vector")}{FILM}</sensor>',
    "radiance meter": lambda o: (
        f'<sensor type="radiancemeter">{point("origin", o + [0, 0, 4])}{point("direction", [0, 0, -1], "vector")}{FILM}'
        "</sensor>"
    ),
    "included": lambda o: '<include filename="part.xml"/>',
    "by reference": lambda o: f'<bsdf type="diffuse" id="m"/><shape type="disk">{moved(o)}<ref id="m"/></shape>',
}


def write(folder, content: str, at):
    trimesh.creation.icosphere(1).export(folder / "ball.ply")
    disk = f'<shape type="disk">{moved(at + [0, 0, 1])}{GRAY}</shape>'
    (folder / "part.xml").write_text(f'<scene version="3.0.0">{disk}</scene>')
    x, y, z = (f"{value:.17g}" for value in at)
    floor = (
        f'<shape type="rectangle" id="floor"><transform name="to_world"><scale value="4"/>'
        f'<translate x="{x}" y="{y}" z="{z}"/></transform>{GRAY}</shape>'
    )
    path = folder / "scene.xml"
    path.write_text(f'<scene version="3.0.0">{floor}{content}</scene>')
    return path


@pytest.mark.parametrize("name", THINGS)
def test_everything_is_moved_as_one(name, tmp_path):
    boxes, positions = [], []
    for at in (NEAR, FAR):
        with open_scene(write(tmp_path, THINGS[name](at), at)) as scene:
            low, high = scene.traced_bounds
            boxes.append(np.array([low, high]) + scene.origin - at)
            positions.append(scene.mesh.positions - at)
            if at is NEAR:
                assert_exact(scene.origin, NEAR, "not moved")
            else:
                assert np.linalg.norm(scene.origin - FAR) < 8.0
                np.testing.assert_allclose(scene.origin, np.round(scene.origin))
    # Positions of a few units, in float32; and twice float64 at five million.
    np.testing.assert_allclose(boxes[1], boxes[0], atol=2e-6)
    np.testing.assert_allclose(positions[1], positions[0], atol=2e-6)


def test_cameras_stand_in_the_world(tmp_path):
    camera = f'<sensor type="perspective">{looking(FAR + [0, -9, 1.25], FAR)}</sensor>'
    with open_scene(write(tmp_path, camera, FAR)) as scene:
        np.testing.assert_allclose(np.array(scene.view.to_world)[:3, 3], FAR + [0, -9, 1.25], atol=1e-6)
    with open_scene(write(tmp_path, camera.replace("perspective", "orthographic"), FAR)) as scene:
        matrix = np.array(scene.sensor.world_transform().matrix).reshape(4, 4)
        np.testing.assert_allclose(matrix[:3, 3] + scene.origin, FAR + [0, -9, 1.25], atol=1e-5)


def test_smoke_is_where_its_shape_is(tmp_path):
    """A grid between the corners of two unit cubes, whose medium is shared."""
    with mitsuba() as mi:
        mi.VolumeGrid(np.ones((2, 2, 2, 1), dtype=np.float32)).write(str(tmp_path / "smoke.vol"))
    cubes = "".join(
        f'<shape type="cube">{moved(FAR + [0, 0, z])}<bsdf type="null"/><ref id="smoke" name="interior"/></shape>'
        for z in (1.0, 3.0)
    )
    smoke = (
        '<medium type="heterogeneous" id="smoke"><volume type="gridvolume" name="sigma_t">'
        f'<string name="filename" value="smoke.vol"/>{moved(FAR)}</volume></medium>'
    )
    with mitsuba() as mi:
        scene, middle = load_xml(mi, write(tmp_path, smoke + cubes, FAR))
        smoke = media_of(mi, scene)[0]
        origin = mi.Point3f(*(FAR - middle + [-3.0, 0.5, 0.5]).tolist())
        _, begin, end = smoke.intersect_aabb(mi.Ray3f(origin, mi.Vector3f(1, 0, 0)))
        np.testing.assert_allclose([begin[0], end[0]], [3.0, 4.0], rtol=1e-6)


@pytest.mark.parametrize(
    "light",
    [
        '<emitter type="constant"/>',
        '<emitter type="envmap"><string name="filename" value="map.exr"/></emitter>',
        '<emitter type="envmap"><string name="filename" value="map.exr"/><transform name="to_world">'
        '<rotate y="1" angle="70"/></transform></emitter>',
        '<emitter type="sunsky"><transform name="to_world"><rotate x="1" angle="90"/></transform></emitter>',
    ],
    ids=["constant", "envmap", "turned envmap", "turned sunsky"],
)
def test_distant_light_is_the_same(light, tmp_path, rng):
    with mitsuba() as mi:
        mi.Bitmap(rng.random((8, 16, 3)).astype(np.float32)).write(str(tmp_path / "map.exr"))
    found = []
    for at in (NEAR, FAR):
        with open_scene(write(tmp_path, light, at)) as scene:
            found.append(scene.environment)
    assert_exact(found[1].texels, found[0].texels, "the same file, read in the same way")
    assert_exact(found[1].to_world, found[0].to_world, "not moved")


@pytest.mark.parametrize("diagonals", [15.0, 17.0])
def test_only_scenes_far_for_their_size_are_moved(diagonals, tmp_path):
    """The floor has a diagonal of 8 √2."""
    at = np.array([diagonals * 8.0 * np.sqrt(2.0), 0.0, 0.0])
    with open_scene(write(tmp_path, "", at)) as scene:
        assert (np.linalg.norm(scene.origin) > 0.0) == (diagonals > 16.0)
        np.testing.assert_allclose(scene.mesh.positions.mean(axis=0), at, atol=2e-5)  # float32 at 200


# --- What is too coarse all the same ---------------------------------------------------------------------------------


def receivers(positions, pairs, *, active=None) -> Receivers:
    normals = np.tile([0.0, 0.0, 1.0], (len(positions), 1))
    if active is not None:
        normals[~np.asarray(active)] = 0.0
    return Receivers(np.asarray(positions), normals, np.ones((len(positions), 3), np.float32), np.array(pairs))


def test_coarse_receivers_are_counted_by_piece():
    """At 2^20 float32 has steps of 1/8: too coarse for a piece of size 1, not for one of size 1,000."""
    near, far = [[0, 0, 0], [1, 0, 0]], [[2.0**20, 0, 0], [2.0**20 + 1, 0, 0]]
    large = [[2.0**20, 9, 0], [2.0**20 - 1000, 9, 0]]
    positions = np.array(near + far + large)
    count, step = coarse_receivers(positions, receivers(positions, [[0, 1], [2, 3], [4, 5]]))
    assert (count, step) == (2, 0.125)
    idle = receivers(positions, [[0, 1], [2, 3], [4, 5]], active=[True, True, True, False, True, True])
    assert coarse_receivers(positions, idle) == (1, 0.125)


def test_a_vertex_alone_is_no_coarse_piece():
    """As one side of faces whose normals differ at every corner has them."""
    positions = np.array([[0.0, 0, 0], [1, 0, 0], [1000.0, 2, 3]])
    assert coarse_receivers(positions, receivers(positions, [[0, 1]])) == (0, 0.0)


def test_nothing_coarse():
    positions = np.array([[0.0, 0, 0], [1, 0, 0]])
    assert coarse_receivers(positions, receivers(positions, [[0, 1]])) == (0, 0.0)
