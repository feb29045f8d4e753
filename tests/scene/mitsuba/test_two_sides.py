"""Both sides of surfaces that are seen from behind, and which these are."""

import math
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from slepian_prt.scene.loading import open_scene
from slepian_prt.scene.mesh import make_mesh
from slepian_prt.transport.interior import sees_backs
from slepian_prt.transport.interreflection import gather_operator
from slepian_prt.transport.survey import Survey
from slepian_prt.transport.transfer import precompute
from tests.numerics import assert_exact, assert_rounded
from tests.transport.test_interreflection import spherical_bowl

AMBIENT = math.sqrt(4.0 * math.pi)
WHITE = '<bsdf type="twosided"><bsdf type="diffuse"><rgb name="reflectance" value="0.5"/></bsdf></bsdf>'
CAMERA = (
    '<sensor type="perspective"><transform name="to_world"><lookat origin="{}" target="0,0,0.1" up="0,1,0"/>'
    "</transform></sensor>"
)
BALL = f'<shape type="sphere" id="ball">{WHITE}</shape>'
OTHER = f'<shape type="sphere"><point name="center" x="{{}}" y="0" z="0"/>{WHITE}</shape>'
FLOOR = f'<shape type="rectangle"><transform name="to_world"><scale value="3"/></transform>{WHITE}</shape>'
LAMP = '<shape type="disk"><transform name="to_world"><scale value="0.4"/></transform><emitter type="area"/></shape>'
GLASS = '<shape type="sphere"><float name="radius" value="0.2"/><bsdf type="dielectric"/></shape>'
POINT = '<emitter type="point"><point name="position" x="0.2" y="0" z="0"/></emitter>'
ONE_SIDED = '<bsdf type="diffuse"/>'


def write(folder, body: str):
    path = folder / "scene.xml"
    path.write_text(f'<scene version="3.0.0">{body}</scene>')
    return path


def test_backs_come_after_fronts(tmp_path):
    other = '<bsdf type="diffuse"><rgb name="reflectance" value="0.1, 0.2, 0.3"/></bsdf>'
    material = f'<bsdf type="twosided"><bsdf type="diffuse"/>{other}</bsdf>'
    body = f'<shape type="disk" id="d">{material}</shape>{OTHER.format(9)}'
    with open_scene(write(tmp_path, body)) as scene:
        disk, ball = scene.parts
        assert (disk.sides, ball.sides) == (2, 1)
        assert (disk.first, disk.end, ball.first) == (0, 2 * disk.count, 2 * disk.count)
        mesh, n = scene.mesh, disk.count
        assert ball.end == len(mesh.positions)
        assert_exact(mesh.positions[n : 2 * n], mesh.positions[:n], "copies")
        assert_exact(mesh.normals[n : 2 * n], -mesh.normals[:n], "copies")
        of_disk = mesh.faces[mesh.faces.max(axis=1) < 2 * n]
        half = len(of_disk) // 2
        assert_exact(of_disk[half:, ::-1] - n, of_disk[:half], "indices")
        assert_rounded(mesh.albedo[:n], np.full((n, 3), 0.5, dtype=np.float32), 4)
        assert_rounded(mesh.albedo[n : 2 * n], np.tile(np.float32([0.1, 0.2, 0.3]), (n, 1)), 4)
        # The geometry stays one surface.
        assert len(scene.faces) == half + (mesh.faces.min(axis=1) >= ball.first).sum()
        assert_exact(scene.faces_behind[:half], scene.faces[:half] + n, "indices")
        assert (scene.faces_behind[half:] == -1).all()
        assert_exact(scene.fronts, np.r_[0:n, 0:n, 2 * n : ball.end], "indices")


