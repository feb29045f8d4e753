"""OpenEXR: windows, parts, layers and headers; the pixels are OpenEXR's own."""

import itertools
import logging
import struct
import tempfile
import tracemalloc
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from slepian_prt.errors import UserError
from slepian_prt.lighting.environment import read_environment
from slepian_prt.lighting.formats.exr_header import Channel, Part, Window, read_headers
from slepian_prt.lighting.formats.exr_layers import choose_layer
from slepian_prt.lighting.map_files import file_rows
from tests.numerics import assert_exact

KINDS = {
    "scanline": {"type": OpenEXR.scanlineimage},
    "tiled": {"type": OpenEXR.tiledimage, "tiles": OpenEXR.TileDescription()},
}


def header(kind="scanline", **more):
    return {"compression": OpenEXR.ZIP_COMPRESSION, **KINDS[kind], **more}


def colours(texels, prefix="", names="RGB"):
    return {prefix + name: np.ascontiguousarray(texels[..., i]) for i, name in enumerate(names)}


def write(path, *parts):
    """Parts are pairs of a header and channels, or with a name between."""
    made = [OpenEXR.Part(part[0], part[-1], *part[1:-1]) for part in parts]
    with OpenEXR.File(made) as file:
        file.write(str(path))
    return path


@pytest.fixture
def texels(rng) -> np.ndarray:
    return rng.random((32, 64, 3)).astype(np.float32)


# --- Windows ---------------------------------------------------------------------------------------------------------


def window(left, top, right, bottom):
    return np.array([left, top], np.int32), np.array([right, bottom], np.int32)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("data", "display"),
    [
        ((0, 0, 63, 31), (0, 0, 63, 31)),
        ((16, 4, 47, 19), (0, 0, 63, 31)),  # cropped
        ((0, 0, 63, 15), (0, 0, 63, 31)),  # the upper half
        ((0, 31, 63, 31), (0, 0, 63, 31)),  # a row
        ((-8, -4, 71, 35), (0, 0, 63, 31)),  # overscan
        ((-8, 5, 20, 40), (0, 0, 63, 31)),  # both
        ((100, -7, 163, 24), (100, -7, 163, 24)),  # elsewhere
        ((-200, -90, -130, -50), (-190, -85, -127, -54)),
        ((64, 0, 127, 31), (0, 0, 63, 31)),  # beside it: nothing is seen
        ((0, 32, 63, 63), (0, 0, 63, 31)),  # below
    ],
)
def test_the_map_is_the_display_window(data, display, kind, tmp_path, rng):
    world = rng.random((200, 400, 3)).astype(np.float32)  # at row, column of the plane, from (-100, -200)
    x, y, right, bottom = data
    stored = world[100 + y : 101 + bottom, 200 + x : 201 + right]
    seen = np.zeros_like(world)
    seen[100 + y : 101 + bottom, 200 + x : 201 + right] = stored
    expected = seen[100 + display[1] : 101 + display[3], 200 + display[0] : 201 + display[2]]
    more = {"dataWindow": window(*data), "displayWindow": window(*display)}
    rows = file_rows(write(tmp_path / "map.exr", (header(kind, **more), colours(stored))))
    assert_exact(rows.read(0, 32), expected, because="a copy")
    for begin, end in [(0, 1), (3, 5), (12, 32), (31, 32)]:
        assert_exact(rows.read(begin, end), expected[begin:end], because="a copy")


def test_twice_as_wide_as_high_is_asked_of_the_display_window(tmp_path, texels):
    more = {"displayWindow": window(0, 0, 63, 63)}
    with pytest.raises(UserError, match="is 64 x 64 texels"):
        file_rows(write(tmp_path / "map.exr", (header(**more), colours(texels))))


def test_absurd_windows_are_told_before_memory_is_taken(tmp_path, texels):
    content = bytearray(write(tmp_path / "map.exr", (header(), colours(texels))).read_bytes())
    for name, box in itertools.product((b"dataWindow", b"displayWindow"), ((0, 0, 2**31 - 2, 2**30 - 2), (9, 9, 0, 0))):
        changed, at = bytearray(content), content.index(name + b"\0box2i\0") + len(name) + 11
        changed[at : at + 16] = struct.pack("<4i", *box)
        (tmp_path / "map.exr").write_bytes(changed)
        with pytest.raises(UserError, match=r"at most 65536|no light in it"):
            file_rows(tmp_path / "map.exr")


