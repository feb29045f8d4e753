"""Pictures that are gathered in the scene, or textured from the mesh file, that transfer was made from."""

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

import slepian_prt as sp
from slepian_prt.compression.stream import compress
from slepian_prt.errors import UserError
from slepian_prt.lighting.emitters import environment_emitter
from slepian_prt.lighting.environment import about_up, make_environment
from slepian_prt.lighting.projection import project_environment
from slepian_prt.relighting.drawing import scene_pictures
from slepian_prt.relighting.drawing.camera import relit_camera
from slepian_prt.relighting.drawing.drawings import open_drawing
from slepian_prt.relighting.drawing.render import render_picture
from slepian_prt.relighting.drawing.scene_pictures import environment_of, scene_camera
from slepian_prt.relighting.drawing.shots import SceneDrawing, VertexDrawing
from slepian_prt.relighting.drawing.taking import Lit, Taking
from slepian_prt.relighting.relight import relight
from slepian_prt.relighting.source import locate_source
from slepian_prt.renderer.variants import mitsuba
from slepian_prt.scene.view import Aim, View
from slepian_prt.transport.effects import Effect
from slepian_prt.transport.transfer import precompute
from tests.numerics import assert_exact
from tests.relighting.drawing.test_render import gradient_sky
from tests.relighting.drawing.test_texture_lookup import bilinear

BALL = (
    '<shape type="sphere" id="ball"><point name="center" x="0" y="0" z="1"/><float name="radius" value="0.5"/>'
    '<bsdf type="diffuse"><rgb name="reflectance" value="1"/></bsdf></shape>'
)
MIRROR = (
    '<shape type="rectangle" id="mirror"><transform name="to_world"><scale value="3"/><rotate y="1" angle="90"/>'
    '<translate x="-2"/></transform><bsdf type="conductor"/></shape>'
)
EPSILON = np.finfo(np.float32).eps
EYE, MIRRORED = (2.0, 0.0, -1.0), (-6.0, 0.0, -1.0)


def write_scene(path, *shapes: str):
    path.write_text(f'<scene version="3.0.0">{"".join(shapes)}</scene>')
    return path


def packed_scene(path):
    return compress(precompute(path, bandlimit=2, samples=64), "none")


@pytest.fixture(scope="module")
def ball(tmp_path_factory):
    return packed_scene(write_scene(tmp_path_factory.mktemp("scenes") / "ball.xml", BALL))


@pytest.fixture(scope="module")
def white():
    return make_environment(np.ones((8, 16, 3)), name="white")


def test_a_mirror_shows_what_its_mirrored_eye_sees(ball, tmp_path):
    """The ball in the mirror is, but for the sides, that from behind the mirror, and the sky that beyond it."""
    sky = make_environment(gradient_sky())
    room = write_scene(tmp_path / "room.xml", BALL, MIRROR)
    asked = {"width": 48, "fov": 14.0, "scene_linear": True}
    reflected = render_picture(ball, sky, look_at=(EYE, (-4.0, 0.0, 1.0)), scene=room, spp=64, **asked)
    direct = render_picture(ball, sky, look_at=(MIRRORED, (0.0, 0.0, 1.0)), background="map", **asked)[:, ::-1]
    assert_exact(reflected[..., 3], np.ones_like(reflected[..., 3]), "the mirror fills the picture")
    metal = reflected[..., :3] / np.maximum(direct[..., :3], 1e-6)
    # A mirror without a material reflects all. 64 jittered samples at edges of contrast below two; elsewhere the light
    # hardly changes within a pixel.
    assert np.median(np.abs(metal - 1.0)) < 2e-3
    assert np.mean(np.abs(metal - 1.0) > 0.02) < 0.03


