"""Shapes of Mitsuba scenes as meshes: geometry, orientation, textures, lights and cameras."""

import math

import numpy as np
import pytest
import trimesh

from slepian_prt.errors import UserError
from slepian_prt.lighting.emitters import emitted_environment
from slepian_prt.lighting.projection import project_environment
from slepian_prt.renderer.variants import mitsuba
from slepian_prt.scene.loading import open_scene
from slepian_prt.transport.transfer import precompute
from tests.numerics import assert_exact

TURNED = (
    '<transform name="to_world"><scale value="2"/><rotate x="1" angle="35"/><rotate z="1" angle="-20"/>'
    '<translate x="3" y="-1" z="0.5"/></transform>'
)
RIGHT_ANGLES = (
    '<transform name="to_world"><scale value="2"/><rotate z="1" angle="90"/><rotate x="1" angle="90"/>'
    '<translate x="1" y="0.5"/></transform>'
)
MIRRORED = '<transform name="to_world"><scale x="-2" y="2" z="2"/><rotate y="1" angle="70"/></transform>'
AMBIENT = math.sqrt(4 * math.pi)


def write(folder, body: str):
    path = folder / "scene.xml"
    path.write_text(f'<scene version="3.0.0">{body}</scene>')
    return path


def area(mesh) -> float:
    a, b, c = (mesh.positions[mesh.faces[:, k]] for k in range(3))
    return float(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())


@pytest.mark.parametrize(
    ("kind", "exact"),
    [
        ("sphere", 16 * math.pi),
        ("rectangle", 16.0),
        ("disk", 4 * math.pi),
        ("cylinder", 8 * math.pi),
        ("cube", 96.0),
    ],
)
@pytest.mark.parametrize("flipped", ["false", "true"])
@pytest.mark.parametrize("placed", [TURNED, RIGHT_ANGLES, MIRRORED], ids=["turned", "right angles", "mirrored"])
def test_shapes_become_meshes(kind, exact, flipped, placed, tmp_path):
    flip = f'<boolean name="flip_normals" value="{flipped}"/>'
    body = f'<shape type="{kind}">{flip}{placed}<bsdf type="diffuse"/></shape>'
    with open_scene(write(tmp_path, body)) as scene:
        mi = scene.mi
        mesh = scene.mesh
        # 48 cuts around a circle lose (2π/48)²/6 of its area.
        assert area(mesh) == pytest.approx(exact, rel=4e-3)
        assert mesh.receivers.active.all()
        np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1.0, atol=1e-6)
        # Faces turn the way that the normals point, and both the way that Mitsuba's own shape is shaded.
        corner = mesh.positions[mesh.faces]
        turned = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        assert (np.einsum("ij,ij->i", turned, mesh.normals[mesh.faces[:, 0]]) > 0).all()
        if kind in ("sphere", "cube", "cylinder") and placed != MIRRORED:
            outward = np.einsum("ij,ij->i", mesh.positions - mesh.positions.mean(axis=0), mesh.normals).mean()
            assert (outward < 0) == (flipped == "true")
        shape = mi.load_file(str(tmp_path / "scene.xml"), optimize=False).shapes()[0]
        # Watertight: rays go exactly through the diagonals of the original cube.
        original = mi.load_dict({"type": "scene", "embree_use_robust_intersections": True, "shape": shape})
        # From every vertex, a ray from a little above it comes back to it on the original.
        start = mesh.positions + 0.05 * mesh.normals
        ray = mi.Ray3f(mi.Point3f(start.T.astype(np.float32)), mi.Vector3f(-mesh.normals.T.astype(np.float32)))
        si = original.ray_intersect(ray)
        distance = np.array(si.t)
        inner = np.abs(distance - 0.05) < 1e-3
        sides = np.sort(np.concatenate([mesh.faces[:, [i, j]] for i, j in ((0, 1), (1, 2), (2, 0))]), axis=1)
        edges, count = np.unique(sides, axis=0, return_counts=True)
        assert np.isin(np.flatnonzero(~inner), edges[count == 1]).all()  # only at a border may it meet something else
        facing = np.einsum("ji,ij->i", np.array(si.sh_frame.n), mesh.normals)
        assert (facing[inner] > 0.99).all() or kind == "cylinder"


