"""Bitmaps of Mitsuba scenes on the faces that transfer is computed on, against Mitsuba's own lookup."""

import numpy as np
import pytest
from PIL import Image

from slepian_prt.relighting.drawing.texture_lookup import TextureLookup
from slepian_prt.relighting.files.bitmap_detail import bitmap_detail
from slepian_prt.relighting.files.painted_mesh import textured_faces
from slepian_prt.scene.loading import open_scene
from tests.numerics import assert_exact

OBJ = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0.1 0\nvt 2 0.3\nvt 1 1.5\nvt 0 1\nf 1/1 2/2 3/3\nf 1/1 3/3 4/4\n"


def scene_file(folder, shape: str, material: str) -> str:
    rng = np.random.default_rng(3)
    Image.fromarray(rng.integers(30, 220, (6, 9, 3)).astype(np.uint8)).save(folder / "t.png")
    (folder / "m.obj").write_text(OBJ)
    path = folder / "scene.xml"
    path.write_text(f'<scene version="3.0.0">{shape.format(material)}</scene>')
    return str(path)


def bitmap(wrap: str, turn: str = "", *, sides: bool = False) -> str:
    inside = (
        f'<bsdf type="diffuse"><texture name="reflectance" type="bitmap"><string name="filename" value="t.png"/>'
        f'<string name="wrap_mode" value="{wrap}"/>{turn}</texture></bsdf>'
    )
    return f'<bsdf type="twosided">{inside}</bsdf>' if sides else inside


SHAPES = {
    "rectangle": '<shape type="rectangle" id="r">{}</shape>',
    "sphere": '<shape type="sphere" id="s">{}</shape>',
    "mesh": '<shape type="obj" id="m"><string name="filename" value="m.obj"/>{}</shape>',
}
for kind in ("mesh", "rectangle"):
    SHAPES[f"instances of a {kind}"] = (
        f'<shape type="shapegroup" id="g">{SHAPES[kind]}</shape>'
        '<shape type="instance"><ref id="g"/><transform name="to_world"><scale x="2" y="-1"/>'
        '<rotate x="1" angle="40"/><translate z="3"/></transform></shape>'
        '<shape type="instance" id="second"><ref id="g"/></shape>'
    )
TURN = '<transform name="to_uv"><scale x="3" y="-2"/><rotate z="1" angle="30"/><translate x="0.2"/></transform>'


@pytest.mark.parametrize(
    ("shape", "material"),
    [
        ("rectangle", bitmap("repeat", TURN)),
        ("rectangle", bitmap("clamp", TURN, sides=True)),
        ("rectangle", bitmap("mirror", TURN)),
        ("mesh", bitmap("repeat")),
        ("mesh", bitmap("mirror", TURN)),
        ("instances of a mesh", bitmap("mirror", TURN)),
        ("instances of a rectangle", bitmap("repeat", TURN, sides=True)),
        ("sphere", bitmap("repeat", '<transform name="to_uv"><scale x="2" y="1"/></transform>')),
    ],
)
def test_places_on_faces_look_up_what_mitsuba_does(tmp_path, rng, shape, material):
    path = scene_file(tmp_path, SHAPES[shape], material)
    with open_scene(path) as scene:
        mi, mesh = scene.mi, scene.mesh
        loaded = mi.load_file(path, optimize=False)
        detail = bitmap_detail(mi, loaded, scene.origin, mesh, scene.parts)
        faces = rng.integers(0, len(mesh.faces), 400)
        weights = rng.dirichlet(np.ones(3), 400)
        corners = mesh.positions[mesh.faces[faces]]
        points = np.einsum("nk,nkc->nc", weights, corners)
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        start = points + 0.05 * normals
        ray = mi.Ray3f(mi.Point3f(start.T.astype(np.float32)), mi.Vector3f(-normals.T.astype(np.float32)))
        si = loaded.ray_intersect(ray)
        theirs = np.array(si.bsdf().eval_diffuse_reflectance(si)).T
        u, v = (mi.Float(weights[:, k].astype(np.float32)) for k in (1, 2))
        ours = np.array(TextureLookup(mi, detail).reflectance(mi.UInt32(faces), u, v, mi.Bool(True))).T
    # Half a step of 8 bits in sRGB is at most 0.0045 of linear light; the sphere's faces are chords of it, along which
    # texture coordinates run a little otherwise.
    off = np.abs(ours - theirs).max(axis=1)
    if shape == "sphere":
        # Within 1/24 of a radian of a pole, where the coordinates of a triangle are no longer those of the sphere.
        off = off[np.abs(points[:, 2]) < 0.95]
        assert np.quantile(off, 0.95) < 0.06
    else:
        assert off.max() < 0.006


def test_a_bitmap_of_several_shapes_is_one_texture(tmp_path):
    """Also where materials of their own read it, so that a format with one texture for all holds it."""
    shapes = (
        SHAPES["rectangle"]
        + SHAPES["mesh"].replace("{}", bitmap("repeat"))
        + SHAPES["sphere"].replace("{}", bitmap("repeat", TURN))
    )
    path = scene_file(tmp_path, shapes, bitmap("repeat"))
    with open_scene(path) as scene:
        loaded = scene.mi.load_file(path, optimize=False)
        detail = bitmap_detail(scene.mi, loaded, scene.origin, scene.mesh, scene.parts)
    assert len(scene.parts) == 3
    assert len(detail.textures) == 1
    assert_exact(textured_faces(scene.mesh, detail), np.zeros(len(scene.mesh.faces)), "whole numbers")


def test_other_textures_are_told(tmp_path):
    checks = '<bsdf type="diffuse"><texture name="reflectance" type="checkerboard"/></bsdf>'
    told = []
    path = scene_file(tmp_path, SHAPES["rectangle"], checks)
    with open_scene(path) as scene:
        loaded = scene.mi.load_file(path, optimize=False)
        assert bitmap_detail(scene.mi, loaded, scene.origin, scene.mesh, scene.parts, told.append) is None
    assert told == ["textures of 'r' are no bitmaps of a diffuse material; they are written as colours of vertices"]


def test_a_mesh_without_coordinates_has_no_texture(tmp_path):
    path = scene_file(tmp_path, SHAPES["mesh"], bitmap("repeat"))
    (tmp_path / "m.obj").write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nf 1 2 3\n")
    with open_scene(path) as scene:
        loaded = scene.mi.load_file(path, optimize=False)
        detail = bitmap_detail(scene.mi, loaded, scene.origin, scene.mesh, scene.parts)
    assert not detail.is_textured
