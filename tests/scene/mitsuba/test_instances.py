"""Instances of groups against Mitsuba's own, and against the same shapes written out."""

import gc
import math

import numpy as np
import pytest
import trimesh

from slepian_prt.errors import UserError
from slepian_prt.scene.loading import open_scene
from slepian_prt.scene.mitsuba import sorting
from slepian_prt.transport.transfer import precompute

AMBIENT = math.sqrt(4.0 * math.pi)
DIFFUSE = '<bsdf type="diffuse"><rgb name="reflectance" value="0.2, 0.4, 0.6"/></bsdf>'
FLOOR = f'<shape type="rectangle" id="floor"><transform name="to_world"><scale value="3"/></transform>{DIFFUSE}</shape>'
GROUP = f'<shape type="shapegroup" id="g"><shape type="sphere" id="ball">{DIFFUSE}</shape></shape>'
PLACES = {
    "turned": '<scale x="1" y="2" z="0.5"/><rotate x="1" y="1" angle="40"/><translate x="1" y="-2" z="3"/>',
    "mirrored": '<scale x="-1" y="1" z="2"/><rotate z="1" angle="20"/><translate x="-4"/>',
}


def instance(group: str, placed: str = "", name: str = "") -> str:
    named = f' id="{name}"' if name else ""
    return f'<shape type="instance"{named}><ref id="{group}"/><transform name="to_world">{placed}</transform></shape>'


def write(folder, body: str):
    path = folder / "scene.xml"
    path.write_text(f'<scene version="3.0.0">{body}</scene>')
    return path


@pytest.mark.parametrize("placed", PLACES.values(), ids=PLACES.keys())
@pytest.mark.parametrize(
    "shape",
    ['<shape type="sphere">', '<shape type="cube">', '<shape type="ply"><string name="filename" value="m.ply"/>'],
    ids=["sphere", "cube", "mesh"],
)
def test_they_are_where_mitsuba_has_them(shape, placed, tmp_path):
    trimesh.creation.icosphere(2).export(tmp_path / "m.ply")
    body = f'<shape type="shapegroup" id="g">{shape}{DIFFUSE}</shape></shape>{instance("g", placed)}'
    with open_scene(write(tmp_path, body)) as scene:
        mi, mesh = scene.mi, scene.mesh
        start = mesh.positions + 0.05 * mesh.normals
        ray = mi.Ray3f(mi.Point3f(start.T.astype(np.float32)), mi.Vector3f(-mesh.normals.T.astype(np.float32)))
        hit = scene.loaded.ray_intersect(ray)
        # A chord of a sphere cut into 48 is (π/48)²/2 of the radius inside it; here that is up to 2. Rays slip through
        # at some vertices, most at the edges of a cube, or meet the next side there.
        near = np.abs(np.array(hit.t) - 0.05) < 0.01
        shading = np.einsum("ji,ij->i", np.array(hit.sh_frame.n), mesh.normals)
        assert (near & (shading > 0.99)).mean() > 0.9
        assert near.mean() > 0.95
        corner = mesh.positions[mesh.faces]
        turned = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        assert (np.einsum("ij,ij->i", turned, mesh.normals[mesh.faces[:, 0]]) > 0).all()
        np.testing.assert_allclose(mesh.albedo - np.float32([0.2, 0.4, 0.6]), 0.0, atol=1e-6)


def test_they_light_and_shade_like_shapes_written_out(tmp_path):
    def ball(place: str) -> str:
        return f'<shape type="sphere"><transform name="to_world">{place}</transform>{DIFFUSE}</shape>'

    places = ['<translate x="-1" z="1"/>', '<translate x="1.2" z="1.5"/>']
    direct = precompute(write(tmp_path, FLOOR + "".join(map(ball, places))), 2, 64)
    body = FLOOR + GROUP + "".join(instance("g", place) for place in places)
    instanced = precompute(write(tmp_path, body), 2, 64)
    np.testing.assert_allclose(instanced.positions, direct.positions, atol=1e-6)
    assert instanced.bounces == direct.bounces > 0
    # The same rays from places that differ by rounding, a few of which meet an edge or miss it.
    assert np.abs(instanced.vectors - direct.vectors).mean() < 1e-3


def test_names(tmp_path):
    two = f'<shape type="shapegroup" id="a &quot;b&quot;"><shape type="cube">{DIFFUSE}</shape>'
    two += f'<shape type="disk" id="lid">{DIFFUSE}</shape></shape>'
    body = GROUP + two + instance("g", name="first") + instance("a &quot;b&quot;") + instance("g")
    with open_scene(write(tmp_path, body)) as scene:
        names = {part.name for part in scene.parts}
    assert names == {"first/ball", "instance_2/ball", "instance_1/shape_0", "instance_1/lid"}


