"""Maps that are given to pages: what the browser reads against what Python reads, of files written in the tests."""

from __future__ import annotations

import dataclasses
import io
import re
import struct
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from PIL import Image

from slepian_prt.lighting.environment import read_environment
from slepian_prt.lighting.formats.exr_layers import choose_layer
from slepian_prt.lighting.map_rows import NEGATIVE_TOLERANCE
from tests.lighting.test_exr import CHOICES, KINDS, REFUSED, colours, header, raw_file, window, write
from tests.lighting.test_map_rows import negative, write_pfm
from tests.lighting.test_pictures import ORIENTATION, chunk, gamma, write_png
from tests.lighting.test_radiance import DAMAGED, PLAIN, encode, flat, repeated_bytes, repeated_texels
from tests.lighting.test_radiance import write as write_hdr
from tests.numerics import assert_exact, assert_rounded

READ = 'const { readMap } = await import("#maps"); return readMap(name, bytes.slice().buffer, options);'


@pytest.fixture(scope="module")
def texels() -> np.ndarray:
    """Smooth and noisy, as maps are, over a wide range."""
    rng = np.random.default_rng(7)
    rows, columns = np.mgrid[:64, :128] / 20.0
    smooth = np.exp(2.0 * np.sin(rows)[..., None] + np.cos(columns[..., None] + np.arange(3)))
    return (smooth * np.exp(0.1 * rng.normal(size=smooth.shape))).astype(np.float32)


def read(modules, path: Path, **options) -> dict:
    """What the page reads of a file, with its texels (H, W, 3)."""
    found = modules.run(READ, name=path.name, bytes=path.read_bytes(), options=options)
    return found | {"texels": found["data"].reshape(found["height"], found["width"], 3)}


def refusal(modules, path: Path, **options) -> str:
    return modules.error(READ, name=path.name, bytes=path.read_bytes(), options=options)


def assert_same(modules, path: Path, because: str) -> None:
    assert_exact(read(modules, path)["texels"], read_environment(path).texels, because)


def assert_same_cosines(found: np.ndarray, expected: np.ndarray) -> None:
    """Decoded from DWA: what cosine transforms in float32 give may round to either side.

    It is a half float v, linear for x = v^2.2 up to 1 and x = e^(2.2 (v - 1)) beyond, which is a half float again.
    """
    x = np.abs(expected).astype(np.float64)
    v = np.where(x <= 1.0, x ** (1 / 2.2), 1.0 + np.log(np.maximum(x, 1.0)) / 2.2)
    slope = 2.2 * np.where(x <= 1.0, v**1.2, x)
    step, last = (np.spacing(values.astype(np.float16)).astype(np.float64) for values in (v, x))
    assert (np.abs(found - expected) <= slope * step + last).all()
    assert np.mean(found != expected) < 0.01


# --- OpenEXR ---------------------------------------------------------------------------------------------------------

LOSSLESS = ("NO", "RLE", "ZIPS", "ZIP", "PIZ", "PXR24")


@pytest.mark.parametrize("depth", [np.float16, np.float32])
@pytest.mark.parametrize("compression", [*LOSSLESS, "B44", "B44A", "DWAA", "DWAB"])
@pytest.mark.parametrize("alpha", [False, True])
def test_compressions(compression, depth, alpha, texels, tmp_path, modules):
    channels = colours(texels.astype(depth))
    if alpha:
        channels["A"] = np.ones(texels.shape[:2], depth)
    made = {"compression": getattr(OpenEXR, f"{compression}_COMPRESSION"), **KINDS["scanline"]}
    path = write(tmp_path / "map.exr", (made, channels))
    found, expected = read(modules, path)["texels"], read_environment(path).texels
    if compression.startswith("DWA"):
        assert_same_cosines(found, expected)
    else:
        assert_exact(found, expected, because="the same bits")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("data", "display"),
    [
        ((0, 0, 127, 63), (0, 0, 127, 63)),
        ((-8, 5, 119, 68), (0, 0, 63, 31)),  # overscan and cropped
        ((16, 4, 143, 67), (0, 0, 63, 31)),
        ((200, 0, 327, 63), (0, 0, 63, 31)),  # beside it
    ],
)
def test_windows_of_scanlines_and_tiles(data, display, kind, texels, tmp_path, modules):
    more = {"dataWindow": window(*data), "displayWindow": window(*display)}
    path = write(tmp_path / "map.exr", (header(kind, **more), colours(texels)))
    assert_same(modules, path, because="a copy")