def test_light_inside_a_bowl_has_a_closed_form(tmp_path):
    """Of a part f of a sphere, seen from inside: (1 - f) of the light comes directly, in all (1 - f) / (1 - ρ f)."""
    bowl = spherical_bowl(0.5, 24)
    outward = trimesh.Trimesh(bowl.positions, bowl.faces[:, ::-1], vertex_normals=-bowl.normals, process=False)
    outward.export(tmp_path / "bowl.ply", vertex_normal=True)
    body = f'<shape type="ply"><string name="filename" value="bowl.ply"/>{WHITE}</shape>'
    transfer = precompute(write(tmp_path, body), 0, 256)
    (part,) = transfer.parts
    assert part.sides == 2
    light = transfer.vectors[:, 0, 0] * AMBIENT
    inner = transfer.positions[part.first + part.count : part.end, 2] < -0.1  # at the rim chords cut something off
    # Chords of 24 rings: their own area is (π/48)² too small; 64 rays gather.
    np.testing.assert_allclose(light[part.count :][inner], 0.5 / (1.0 - 0.5 * 0.5), rtol=0.02)
    np.testing.assert_allclose(light[: part.count], 1.0, rtol=0.01)
    assert not any("backs" in effect.name for effect in transfer.effects)


@pytest.mark.parametrize(
    ("body", "sides"),
    [
        (BALL, 1),
        (BALL + OTHER.format(1.2), 1),
        (BALL + FLOOR, 1),
        (BALL + GLASS, 2),
        (BALL + LAMP, 2),
        (BALL + CAMERA.format("0.3,0,0"), 2),
        (BALL + CAMERA.format("3,0,0"), 1),
        (BALL + POINT, 2),
        (BALL.replace(WHITE, ONE_SIDED) + POINT, 1),
    ],
    ids=[
        "alone",
        "sunk in another",
        "cut by a floor",
        "glass inside",
        "lamp inside",
        "camera inside",
        "camera outside",
        "point light inside",
        "one-sided",
    ],
)
def test_which_backs_are_seen(body, sides, tmp_path):
    with open_scene(write(tmp_path, body)) as scene:
        assert scene.parts[0].name == "ball"
        assert scene.parts[0].sides == sides


@pytest.mark.parametrize("scale", [1e-4, 1e4])
def test_of_any_size(scale, tmp_path):
    placed = '<shape type="{}"><transform name="to_world"><scale value="{}"/><translate x="{}"/></transform>{}</shape>'
    body = placed.format("sphere", scale, 0, WHITE) + placed.format("disk", scale, 3 * scale, WHITE)
    with open_scene(write(tmp_path, body)) as scene:
        assert [part.sides for part in scene.parts] == [1, 2]


def test_toward_a_camera_fronts_alone(tmp_path):
    body = f'<shape type="disk">{WHITE}</shape>{CAMERA.format("0,0,4")}'
    with open_scene(write(tmp_path, body), view=0) as scene:
        assert scene.parts[0].sides == 1


@pytest.fixture
def tube(tmp_path):
    """A tube around a small ball, both open to all sides."""
    ends = '<point name="p0" x="0" y="0" z="-2"/><point name="p1" x="0" y="0" z="2"/>'
    body = f'<shape type="cylinder" id="tube">{ends}{{}}</shape><shape type="sphere" id="ball">'
    body += f'<float name="radius" value="0.3"/>{WHITE}</shape>'
    return lambda material: write(tmp_path, body.format(material))


def test_held_backs_close_nothing_in(tube):
    """What is inside a tube of which both sides are lit is not inside a solid."""
    for material, hidden in ((WHITE, False), (ONE_SIDED, True)):
        with open_scene(tube(material)) as scene:
            ball = scene.parts[1]
            middle = ball.first + np.flatnonzero(np.abs(scene.receivers.normals[ball.first : ball.end, 2]) < 0.1)
            assert sees_backs(scene, middle).all() == hidden
            assert scene.parts[0].sides == 1 + (not hidden)