@pytest.mark.parametrize("flipped", ["false", "true"])
@pytest.mark.parametrize("scale", [0.5, -0.5])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_front_of_a_mesh_is_that_of_its_shading_normals(flipped, scale, side, tmp_path):
    """Mirrored meshes keep their normals, while their faces turn round; so do those whose file has them inward."""
    ball = trimesh.creation.icosphere(2)
    trimesh.Trimesh(ball.vertices, ball.faces, vertex_normals=side * ball.vertices, process=False).export(
        tmp_path / "ball.ply", vertex_normal=True
    )
    placed = f'<transform name="to_world"><scale x="{scale}" y="0.5" z="0.5"/><translate x="0.25"/></transform>'
    body = (
        f'<shape type="ply"><string name="filename" value="ball.ply"/>{placed}'
        f'<boolean name="flip_normals" value="{flipped}"/><bsdf type="diffuse"/></shape>'
    )
    path = write(tmp_path, body)
    with open_scene(path) as scene:
        mi, mesh = scene.mi, scene.mesh
        away = (mesh.positions - [0.25, 0.0, 0.0]) / 0.5
        loaded = mi.load_file(str(path), optimize=False)
        hit = loaded.ray_intersect(mi.Ray3f(mi.Point3f(0.3, 0.05, 2), mi.Vector3f(0, 0, -1)))
        outward = float(hit.sh_frame.n.z[0]) > 0.0
        assert outward == ((side > 0.0) != (flipped == "true"))
        toward = np.einsum("ij,ij->i", mesh.normals, away)  # 1, and less in the middle of chords
        assert np.all(toward > 0.95) if outward else np.all(toward < -0.95)
        corner = mesh.positions[mesh.faces]
        turned = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        assert np.all(np.einsum("ij,ij->i", turned, mesh.normals[mesh.faces[:, 0]]) > 0.0)


@pytest.mark.parametrize("linear", ["0.5 0 0 0 0 0.3 0 0.6 0 0 0.4 0", "0.3 0.2 0 0 0 0.5 0.1 0 0 0 -0.4 0"])
def test_spheres_stay_round_under_any_transform(linear, tmp_path):
    placed = f'<transform name="to_world"><matrix value="{linear} 0 0 0 1"/></transform>'
    path = write(tmp_path, f'<shape type="sphere">{placed}<bsdf type="diffuse"/></shape>')
    with open_scene(path) as scene:
        mi, mesh = scene.mi, scene.mesh
        # Rays to Mitsuba's own sphere meet it where the vertices are.
        original = mi.load_dict({"type": "scene", "shape": mi.load_file(str(path), optimize=False).shapes()[0]})
        start = mesh.positions + 0.05 * mesh.normals
        si = original.ray_intersect(
            mi.Ray3f(mi.Point3f(start.T.astype(np.float32)), mi.Vector3f(-mesh.normals.T.astype(np.float32)))
        )
        np.testing.assert_allclose(np.array(si.t), 0.05, atol=1e-6)
        np.testing.assert_allclose(np.abs(np.einsum("ji,ij->i", np.array(si.n), mesh.normals)), 1.0, atol=1e-6)


def test_a_cube_keeps_its_edges(tmp_path):
    with open_scene(write(tmp_path, '<shape type="cube"><bsdf type="diffuse"/></shape>')) as scene:
        normals = scene.mesh.normals
        assert np.allclose(np.abs(normals).max(axis=1), 1.0)  # none is averaged over an edge
        assert len(normals) > 1000
        # A side's two triangles share the points of their common edge.
        edges = np.sort(np.concatenate([scene.mesh.faces[:, [i, j]] for i, j in ((0, 1), (1, 2), (2, 0))]), axis=1)
        _, count = np.unique(edges, axis=0, return_counts=True)
        n = round((len(scene.mesh.faces) / 12) ** 0.5)
        assert (count == 1).sum() == 6 * 4 * n