def write_levels(path: Path, texels: np.ndarray, by_side: bool) -> Path:
    """Tiles of 32 x 32 of all levels, uncompressed float32, each level filled with its number but the finest."""
    height, width = texels.shape[:2]
    attributes = [
        (
            b"channels",
            b"chlist",
            b"".join(c + b"\0" + struct.pack("<iIii", 2, 0, 1, 1) for c in (b"B", b"G", b"R")) + b"\0",
        ),
        (b"compression", b"compression", b"\0"),
        (b"dataWindow", b"box2i", struct.pack("<4i", 0, 0, width - 1, height - 1)),
        (b"displayWindow", b"box2i", struct.pack("<4i", 0, 0, width - 1, height - 1)),
        (b"lineOrder", b"lineOrder", b"\2"),
        (b"pixelAspectRatio", b"float", struct.pack("<f", 1.0)),
        (b"screenWindowCenter", b"v2f", bytes(8)),
        (b"screenWindowWidth", b"float", struct.pack("<f", 1.0)),
        (b"tiles", b"tiledesc", struct.pack("<IIB", 32, 32, 2 if by_side else 1)),
    ]
    start = b"\x76\x2f\x31\x01" + struct.pack("<I", 0x202)
    start += b"".join(n + b"\0" + t + b"\0" + struct.pack("<I", len(v)) + v for n, t, v in attributes) + b"\0"
    across, down = width.bit_length(), height.bit_length()
    levels = [(i, j) for j in range(down) for i in range(across)] if by_side else [(i, i) for i in range(across)]
    tiles = []
    for i, j in levels:
        size = max(height >> j, 1), max(width >> i, 1)
        level = texels if i == j == 0 else np.full((*size, 3), float(i + j), np.float32)
        for y in range(0, size[0], 32):
            for x in range(0, size[1], 32):
                pixels = level[y : y + 32, x : x + 32, ::-1].transpose(0, 2, 1).astype("<f4").tobytes()
                tiles.append(struct.pack("<5i", x // 32, y // 32, i, j, len(pixels)) + pixels)
    # From the coarsest level on; only the table knows which tile is where.
    ends = len(start) + 8 * len(tiles) + np.cumsum([len(tile) for tile in tiles[::-1]])[::-1]
    places = ends - [len(tile) for tile in tiles]
    path.write_bytes(start + places.astype("<u8").tobytes() + b"".join(tiles[::-1]))
    return path


@pytest.mark.parametrize("by_side", [False, True])
def test_the_finest_level_is_read(by_side, texels, tmp_path, modules):
    path = write_levels(tmp_path / "map.exr", texels, by_side)
    assert_same(modules, path, because="a copy")
    assert_exact(read(modules, path)["texels"], texels, because="a copy")


@pytest.mark.parametrize("kind", KINDS)
def test_the_choice_is_read_and_said(kind, texels, tmp_path, modules):
    albedo = header(kind), "albedo", colours(texels[::-1], "albedo.")
    beauty = (
        header(kind),
        "rgba",
        colours(texels, "sky.") | {"Z": texels[..., 0].copy(), "id": np.ones((64, 128), "u4")},
    )
    path = write(tmp_path / "map.exr", albedo, beauty)
    found = read(modules, path)
    assert_exact(found["texels"], texels, because="a copy")
    assert found["notes"] == [
        "map.exr: holds several images; the light is part 1 'rgba' layer sky, not part 0 'albedo' layer albedo"
    ]


def plain(parts) -> list:
    """Headers as the page has them."""
    made = [dataclasses.asdict(part) for part in parts]
    return [{**part, "channels": list(part["channels"]), "data": None, "display": None} for part in made]


CHOOSE = 'const { chooseLayer } = await import("#exrLayers"); return chooseLayer(parts);'


def test_which_image_is_the_light(modules):
    for name, (parts, (number, channel)) in CHOICES.items():
        found = modules.run(CHOOSE, parts=plain(parts))
        assert (found["part"], found["channels"][0]["name"]) == (number, channel), name
        assert found["label"] == choose_layer(Path("map.exr"), parts).label


def test_no_image_that_is_the_light_rather_than_another(modules):
    for name, (parts, message) in REFUSED.items():
        assert re.search(message, modules.error(CHOOSE, parts=plain(parts))), name


def test_primaries_and_luminance(texels, tmp_path, modules):
    primaries = (0.708, 0.292, 0.170, 0.797, 0.131, 0.046, 0.3127, 0.3290)
    path = write(tmp_path / "map.exr", (header(chromaticities=primaries), colours(texels)))
    found = read(modules, path, clampNegative=True)["texels"]
    expected = read_environment(path, clamp_negative=True).texels
    assert_rounded(found, expected, terms=6, size=3 * float(texels.max()))
    path = write(tmp_path / "map.exr", (header(), {"Y": texels[..., 0].copy()}))
    assert_same(modules, path, because="a copy")


PIZ = {"compression": OpenEXR.PIZ_COMPRESSION, **KINDS["scanline"]}
DWAA = {"compression": OpenEXR.DWAA_COMPRESSION, **KINDS["scanline"]}
PXR24 = {"compression": OpenEXR.PXR24_COMPRESSION, **KINDS["scanline"]}


@pytest.mark.parametrize(
    ("made", "more", "message"),
    [
        (PIZ, {"Z": np.float16}, r"beside its colours \(Z\) that pages cannot tell from them in PIZ"),
        (PXR24, {"id": np.uint32}, r"beside its colours \(id\) .* in PXR24"),
        (
            DWAA,
            {"sky.R": np.float32, "sky.G": np.float32, "sky.B": np.float32},
            r"beside its colours \(sky.B, sky.G, sky.R\) .* DWAA",
        ),
        (DWAA, {"Z": np.float32}, r"beside its colours \(Z\) .* DWAA"),
    ],
)
def test_what_only_python_reads_is_told(made, more, message, texels, tmp_path, modules):
    others = {name: np.zeros(texels.shape[:2], kind) for name, kind in more.items()}
    path = write(tmp_path / "map.exr", (made, colours(texels) | others))
    assert_exact(read_environment(path).texels.shape, texels.shape, because="Python reads it")
    expected = f"map.exr: holds channels {message}; write it again with R, G and B alone, compressed as ZIP"
    assert re.fullmatch(expected, refusal(modules, path))


def test_no_more_than_a_header(tmp_path, modules):
    for version, channels, kind, message in [
        (0x802, [(b"B", 1, 1), (b"G", 1, 1), (b"R", 1, 1)], b"deepscanline", "deep data"),
        (2, [(b"BY", 2, 2), (b"RY", 2, 2), (b"Y", 1, 1)], b"scanlineimage", "luminance and subsampled chroma"),
        (2, [(b"B", 2, 2), (b"G", 1, 1), (b"R", 2, 2)], b"scanlineimage", "are subsampled"),
        (2, [(b"B", 1, 1), (b"G", 1, 1), (b"R", 1, 1)], b"scanlineimage", "cut short"),
    ]:
        (tmp_path / "map.exr").write_bytes(raw_file(version, channels, kind))
        assert message in refusal(modules, tmp_path / "map.exr")


def test_a_compression_that_no_browser_knows(texels, tmp_path, modules):
    content = write(tmp_path / "map.exr", (header(), colours(texels))).read_bytes()
    for code, name in ((10, "HTJ2K"), (77, "of kind 77")):
        place = content.index(b"compression\0compression\0") + 28
        (tmp_path / "map.exr").write_bytes(content[:place] + bytes([code]) + content[place + 1 :])
        assert f"map.exr: its compression ({name}) is not read in pages" in refusal(modules, tmp_path / "map.exr")


@pytest.mark.parametrize("kind", KINDS)
def test_damage_is_told_in_a_line(kind, texels, tmp_path, modules, rng):
    flat_texels = np.repeat(np.repeat(texels[::8, ::8], 8, axis=0), 8, axis=1)  # so that they are compressed
    whole = write(tmp_path / "map.exr", (header(kind), colours(flat_texels))).read_bytes()
    contents = [whole[:size] for size in (5, 50, 300, len(whole) // 2, len(whole) - 1)]
    for _ in range(5):
        changed = np.frombuffer(whole, np.uint8).copy()
        changed[rng.integers(len(whole) // 2, len(whole), 20)] ^= 0xFF
        contents.append(changed.tobytes())
    for content in contents:
        (tmp_path / "map.exr").write_bytes(content)
        said = refusal(modules, tmp_path / "map.exr")
        assert said.startswith("map.exr: ")
        assert "\n" not in said
    assert modules.complaints == []


def test_a_thread_decodes_and_where_there_is_none_the_page(texels, tmp_path, modules):
    body = """
    const { readMap } = await import("#maps"), kept = Worker;
    let decoded = 0;
    globalThis.Worker = class extends kept {
      constructor(url, options) {
        if (!allowed) throw new DOMException("pages from a disk may not", "SecurityError");
        super(url, options);
        this.addEventListener("message", ({ data }) => { decoded += data.texels ? 1 : 0; });
      }
    };
    const map = await readMap("map.exr", bytes.slice().buffer).finally(() => { globalThis.Worker = kept; });
    return [map.data, decoded];
    """
    path = write(tmp_path / "map.exr", (header(), colours(texels)))
    for allowed in (True, False):
        found, decoded = modules.run(body, bytes=path.read_bytes(), allowed=allowed)
        assert_exact(found, texels.ravel(), because="a copy")
        assert decoded == allowed


# --- Radiance and portable float maps --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("coding", "length"),
    [(flat, 4), (repeated_texels, 4), (flat, 16), (repeated_texels, 16), (repeated_bytes, 8)]
    + [(coding, 600) for coding in (flat, repeated_texels, repeated_bytes)],  # repetitions beyond 255
)
def test_codings_of_radiance(coding, length, tmp_path, modules, rng):
    lines = encode(np.exp(rng.normal(size=(length // 2, length, 3))))
    lines[:, length // 4 :] = lines[:, length // 4 : length // 4 + 1]
    lines[0, :2, 3] = 0
    path = write_hdr(tmp_path / "map.hdr", lines, size=b"-Y %d +X %d" % (length // 2, length), coding=coding)
    assert_same(modules, path, because="a shift of bits")


def test_orders_of_radiance(tmp_path, modules, rng):
    lines = encode(np.exp(rng.normal(size=(8, 16, 3))))
    columns = encode(np.exp(rng.normal(size=(16, 8, 3))))
    for y in (b"-Y 8", b"+Y 8"):
        for x in (b"-X 16", b"+X 16"):
            for stored, size in ((lines, y + b" " + x), (columns, x + b" " + y)):
                assert_same(modules, write_hdr(tmp_path / "map.hdr", stored, size=size), because="a shift of bits")


def test_what_was_done_to_a_radiance_picture_is_undone(tmp_path, modules, rng):
    lines = encode(np.exp(rng.normal(size=(8, 16, 3))))
    for more in (b"EXPOSURE=0.117\n", b"COLORCORR=2 1 1\nEXPOSURE= 2 \nCOLORCORR=1 4 1\n", b"# EXPOSURE=5\n"):
        path = write_hdr(tmp_path / "map.hdr", lines, header=PLAIN + more)
        assert_same(modules, path, because="a product of two numbers in float32")
    for more in (b"FORMAT=32-bit_rle_xyze\n", PLAIN + b"PRIMARIES=0.7 0.3 0.2 0.7 0.15 0.05 0.31 0.33\n"):
        path = write_hdr(tmp_path / "map.hdr", lines, header=more)
        found = read(modules, path, clampNegative=True)["texels"]
        expected = read_environment(path, clamp_negative=True).texels
        assert_rounded(found, expected, terms=4, size=3 * float(expected.max()))
    path = write_hdr(tmp_path / "map.hdr", lines, header=PLAIN + b"GAMMA=2.2\n")
    assert read(modules, path)["notes"] == ["map.hdr: GAMMA=2.2 is ignored; a Radiance picture is linear"]


def test_damaged_radiance_pictures(tmp_path, modules):
    for name, (content, message) in DAMAGED.items():
        (tmp_path / "map.hdr").write_bytes(content)
        said = refusal(modules, tmp_path / "map.hdr")
        assert message in said, name
        assert said.startswith("map.hdr: ")
        assert "\n" not in said


@pytest.mark.parametrize("coding", [flat, repeated_texels, repeated_bytes])
def test_any_part_of_a_radiance_picture(coding, tmp_path, modules, rng):
    whole = write_hdr(tmp_path / "map.hdr", encode(np.exp(rng.normal(size=(8, 16, 3)))), coding=coding).read_bytes()
    body = """
    const { readMap } = await import("#maps"), said = [];
    for (let size = 1; size < bytes.length; size++) {
      const read = readMap("map.hdr", bytes.slice(0, size).buffer);
      said.push(await read.then(() => "", error => error.message));
    }
    return said;
    """
    said = modules.run(body, bytes=whole)
    assert len(said) == len(whole) - 1
    assert all(line.startswith("map.hdr: cannot be read as an environment map (") for line in said)


def test_portable_float_maps(tmp_path, modules, rng):
    for scale in (-1.0, 1.0, -0.5, 4.0):
        for shape in ((8, 16, 3), (8, 16)):
            write_pfm(tmp_path / "map.pfm", rng.random(shape).astype(np.float32), scale)
            assert_same(modules, tmp_path / "map.pfm", because="a power of two")
    for content, message in ((b"PF\n16 8\n-1\n" + bytes(1000), "cut short"), (b"PFsomething", "its header")):
        (tmp_path / "map.pfm").write_bytes(content)
        assert message in refusal(modules, tmp_path / "map.pfm")


# --- Pictures --------------------------------------------------------------------------------------------------------


def test_pictures_of_8_bits(tmp_path, modules, rng):
    numbers = rng.integers(0, 256, (16, 32, 3))
    numbers[0, :, 0] = np.arange(0, 256, 8)
    path = write_png(tmp_path / "map.png", numbers, 8, 2)
    found = read(modules, path)
    # Each engine has a power function of its own, whose result is rounded once.
    assert_rounded(found["texels"], read_environment(path).texels, terms=1, size=1.0)
    assert found["notes"] == []
    path = write_png(tmp_path / "map.png", numbers[..., :1], 8, 0)
    assert_rounded(read(modules, path)["texels"], read_environment(path).texels, terms=1, size=1.0)
    smooth = np.indices((16, 32)).sum(axis=0)[..., None] * np.array([5, 4, 3])
    exif = Image.Exif()
    exif[ORIENTATION] = 3
    Image.fromarray(smooth.astype(np.uint8)).save(tmp_path / "map.jpg", quality=95, exif=exif)
    found, expected = read(modules, tmp_path / "map.jpg")["texels"], read_environment(tmp_path / "map.jpg").texels
    np.testing.assert_allclose(found, expected, rtol=0, atol=2.3 * 2 / 255)  # a step of 8 bits or two at the steepest


def test_what_browsers_do_to_pictures_is_told(tmp_path, modules, rng):
    deep = rng.integers(0, 65536, (16, 32, 3))
    path = write_png(tmp_path / "map.png", deep, 16, 2)
    found = read(modules, path)
    assert found["notes"] == ["map.png: of its 16 bits browsers read 8"]
    np.testing.assert_allclose(found["texels"], read_environment(path).texels, rtol=0, atol=2.3 / 255)
    path = write_png(tmp_path / "map.png", rng.integers(0, 255, (16, 32, 4)), 8, 6)
    assert "map.png: is transparent in places" in refusal(modules, path)
    path = write_png(tmp_path / "map.png", deep, 16, 2, chunk(b"cICP", bytes([9, 16, 0, 1])))
    assert "is a PNG encoded as PQ, which is not read; convert it to .exr" in refusal(modules, path)
    path = write_png(tmp_path / "map.png", rng.integers(0, 256, (16, 32, 3)), 8, 2, gamma(1.0))
    np.testing.assert_allclose(read(modules, path)["texels"], read_environment(path).texels, rtol=0, atol=2.3 / 255)


# --- What texels may be ----------------------------------------------------------------------------------------------


def write_float(path: Path, texels: np.ndarray) -> Path:
    return write(path, (header(), colours(texels.astype(np.float32))))


def test_negative_light_that_matters_is_refused(tmp_path, modules):
    small, large = negative(0.99 * NEGATIVE_TOLERANCE), negative(1.01 * NEGATIVE_TOLERANCE)
    found = read(modules, write_float(tmp_path / "map.exr", small))
    assert found["clamped"] == 2
    assert_exact(found["texels"], np.maximum(small, 0.0).astype(np.float32), because="zeros")
    path = write_float(tmp_path / "map.exr", large)
    said = refusal(modules, path)
    assert said.startswith("map.exr: 2 texels are negative (down to -0.")
    assert "amount to 0.1% of the light; repair the map, or set them to zero" in said
    assert read(modules, path, clampNegative=True)["clamped"] == 2
    kinds = """
    const { readMap } = await import("#maps");
    return readMap("map", bytes.slice().buffer).catch(error => error.negative);
    """
    assert modules.run(kinds, bytes=path.read_bytes()) is True
    assert modules.run(kinds, bytes=b"hello") is False
    path = write_float(tmp_path / "map.exr", np.full((8, 16, 3), -1.0))
    assert "outweigh all light in the map" in refusal(modules, path)


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (np.nan, "texels are NaN or infinite, the first in row 3, column 5; repair the map"),
        (np.inf, "texels are NaN or infinite, the first in row 3, column 5; repair the map"),
        (-np.inf, "texels are NaN or infinite, the first in row 3, column 5; repair the map"),
        (1.1e30, "texels are beyond 1e+30, more than can be calculated with, the first in row 3, column 5"),
        (-1.1e30, "texels are beyond 1e+30, more than can be calculated with, the first in row 3, column 5"),
    ],
)
def test_texels_that_no_calculation_can_follow(value, message, tmp_path, modules):
    texels = np.ones((8, 16, 3), np.float32)
    texels[3, 5, 1] = value
    assert message in refusal(modules, write_float(tmp_path / "map.exr", texels))


def test_what_is_no_map(tmp_path, modules, rng):
    for name, content, message in [
        ("notes.txt", b"hello", "it is of no kind that is known, or damaged); write it again, best as .exr"),
        ("empty.hdr", b"", "it is of no kind that is known, or damaged"),
        ("page.svg", b'<svg xmlns="http://www.w3.org/2000/svg" width="20" height="10"/>', "of no kind that is known"),
    ]:
        (tmp_path / name).write_bytes(content)
        said = refusal(modules, tmp_path / name)
        assert said.startswith(f"{name}: cannot be read as an environment map (")
        assert message in said
    path = write_float(tmp_path / "square.exr", rng.random((16, 16, 3)))
    assert refusal(modules, path).startswith("square.exr: is 16 x 16 texels; a latitude-longitude map is twice as wide")
    assert read(modules, path, anyShape=True)["texels"].shape == (16, 16, 3)  # as an emitter of Mitsuba's may be
    buffer = io.BytesIO()
    Image.fromarray(np.zeros((16, 16, 3), np.uint8)).save(buffer, "PNG")
    (tmp_path / "square.png").write_bytes(buffer.getvalue())
    assert "square.png: is 16 x 16 texels" in refusal(modules, tmp_path / "square.png")


def test_names_and_maps_of_few_rows(tmp_path, modules, rng):
    path = write_float(tmp_path / "my.first.map.exr", rng.random((1, 2, 3)))
    found = read(modules, path)
    assert found["name"] == "my.first.map"
    assert_exact(found["texels"], read_environment(path).texels, because="copies")


@pytest.mark.slow
def test_real_maps(data, modules):
    for name in ("studio", "negative_sky"):
        path = data / "environments" / f"{name}.exr"
        expected = read_environment(path, clamp_negative=True)
        found = read(modules, path, clampNegative=True)
        assert_same_cosines(found["texels"], expected.texels)
        assert found["clamped"] == expected.clamped
    assert "11 texels are negative (down to -3394) and amount to 11.3% of the light" in refusal(modules, path)
