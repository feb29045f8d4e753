"""Scenes of Mitsuba that are wrong, each said in one line with its file and line; and their parameters."""

import numpy as np
import pytest
import trimesh

from slepian_prt.errors import UserError
from slepian_prt.renderer.variants import bitmap_module
from slepian_prt.scene.loading import open_scene
from slepian_prt.scene.mitsuba.errors import load_failure
from tests.numerics import assert_exact

BALL = '<shape type="sphere" id="ball"><bsdf type="diffuse"/></shape>'
GROUP = '<shape type="shapegroup" id="{}">{}</shape>'
CAMERA = '<sensor type="perspective" id="camera">{}</sensor>'


PICTURE = (
    '<bsdf type="diffuse">\n<texture type="bitmap" name="reflectance"><string name="filename" value="picture.png"/>'
    "</texture></bsdf>"
)


def textured(file: str) -> str:
    return f'<shape type="sphere">\n{PICTURE.replace("picture.png", file)}</shape>'


def mesh(kind: str, file: str, bsdf: str = "") -> str:
    return f'<shape type="{kind}" id="mesh"><string name="filename" value="{file}"/>{bsdf}</shape>'


def instance(of: str) -> str:
    return f'<shape type="instance"><ref id="{of}"/></shape>'


@pytest.fixture
def scene(tmp_path):
    """A writer of scenes: a diffuse ball in the second line, and what is given from the third on."""

    def write(content: str, name: str = "scene.xml"):
        path = tmp_path / name
        path.write_text(f'<scene version="3.0.0">\n{BALL}\n{content}\n</scene>')
        return path

    return write


@pytest.fixture
def damaged(tmp_path):
    """Files that are cut off, or no pictures and meshes at all."""
    ball = tmp_path / "ball.ply"
    trimesh.creation.icosphere(1).export(ball)
    (tmp_path / "cut.ply").write_bytes(ball.read_bytes()[:-500])
    picture = tmp_path / "picture.png"
    pixels = np.random.default_rng(1).integers(0, 255, (32, 32, 3), dtype=np.uint8)
    bitmap_module().Bitmap(pixels).write(str(picture))
    (tmp_path / "cut.png").write_bytes(picture.read_bytes()[:1000])
    (tmp_path / "text.png").write_text("not a picture" * 9)
    (tmp_path / "text.obj").write_text("v 1 2\nf 1 2 3\n")
    (tmp_path / "empty.obj").touch()
    (tmp_path / "points.obj").write_text("v 1 2 3\n")
    return tmp_path


# What stands in a scene from its third line on, and what is said of it.
WRONG = {
    "no texture": (textured("gone.png"), r"line 5: texture 'bitmap': gone\.png: no such file"),
    "cut texture": (textured("cut.png"), r"line 5: texture 'bitmap': .*cut\.png: is damaged"),
    "text as texture": (textured("text.png"), r"line 5: texture 'bitmap': text\.png: no picture"),
    "no mesh": (mesh("ply", "gone.ply"), r"line 3: shape 'ply': gone\.ply: no such file"),
    "empty mesh": (mesh("obj", "empty.obj"), r"line 3: shape 'obj': .*empty\.obj: the file is empty"),
    "no faces": (mesh("obj", "points.obj"), r"line 3: shape 'obj': points\.obj: it has no faces"),
    "cut mesh": (mesh("ply", "cut.ply"), r"line 3: shape 'ply': .*cut\.ply: is damaged"),
    "text as mesh": (mesh("obj", "text.obj"), r"line 3: shape 'obj': .*text\.obj.*could not parse line \"v 1 2\""),
    "no map": ('<emitter type="envmap"><string name="filename" value="gone.exr"/></emitter>', r"gone\.exr: no such"),
    "no spectrum": (
        '<shape type="cube">\n<bsdf type="diffuse">\n<spectrum name="reflectance" filename="gone.spd"/></bsdf></shape>',
        r"line 5: .*gone\.spd: no such file",
    ),
    "no plugin": ('<shape type="teapot"/>', r"line 3: shape 'teapot': Mitsuba has no such plugin in the variant "),
    "wrong kind of value": (
        '<shape type="sphere"><string name="radius" value="big"/></shape>',
        r"line 3: shape 'sphere': .*expected float, got string",
    ),
    "no number": ('<shape type="sphere">\n<float name="radius" value="big"/></shape>', r"line 4: .*\"big\""),
    "no property": (
        '<shape type="sphere">\n<bsdf type="diffuse"><float name="colour" value="1"/><float name="gloss" value="1"/>'
        "</bsdf></shape>",
        r"line 4: 'diffuse' has no property 'colour', 'gloss'",
    ),
    "missing property": ('<shape type="ply"/>', r"line 3: shape 'ply': its property 'filename' is missing"),
    "no object of that id": ('<shape type="cube"><ref id="paint"/></shape>', r"line 3: nothing has the id 'paint'"),
    "id twice": ('\n<shape type="cube" id="ball"/>', r"line 4: the id 'ball' is that of line 2 too"),
    "two skies": ('<emitter type="constant"/><emitter type="constant"/>', r"Only one environment emitter"),
    "instance of an instance": (
        GROUP.format("a", '<shape type="sphere"/>') + "\n" + GROUP.format("b", instance("a")) + instance("b"),
        r"line 4: shape 'shapegroup': an instance may not hold instances",
    ),
    "instance of nothing": (GROUP.format("a", "") + "\n" + instance("a"), r"line 4: the shapegroup .* no shapes"),
    "instance without a group": ('<shape type="instance"/>', r"line 3: shape 'instance': .*'shapegroup'"),
    "no attribute": ('<shape kind="sphere"/>', r"line 3: unexpected attribute \"kind\""),
    "no XML": ('<shape type="sphere">', r"line 4: its XML is malformed: mismatched tag"),
    "no included file": ('<include filename="gone.xml"/>', r"line 3: included file \"gone\.xml\" not found"),
}