@pytest.mark.parametrize("limit", ["MOST_VERTICES", "MOST_COPIES"])
def test_too_many_cast_shadows_only(limit, tmp_path, monkeypatch):
    """And the plan tells the numbers; a group that is small enough is lit beside them."""
    monkeypatch.setattr(sorting, limit, {"MOST_VERTICES": 5000, "MOST_COPIES": 1}[limit])
    small = f'<shape type="shapegroup" id="small"><shape type="disk" id="d">{DIFFUSE}</shape></shape>'
    many = "".join(instance("g", f'<translate x="{x}" z="0.8"/>') for x in (0.0, 0.1, 0.2))
    body = FLOOR + GROUP + many
    if limit == "MOST_COPIES":
        body += small + instance("small", '<translate z="9"/>')
    transfer = precompute(write(tmp_path, body), 0, 64, effects="shadows,interreflection")
    assert [part.name for part in transfer.parts] == ["floor"] + ["instance_3/d"] * (limit == "MOST_COPIES")
    assert any("'g/ball'" in effect.name and "3 instances of" in effect.reason for effect in transfer.effects)
    light = transfer.vectors[:, :, 0].mean(axis=1) * AMBIENT
    radius = np.linalg.norm(transfer.positions, axis=1)
    assert light[radius < 0.2].max() < 0.2  # the ball reaches through the floor
    assert light[(radius > 2.9) & (transfer.positions[:, 2] < 1.0)].min() > 0.8
    with open_scene(write(tmp_path, body)) as scene:  # what rays meet of them receives nothing
        mi = scene.mi
        ray = mi.Ray3f(mi.Point3f([0.0, 0.0], [0.0, 2.5], [5.0, 5.0]), mi.Vector3f(0.0, 0.0, -1.0))
        faces = np.array(scene.hit_faces(scene.geometry.ray_intersect_preliminary(ray)))
        assert faces[0] == -1
        assert faces[1] >= 0


def test_shapes_without_vertices_cast_shadows_in_groups_too(tmp_path):
    (tmp_path / "curve.txt").write_text("".join(f"{x} 0 0 0.3\n" for x in (-2.0, -1.0, 0.0, 1.0, 2.0)))
    curve = '<shape type="bsplinecurve" id="hair"><string name="filename" value="curve.txt"/></shape>'
    placed = instance("g", '<translate z="0.4"/>')
    body = f'{FLOOR}<shape type="shapegroup" id="g">{curve}</shape>{placed}'
    transfer = precompute(write(tmp_path, body), 0, 64)
    light = transfer.vectors[:, 0, 0] * AMBIENT
    x, y, _ = transfer.positions.T
    # An infinite cylinder of radius r at a height h over a plane blocks r/h of the light below its axis.
    below = (np.abs(x) < 0.1) & (np.abs(y) < 0.05)
    assert light[below].mean() == pytest.approx(0.25, abs=0.08)
    assert any("'g/hair'" in effect.name and "no vertices" in effect.reason for effect in transfer.effects)


def test_a_mirror_in_a_group(tmp_path):
    body = f'{FLOOR}<shape type="shapegroup" id="g"><shape type="sphere" id="m"><bsdf type="conductor"/></shape>'
    body += f'<shape type="sphere" id="ball"><point name="center" x="5" y="0" z="0"/>{DIFFUSE}</shape></shape>'
    with open_scene(write(tmp_path, body + instance("g"))) as scene:
        assert [part.name for part in scene.parts] == ["floor", "instance_0/ball"]
        assert [shape.class_name() for shape in scene.occluders] == ["Instance"]
        low, high = scene.traced_bounds
        np.testing.assert_allclose([low, high], [[-3.0, -3.0, -1.0], [6.0, 3.0, 1.0]], atol=1e-5)


@pytest.mark.parametrize(
    ("body", "message"),
    [
        (GROUP + FLOOR + instance("g", '<scale x="0" y="1" z="1"/>', "thin"), "instance 'thin': .* flattens it"),
        (
            f'{GROUP}<shape type="shapegroup" id="h">{instance("g")}</shape>{FLOOR}{instance("h")}',
            "an instance may not hold instances",
        ),
        (FLOOR + f'<shape type="instance">{GROUP}</shape>', "Mitsuba cannot load the scene"),
        (
            f'<shape type="shapegroup" id="e"/>{instance("e", "", "i")}{FLOOR}',
            "the shapegroup of this instance holds no shapes",
        ),
    ],
    ids=["flat", "nested", "inline", "empty"],
)
def test_bad_instances(body, message, tmp_path):
    with pytest.raises(UserError, match=message) as caught:
        precompute(write(tmp_path, body), 0, 16)
    assert "\n" not in str(caught.value)
    # While an instance of an empty group is alive anywhere, Mitsuba traces no other scene either.
    del caught
    gc.collect()