@pytest.fixture
def texture(tmp_path):
    """Left half red, right half green, in linear values."""
    pixels = np.zeros((8, 16, 3), dtype=np.float32)
    pixels[:, :8, 0], pixels[:, 8:, 1] = 0.75, 0.5
    with mitsuba() as mi:
        mi.Bitmap(pixels).write(str(tmp_path / "halves.exr"))
    return '<texture type="bitmap" name="reflectance"><string name="filename" value="halves.exr"/></texture>'


def test_bitmaps_are_evaluated_at_the_vertices(texture, tmp_path):
    body = f'<shape type="rectangle"><bsdf type="twosided"><bsdf type="diffuse">{texture}</bsdf></bsdf></shape>'
    transfer = precompute(write(tmp_path, body), 1, 16)
    x, albedo = transfer.positions[:, 0], transfer.mesh.albedo
    np.testing.assert_allclose(albedo[(x > -0.9) & (x < -0.1)] - [0.75, 0, 0], 0.0, atol=1e-6)
    np.testing.assert_allclose(albedo[(x > 0.1) & (x < 0.9)] - [0, 0.5, 0], 0.0, atol=1e-6)


def test_shared_and_layered_materials(tmp_path):
    body = """<bsdf type="twosided" id="paint"><bsdf type="roughplastic">
      <rgb name="diffuse_reflectance" value="0.2, 0.4, 0.6"/></bsdf></bsdf>
      <shape type="sphere" id="a"><ref id="paint"/></shape>
      <shape type="disk" id="b"><transform name="to_world"><translate x="5"/></transform><ref id="paint"/></shape>"""
    with open_scene(write(tmp_path, body)) as scene:
        assert [part.name for part in scene.parts] == ["a", "b"]
        a, b = (scene.mesh.albedo[part.first] for part in scene.parts)
        assert_exact(a, b, "the same material was measured")
        np.testing.assert_allclose(a / np.float32([0.2, 0.4, 0.6]), a[0] / 0.2, rtol=1e-6)
        assert scene.two_sided == (True, True)
        assert "glossy reflection of material 'paint' (2 shapes)" in [row.name for row in scene.not_simulated]


def test_mesh_attributes_are_reflectances_too(tmp_path):
    grid = trimesh.creation.icosphere(3)
    colours = np.zeros((len(grid.vertices), 4), dtype=np.uint8)
    colours[:, 0], colours[:, 3] = np.where(grid.vertices[:, 2] > 0, 255, 0), 255
    with mitsuba() as mi:
        shape = mi.Mesh("m", len(grid.vertices), len(grid.faces))
        parameters = mi.traverse(shape)
        parameters["vertex_positions"] = mi.Float(grid.vertices.astype(np.float32).ravel())
        parameters["faces"] = mi.UInt32(grid.faces.astype(np.uint32).ravel())
        parameters.update()
        shape.add_attribute("vertex_color", 3, (colours[:, :3] / 255.0).astype(np.float32).ravel())
        shape.write_ply(str(tmp_path / "m.ply"))
    body = """<shape type="ply"><string name="filename" value="m.ply"/><bsdf type="diffuse">
      <texture type="mesh_attribute" name="reflectance"><string name="name" value="vertex_color"/></texture>
      </bsdf></shape>"""
    transfer = precompute(write(tmp_path, body), 1, 16)
    z = transfer.positions[:, 2]
    np.testing.assert_allclose(transfer.mesh.albedo[:, 0], z > 0, atol=1e-5)


def test_occluders_that_are_not_receivers(tmp_path):
    body = f"""<shape type="sphere" id="ball"><bsdf type="diffuse"/></shape>
      <shape type="disk" id="mirror"><transform name="to_world"><scale value="50"/><translate z="1.2"/></transform>
      <bsdf type="conductor"/></shape><shape type="rectangle" id="glass">{TURNED}<bsdf type="dielectric"/></shape>"""
    transfer = precompute(write(tmp_path, body), 1, 256, effects="direct")
    assert [part.name for part in transfer.parts] == ["ball"]
    top = transfer.normals[:, 2] > 0.99
    assert transfer.vectors[top, 0, 0].max() * AMBIENT < 0.01
    named = {effect.name: effect.verdict for effect in transfer.effects}
    assert named["mirror reflection of shapes 'mirror', 'glass' (metal, glass)"] == "gathered"
    assert named["transmission through shape 'glass' (glass)"] == "gathered"
    assert named["mirrors"] == named["glass"] == "omitted"