@pytest.mark.parametrize("name", WRONG)
def test_mistakes_are_told_with_file_and_line(name, scene, damaged, capfd):
    """Nothing else is told: Mitsuba's own log goes to standard output, where the plan of effects does."""
    content, message = WRONG[name]
    path = scene(content)
    with pytest.raises(UserError, match=message) as told:
        open_scene(path).__enter__()
    assert str(told.value).startswith(f"{path}: Mitsuba cannot load the scene (")
    assert "\n" not in str(told.value)
    assert "[parser.cpp" not in str(told.value)
    assert capfd.readouterr() == ("", "")


def test_mistakes_in_included_files(scene, tmp_path):
    """The file of the mistake is named, not that which includes it."""
    inner = tmp_path / "inner.xml"
    inner.write_text('<scene version="3.0.0">\n\n<shape type="teapot"/></scene>')
    path = scene(f'<include filename="{inner.name}"/>')
    with pytest.raises(UserError, match=r"scene\.xml: .* \(.*inner\.xml, line 3: shape 'teapot'"):
        open_scene(path).__enter__()


def test_files_that_include_each_other(scene):
    path = scene('<include filename="scene.xml"/>')
    with pytest.raises(UserError, match=r"files include each other in a circle\); correct it there$"):
        open_scene(path).__enter__()


def test_what_mitsuba_may_say_in_other_words_is_passed_on_in_one_line():
    told = load_failure(RuntimeError("[shape.cpp:12] [Shape] This\n  is new!"), "scene.xml", "llvm_ad_rgb")
    assert str(told) == "scene.xml: Mitsuba cannot load the scene (This is new); correct it there"


# --- What transport does not need ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "integrator",
    [
        '<integrator type="none-such"/>',
        '<integrator type="slepian_prt"><string name="transfer" value="to-come.prt"/></integrator>',
        '<integrator type="aov"><string name="aovs" value="x:none"/><integrator type="path"/></integrator>',
    ],
)
def test_integrators_need_not_be_there(integrator, scene):
    with open_scene(scene(integrator)) as opened:
        assert [part.name for part in opened.parts] == ["ball"]


@pytest.mark.parametrize(
    "camera", [CAMERA.format('<film type="none-such"/>'), CAMERA.format('<sampler type="none-such"/>')]
)
def test_cameras_need_not_be_loadable_unless_one_is_asked_for(camera, scene, caplog):
    path = scene(camera)
    with caplog.at_level("INFO", "slepian_prt"), open_scene(path) as opened:
        assert opened.view is None
        assert [part.name for part in opened.parts] == ["ball"]
    (remark,) = caplog.messages
    assert "line 3: " in remark
    assert "none-such" in remark
    assert "cannot load a camera of the scene (" in remark
    assert remark.endswith("); it is loaded without cameras")
    with pytest.raises(UserError, match="none-such"):
        open_scene(path, view=0).__enter__()


def test_a_mistake_beside_a_camera_is_the_one_that_is_told(scene):
    path = scene(CAMERA.format('<film type="hdrfilm"/>') + '\n<shape type="teapot"/>')
    with pytest.raises(UserError, match="line 4: shape 'teapot'"):
        open_scene(path).__enter__()


def test_a_file_of_one_shape(tmp_path):
    path = tmp_path / "ball.xml"
    path.write_text('<shape version="3.0.0" type="sphere"><float name="radius" value="2"/></shape>')
    with open_scene(path) as opened:
        np.testing.assert_allclose(np.linalg.norm(opened.mesh.positions, axis=1), 2.0, rtol=1e-6)


# --- Parameters ------------------------------------------------------------------------------------------------------

RADIUS = (
    '<default name="gray" value="0.25"/><shape type="sphere" id="other"><float name="radius" value="$r"/>'
    '<boolean name="flip_normals" value="$inside"/>\n'
    '<bsdf type="diffuse"><rgb name="reflectance" value="$gray"/></bsdf></shape>'
)