# --- Parts -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("number", [0, 1, 2])
def test_any_part_is_read_by_rows(kind, number, texels, tmp_path, rng):
    others = [rng.random(texels.shape).astype(np.float32) for _ in range(2)]
    images = [*others[:number], texels, *others[number:]]
    names = ["albedo", "depth"]
    names.insert(number, "beauty")
    parts = [(header(kind), name, colours(image)) for name, image in zip(names, images, strict=True)]
    rows = file_rows(write(tmp_path / "map.exr", *parts))
    assert_exact(rows.read(0, 32), texels, because="a copy")
    assert_exact(rows.read(17, 23), texels[17:23], because="a copy")


def test_no_copy_of_a_part_is_left(texels, tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    Path(tempfile.gettempdir()).mkdir()
    path = write(
        tmp_path / "map.exr", (header(), "z", {"Z": texels[..., 0].copy()}), (header(), "rgba", colours(texels))
    )
    assert_exact(read_environment(path).texels, texels, because="a copy")
    assert list(Path(tempfile.gettempdir()).iterdir()) == []


@pytest.mark.parametrize("several", [False, True])
def test_large_files_are_not_held(several, tmp_path):
    """A block of rows and what OpenEXR decodes of it, not the 100 MB of the map."""
    height = 2048
    texels = np.zeros((height, 2 * height, 3), np.float16)
    texels[700, 5] = 3.0
    picture = (header(), "rgba", colours(texels))
    parts = [(header(), "other", {"Z": texels[..., 0].copy()}), picture] if several else [picture]
    rows = file_rows(write(tmp_path / "map.exr", *parts))
    tracemalloc.start()
    try:
        total = sum(float(rows.read(begin, begin + 256).sum()) for begin in range(0, height, 256))
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert total == 9.0
    assert peak < 3 * 256 * 2 * height * 12


# --- The choice ------------------------------------------------------------------------------------------------------


def part(name, *channels, kind="half", **more):
    box = Window(0, 0, 63, 31)
    made = tuple(Channel(c, kind, (1, 1)) for c in channels)
    plain = {"view": "", "views": (), "tiled": False, "deep": False, "cube": False, "chromaticities": None}
    return Part(name=name, channels=made, data=box, display=box, begin=0, end=0, chunks=1, **(plain | more))


def rgb(prefix="", names="RGB"):
    return tuple(prefix + c for c in names)


# The parts, and the first channel of the choice with its part.
CHOICES = {
    "plain": ([part("", *rgb(), "A")], (0, "R")),
    "plain beside a layer": ([part("", *rgb(), *rgb("sky."))], (0, "R")),
    "plain beside beauty": ([part("", *rgb(), *rgb("beauty."))], (0, "R")),
    "beside albedo": ([part("", *rgb("albedo."), *rgb("Combined."))], (0, "Combined.R")),
    "a layer alone": ([part("", *rgb("sky."))], (0, "sky.R")),
    "an albedo alone": ([part("", *rgb("albedo."))], (0, "albedo.R")),
    "noisy": ([part("", *rgb("ViewLayer.Noisy Image."), *rgb("ViewLayer.Combined."))], (0, "ViewLayer.Combined.R")),
    "a light beside all": ([part("", *rgb("RGBA_key."), *rgb("RGBA."))], (0, "RGBA.R")),
    "words": ([part("", *rgb("diffuseColor."), *rgb("room."))], (0, "room.R")),
    "numbered": ([part("", *rgb("beauty2."), *rgb("cryptoAsset00."))], (0, "beauty2.R")),
    "nuke": ([part("", "beauty.red", "beauty.green", "beauty.blue")], (0, "beauty.red")),
    "small letters": ([part("", "r", "g", "b")], (0, "r")),
    "part": ([part("depth", "Z"), part("beauty", *rgb())], (1, "R")),
    "part of two": ([part("shadow_matte", *rgb()), part("beauty", *rgb())], (1, "R")),
    "part of no name": ([part("emission", *rgb()), part("", *rgb())], (1, "R")),
    "part and layer": ([part("N", *rgb("N.", "XYZ")), part("C", *rgb("C."))], (1, "C.R")),
    "in a part": ([part("a", *rgb("a."), *rgb()), part("normal", *rgb())], (0, "R")),
    "left": ([part("", *rgb("right."), *rgb("left."))], (0, "left.R")),
    "default view": ([part("", *rgb(), *rgb("left."), views=("right", "left"))], (0, "R")),
    "view parts": ([part("c.r", *rgb(), view="right"), part("c.l", *rgb(), view="left")], (1, "R")),
    "views and passes": ([part("rgba_right", *rgb()), part("depth_left", "Z"), part("rgba_left", *rgb())], (2, "R")),
    "luminance": ([part("", "Y", "A")], (0, "Y")),
    "luminance of a layer": ([part("", "sky.Y", "Z")], (0, "sky.Y")),
    "colours before luminance": ([part("", "Y", "Z", *rgb("Combined."))], (0, "Combined.R")),
    "colours of a layer before luminance": ([part("", "Y", "A", *rgb("Combined."))], (0, "Combined.R")),
    "colours before a position": ([part("", *"XYZ", *rgb("diffuse."))], (0, "diffuse.R")),
    "colours before numbers": ([part("ids", *rgb(), kind="uint"), part("m", *rgb("m."))], (1, "m.R")),
    "flat before deep": ([part("deep", *rgb(), deep=True), part("flat", *rgb())], (1, "R")),
}

REFUSED = {
    "two layers": ([part("", *rgb("sky."), *rgb("ground."))], "names do not tell .*layer ground, layer sky"),
    "two parts": ([part("a", *rgb()), part("b", *rgb())], "part 0 'a', part 1 'b'"),
    "two pictures": ([part("beauty", *rgb()), part("rgba", *rgb())], "keep the one that is, or name it beauty"),
    "parts of light": ([part("", *rgb("diffuse."), *rgb("specular."))], "names do not tell"),
    "parts of light by other names": ([part("", *rgb("albedo."), *rgb("diffuseColor."))], "names do not tell"),
    "two eyes and two layers": (
        [part("", *rgb("left.sky."), *rgb("right.sky."), *rgb("left.hill."), *rgb("right.hill."))],
        "names do not tell",
    ),
    "depth": ([part("", "Z")], "has the channels Z, not R, G and B"),
    "position": ([part("", "X", "Y", "Z")], "has the channels X, Y, Z, not"),
    "position layer": ([part("P", "P.X", "P.Y", "P.Z")], "not R, G and B"),
    "two of three": ([part("", "R", "G", "A")], "has the channels R, G, A, not"),
    "numbers": ([part("", *rgb(), kind="uint")], "not R, G and B of half or float"),
    "chroma": ([part("", "Y", "RY", "BY")], "luminance and subsampled chroma"),
    "deep": ([part("", *rgb(), deep=True)], "deep data"),
    "none": ([part("")], "has the channels none"),
}


@pytest.mark.parametrize("name", CHOICES)
def test_which_image_is_the_light(name, caplog):
    parts, expected = CHOICES[name]
    with caplog.at_level(logging.INFO, "slepian_prt"):
        chosen = choose_layer(Path("map.exr"), parts)
    assert (chosen.part, chosen.channels[0].name) == expected
    images = sum(name.lower().endswith((".r", "red")) or name in "Rr" for p in parts for name in _flat_names(p))
    assert ("holds several images; the light is" in caplog.text) == (images > 1)
    assert ("which is taken as the light" in caplog.text) == (name in ("an albedo alone", "colours before a position"))


def _flat_names(one: Part) -> list[str]:
    return [c.name for c in one.channels if not one.deep and c.kind != "uint"]


@pytest.mark.parametrize("name", REFUSED)
def test_no_image_that_is_the_light_rather_than_another(name):
    parts, message = REFUSED[name]
    with pytest.raises(UserError, match=message) as caught:
        choose_layer(Path("map.exr"), parts)
    assert "\n" not in str(caught.value)


def test_the_choice_is_read_and_said(texels, tmp_path, caplog):
    albedo = header(), "albedo", colours(texels[::-1], "albedo.")
    path = write(tmp_path / "map.exr", albedo, (header(), "rgba", colours(texels)))
    with caplog.at_level(logging.INFO, "slepian_prt"):
        assert_exact(read_environment(path).texels, texels, because="a copy")
    assert "holds several images; the light is part 1 'rgba', not part 0 'albedo' layer albedo" in caplog.text


# --- Headers ---------------------------------------------------------------------------------------------------------


def test_headers_say_what_openexr_wrote(texels, tmp_path):
    numbers = {"id": np.zeros((16, 32), np.uint32), "half": np.zeros((16, 32), np.float16)}
    primaries = (0.7, 0.3, 0.2, 0.8, 0.1, 0.1, 0.31, 0.33)
    shared = {"chromaticities": primaries, "displayWindow": window(0, 0, 9, 4)}
    path = write(
        tmp_path / "map.exr",
        (header(view="left", **shared), "first", colours(texels)),
        (header("tiled", dataWindow=window(-3, 4, 28, 19), **shared), "second", numbers),
    )
    first, second = read_headers(path)
    assert (first.name, first.view, first.tiled, first.cube, first.deep) == ("first", "left", False, False, False)
    assert second.channels == (Channel("half", "half", (1, 1)), Channel("id", "uint", (1, 1)))
    assert (second.name, second.tiled, second.data, second.display) == (
        "second",
        True,
        Window(-3, 4, 28, 19),
        Window(0, 0, 9, 4),
    )
    np.testing.assert_allclose(first.chromaticities.ravel(), primaries, rtol=1e-7)  # stored in float32


@pytest.mark.parametrize("several", [False, True])
def test_the_faces_of_a_cube_are_refused(several, texels, tmp_path):
    cube = header(envmap=OpenEXR.ENVMAP_CUBE), "rgba", colours(texels)
    depth = header(), "depth", {"Z": texels[..., 0].copy()}
    with pytest.raises(UserError, match="six faces of a cube"):
        read_environment(write(tmp_path / "map.exr", *([depth, cube] if several else [cube])))
    flat = header(envmap=OpenEXR.ENVMAP_LATLONG), colours(texels)
    assert_exact(read_environment(write(tmp_path / "map.exr", flat)).texels, texels, because="a copy")


def raw_file(version, channels, kind):
    """A header alone, as the file format's description has it."""
    listed = b"".join(name + b"\0" + struct.pack("<iIii", 1, 0, x, y) for name, x, y in channels) + b"\0"
    box = struct.pack("<4i", 0, 0, 63, 31)
    found = b""
    for name, type_, value in [
        (b"channels", b"chlist", listed),
        (b"compression", b"compression", b"\0"),
        (b"dataWindow", b"box2i", box),
        (b"displayWindow", b"box2i", box),
        (b"lineOrder", b"lineOrder", b"\0"),
        (b"type", b"string", kind),
    ]:
        found += name + b"\0" + type_ + b"\0" + struct.pack("<I", len(value)) + value
    return b"\x76\x2f\x31\x01" + struct.pack("<I", version) + found + b"\0"


@pytest.mark.parametrize(
    ("version", "channels", "kind", "message"),
    [
        (0x802, [(b"B", 1, 1), (b"G", 1, 1), (b"R", 1, 1)], b"deepscanline", "deep data"),
        (0x802, [(b"B", 1, 1), (b"G", 1, 1), (b"R", 1, 1)], b"deeptile", "deep data"),
        (2, [(b"BY", 2, 2), (b"RY", 2, 2), (b"Y", 1, 1)], b"scanlineimage", "luminance and subsampled chroma"),
        (2, [(b"B", 2, 2), (b"G", 1, 1), (b"R", 2, 2)], b"scanlineimage", "are subsampled"),
    ],
)
def test_what_is_not_read_is_named(version, channels, kind, message, tmp_path):
    (tmp_path / "map.exr").write_bytes(raw_file(version, channels, kind))
    with pytest.raises(UserError, match=message):
        read_environment(tmp_path / "map.exr")


def test_alpha_changes_nothing(texels, tmp_path, rng):
    alpha = {"A": rng.random((32, 64)).astype(np.float32)}
    path = write(tmp_path / "map.exr", (header(), colours(texels) | alpha))
    assert_exact(read_environment(path).texels, texels, because="a copy")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("several", [False, True])
def test_damage_is_told_in_a_line_and_nothing_else_is_printed(kind, several, texels, tmp_path, capfd, rng):
    texels = np.repeat(np.repeat(texels[::8, ::8], 8, axis=0), 8, axis=1)  # so that they are compressed
    picture = header(kind), "rgba", colours(texels)
    depth = header(kind), "depth", {"Z": texels[..., 0].copy()}
    whole = write(tmp_path / "map.exr", *([depth, picture] if several else [picture])).read_bytes()
    for size in [5, 8, 50, 200, 300, 700, len(whole) // 2, len(whole) - 1]:
        (tmp_path / "map.exr").write_bytes(whole[:size])
        with pytest.raises(UserError, match="cannot be read as an environment map") as caught:
            read_environment(tmp_path / "map.exr")
        assert "\n" not in str(caught.value)
    for _ in range(20):  # pixels that do not decompress
        changed = bytearray(whole)
        for at in rng.integers(len(whole) // 2, len(whole), 20):
            changed[at] ^= 0xFF
        (tmp_path / "map.exr").write_bytes(changed)
        with pytest.raises(UserError, match=r"map\.exr: ") as caught:
            read_environment(tmp_path / "map.exr")
        assert "\n" not in str(caught.value)
    assert capfd.readouterr().err == ""