def test_transfer_that_is_not_compressed_is_gathered_too(tmp_path):
    """As from a file that holds all of it."""
    room = write_scene(tmp_path / "room.xml", BALL, MIRROR)
    transfer = precompute(write_scene(tmp_path / "ball.xml", BALL), 2, 64)
    sky = make_environment(gradient_sky())
    asked = {"width": 16, "look_at": (EYE, (-4.0, 0.0, 1.0)), "scene": room, "spp": 1, "scene_linear": True}
    kept = compress(transfer, "none", coding="float32")
    found, expected = (render_picture(one, sky, **asked) for one in (transfer, kept))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-5 * expected.max())
    assert_exact(found[..., 3], np.ones_like(found[..., 3]), "the mirror fills the picture")


def test_under_the_same_light_from_everywhere_all_is_as_bright(ball, white, tmp_path):
    far = BALL.replace('x="0"', 'x="40"').replace("ball", "other").replace("diffuse", "conductor")
    far = far.replace('<rgb name="reflectance" value="1"/>', "")
    room = write_scene(tmp_path / "room.xml", BALL, far)
    look = ((40.0, 0.0, -4.0), (40.0, 0.0, 1.0))
    pixels = render_picture(ball, white, width=32, look_at=look, scene=room, scene_linear=True)
    covered = pixels[..., 3] > 0
    assert covered.any()
    assert not covered.all()
    # What is seen in the other ball is the sky, or the first ball, 64 rays of which differ from one by 1 %.
    np.testing.assert_allclose(pixels[covered][:, :3], pixels[covered][:, 3:] * np.ones(3), rtol=2e-3)


@pytest.mark.slow
def test_coverage_is_that_of_the_shapes(ball, white, tmp_path):
    plastic = BALL.replace("diffuse", "plastic").replace("reflectance", "diffuse_reflectance")
    room = write_scene(tmp_path / "room.xml", plastic)
    aim = Aim(((0.0, 0.0, -3.0), (0.0, 0.0, 1.0)))
    pixels = render_picture(ball, white, width=48, look_at=aim.look_at, scene=room, scene_linear=True, spp=64)
    alpha = relit_camera(ball, 48, aim).alpha
    # The sphere and its triangles; 64 and 25 samples of the pixels on the rim.
    assert abs(pixels[..., 3].sum() / alpha.sum() - 1.0) < 0.01
    assert_exact(pixels[24, 24, 3], np.float32(1.0), "all rays meet it")
    assert_exact(pixels[0, 0], np.zeros(4, np.float32), "none does")


def test_pictures_are_as_large_as_the_film_of_the_scenes_camera(white, tmp_path):
    camera = (
        '<sensor type="perspective"><transform name="to_world"><lookat origin="0, 0, -4" target="0, 0, 1" '
        'up="0, 1, 0"/></transform><film type="hdrfilm"><integer name="width" value="24"/><integer name="height" '
        'value="16"/></film></sensor>'
    )
    packed = packed_scene(write_scene(tmp_path / "room.xml", BALL, MIRROR, camera))
    assert render_picture(packed, white, scene_linear=True, spp=1).shape == (16, 24, 4)
    assert render_picture(packed, white, width=48, scene_linear=True, spp=1).shape == (32, 48, 4)


def texture_file(folder) -> np.ndarray:
    codes = np.random.default_rng(5).integers(20, 235, (4, 4, 3)).astype(np.uint8)
    Image.fromarray(codes).save(folder / "t.png")
    return codes