@pytest.mark.parametrize("inside", [True, "true", np.bool_(True)])
@pytest.mark.parametrize("radius", [3, 3.0, "3", np.float32(3.0)])
def test_parameters_are_numbers_booleans_and_strings(radius, inside, scene):
    with open_scene(scene(RADIUS), parameters={"r": radius, "inside": inside}) as opened:
        part = opened.parts[1]
        rows = slice(part.first, part.first + part.count)
        positions, normals = opened.mesh.positions[rows], opened.mesh.normals[rows]
    np.testing.assert_allclose(positions, -3.0 * normals, atol=1e-5)
    np.testing.assert_allclose(opened.mesh.albedo[rows], 0.25, rtol=1e-6)


def test_a_parameter_without_a_value(scene):
    with pytest.raises(UserError) as told:
        open_scene(scene(RADIUS), parameters={"r": 1}).__enter__()
    assert str(told.value).endswith(
        "scene.xml: its parameter $inside (line 3) has no value; give `parameters={'inside': …}`"
    )


def test_parameters_that_a_scene_does_not_have(scene, tmp_path):
    (tmp_path / "inner.xml").write_text(f'<scene version="3.0.0">{RADIUS}</scene>')
    path = scene('<include filename="inner.xml"/>')
    parameters = {"r": 1, "inside": False, "size": 4, "spp": 16}
    with pytest.raises(UserError, match=r"scene\.xml: has no parameters \$size, \$spp; it has \$gray, \$inside, \$r$"):
        open_scene(path, parameters=parameters).__enter__()
    with pytest.raises(UserError, match=r"scene\.xml: has no parameter \$r; it has no parameters$"):
        open_scene(scene(""), parameters={"r": 1}).__enter__()


@pytest.mark.parametrize("name", ["config", "filename"])
def test_parameters_that_cannot_be_handed_over(name, scene):
    with pytest.raises(UserError, match=rf"takes no parameter \${name} from outside; rename it"):
        open_scene(scene(RADIUS), parameters={name: 1}).__enter__()


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"r": [1, 2]}, r"^parameters must be numbers, booleans or strings; 'r' is \[1, 2\]"),
        ({"a b": 1}, r"^parameters must have names of letters, digits and underscores, not 'a b'"),
        ({1: 1}, r"^parameters must have names .*, not 1"),
        ("r=1", r"^parameters must be a dict of names and values, not 'r=1'"),
    ],
)
def test_parameters_that_make_no_sense(parameters, message, scene):
    with pytest.raises(UserError, match=message):
        open_scene(scene(RADIUS), parameters=parameters).__enter__()


def test_parameters_of_what_has_none(damaged):
    with pytest.raises(UserError, match=r"ball\.ply: is no Mitsuba \.xml scene, and no other takes parameters"):
        open_scene(damaged / "ball.ply", parameters={"r": 1}).__enter__()


# --- Textures without coordinates ------------------------------------------------------------------------------------


def test_a_texture_on_a_mesh_without_coordinates_is_remarked_on(scene, damaged, caplog):
    path = scene(mesh("ply", "ball.ply", PICTURE) + f'<shape type="cube">{PICTURE}</shape>')
    with caplog.at_level("INFO", "slepian_prt"), open_scene(path):
        pass
    assert [text for text in caplog.messages if "coordinates" in text] == [
        f"{path}: shape 'mesh' has a texture and no texture coordinates, so that each face shows a triangle of it; "
        "give the mesh coordinates"
    ]


def test_warnings_of_mitsuba_stay_out_of_the_output(scene, capfd):
    """They go to standard output, where the plan does: of a number of samples, of a sphere that is no sphere."""
    sampler = '<sampler type="multijitter"><integer name="sample_count" value="17"/></sampler>'
    stretched = '<shape type="sphere"><transform name="to_world"><scale x="2"/></transform></shape>'
    with open_scene(scene(CAMERA.format(sampler) + stretched)):
        pass
    assert capfd.readouterr() == ("", "")


def test_the_log_of_mitsuba_is_as_before(scene):
    mi = bitmap_module()
    level = mi.log_level()
    resolver = mi.file_resolver()
    with open_scene(scene("")):
        assert mi.log_level() == level
    assert_exact(len(mi.file_resolver()), len(resolver), "the folder of the scene is forgotten")


def test_a_reason_that_quotes_a_long_value_stays_short(tmp_path):
    path = tmp_path / "long.xml"
    path.write_text(f'<scene version="3.0.0"><shape type="{"x" * 5000}"/></scene>')
    with (
        pytest.raises(UserError, match=r"Mitsuba cannot load the scene .*x … x.*; correct it there$") as told,
        open_scene(path),
    ):
        pass
    assert len(str(told.value)) < 400 + 200 + len(str(path))
