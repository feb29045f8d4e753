"""Pictures from Python and from files of transfer: where from, before what, how bright, and which side is lit."""

import math
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from slepian_prt.cli import main
from slepian_prt.compression.stream import compress
from slepian_prt.errors import UserError
from slepian_prt.lighting.environment import about_up, make_environment
from slepian_prt.lighting.projection import project_environment
from slepian_prt.relighting.drawing.backdrop import draw_backdrop, look_up
from slepian_prt.relighting.drawing.camera import aim_camera
from slepian_prt.relighting.drawing.pictures import Finish, Picture, display, linear
from slepian_prt.relighting.drawing.render import render_picture, save_picture
from slepian_prt.relighting.files.coloured_mesh import write_ply
from slepian_prt.relighting.files.mesh_outputs import write_coloured_mesh
from slepian_prt.relighting.files.wishes import Wish, check_output, check_source
from slepian_prt.relighting.relight import relight
from slepian_prt.relighting.series import Lights, relight_series
from slepian_prt.renderer.variants import bitmap_module, mitsuba
from slepian_prt.scene.loading import open_scene
from slepian_prt.scene.mesh import Mesh, make_mesh
from slepian_prt.scene.view import Aim, View, look_matrix, up_rotation
from slepian_prt.transport.transfer import precompute
from tests.conftest import bumpy, sphere
from tests.numerics import assert_exact, assert_rounded


def gradient_sky() -> np.ndarray:
    """Radiance 1 + cos of the angle from up: of degree 1, so exact at any bandlimit."""
    return np.broadcast_to(1.0 + np.cos(np.pi * np.arange(33) / 32)[:, None, None], (33, 66, 3)).copy()


@pytest.fixture(scope="module")
def ball():
    return compress(precompute(sphere(3), bandlimit=2, samples=16), "none")


@pytest.fixture(scope="module")
def sky_file(tmp_path_factory) -> str:
    path = tmp_path_factory.mktemp("maps") / "sky.exr"
    bitmap_module().Bitmap(gradient_sky().astype(np.float32)).write(str(path))
    return str(path)


# --- Light -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("up", "axis"), [("y", 1), ("z", 2)])
def test_the_sky_is_above_the_model(ball, sky_file, up, axis):
    """Of a clamped cosine in such a sky radiance is 1 + 2/3 n · up, however the light is given."""
    expected = 1.0 + 2.0 / 3.0 * ball.mesh.normals[:, [axis] * 3]
    environment = make_environment(gradient_sky())
    for lighting in (sky_file, environment, project_environment(environment, 2)):
        # 33 rows of float32 texels, and a file of them: rounding of a few units of 2^-24, and of the quadrature.
        np.testing.assert_allclose(relight(ball, lighting, up=up), expected, atol=2e-3)
    series = relight_series(ball, Lights((sky_file,), up=up), "ball.prt")
    np.testing.assert_allclose(series.radiance[0], expected, atol=2e-3)


def test_the_turntable_turns_about_what_is_up(ball, tmp_path):
    v, u = np.meshgrid(np.pi * np.arange(33) / 32, np.pi * (np.arange(66) + 0.5) / 33, indexing="ij")
    side = 1.0 + np.sin(v) * np.sin(u)  # brighter from +x
    bitmap_module().Bitmap(np.repeat(side[..., None], 3, axis=2).astype(np.float32)).write(str(tmp_path / "side.exr"))
    series = relight_series(ball, Lights((str(tmp_path / "side.exr"),), turntable=4, up="z"), "ball.prt")
    # Counter-clockwise seen from +z: from x to y.
    for radiance, toward in zip(series.radiance, [[1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]], strict=True):
        shaded = 1.0 + 2.0 / 3.0 * ball.mesh.normals @ np.array(toward, dtype=float)
        np.testing.assert_allclose(radiance[:, 0], shaded, atol=5e-3)


def test_lighting_that_is_none_of_these(ball):
    with pytest.raises(UserError, match="no such file"):
        relight(ball, "no.exr")
    with pytest.raises(UserError, match="up must be one of y, z"):
        relight(ball, np.zeros((3, 9)), up="x")