@pytest.mark.parametrize("kind", ["xml", "obj"])
def test_a_texture_is_looked_up_at_the_pixel(kind, tmp_path, white):
    """A square of two faces shows each texel, which its four vertices cannot."""
    codes = texture_file(tmp_path)
    square = "v -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
    faces = "f 1/1 2/2 3/3\nf 1/1 3/3 4/4\n"
    (tmp_path / "m.mtl").write_text("newmtl painted\nmap_Kd t.png\n")
    (tmp_path / "m.obj").write_text(f"mtllib m.mtl\n{square}usemtl painted\n{faces}")
    path = tmp_path / "m.obj"
    if kind == "xml":
        texture = '<texture name="reflectance" type="bitmap"><string name="filename" value="t.png"/></texture>'
        bsdf = f'<bsdf type="diffuse">{texture}</bsdf>'
        shape = f'<shape type="obj" id="m"><string name="filename" value="m.obj"/>{bsdf}</shape>'
        path = write_scene(tmp_path / "scene.xml", shape)
    packed = packed_scene(path)
    look = ((0.0, 0.0, 5.0), (0.0, 0.0, 0.0))
    fov = 2.0 * np.degrees(np.arctan(1.0 / 5.0))
    pixels = render_picture(packed, white, width=64, look_at=look, fov=fov, scene_linear=True)
    above = (64 - len(pixels)) // 2  # the picture may be lower than it is wide
    code = codes / 255.0
    texels = np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4)
    places = [(row, column) for row in range(12 - above, 52 - above, 8) for column in range(4, 64, 8)]
    expected = [bilinear(texels, ("repeat", "repeat"), (c + 0.5) / 64, (r + above + 0.5) / 64) for r, c in places]
    found = [pixels[row, column, :3] for row, column in places]
    # A flat square under white light sends all of it back, but for 64 rays at degree 2. Within a pixel, which is in one
    # quarter of a texel, the lookup is bilinear: its mean is that of the middle, but for the jitter.
    np.testing.assert_allclose(found, expected, rtol=0.02, atol=0.005)


def test_a_plain_scene_is_drawn_from_the_file_alone(ball):
    with mitsuba() as mi:
        assert locate_source(mi, ball, None, None, pytest.fail).scene is None
    lit = Lit(np.zeros((1, 3, 9)), np.zeros((1, len(ball.mesh.positions), 3), np.float32))
    with mitsuba() as mi:
        assert isinstance(open_drawing(mi, ball, lit, Taking(16), report=pytest.fail), VertexDrawing)


def test_a_scene_that_changed_is_told(ball, tmp_path):
    room = write_scene(tmp_path / "ball.xml", BALL.replace("0.5", "0.7"), MIRROR)
    lit = Lit(np.zeros((1, 3, 9)), np.zeros((1, len(ball.mesh.positions), 3), np.float32))
    told = []
    with mitsuba() as mi:
        moved = replace(ball, source=str(room))
        assert isinstance(open_drawing(mi, moved, lit, Taking(16), report=told.append), VertexDrawing)
        with pytest.raises(UserError, match="ball"):
            open_drawing(mi, ball, lit, Taking(16, scene=room))
    assert len(told) == 1
    assert "until then pictures are drawn from the file alone" in told[0]


def test_scenes_that_cannot_be_had(ball, tmp_path):
    with pytest.raises(UserError, match="no such file; check the path of `scene`"):
        render_picture(ball, np.zeros((3, 9)), width=16, scene=tmp_path / "no.xml")
    for wrong in (0, 65537, 2.5, "a", True):
        with pytest.raises(UserError, match=r"^spp must be an integer in \[1, 65536\], not "):
            render_picture(ball, np.zeros((3, 9)), width=16, spp=wrong)
    (tmp_path / "broken.xml").write_text("<scene")
    told = []
    with mitsuba() as mi:
        locate_source(mi, replace(ball, source=str(tmp_path / "broken.xml")), None, None, told.append)
    assert len(told) == 1
    assert "Mitsuba cannot load the scene" in told[0]


def test_scenes_are_found_beside_the_file(ball, tmp_path):
    write_scene(tmp_path / "room.xml", BALL, MIRROR)
    elsewhere = replace(ball, source="elsewhere/room.xml")
    with mitsuba() as mi:
        assert locate_source(mi, elsewhere, None, tmp_path / "room.prt", pytest.fail).path == tmp_path / "room.xml"
        assert locate_source(mi, elsewhere, None, None, pytest.fail).path is None