def test_rays_gather_from_backs(tube):
    """The ball sees the vertices of the back of the tube, those beside it and no others; none is left out."""
    with open_scene(tube(WHITE)) as scene:
        wall, ball = scene.parts
        vertices = ball.first + np.flatnonzero(np.abs(scene.receivers.normals[ball.first : ball.end, 2]) < 0.05)
        gather = gather_operator(scene, 128, vertices, None, 0)
        assert gather.backs == 0.0
        seen = gather.weights.sum(axis=0)
        assert seen[wall.first : wall.first + wall.count].sum() == 0.0
        behind = slice(wall.first + wall.count, wall.end)
        toward = -np.einsum("ij,ij->i", scene.receivers.normals[behind], scene.receivers.positions[behind])
        assert seen[behind].sum() > 0.5 * len(vertices)
        assert (toward > 0.0).all()  # the backs look to the axis
    with open_scene(tube(ONE_SIDED)) as scene:  # which a one-sided tube does not light
        gather = gather_operator(scene, 128, vertices - wall.count, None, 0)
        assert gather.backs == 0.0
        assert gather.weights.sum() == 0.0


def test_backs_that_are_not_held_are_told_of():
    """Of a mesh file fronts alone are lit: a floor sees the back of the ceiling, whose front is up too."""
    square = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
    faces = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])
    mesh = make_mesh(np.concatenate([square, square + [0.0, 0.0, 1.0]]), faces, albedo=0.5)
    told = []
    for known in (True, False):
        with open_scene(replace(mesh, known_albedo=known)) as scene:
            plan = Survey.of(scene).plan(1, 64, effects="all")
        told.append([effect.name for effect in plan.effects if "backs" in effect.name])
    assert told == [["light reflected by the backs of surfaces"], []]


def test_rays_start_behind_as_from_the_sheet_turned_round(tmp_path):
    """Of a crumpled sheet, whose faces hide each other: that it lies between its two sides is no contact."""
    rng = np.random.default_rng(4)
    x, y = (axis.ravel() for axis in np.meshgrid(np.linspace(0, 1, 40), np.linspace(0, 1, 40), indexing="ij"))
    positions = np.column_stack([x, y, rng.uniform(-0.04, 0.04, x.size)])
    place = np.arange(x.size).reshape(40, 40)
    a, b, c, d = (corner.ravel() for corner in (place[:-1, :-1], place[1:, :-1], place[1:, 1:], place[:-1, 1:]))
    faces = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    for name, wound in (("sheet", faces), ("turned", faces[:, ::-1])):
        normals = make_mesh(positions, wound).normals
        trimesh.Trimesh(positions, wound, vertex_normals=normals, process=False).export(
            tmp_path / f"{name}.ply", vertex_normal=True
        )
    shape = '<shape type="ply"><string name="filename" value="{}.ply"/>{}</shape>'
    with open_scene(write(tmp_path, shape.format("sheet", WHITE))) as scene:
        (part,) = scene.parts
        assert part.sides == 2
        behind = scene.ray_origins.front[part.count :]
        hidden = scene.is_hidden[part.count :]
    with open_scene(write(tmp_path, shape.format("turned", ONE_SIDED))) as scene:
        assert_rounded(behind, scene.ray_origins.front, 8)
        assert_exact(hidden, scene.is_hidden, "found by rays from the same points")


def test_the_plan_tells_what_vertices_lose_on_either_side(tmp_path):
    checks = (
        '<bsdf type="diffuse"><texture name="reflectance" type="checkerboard"><transform name="to_uv">'
        '<scale x="97" y="89"/></transform></texture></bsdf>'
    )
    lost = []
    for sides in ((checks, checks), (ONE_SIDED, checks), (checks, ONE_SIDED)):
        sheet = f'<shape type="rectangle" id="sheet"><bsdf type="twosided">{"".join(sides)}</bsdf></shape>'
        with open_scene(write(tmp_path, sheet)) as scene:
            rows = [row for row in scene.not_simulated if row.name == "texture between vertices of shape 'sheet'"]
        lost += [row.share for row in rows]
    # Checks of 0.2 and 0.4 about a mean that is their half deviate by 0.1, of a root mean square of sqrt(0.1).
    np.testing.assert_allclose(lost, np.sqrt(0.1) * np.array([1.0, np.sqrt(0.5), np.sqrt(0.5)]), rtol=0.02)