# --- What is behind --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("shape", [(8, 16), (3, 6), (5, 7)])
def test_the_backdrop_is_what_mitsubas_map_shows(shape, rng):
    from slepian_prt.lighting.environment import Environment

    turn = up_rotation("z") @ about_up(50.0)
    environment = Environment("random", rng.random((*shape, 3)).astype(np.float32), turn)
    directions = rng.normal(size=(400, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    with mitsuba() as mi:
        matrix = np.eye(4)
        matrix[:3, :3] = turn
        emitter = mi.load_dict(
            {
                "type": "envmap",
                "bitmap": mi.Bitmap(environment.texels),
                "to_world": mi.ScalarTransform4f(matrix.tolist()),
            }
        )
        import drjit as dr

        si = dr.zeros(mi.SurfaceInteraction3f, len(directions))
        si.wi = -mi.Vector3f(directions.T.astype(np.float32))
        theirs = np.array(emitter.eval(si)).T
    # Places in the map in float32: an error of 1e-6 of the map, times texels that differ by 1 over 1/16 of it.
    np.testing.assert_allclose(look_up(environment, directions), theirs, atol=2e-4)


def test_a_constant_map_is_a_constant_backdrop():
    environment = make_environment(np.full((8, 16, 3), 0.7))
    directions = np.stack(np.meshgrid(np.linspace(-1, 1, 9), np.linspace(-1, 1, 5)), axis=-1)
    directions = np.dstack([directions, np.ones((5, 9))])
    assert_rounded(draw_backdrop(environment, directions.astype(np.float32)), np.full((5, 9, 3), np.float32(0.7)), 24)


def test_the_map_stands_behind_the_model_as_it_lights_it(ball):
    """Before a bright sky above and dark below, the upper rows of the picture are bright, for either up."""
    environment = make_environment(np.where(np.arange(32)[:, None, None] < 16, 4.0, 0.25) * np.ones((32, 64, 3)))
    for up in ("y", "z"):
        pixels = render_picture(ball, environment, width=48, up=up, background="map", scene_linear=True, fov=60.0)
        assert_exact(pixels[..., 3], np.ones_like(pixels[..., 3]), "nothing is transparent before a map")
        np.testing.assert_allclose(pixels[0, 0, :3], 4.0, rtol=1e-5)
        np.testing.assert_allclose(pixels[-1, -1, :3], 0.25, rtol=1e-5)


# --- The picture -----------------------------------------------------------------------------------------------------


def test_places_of_a_picture_are_where_the_camera_puts_them(ball, sky_file):
    """A unit ball from distance 4 has the angular radius asin(1/4): so many pixels at this angle of view."""
    pixels = render_picture(ball, sky_file, width=200, look_at=([4, 0, 0], [0, 0, 0]), fov=40.0)
    rows, columns = np.nonzero(pixels[..., 3] > 0.5)
    radius = math.tan(math.asin(0.25)) / math.tan(math.radians(20.0)) * 100.0
    # The ball has 642 vertices: its outline is a polygon inside the circle, by up to 1 - cos(pi/26) of it.
    assert radius * 0.98 - 1.0 <= 0.5 * (np.ptp(columns) + 1) <= radius + 0.5
    assert abs(columns.mean() - 99.5) < 0.5
    assert abs(rows.mean() - 74.5) < 0.5


def test_a_view_of_a_z_up_model_is_that_of_the_y_up_one(sky_file):
    """The same model turned on its back, with `up=z`, gives the same picture."""
    mesh = bumpy(2)
    lying = make_mesh(mesh.positions @ up_rotation("z").T, mesh.faces, name="lying")
    pictures = []
    for one, up in ((mesh, "y"), (lying, "z")):
        packed = compress(precompute(one, bandlimit=2, samples=4096), "none")
        pictures.append(render_picture(packed, sky_file, width=64, up=up, scene_linear=True))
    # Rays are others: 4096^-3/4 = 0.2 % per vertex, largest of a few hundred; a wrong side would be off by 1.
    difference = np.abs(pictures[0] - pictures[1])
    assert np.quantile(difference, 0.99) < 0.03


def test_opacity_colour_and_exposure(ball, sky_file):
    plain = render_picture(ball, sky_file, width=32, scene_linear=True)
    brighter = render_picture(ball, sky_file, width=32, scene_linear=True, exposure=1.0)
    np.testing.assert_allclose(brighter[..., :3], 2.0 * plain[..., :3], rtol=1e-6)
    assert_exact(brighter[..., 3], plain[..., 3], "the same rays")
    assert plain[0, 0].max() == 0.0
    red = render_picture(ball, sky_file, width=32, background="#ff8000")
    np.testing.assert_allclose(red[0, 0], [1.0, 128 / 255, 0.0, 1.0], atol=1e-6)
    assert_exact(red, render_picture(ball, sky_file, width=32, background="#FF8000"), "the same computation")
    shown = render_picture(ball, sky_file, width=32)
    assert shown[..., 3].min() == 0.0
    assert 0.0 <= shown.min() <= shown.max() <= 1.0
    assert render_picture(ball, sky_file, width=32, exposure=-1.0)[16, 16, 0] < shown[16, 16, 0]


def test_colours_are_those_that_are_named():
    """Linear values of sRGB by the formula of IEC 61966-2-1."""
    assert Finish("transparent").colour is None
    np.testing.assert_allclose(Finish("white").colour, 1.0)
    half = ((128 / 255 + 0.055) / 1.055) ** 2.4
    np.testing.assert_allclose(Finish("#80ff0a").colour, [half, 1.0, 10 / 255 / 12.92], rtol=1e-12)
    empty = Picture(np.zeros((1, 1, 3), np.float32), np.zeros((1, 1), np.float32))
    finish = Finish("#336699")
    np.testing.assert_allclose(display(empty, 3.0, finish.colour)[0, 0] * 255, [0x33, 0x66, 0x99, 255], atol=1e-9)
    np.testing.assert_allclose(linear(empty, 8.0, finish.colour)[0, 0, :3], finish.colour, rtol=1e-6)


@pytest.mark.parametrize("background", ["bluish", "#12345", "#11223344", "", None, "rgb(1,2,3)", 7])
def test_colours_that_are_none(background):
    with pytest.raises(UserError, match="background must be transparent, map, a colour"):
        Finish(background)


@pytest.mark.parametrize("stops", [float("nan"), float("inf"), 61.0, "bright", None])
def test_stops_that_are_none(stops):
    with pytest.raises(UserError, match="exposure must be a number of stops"):
        Finish(exposure=stops)


def test_wrong_wishes_from_python(ball, sky_file, tmp_path):
    with pytest.raises(UserError, match="no light of its own"):
        render_picture(ball)
    with pytest.raises(UserError, match="given as spherical harmonics"):
        render_picture(ball, np.ones((3, 9)), background="map")
    with pytest.raises(UserError, match="of one light, not of 2"):
        render_picture(ball, np.ones((2, 3, 9)))
    with pytest.raises(UserError, match=r"width must be an integer in \[16, 8192\]"):
        render_picture(ball, sky_file, width=9000)
    with pytest.raises(UserError, match=r"written as \.png or \.exr"):
        save_picture(tmp_path / "out.jpg", ball, sky_file)
    with pytest.raises(UserError, match="is the input"):
        save_picture(sky_file, ball, sky_file)


def test_a_saved_picture_is_the_rendered_one(ball, sky_file, tmp_path):
    options = {"width": 32, "background": "navy", "exposure": 0.5}
    for suffix, linear_light in ((".png", False), (".exr", True)):
        save_picture(tmp_path / f"out{suffix}", ball, sky_file, **options)
        saved = np.array(bitmap_module().Bitmap(str(tmp_path / f"out{suffix}")))
        rendered = render_picture(ball, sky_file, **options, scene_linear=linear_light)
        if linear_light:
            assert_exact(saved, rendered, "float32 as they are")
        else:
            np.testing.assert_allclose(saved / 255.0, rendered, atol=0.51 / 255)


def test_transfer_toward_a_camera_is_seen_from_there_alone():
    eye = View("eye", look_matrix(np.array([0.0, 0, 5]), np.array([0.0, 0, -1]), "y").tolist(), 40.0, 80, 60, 0.1, 99.0)
    with open_scene(sphere(1)) as scene:
        from dataclasses import replace

        seen = replace(scene, view=eye)
        with pytest.raises(UserError, match="light toward the camera 'eye'"):
            aim_camera(seen, Aim(look_at=([1, 0, 5], [0, 0, 0])), 64, toward_view=True)
        turned = aim_camera(seen, Aim(look_at=([0, 0, 5], [1, 0, 0])), 64, toward_view=True)
        assert turned.view.width == 80
        assert aim_camera(seen, Aim(look_at=([1, 0, 5], [0, 0, 0])), 64).view.name == "look_at"


# --- Files -----------------------------------------------------------------------------------------------------------


def read_ply(path) -> tuple[list[str], np.ndarray, np.ndarray]:
    """Properties of the vertices, vertices, and faces of a binary file, from the description of the format."""
    header, _, body = path.read_bytes().partition(b"end_header\n")
    lines = header.decode().splitlines()
    kinds = {"float": "<f4", "double": "<f8", "uchar": "u1"}
    properties = [line.split()[1:] for line in lines if line.startswith("property") and "list" not in line]
    count, faces = (int(line.split()[2]) for line in lines if line.startswith("element"))
    vertices = np.frombuffer(body, [(name, kinds[kind]) for kind, name in properties], count)
    assert "property list uchar int vertex_indices" in lines
    rest = np.frombuffer(body, [("n", "u1"), ("at", "<i4", 3)], faces, offset=vertices.nbytes)
    assert len(body) == vertices.nbytes + rest.nbytes
    assert (rest["n"] == 3).all()
    return [kind for kind, _ in properties], vertices, rest["at"]


@pytest.mark.parametrize(
    ("place", "size", "kind"),
    [
        ([0.0, 0.0, 0.0], 1.0, "float"),
        ([3.0, 1.0, 0.0], 1.0, "float"),
        ([500000.0, 5400000.0, 100.0], 10.0, "double"),
        ([0.0, 0.0, 0.0], 1e-40, "double"),
        ([0.0, 0.0, 0.0], 1e39, "double"),
    ],
)
def test_positions_of_a_coloured_mesh_do_not_move(place, size, kind, tmp_path, rng):
    ball = sphere(2)
    mesh = Mesh("ball", ball.positions * size + place, ball.normals, ball.faces, ball.albedo)
    colours = rng.integers(0, 256, (len(ball.positions), 3)).astype(np.uint8)
    write_ply(tmp_path / "out.ply", mesh, colours)
    kinds, vertices, faces = read_ply(tmp_path / "out.ply")
    assert kinds == [kind] * 3 + ["float"] * 3 + ["uchar"] * 4
    positions = np.stack([vertices[axis] for axis in "xyz"], axis=1).astype(float)
    np.testing.assert_allclose(positions, mesh.positions, rtol=0.0, atol=1e-6 * size * math.sqrt(12.0))
    assert_exact(np.stack([vertices[name] for name in ("red", "green", "blue")], axis=1), colours, "copies")
    assert_exact(np.stack([vertices[f"n{axis}"] for axis in "xyz"], axis=1), mesh.normals.astype(np.float32), "copies")
    assert (vertices["alpha"] == 255).all()
    assert_exact(faces, mesh.faces, "copies")


def test_a_stray_vertex_does_not_make_a_model_large(tmp_path):
    """A vertex at the origin that no face uses, beside a model in projected coordinates."""
    ball = sphere(2)
    positions = np.vstack([ball.positions * 10.0 + [500000.0, 5400000.0, 100.0], np.zeros(3)])
    write_ply(tmp_path / "out.ply", make_mesh(positions, ball.faces), np.zeros((len(positions), 3), np.uint8))
    assert read_ply(tmp_path / "out.ply")[0][0] == "double"


def test_other_readers_read_the_coloured_mesh(tmp_path):
    mesh = sphere(2)
    write_ply(tmp_path / "out.ply", mesh, np.full((len(mesh.positions), 3), 77, np.uint8))
    read = trimesh.load(tmp_path / "out.ply", process=False)
    np.testing.assert_allclose(read.vertices, mesh.positions, atol=1e-7)
    assert_exact(read.visual.vertex_colors, np.tile([77, 77, 77, 255], (len(mesh.positions), 1)), "copies")


def test_a_coloured_mesh_is_shaded_by_radiance_and_exposed(tmp_path):
    mesh = sphere(2)
    radiance = np.repeat(0.5 + 0.5 * mesh.normals[:, 1:2], 3, axis=1)
    scale = write_coloured_mesh(tmp_path / "out.ply", mesh, radiance)
    brighter = write_coloured_mesh(tmp_path / "brighter.ply", mesh, radiance, factor=2.0)
    assert brighter == 2.0 * scale
    plain, bright = (read_ply(tmp_path / f"{name}.ply")[1]["red"].astype(int) for name in ("out", "brighter"))
    assert (np.diff(plain[np.argsort(radiance[:, 0])]) >= 0).all()
    assert plain.max() > 200
    assert plain.min() < 10
    assert (bright >= plain).all()
    assert bright.mean() > plain.mean() + 10


def test_inputs_are_not_overwritten(ball, tmp_path):
    for name in ("one.exr", "two.exr", "0000.png", "ball.prt", "ball.ply"):
        (tmp_path / name).write_bytes(b"kept")
    maps = [tmp_path / "one.exr", tmp_path / "two.exr"]
    for output, names, wish, inputs in (
        (tmp_path, ["one", "two"], Wish(".exr"), maps),
        (tmp_path, ["0000", "0001"], Wish(".png"), [tmp_path / "0000.png"]),
    ):
        with pytest.raises(UserError, match="is the input"):
            check_output(str(output), inputs, names, wish, several=True)
    check_output(str(tmp_path), maps, ["one", "two"], Wish(".png"), several=True)
    with pytest.raises(UserError, match="is the input"):
        check_output(str(tmp_path / "one.exr"), maps[:1], ["one"], Wish(), several=False)
    for source in (str(tmp_path / "ball.ply"), "ball.ply", "elsewhere/ball.ply"):
        with pytest.raises(UserError, match="is the input"):
            check_source(str(tmp_path / "ball.ply"), replace(ball, source=source), str(tmp_path / "ball.prt"))
    check_source(str(tmp_path / "other.ply"), replace(ball, source="ball.ply"), str(tmp_path / "ball.prt"))


@pytest.mark.parametrize(("name", "suffix"), [("ball", ".ply"), ("skin", ".png")])
def test_sources_in_a_folder_of_results_are_not_overwritten(ball, tmp_path, capsys, name, suffix):
    """The mesh that the transfer was made from, and the texture that it names."""
    (tmp_path / "ball.ply").write_bytes(b"ply\ncomment TextureFile skin.png\nend_header\n")
    (tmp_path / "skin.png").write_bytes(b"kept")
    (tmp_path / "other.ply").write_bytes(b"ply\n")
    made = replace(ball, source="ball.ply")
    with pytest.raises(UserError, match=f"/{name}{suffix}: is the input"):
        check_source(str(tmp_path), made, str(tmp_path / "ball.prt"), ("other", name), suffix)
    check_source(str(tmp_path), made, str(tmp_path / "ball.prt"), ("other", "new"), suffix)
    made.save(tmp_path / "ball.prt")
    maps = [part for stem in ("other", name) for part in ("--environment", str(tmp_path / f"{stem}.hdr"))]
    assert main(["relight", str(tmp_path / "ball.prt"), *maps, "--format", suffix[1:], "-o", str(tmp_path)]) == 2
    assert "is the input" in capsys.readouterr().err


def test_wishes_that_do_not_show_are_told():
    wish = Wish(".npz", 64, Aim(fov=30.0, up="z"), Finish("white", 1.0))
    assert wish.unused("out.npz") == ["width", "fov", "background", "exposure"]
    assert wish.unused("out.ply") == ["width", "fov", "background"]
    assert wish.unused("out.png") == []
    assert wish.unused("folder") == ["width", "fov", "background", "exposure"]
