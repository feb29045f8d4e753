"""Shapes of all kinds: what has no vertices casts shadows, and what is nothing but a boundary casts none."""

import math

import numpy as np
import pytest
import trimesh

from slepian_prt.renderer.variants import mitsuba
from slepian_prt.scene.loading import open_scene
from slepian_prt.transport.transfer import precompute
from tests.numerics import assert_exact

AMBIENT = math.sqrt(4.0 * math.pi)
DIFFUSE = '<bsdf type="diffuse"/>'
FLOOR = f'<shape type="rectangle" id="floor"><transform name="to_world"><scale value="3"/></transform>{DIFFUSE}</shape>'
BOUNDARIES = {
    "null": '<bsdf type="null"/>',
    "medium": '<bsdf type="null"/><medium type="homogeneous" name="interior"/>',
    "no opacity": f'<bsdf type="mask"><float name="opacity" value="0"/>{DIFFUSE}</bsdf>',
    "no refraction": '<bsdf type="dielectric"><float name="int_ior" value="1.3"/><float name="ext_ior" value="1.3"/>'
    "</bsdf>",
}
OPAQUE = {
    "half opacity": f'<bsdf type="mask"><float name="opacity" value="0.5"/>{DIFFUSE}</bsdf>',
    "glass": '<bsdf type="dielectric"/>',
    "thin glass": '<bsdf type="thindielectric"/>',
    "mirror": '<bsdf type="conductor"/>',
}


def write(folder, body: str):
    path = folder / "scene.xml"
    path.write_text(f'<scene version="3.0.0">{body}</scene>')
    return path


def cube(material: str, name: str = "case") -> str:
    placed = '<transform name="to_world"><scale value="0.8"/><translate z="1"/></transform>'
    return f'<shape type="cube" id="{name}">{placed}{material}</shape>'


def floor_light(transfer) -> np.ndarray:
    """(2,) what the floor receives below the middle, and far from it."""
    floor = transfer.parts[0]
    light = transfer.vectors[floor.first : floor.end, :, 0].mean(axis=1) * AMBIENT
    radius = np.linalg.norm(transfer.positions[floor.first : floor.end], axis=1)
    return np.array([light[radius < 0.3].mean(), light[radius > 2.9].mean()])


@pytest.mark.parametrize("material", BOUNDARIES.values(), ids=BOUNDARIES.keys())
def test_boundaries_cast_no_shadow(material, tmp_path):
    transfer = precompute(write(tmp_path, FLOOR + cube(material)), 0, 32, effects="direct")
    np.testing.assert_allclose(floor_light(transfer), 1.0, atol=1e-3)
    assert [part.name for part in transfer.parts] == ["floor"]
    assert not any("light" in effect.name for effect in transfer.effects)


@pytest.mark.parametrize("material", OPAQUE.values(), ids=OPAQUE.keys())
def test_others_cast_full_shadows(material, tmp_path):
    """Of what comes through them, or back from them, nothing counts as direct light."""
    transfer = precompute(write(tmp_path, FLOOR + cube(material)), 0, 32, effects="direct")
    below, beside = floor_light(transfer)
    assert below < 0.3
    assert beside > 0.9
    assert any("'case'" in effect.name for effect in transfer.effects)


def test_boundaries_in_groups(tmp_path):
    group = f'<shape type="shapegroup" id="g">{cube(BOUNDARIES["null"])}{cube(OPAQUE["mirror"], "m")}</shape>'
    placed = '<shape type="instance"><ref id="g"/><transform name="to_world"><translate x="50"/></transform></shape>'
    with open_scene(write(tmp_path, FLOOR + group + placed)) as scene:
        (instance,) = scene.occluders
        assert "prim_count = 12" in str(instance)  # the mirror alone


def written_curve(folder) -> str:
    (folder / "curve.txt").write_text("".join(f"{x} 0 1 0.3\n" for x in (-2.0, -1.0, 0.0, 1.0, 2.0)))
    return '<string name="filename" value="curve.txt"/>'