# --- Lights and cameras ----------------------------------------------------------------------------------------------


def test_an_envmap_is_taken_as_it_is(rng):
    texels = rng.random((16, 32, 3)).astype(np.float32)
    with mitsuba() as mi:
        turn = mi.ScalarTransform4f().rotate([0.6, 0.0, 0.8], 50)
        emitter = mi.load_dict({"type": "envmap", "bitmap": mi.Bitmap(texels), "scale": 2.0, "to_world": turn})
        environment = emitted_environment(mi, emitter, "test")
        np.testing.assert_allclose(environment.texels, 2.0 * texels, rtol=1e-6)
        # In the direction that the environment says a texel is in, the emitter shines with its radiance.
        row, column = 5, 9
        theta, phi = row / 15 * np.pi, (column + 0.5) / 32 * 2 * np.pi
        own = [np.sin(phi) * np.sin(theta), np.cos(theta), -np.cos(phi) * np.sin(theta)]
        si = mi.SurfaceInteraction3f()
        si.wi = -mi.Vector3f((environment.to_world @ own).astype(np.float32).tolist())
        np.testing.assert_allclose(np.array(emitter.eval(si)).ravel(), 2.0 * texels[row, column], rtol=1e-3)


@pytest.mark.slow
def test_constant_and_sky():
    with mitsuba() as mi:
        constant = mi.load_dict({"type": "constant", "radiance": {"type": "rgb", "value": [0.2, 0.5, 1.0]}})
        lighting = project_environment(emitted_environment(mi, constant, "test"), 4)
        np.testing.assert_allclose(lighting[:, 0], np.array([0.2, 0.5, 1.0]) * AMBIENT, rtol=1e-5)
        assert np.abs(lighting[:, 1:]).max() < 1e-5
        sky = mi.load_dict({"type": "sunsky", "sun_direction": [0.5, 0.6, 0.3], "to_world": mi.ScalarTransform4f()})
        environment = emitted_environment(mi, sky, "test")
        # Power by uniform sampling of directions, with the sun's own sampling for the sun.
        theirs = project_environment(environment, 0)[:, 0] * AMBIENT
        ctx = mi.load_dict({"type": "independent"})
        ctx.seed(1, 1 << 18)
        import drjit as dr

        it = dr.zeros(mi.SurfaceInteraction3f, 1 << 18)
        _, weight = sky.sample_direction(it, ctx.next_2d())
        power = np.array(weight).mean(axis=1)
        np.testing.assert_allclose(theirs, power, rtol=0.02)


@pytest.mark.slow
def test_the_scenes_own_light_is_kept_with_the_transfer(tmp_path):
    from slepian_prt.compression.files.prt_file import load
    from slepian_prt.compression.stream import compress

    body = """<emitter type="constant"><rgb name="radiance" value="1, 2, 3"/></emitter>
      <sensor type="perspective" id="cam"><float name="fov" value="40"/><transform name="to_world">
      <lookat origin="0, -4, 0" target="0, 0, 0" up="0, 0, 1"/></transform></sensor>
      <shape type="sphere"><bsdf type="diffuse"/></shape>"""
    transfer = precompute(write(tmp_path, body), 3, 16)
    compress(transfer).save(tmp_path / "a.prt")
    packed = load(tmp_path / "a.prt")
    np.testing.assert_allclose(packed.lighting[:, 0], np.array([1.0, 2.0, 3.0]) * AMBIENT, rtol=1e-5)
    assert packed.view.name == "cam"
    assert packed.view.fov == pytest.approx(40.0)
    assert not packed.toward_view