def test_a_scene_is_opened_again_with_its_parameters(tmp_path):
    shown = MIRROR.replace('type="conductor"', 'type="$kind"')
    source = write_scene(tmp_path / "room.xml", BALL, shown)
    made = compress(precompute(source, 2, 16, parameters={"kind": "conductor"}), "none")
    made.save(tmp_path / "room.prt")
    with mitsuba() as mi:
        opened = locate_source(mi, sp.load(tmp_path / "room.prt"), None, None, pytest.fail)
        assert opened.scene.shapes()[1].bsdf().class_name() == "SmoothConductor"


def test_what_is_not_found_is_missed_in_one_line(ball):
    rows = [
        ("mirror reflection of material 'Chrome'", "gathered"),
        ("shadows", "simulated"),
        ("caustics", "not simulated"),
    ]
    effects = tuple(Effect(name, verdict, None, None, 0, "") for name, verdict in rows)
    told = []
    with mitsuba() as mi:
        lost = replace(ball, source="gone/room.xml", effects=effects)
        assert locate_source(mi, lost, None, None, told.append).scene is None
        locate_source(mi, replace(lost, effects=effects[1:2]), None, None, pytest.fail)
    assert told == [
        "gone/room.xml is not found, so pictures lack what the file does not hold (mirror reflection of material "
        "'Chrome'); name its `scene`"
    ]


def test_several_lights_are_drawn_once(ball, white, tmp_path):
    """And what of the scene they lack is told once: here the bounces of a lamp that is new."""
    unknown = '<emitter type="spot" id="lamp"><rgb name="intensity" value="0, 0, 1e-9"/></emitter>'
    room = write_scene(tmp_path / "room.xml", BALL, MIRROR, unknown)
    lighting = np.stack([project_environment(white, 2), 3.0 * project_environment(white, 2)])
    lit = Lit(lighting, relight(ball, lighting))
    look = Aim((EYE, (-4.0, 0.0, 1.0)))
    told = []
    with mitsuba() as mi:
        drawing = open_drawing(mi, ball, lit, Taking(16, look, room, 4), report=told.append)
        assert isinstance(drawing, SceneDrawing)
        first, second = drawing.picture(0), drawing.picture(1)
        again = drawing.picture(0)
    np.testing.assert_allclose(second.radiance, 3.0 * first.radiance, rtol=1e-4)
    assert_exact(again.radiance, first.radiance, "kept")
    assert told == [
        "ball.xml does not know the light of lamp: it falls on its shapes, but what they send each other of it is "
        "missing"
    ]


def test_without_a_width_a_picture_is_as_wide_as_the_film(ball, tmp_path):
    """As of one that is drawn from the file alone; 800 pixels where the scene has no camera."""
    room = write_scene(tmp_path / "room.xml", BALL, MIRROR)
    filmed = replace(ball, view=View("cam", np.eye(4).tolist(), 40.0, 24, 16, 0.1, 10.0))
    lit = Lit(np.zeros((1, 3, 9)), np.zeros((1, len(ball.mesh.positions), 3), np.float32))
    with mitsuba() as mi:
        drawing = open_drawing(mi, filmed, lit, Taking(scene=room, spp=1))
        assert isinstance(drawing, SceneDrawing)
        assert drawing.picture(0).alpha.shape == (16, 24)
        loaded = mi.load_file(str(room), optimize=False)
        assert scene_camera(mi, filmed, loaded, np.zeros(3), 48, Aim()).directions.shape[:2] == (32, 48)
        assert scene_camera(mi, ball, loaded, np.zeros(3), None, Aim()).directions.shape[1] == 800