def written_grid(folder) -> str:
    """The distance from a ball of radius 0.3 in the middle of the unit cube."""
    with mitsuba() as mi:
        z, y, x = np.meshgrid(*(np.linspace(-0.5, 0.5, 16),) * 3, indexing="ij")
        distance = np.sqrt(x * x + y * y + z * z) - 0.3
        mi.VolumeGrid(distance[..., None].astype(np.float32)).write(str(folder / "ball.vol"))
    placed = '<transform name="to_world"><translate x="-0.5" y="-0.5"/><translate z="0.2"/></transform>'
    return f'<string name="filename" value="ball.vol"/>{placed}'


def written_ellipsoids(folder) -> str:
    """One ball of radius 0.3 as 3D Gaussian splats are kept."""
    numbered = [f"{name}_{i}" for name, count in (("scale", 3), ("rot", 4)) for i in range(count)]
    names = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", *numbered]
    values = np.float32([0, 0, 0.7, 0, 0, 0, 1, 1, 1, 10, *np.log([0.1, 0.1, 0.1]), 1, 0, 0, 0])
    header = ["ply", "format binary_little_endian 1.0", "element vertex 1"]
    header += [f"property float {name}" for name in names] + ["end_header", ""]
    (folder / "splats.ply").write_bytes("\n".join(header).encode() + values.tobytes())
    return '<string name="filename" value="splats.ply"/>'


@pytest.mark.parametrize(
    ("kind", "written"),
    [
        ("bsplinecurve", written_curve),
        ("linearcurve", written_curve),
        ("sdfgrid", written_grid),
        ("ellipsoids", written_ellipsoids),
        ("ellipsoidsmesh", written_ellipsoids),
    ],
)
def test_shapes_without_vertices_cast_shadows(kind, written, tmp_path):
    body = f'<shape type="{kind}" id="odd">{written(tmp_path)}{DIFFUSE}</shape>'
    transfer = precompute(write(tmp_path, FLOOR + body), 0, 64)
    below, beside = floor_light(transfer)
    assert 0.2 < below < 0.9
    assert beside > 0.95
    assert [part.name for part in transfer.parts] == ["floor"]
    assert any("'odd'" in effect.name and "no vertices" in effect.reason for effect in transfer.effects)


def test_merged_shapes_keep_their_places(tmp_path):
    trimesh.creation.icosphere(2).export(tmp_path / "m.ply")
    mesh = f'<shape type="ply"><string name="filename" value="m.ply"/>{DIFFUSE}</shape>'
    body = f'<shape type="merge" id="both">{mesh}{cube(DIFFUSE)}</shape>'
    with open_scene(write(tmp_path, body)) as scene:
        low, high = scene.receivers.positions.min(axis=0), scene.receivers.positions.max(axis=0)
        np.testing.assert_allclose([low, high], [[-1, -1, -1], [1, 1, 1.8]], atol=1e-6)


def test_attributes_of_flat_meshes_are_kept(tmp_path):
    """A mesh that is drawn flat gets vertices for each face; its colours go with them."""
    box = trimesh.creation.box()
    with mitsuba() as mi:
        shape = mi.Mesh("m", len(box.vertices), len(box.faces))
        parameters = mi.traverse(shape)
        parameters["vertex_positions"] = mi.Float(box.vertices.astype(np.float32).ravel())
        parameters["faces"] = mi.UInt32(box.faces.astype(np.uint32).ravel())
        parameters.update()
        shape.add_attribute("vertex_color", 3, np.float32(box.vertices + 0.5).ravel())
        shape.write_ply(str(tmp_path / "m.ply"))
    texture = '<texture type="mesh_attribute" name="reflectance"><string name="name" value="vertex_color"/></texture>'
    body = f"""<shape type="ply"><string name="filename" value="m.ply"/><boolean name="face_normals" value="true"/>
      <bsdf type="diffuse">{texture}</bsdf></shape>"""
    with open_scene(write(tmp_path, body)) as scene:
        positions, albedo = scene.mesh.positions, scene.mesh.albedo
        # Of a corner it is the mean over the faces around it; the colour is linear on each.
        assert np.abs(albedo - (positions + 0.5)).max() < 0.05
        assert_exact(len(positions) > 1000, True, "cut finer")
