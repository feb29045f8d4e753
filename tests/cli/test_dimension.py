"""`dimension`: what it writes, what it says, and bad input in one line."""

import io
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

import slepian_prt as sp
from slepian_prt.cli import main
from slepian_prt.evaluation.dimension.estimate import EffectiveDimension, effective_dimension
from slepian_prt.scene.mesh import make_mesh
from slepian_prt.transport.transfer import Transfer
from tests.conftest import bumpy
from tests.numerics import assert_exact, assert_rounded


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A mesh, its transfer whole and compressed, and a small cube."""
    folder = tmp_path_factory.mktemp("dimension")
    mesh = bumpy(3)
    trimesh.Trimesh(mesh.positions, mesh.faces, process=False).export(folder / "bumpy.ply")
    transfer = sp.precompute(folder / "bumpy.ply", bandlimit=3, samples=32)
    transfer.save(folder / "bumpy.npz")
    sp.compress(transfer, tolerance=0.05).save(folder / "bumpy.prt")
    trimesh.creation.box((1, 1, 1)).export(folder / "cube.ply")
    return folder


@pytest.fixture(scope="module")
def transfer(folder) -> Transfer:
    return sp.load_transfer(folder / "bumpy.npz")


def run(capsys, *arguments: object) -> tuple[str, str]:
    """What is printed, and what is remarked."""
    assert main([str(argument) for argument in ("dimension", *arguments)]) == 0
    printed = capsys.readouterr()
    return printed.out, printed.err


def test_arrays_are_what_python_gives(folder, transfer, tmp_path, capsys):
    out, err = run(capsys, folder / "bumpy.npz", "-o", tmp_path / "d.npz", "--error", 0.1, "--neighbourhood", 0.2)
    expected = effective_dimension(transfer, 0.1, 0.2)
    with np.load(tmp_path / "d.npz") as arrays:
        assert_rounded(arrays["dimension"], expected.dimension, 1000)
        assert_exact(arrays["positions"], transfer.positions, "a copy")
        assert_exact(arrays["faces"], transfer.mesh.faces, "a copy")
        assert (int(arrays["functions"]), float(arrays["error"])) == (16, 0.1)
        assert float(arrays["radius"]) == pytest.approx(0.2 * np.linalg.norm(np.ptp(transfer.positions, axis=0)))
    assert err == ""
    low, middle, high = (int(np.ceil(expected.quantile(part))) for part in (0.05, 0.5, 0.95))
    assert out == (
        f"{tmp_path / 'd.npz'}: effective dimension of transport over neighbourhoods of 20 % of the model's size, "
        f"error 10 %: median {middle} of 16 (coherence {1 - middle / 16:.2f}), 5 % of the surface at most {low}, "
        f"5 % at least {high}\n"
    )


def test_a_scene_is_traced_as_by_precompute(folder, transfer, tmp_path, capsys):
    options = ("--bandlimit", 3, "--samples", 32, "--neighbourhood", 0.2)
    run(capsys, folder / "bumpy.ply", "-o", tmp_path / "d.npz", *options)
    with np.load(tmp_path / "d.npz") as arrays:
        np.testing.assert_allclose(
            arrays["dimension"], effective_dimension(transfer, neighbourhood=0.2).dimension, rtol=1e-6
        )


def test_a_mesh_has_the_dimension_as_a_property_and_as_colours(folder, tmp_path, capsys):
    run(capsys, folder / "bumpy.prt", "-o", tmp_path / "d.ply", "--neighbourhood", 0.2)
    content = (tmp_path / "d.ply").read_bytes()
    header, _, body = content.partition(b"end_header\n")
    assert b"property float dimension\n" in header
    kinds = {b"float": "<f4", b"uchar": "u1", b"double": "<f8"}
    pairs = re.findall(rb"property (float|double|uchar) (\w+)\n", header)
    kind = np.dtype([(name.decode(), kinds[of]) for of, name in pairs])
    vertices = np.frombuffer(body, kind, count=int(re.search(rb"element vertex (\d+)", header)[1]))
    expected = effective_dimension(sp.load(folder / "bumpy.prt"), neighbourhood=0.2).dimension
    np.testing.assert_allclose(vertices["dimension"], expected, rtol=1e-6)
    # Viridis goes from violet to yellow: green grows with the dimension.
    assert np.corrcoef(vertices["green"].astype(float), np.log(expected))[0, 1] > 0.95


@pytest.mark.parametrize("width", [100, 120])
def test_a_picture_with_its_scale(folder, tmp_path, capsys, width):
    run(capsys, folder / "bumpy.npz", "-o", tmp_path / "d.png", "--width", width, "--neighbourhood", 0.2)
    picture = np.asarray(Image.open(io.BytesIO((tmp_path / "d.png").read_bytes())).convert("RGBA"))
    assert picture.shape[1] == width
    assert picture.shape[0] > width
    assert np.all(picture[..., 3] == 255)
    assert np.all(picture[0, 0, :3] == 255)
    middle = picture[width // 2, width // 2, :3].astype(int)
    assert np.ptp(middle) > 40  # a colour


def test_a_picture_too_narrow_for_its_scale_has_none(folder, tmp_path, capsys):
    _, err = run(capsys, folder / "bumpy.npz", "-o", tmp_path / "d.png", "--width", 99, "--neighbourhood", 0.2)
    assert err == (
        f"note: {tmp_path / 'd.png'}: 99 pixels are too few for the scale of the colours, which is left out; give a "
        "--width of 100 or more\n"
    )
    run(capsys, folder / "bumpy.npz", "-o", tmp_path / "e.png", "--width", 100, "--neighbourhood", 0.2)
    with Image.open(tmp_path / "d.png") as bare, Image.open(tmp_path / "e.png") as scaled:
        assert bare.width == 99
        assert bare.height < scaled.height - 60


@pytest.mark.parametrize(
    ("width", "title", "caption"), [(100, 3, 4), (200, 2, 2), (300, 1, 2), (420, 1, 1), (800, 1, 1), (1600, 1, 1)]
)
@pytest.mark.parametrize(("low", "high"), [(2.3, 24.0), (1.0, 2601.0), (3.1, 4.7)])
def test_no_word_of_the_scale_is_cut(width, title, caption, low, high):
    """Of an empty picture: what stands in rows of ink is the title, the bar, its numbers and the caption, as lines."""
    from slepian_prt.evaluation.dimension.picture import ColourScale, encode_picture
    from slepian_prt.relighting.drawing.pictures import Finish

    result = EffectiveDimension(np.ones(4), 2601, 0.0501, 1.0, 0.0501, np.ones(4), 4)
    scale = ColourScale(low, high)
    content = encode_picture(np.zeros((20, width, 4)), result, scale, Finish("white"))
    ink = np.asarray(Image.open(io.BytesIO(content)).convert("L")) < 160
    assert not ink[:20].any()
    assert not any(edge.any() for edge in (ink[-2:], ink[:, :2], ink[:, -2:]))
    rows = [row for row in _runs(ink.any(axis=1)) if row[1] - row[0] > 2]  # ticks that do not touch the bar are less
    assert len(rows) == title + 2 + caption
    assert min(end - start for start, end in rows) >= 7
    start, end = rows[title + 1]
    numbers = _runs(ink[start:end].any(axis=0), within=0.5 * (end - start))
    assert len(numbers) > 1
    assert len(numbers) == len(scale.ticks(max(9.0, 0.0225 * width) / (0.8 * width)))  # they stand apart


def _runs(marked: np.ndarray, within: float = 0.0) -> list[tuple[int, int]]:
    """Where what is marked begins and ends; gaps no wider than ``within`` do not count."""
    places = np.flatnonzero(marked)
    cut = np.flatnonzero(np.diff(places) > max(1.0, within))
    return list(zip(places[np.append(0, cut + 1)].tolist(), (places[np.append(cut, -1)] + 1).tolist(), strict=True))


def test_a_transparent_and_a_dark_background(folder, tmp_path, capsys):
    options = ("--width", 100, "--neighbourhood", 0.2, "--background")
    run(capsys, folder / "bumpy.npz", "-o", tmp_path / "clear.png", *options, "transparent")
    clear = np.asarray(Image.open(tmp_path / "clear.png"))
    assert clear[0, 0, 3] == 0
    assert clear[50, 50, 3] == 255
    run(capsys, folder / "bumpy.npz", "-o", tmp_path / "dark.png", *options, "#102030")
    dark = np.asarray(Image.open(tmp_path / "dark.png").convert("RGB"))
    assert dark[0, 0].tolist() == [0x10, 0x20, 0x30]
    assert dark[-20:].max() > 200  # letters are bright there


def test_an_error_that_the_file_has_itself_is_remarked_on(folder, tmp_path, capsys):
    options = ("--neighbourhood", 0.2, "--error")
    least = sp.load(folder / "bumpy.prt").predicted_error
    _, err = run(capsys, folder / "bumpy.prt", "-o", tmp_path / "d.npz", *options, 1.9 * least)
    assert re.fullmatch(
        rf"note: transfer vectors have an error of {least:.2g} themselves, which counts as dimension at an --error of "
        r"0\.\d+: give an --error of 0\.1 or more, or transfer of a smaller --tolerance and more --samples\n",
        err,
    )
    _, err = run(capsys, folder / "bumpy.prt", "-o", tmp_path / "d.npz", *options, 2.0001 * least)
    assert err == ""
    _, err = run(capsys, folder / "bumpy.npz", "-o", tmp_path / "d.npz", *options, 1.9 * least)
    assert err == ""  # of a file of no loss nothing is known


def test_what_has_no_effect_is_said(folder, tmp_path, capsys):
    _, err = run(
        capsys, folder / "bumpy.npz", "-o", tmp_path / "d.npz", "--samples", 16, "--width", 99, "--neighbourhood", 0.2
    )
    assert err.splitlines() == [
        "note: --width has no effect on .npz files",
        f"note: --samples has no effect on transfer that is traced already, as {folder / 'bumpy.npz'} is",
    ]


def test_a_mesh_that_is_too_coarse_is_remarked_on(folder, tmp_path, capsys):
    _, err = run(capsys, folder / "cube.ply", "-o", tmp_path / "d.npz", "--bandlimit", 2, "--samples", 16)
    assert re.fullmatch(
        r"note: neighbourhoods have \d vertices \(the median\), too few to tell: give a larger --neighbourhood, or a "
        r"finer mesh\n",
        err,
    )


def test_surfaces_that_are_left_out_are_named(tmp_path, capsys):
    """A mirror and glass receive nothing at vertices; of a sheet with two sides the front counts."""
    (tmp_path / "scene.xml").write_text(
        """<scene version="3.0.0">
          <shape type="rectangle" id="sheet"><bsdf type="twosided"><bsdf type="diffuse"/></bsdf></shape>
          <shape type="sphere" id="silver"><point name="center" x="0" y="0" z="2"/><bsdf type="conductor"/></shape>
          <shape type="sphere" id="drop"><point name="center" x="3" y="0" z="2"/><bsdf type="dielectric"/></shape>
        </scene>"""
    )
    options = ("--bandlimit", 2, "--samples", 16, "--neighbourhood", 0.4)
    out, err = run(capsys, tmp_path / "scene.xml", "-o", tmp_path / "d.npz", *options)
    told = next(line for line in err.splitlines() if line.startswith("note: what surfaces reflect diffusely is "))
    assert "mirror reflection of shapes 'silver', 'drop' (metal, glass)" in told
    assert told.endswith("transmission through shape 'drop' (glass)")
    assert out.endswith("; of what has two sides fronts alone count\n")
    with np.load(tmp_path / "d.npz") as arrays:
        half = len(arrays["areas"]) // 2
        assert arrays["areas"][:half].sum() == pytest.approx(4.0, rel=1e-6)
        assert not arrays["areas"][half:].any()


def test_a_picture_of_nothing_is_said_to_be_empty(folder, tmp_path, capsys):
    away = ("--look-at", "0,0,9", "0,0,20", "--width", 100, "--neighbourhood", 0.2)
    _, err = run(capsys, folder / "bumpy.npz", "-o", tmp_path / "d.png", *away)
    assert err == f"note: {tmp_path / 'd.png'}: the camera sees no front of any surface; the picture is empty\n"


@pytest.mark.parametrize(
    ("file", "output", "options", "said"),
    [
        ("bumpy.npz", "d.png", ("--error", "2"), "--error must be a number in [1e-05, 1), not 2.0"),
        (
            "bumpy.npz", "d.png", ("--neighbourhood", "0"),
            "--neighbourhood must be a number in (0, 1], a part of the model's size, not 0.0",
        ),
        ("bumpy.npz", "d.jpg", (), "d.jpg: unknown kind of output '.jpg'; name one of .png, .ply, .npz"),
        ("bumpy.npz", "none/d.png", (), "none/d.png: the folder none does not exist; create it or choose another"),
        ("bumpy.npz", "bumpy.npz", (), "bumpy.npz: is the input; choose another name for the output"),
        ("gone.prt", "d.png", (), "gone.prt: no such file; precompute it first"),
        (
            "bumpy.npz", "d.png", ("--background", "map"),
            "the map cannot be the background: no light falls on this picture; name a colour",
        ),
        ("bumpy.npz", "d.png", ("--width", "3"), "--width must be between 16 and 8192 pixels, not 3"),
        ("bumpy.ply", "d.png", ("--samples", "0"), "--samples must be an integer in [1, 65536], not 0"),
        ("bumpy.npz", "d.png", ("--fov", "190"), "--fov must be"),
    ],
)  # fmt: skip
def test_bad_input_gets_one_line(folder, monkeypatch, capsys, file, output, options, said):
    monkeypatch.chdir(folder)
    assert main(["dimension", file, "-o", output, *options]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith(f"slepian-prt: {said}")
    assert printed.err.count("\n") == 1
    assert not (folder / "d.png").exists()


def test_vertices_are_those_of_the_file_in_a_mesh(tmp_path, capsys):
    """A vertex that hard edges split is one again."""
    trimesh.creation.box((1, 1, 1)).subdivide().subdivide().export(tmp_path / "box.obj")
    count = sum(line.startswith("v ") for line in (tmp_path / "box.obj").read_text().splitlines())
    options = ("--bandlimit", 2, "--samples", 16, "--neighbourhood", 0.4, "--crease-angle", 30)
    run(capsys, tmp_path / "box.obj", "-o", tmp_path / "d.ply", *options)
    assert f"element vertex {count}\n".encode() in (tmp_path / "d.ply").read_bytes()


def test_colours_are_those_of_the_scale(tmp_path):
    """A square that faces the camera, of one dimension but for a corner: neither shade nor interpolation changes it."""
    from slepian_prt.evaluation.dimension.picture import ColourScale, draw_dimension
    from slepian_prt.relighting.drawing.camera import relit_camera
    from slepian_prt.renderer.variants import mitsuba
    from slepian_prt.scene.view import Aim

    mesh = make_mesh([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], [[0, 1, 2], [0, 2, 3]])
    transfer = sp.precompute(mesh, bandlimit=1, samples=1, effects="none")
    result = EffectiveDimension(np.array([4.0, 4.0, 4.0, 4.0]), 16, 0.05, 1.0, 0.1, np.ones(4), 4)
    scale = ColourScale(1.0, 16.0)
    with mitsuba():
        camera = relit_camera(transfer, 65, Aim(look_at=((0, 0, 8), (0, 0, 0))))
    pixels = draw_dimension(camera, mesh.normals, result, scale)
    assert pixels[32, 32, 3] == 1.0
    # ln 4 is half of ln 16: the middle of viridis, #21918c. The middle ray is half a pixel off, cos of 0.3 degrees.
    np.testing.assert_allclose(pixels[32, 32, :3], np.array([0x21, 0x91, 0x8C]) / 255.0, atol=1.5 / 255.0)


def test_a_model_that_no_light_reaches(transfer, tmp_path, capsys):
    """It has no dimension, which is not full coherence; grey is said to be what it is."""
    from slepian_prt.evaluation.dimension.picture import describe_scale

    dark = replace(transfer, vectors=np.zeros_like(transfer.vectors))
    dark.save(tmp_path / "dark.npz")
    out, _ = run(capsys, tmp_path / "dark.npz", "-o", tmp_path / "d.npz", "--neighbourhood", 0.2)
    assert out.endswith("error 5 %: none, no light arrives anywhere\n")
    assert describe_scale(effective_dimension(dark, neighbourhood=0.2)).endswith("; grey: no light")
    assert "grey" not in describe_scale(effective_dimension(transfer, neighbourhood=0.2))


def test_a_mesh_that_the_scene_reads_is_not_overwritten(folder, tmp_path, capsys):
    (tmp_path / "ball.ply").write_bytes((folder / "bumpy.ply").read_bytes())
    shape = '<shape type="ply"><string name="filename" value="ball.ply"/></shape>'
    (tmp_path / "scene.xml").write_text(f'<scene version="3.0.0">{shape}</scene>')
    assert main(["dimension", str(tmp_path / "scene.xml"), "-o", str(tmp_path / "ball.ply")]) == 2
    assert "is the input" in capsys.readouterr().err
    assert_exact(
        np.frombuffer((tmp_path / "ball.ply").read_bytes(), np.uint8),
        np.frombuffer((folder / "bumpy.ply").read_bytes(), np.uint8),
        "nothing is written",
    )


@pytest.mark.parametrize("name", ["ball.ply", "skin.png"])
def test_what_a_transfer_was_made_from_is_not_overwritten(folder, transfer, tmp_path, capsys, name):
    """The model, and a texture that it names, which only the transfer knows."""
    mesh = (folder / "bumpy.ply").read_bytes().replace(b"\n", b"\ncomment TextureFile skin.png\n", 1)
    contents = {"ball.ply": mesh, "skin.png": b"kept"}
    for file, content in contents.items():
        (tmp_path / file).write_bytes(content)
    replace(transfer, source=str(tmp_path / "ball.ply")).save(tmp_path / "b.npz")
    assert main(["dimension", str(tmp_path / "b.npz"), "-o", str(tmp_path / name)]) == 2
    assert capsys.readouterr().err == (
        f"slepian-prt: {tmp_path / name}: is the input; choose another name for the output\n"
    )
    assert all((tmp_path / file).read_bytes() == content for file, content in contents.items())
