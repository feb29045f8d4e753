"""Bitmaps of Mitsuba scenes on the faces that transfer is computed on, against Mitsuba's own lookup."""

from typing import NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from slepian_prt.relighting.drawing.texture_lookup import TextureLookup
from slepian_prt.relighting.files.bitmap_detail import bitmap_detail
from slepian_prt.scene.loading import open_scene

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
PAINT = bitmap("repeat")
TURN = '<transform name="to_uv"><scale x="3" y="-2"/><rotate z="1" angle="30"/><translate x="0.2"/></transform>'


class LookedUp(NamedTuple):
    """Reflectance at some points (n, 3) of the surface: as the images have it, and as Mitsuba looks it up."""

    points: NDArray
    ours: NDArray
    theirs: NDArray


def look_up(path: str, rng) -> LookedUp:
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
    return LookedUp(points, ours, theirs)


# Half a step of 8 bits in sRGB is at most 0.0045 of linear light.
STEP = 0.006


@pytest.mark.parametrize(
    ("shape", "material"),
    [
        ("rectangle", bitmap("repeat", TURN)),
        ("rectangle", bitmap("clamp", TURN, sides=True)),
        ("rectangle", bitmap("mirror", TURN)),
        ("mesh", bitmap("repeat")),
        ("mesh", bitmap("mirror", TURN)),
        ("sphere", bitmap("repeat", '<transform name="to_uv"><scale x="2" y="1"/></transform>')),
    ],
)
def test_places_on_faces_look_up_what_mitsuba_does(tmp_path, rng, shape, material):
    found = look_up(scene_file(tmp_path, SHAPES[shape], material), rng)
    off = np.abs(found.ours - found.theirs).max(axis=1)
    if shape == "sphere":
        # The sphere's faces are chords of it, along which texture coordinates run a little otherwise; within 1/24 of
        # a radian of a pole those of a triangle are no longer those of the sphere.
        off = off[np.abs(found.points[:, 2]) < 0.95]
        assert np.quantile(off, 0.95) < 0.06
    else:
        assert off.max() < STEP


def test_each_side_has_its_own_image(tmp_path, rng):
    other = bitmap("repeat", TURN)
    found = look_up(scene_file(tmp_path, SHAPES["rectangle"], f'<bsdf type="twosided">{PAINT}{other}</bsdf>'), rng)
    assert np.ptp(found.theirs[:, 0]) > 0.3  # the images
    np.testing.assert_allclose(found.ours, found.theirs, atol=STEP)


def test_copies_have_the_image_where_their_instance_puts_them(tmp_path, rng):
    """One turned, one mirrored."""
    group = f'<shape type="shapegroup" id="g">{SHAPES["mesh"]}</shape>'
    turns = '<rotate y="1" angle="40"/><translate x="3"/>', '<scale x="-2" y="1" z="1"/><translate x="-1" z="0.5"/>'
    copies = "".join(
        f'<shape type="instance"><ref id="g"/><transform name="to_world">{turn}</transform></shape>' for turn in turns
    )
    found = look_up(scene_file(tmp_path, group + copies, bitmap("repeat", sides=True)), rng)
    np.testing.assert_allclose(found.ours, found.theirs, atol=STEP)


@pytest.mark.parametrize("nesting", ["{}", '<bsdf type="bumpmap"><texture type="checkerboard"/>{}</bsdf>'])
@pytest.mark.parametrize(("kind", "slot"), [("principled", "base_color"), ("roughplastic", "diffuse_reflectance")])
def test_images_are_what_the_diffuse_lobe_reflects(tmp_path, rng, kind, slot, nesting):
    """Which is proportional to the texture in both."""
    inner = PAINT.replace('"diffuse"', f'"{kind}"').replace('"reflectance"', f'"{slot}"')
    path = scene_file(tmp_path, SHAPES["rectangle"], f'<bsdf type="twosided">{nesting.format(inner)}</bsdf>')
    found = look_up(path, rng)
    factor = found.ours.sum() / found.theirs.sum()
    assert 0.8 < factor < 1.1
    np.testing.assert_allclose(found.ours, factor * found.theirs, atol=STEP)


def test_checkerboards_are_images_too(tmp_path, rng):
    checks = f'<bsdf type="diffuse"><texture name="reflectance" type="checkerboard">{TURN}</texture></bsdf>'
    found = look_up(scene_file(tmp_path, SHAPES["rectangle"], checks), rng)
    # Edges, two along each axis, are blurred over a texel of 256.
    assert np.mean(np.abs(found.ours - found.theirs).max(axis=1) > STEP) < 0.05


@pytest.mark.parametrize("sides", [1, 2])
def test_one_material_has_one_image(tmp_path, sides):
    both = bitmap("repeat", sides=sides == 2).replace('">', '" id="m">', 1) + "".join(
        f'<shape type="rectangle" id="r{x}"><transform name="to_world"><translate x="{x}"/></transform><ref id="m"/>'
        "</shape>"
        for x in (0, 3)
    )
    path = scene_file(tmp_path, both, "")
    with open_scene(path) as scene:
        loaded = scene.mi.load_file(path, optimize=False)
        detail = bitmap_detail(scene.mi, loaded, scene.origin, scene.mesh, scene.parts)
        assert [part.sides for part in scene.parts] == [sides, sides]
    assert len(detail.textures) == 1
    assert np.all(detail.choice == 0)


def test_other_textures_are_told(tmp_path):
    fog = '<texture name="reflectance" type="volume"><volume name="volume" type="constvolume"/></texture>'
    told = []
    path = scene_file(tmp_path, SHAPES["rectangle"], f'<bsdf type="diffuse">{fog}</bsdf>')
    with open_scene(path) as scene:
        loaded = scene.mi.load_file(path, optimize=False)
        assert bitmap_detail(scene.mi, loaded, scene.origin, scene.mesh, scene.parts, told.append) is None
    assert told == ["textures of 'r' are no single image; they are written as colours of vertices"]


def test_a_mesh_without_coordinates_has_no_texture(tmp_path):
    path = scene_file(tmp_path, SHAPES["mesh"], bitmap("repeat"))
    (tmp_path / "m.obj").write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nf 1 2 3\n")
    with open_scene(path) as scene:
        loaded = scene.mi.load_file(path, optimize=False)
        detail = bitmap_detail(scene.mi, loaded, scene.origin, scene.mesh, scene.parts)
    assert not detail.is_textured


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
    assert (len(scene.parts), len(detail.textures)) == (3, 1)