def test_mirrored_envmaps_are_turned_left_to_right(rng):
    texels = rng.random((16, 32, 3)).astype(np.float32)
    with mitsuba() as mi:
        mirror = mi.ScalarTransform4f().rotate([0, 1, 0], 25) @ mi.ScalarTransform4f().scale([-1, 1, 1])
        emitter = mi.load_dict({"type": "envmap", "bitmap": mi.Bitmap(texels), "to_world": mirror})
        environment = emitted_environment(mi, emitter, "test")
        assert np.linalg.det(environment.to_world) == pytest.approx(1.0, abs=1e-5)
        row, column = 5, 9
        theta, phi = row / 15 * np.pi, (column + 0.5) / 32 * 2 * np.pi
        own = [np.sin(phi) * np.sin(theta), np.cos(theta), -np.cos(phi) * np.sin(theta)]
        si = mi.SurfaceInteraction3f()
        si.wi = -mi.Vector3f((environment.to_world @ own).astype(np.float32).tolist())
        np.testing.assert_allclose(np.array(emitter.eval(si)).ravel(), environment.texels[row, column], rtol=1e-3)


def test_metal_is_not_diffuse(tmp_path):
    body = """<shape type="sphere"><bsdf type="principled"><rgb name="base_color" value="0.9, 0.6, 0.3"/>
      <float name="metallic" value="{metallic}"/></bsdf></shape>"""
    whole = np.zeros(3)
    for metallic in (0.0, 0.25, 1.0):
        with open_scene(write(tmp_path, body.format(metallic=metallic))) as scene:
            whole = scene.mesh.albedo[0] if metallic == 0.0 else whole
            np.testing.assert_allclose(scene.mesh.albedo - (1.0 - metallic) * whole, 0.0, atol=1e-6)


def test_blends_with_metal(tmp_path):
    body = """<shape type="sphere"><bsdf type="blendbsdf"><float name="weight" value="0.4"/><bsdf type="diffuse"/>
      <bsdf type="roughconductor"><string name="material" value="Ag"/></bsdf></bsdf></shape>"""
    with open_scene(write(tmp_path, body)) as scene:
        np.testing.assert_allclose(scene.mesh.albedo, 0.6 * 0.5, atol=1e-6)


@pytest.mark.parametrize(
    ("body", "message"),
    [
        (
            '<shape type="disk"><transform name="to_world"><scale value="0"/></transform><bsdf type="diffuse"/>'
            "</shape>",
            "flattens it to nothing",
        ),
        (
            '<shape type="sphere"><bsdf type="diffuse"><spectrum name="reflectance" value="3"/></bsdf></shape>',
            "no surface reflects more than 1",
        ),
        ('<shape type="sphere"><bsdf type="conductor"/></shape>', "nothing in the scene can be lit"),
        (
            '<shape type="sphere"><bsdf type="diffuse"><texture type="bitmap" name="reflectance">'
            '<string name="filename" value="gone.png"/></texture></bsdf></shape>',
            r"scene\.xml: Mitsuba cannot load the scene .*gone\.png",
        ),
        ('<shape type="obj"><string name="filename" value="gone.obj"/></shape>', r"gone\.obj"),
        ('<shape type="teapot"/>', r"scene\.xml: Mitsuba cannot load the scene .*teapot"),
    ],
)
def test_bad_scenes(body, message, tmp_path):
    with pytest.raises(UserError, match=message) as caught:
        precompute(write(tmp_path, body), 1, 16)
    assert "\n" not in str(caught.value)


def test_an_unreadable_texture(tmp_path):
    (tmp_path / "broken.png").write_bytes(b"not a picture")
    body = (
        '<shape type="sphere"><bsdf type="diffuse"><texture type="bitmap" name="reflectance">'
        '<string name="filename" value="broken.png"/></texture></bsdf></shape>'
    )
    with pytest.raises(UserError, match=r"broken\.png"):
        precompute(write(tmp_path, body), 1, 16)


@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_cubes_of_any_size_are_cut_alike(scale, tmp_path):
    placed = f'<transform name="to_world"><scale value="{scale}"/></transform>'
    with open_scene(write(tmp_path, f'<shape type="cube">{placed}<bsdf type="diffuse"/></shape>')) as scene:
        assert area(scene.mesh) == pytest.approx(24.0 * scale**2, rel=1e-4)
        assert len(scene.mesh.positions) == 6 * round((len(scene.mesh.faces) / 12) ** 0.5 + 1) ** 2