def test_the_own_sky_of_a_scene_turns(ball, tmp_path):
    """What mirrors show of it stands where the coefficients have it, and is the sky itself where it was not turned."""
    sky = '<emitter type="sunsky"><vector name="sun_direction" x="0.5" y="0.6" z="0.6"/></emitter>'
    room = write_scene(tmp_path / "room.xml", BALL, MIRROR, sky)
    turns = [about_up(degrees) for degrees in (0.0, 90.0)]
    lit = Lit(np.zeros((2, 3, 9)), np.zeros((2, len(ball.mesh.positions), 3), np.float32), own_turns=turns)
    with mitsuba() as mi:
        unturned, turned = open_drawing(mi, ball, lit, Taking(16, scene=room, spp=1)).lights
        assert unturned.environment.emitter is not None
        assert environment_emitter(mi, turned.environment)["type"] == "envmap"
    expected = project_environment(unturned.environment, 2, rotate=90.0)
    found = project_environment(turned.environment, 2)
    np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())


class Film:
    """A camera of so many pixels, of which nothing else is wanted."""

    def __init__(self, columns: int, rows: int) -> None:
        self._size = (columns, rows)

    def film(self):
        return self

    def size(self):
        return self._size


@pytest.mark.parametrize("samples", [None, 20])
def test_rare_bright_paths_are_not_lost(samples, monkeypatch):
    """Where one sample of 400 is 40 brighter, the mean is 1.1, also where a pilot says how many samples are taken."""
    rng, spread, (columns, rows) = np.random.default_rng(0), 40.0 * np.sqrt(1 / 400), (96, 64)

    def trace(_mi, _scene, _integrator, _view, pixels, numbers):
        rare = (rng.random((len(pixels), len(numbers))) < 1 / 400).mean(axis=1)
        return np.repeat(1.0 + 40.0 * rare[:, None], 4, axis=1)

    monkeypatch.setattr(scene_pictures, "_trace", trace)
    mean = float(scene_pictures._gather(None, None, None, Film(columns, rows), samples).radiance.mean())
    # Four standard deviations of a mean of at least 16 samples of each pixel.
    assert abs(mean - 1.1) < 4.0 * spread / np.sqrt(16 * rows * columns)


def test_noise_of_a_tile_is_that_of_those_around_it():
    """Batches of 1 ± d have variance 4 d²/3, samples four times that, and 1/0.02² of it are wanted."""
    pilot = np.ones((4, 40 * 40, 3))
    noisy = np.zeros((40, 40), dtype=bool)
    noisy[16:24, 16:24] = True
    pilot[:, noisy.ravel()] += 0.06 * np.array([1.0, -1.0, 1.0, -1.0])[:, None, None]
    wanted = scene_pictures._samples_wanted(pilot, 40, 40).reshape(40, 40)
    expected = np.full((40, 40), 16)
    expected[8:32, 8:32] = 48
    assert_exact(wanted, expected, "whole numbers")
    assert scene_pictures._samples_wanted(100.0 * (pilot - 0.9), 40, 40).max() == 128


def test_any_number_of_samples_can_be_drawn():
    """The last of as many as may be asked for, of a large picture."""
    import drjit as dr

    with mitsuba() as mi:
        scene = mi.load_dict({"type": "scene", "room": {"type": "sphere"}, "sky": {"type": "constant"}})
        view = mi.load_dict({"type": "perspective", "film": {"type": "hdrfilm", "width": 1024, "height": 768}})

        def look(scene, _sampler, ray):
            return mi.Color3f(0.0), mi.Float(dr.select(scene.ray_test(ray), 1.0, 0.0))

        found = scene_pictures._trace(mi, scene, look, view, np.array([5]), range(65528, 65536))
    assert_exact(found, [[0.0, 0.0, 0.0, 1.0]], "rays from within a dark ball meet it")


def test_a_map_of_coefficients_is_the_light_they_are_of():
    lighting = project_environment(make_environment(gradient_sky()), 3)
    texels = environment_of(lighting).texels
    expected = 1.0 + np.cos(np.pi * np.arange(len(texels)) / (len(texels) - 1))
    # 33 rows of the map are interpolated between, which bends a cosine by (pi / 32)^2 / 8.
    np.testing.assert_allclose(texels, np.broadcast_to(expected[:, None, None], texels.shape), atol=5e-3)
    assert texels.min() >= 0.0


def test_the_public_names_take_a_scene(ball, white, tmp_path):
    room = write_scene(tmp_path / "room.xml", BALL, MIRROR)
    sp.save_picture(tmp_path / "out.png", ball, white, width=16, scene=room, spp=2)
    assert (tmp_path / "out.png").stat().st_size > 0


POINT = (
    '<emitter type="point"{}><point name="position" x="{}" y="0" z="-1"/><rgb name="intensity" value="2"/></emitter>'
)


CORNER = "".join(
    f'<shape type="rectangle"><transform name="to_world">{turn}</transform><bsdf type="diffuse">'
    '<rgb name="reflectance" value="0.8"/></bsdf></shape>'
    for turn in ("", '<rotate y="1" angle="90"/><translate x="-1"/>')
)
SQUARE_LAMP = (
    '<shape type="rectangle"><transform name="to_world"><scale value="0.2"/><rotate x="1" angle="180"/>'
    '<translate x="{}" z="1"/></transform><emitter type="area"><rgb name="radiance" value="{}"/></emitter></shape>'
)


@pytest.mark.slow
@pytest.mark.parametrize("many", [False, True])
def test_bounces_are_scaled_with_their_lamp(many, tmp_path):
    """Half the light of each lamp is half the picture, of lamps without names and of those that are one in the file."""
    lamps = [SQUARE_LAMP.format(0, 4), SQUARE_LAMP.format(0.5, 2)]
    points = [POINT.format("", x).replace('z="-1"', 'z="0.5"') for x in np.linspace(-0.5, 0.5, 17 if many else 2)]
    path = write_scene(tmp_path / "lit.xml", CORNER, *lamps, *points)
    packed = packed_scene(path)
    assert packed.fixed.bounced.any()
    asked = {"width": 16, "look_at": ((2.0, 0.0, 2.0), (-0.5, 0.0, 0.0)), "scene_linear": True, "spp": 1}
    full, half = (render_picture(packed, **asked, fixed_lights=scale) for scale in (1.0, 0.5))
    names = dict.fromkeys(packed.fixed.names, 0.5)
    by_name = render_picture(packed, **asked, fixed_lights=names)
    assert full[..., :3].max() > 0.1
    # The same paths: sums of float32, among them one of each lamp.
    for dimmed in (half, by_name):
        np.testing.assert_allclose(dimmed[..., :3], 0.5 * full[..., :3], rtol=0, atol=32 * EPSILON * full.max())


@pytest.mark.slow
def test_lamps_cast_sharp_shadows_and_can_be_turned_off(tmp_path):
    """A point above a square: I cos / r^2 / pi of the light in the picture, and nothing without it."""
    square = (
        '<shape type="rectangle" id="floor"><bsdf type="diffuse"><rgb name="reflectance" value="1"/></bsdf></shape>'
    )
    lamp = POINT.format(' id="key"', 0).replace('z="-1"', 'z="2"')
    packed = packed_scene(write_scene(tmp_path / "lit.xml", square, lamp))
    asked = {"width": 17, "look_at": ((0.0, 0.0, 5.0), (0.0, 0.0, 0.0)), "fov": 2.0, "scene_linear": True, "spp": 8}
    lit = render_picture(packed, **asked, scene=tmp_path / "lit.xml")
    dark = render_picture(packed, **asked, scene=tmp_path / "lit.xml", fixed_lights={"key": 0.0})
    middle = lit.shape[0] // 2
    # Within 1/17 of two degrees of the middle the cosine and the distance are those of it.
    np.testing.assert_allclose(lit[middle, 8, :3], 2.0 / 4.0 / np.pi, rtol=1e-3)
    assert_exact(dark[..., :3], np.zeros_like(dark[..., :3]), "no light at all")
