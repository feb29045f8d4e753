"""Pictures whose data end early without any other damage: refused as maps, and as textures of meshes."""

import io
import struct
import zlib

import numpy as np
import pytest
from PIL import Image

from slepian_prt.errors import UserError
from slepian_prt.lighting.environment import read_environment
from slepian_prt.lighting.formats.exr_header import read_headers
from slepian_prt.scene.formats.parts import Texture
from slepian_prt.scene.reflectance.textures import decode_texture, encoded_image
from tests.fuzzing import maps

WIDTH, HEIGHT = 16, 8

# Adam7: first column and row of a pass, and its steps (W3C, PNG Specification, section 8).
PASSES = [(0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2)]

CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}


def chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))


def png(depth: int, kind: int, interlaced: bool, value: int, missing: int) -> bytes:
    """A PNG of bytes ``value``, the last of which are ``missing``; all else in it is right."""
    data = b""
    for column, row, across, down in PASSES if interlaced else [(0, 0, 1, 1)]:
        texels = len(range(column, WIDTH, across))
        data += (b"\0" + bytes([value]) * (-(-texels * depth * CHANNELS[kind] // 8))) * len(range(row, HEIGHT, down))
    header = struct.pack(">IIBBBBB", WIDTH, HEIGHT, depth, kind, 0, 0, interlaced)
    chunks = [chunk(b"IHDR", header), chunk(b"IDAT", zlib.compress(data[: len(data) - missing])), chunk(b"IEND", b"")]
    if kind == 3:
        chunks.insert(1, chunk(b"PLTE", bytes(range(60))))
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunks)


KINDS = [(1, 0), (4, 0), (8, 0), (16, 0), (8, 2), (16, 2), (1, 3), (8, 3), (8, 4), (16, 4), (8, 6), (16, 6)]


@pytest.mark.parametrize("value", [0x11, 0])
@pytest.mark.parametrize("interlaced", [False, True])
@pytest.mark.parametrize(("depth", "kind"), KINDS)
def test_png_whose_stream_ends_early(depth, kind, interlaced, value, tmp_path):
    path = tmp_path / "a.png"
    path.write_bytes(png(depth, kind, interlaced, value, 0))
    read_environment(path)
    assert decode_texture(Texture("t", path), is_srgb=True).shape == (HEIGHT, WIDTH, 3)
    row = 1 + WIDTH * depth * CHANNELS[kind] // 8  # of the last pass, too
    for missing, message in ((row, "after 112 of 128 texels"), (3 * row, "after 80 of 128 texels"), (1, "truncated")):
        path.write_bytes(png(depth, kind, interlaced, value, missing))
        with pytest.raises(UserError, match=message):
            read_environment(path)
        for source in (path, path.read_bytes()):
            with pytest.raises(UserError, match=message):
                decode_texture(Texture("t", source), is_srgb=True)


@pytest.mark.parametrize("name", ["none.exr", "layers.exr", "tiled.exr"])
def test_exr_whose_blocks_are_not_all_there(name, tmp_path):
    """All places in the table are one; the file is as long as it should be."""
    path, content = tmp_path / name, maps.seeds()[name]
    path.write_bytes(content)
    read_environment(path)
    first = read_headers(path)[-1].end
    count = (struct.unpack_from("<Q", content, first)[0] - first) // 8
    path.write_bytes(content[:first] + struct.pack("<Q", len(content) - 9) * count + content[first + 8 * count :])
    with pytest.raises(UserError, match="cut short or damaged"):
        read_environment(path)


def gif(count: int, box: tuple[int, int, int, int] = (0, 0, WIDTH, HEIGHT)) -> bytes:
    """A GIF of a picture that is filled in ``box`` (left, top, width, height) by as many codes; no code is longer."""
    codes = [code for k in range(0, count, 100) for code in (128, *range(1, 1 + min(100, count - k)))]
    blocks = bytes([len(codes) + 1, *codes, 129, 0])
    screen = struct.pack("<HHBBB", WIDTH, HEIGHT, 0xF6, 0, 0) + bytes(range(128)) * 3
    return b"GIF89a" + screen + b"," + struct.pack("<4HB", *box, 0) + b"\7" + blocks + b";"


def test_gif_whose_codes_end_early():
    """Those that fill a part of the screen only are no fault."""
    for whole in (gif(128), gif(32, (4, 2, 8, 4))):
        assert decode_texture(Texture("t", whole), is_srgb=True).shape == (HEIGHT, WIDTH, 3)
    for short in (gif(100), gif(31, (4, 2, 8, 4)), gif(0)):
        with pytest.raises(UserError, match="truncated"):
            decode_texture(Texture("t", short), is_srgb=True)


JPEGS = [{}, {"subsampling": 0}, {"progressive": True}, {"restart_marker_blocks": 2}, {"quality": 30}]


@pytest.mark.parametrize("mode", ["RGB", "L", "CMYK"])
@pytest.mark.parametrize("how", JPEGS, ids=str)
def test_jpeg_whose_codes_end_early(how, mode):
    """Missing codes are decoded as grey. Those of grey pictures are there; what looks like a scan in EXIF is none."""
    texels = np.random.default_rng(4).integers(0, 256, (32, 64, 3), dtype=np.uint8)
    thumbnail = Image.Exif()
    thumbnail[0x010E] = "\x7f\xff\xda\x01\xff\xc0"
    for array in (texels, np.full_like(texels, 128), np.full_like(texels, 127)):
        file = io.BytesIO()
        Image.fromarray(array).convert(mode).save(file, "JPEG", exif=thumbnail, **how)
        content = file.getvalue()
        decode_texture(Texture("t", content), is_srgb=True)
        for part in (0.5, 0.8) if array is texels else ():
            short = content[: int(part * len(content))].rstrip(b"\xff")
            with pytest.raises(UserError, match=r"of 32 rows, those from \d+ on are not all there|cannot be read as"):
                decode_texture(Texture("t", short + b"\xff\xd9"), is_srgb=True)


@pytest.mark.parametrize("kind", ["PNG", "JPEG", "WEBP", "BMP", "TGA", "GIF", "PPM", "TIFF"])
def test_files_cut_short(kind):
    texels = np.random.default_rng(3).integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8)
    file = io.BytesIO()
    Image.fromarray(texels).save(file, kind)
    content = file.getvalue()
    decode_texture(Texture("t", content), is_srgb=True)
    for part in (0.4, 0.7):
        with pytest.raises(UserError, match=r"cannot be read as an image|no image of a kind"):
            decode_texture(Texture("t", content[: int(part * len(content))]), is_srgb=True)


def test_no_program_is_started_for_a_picture(monkeypatch):
    """Pillow gives PostScript to Ghostscript."""
    file = io.BytesIO()
    Image.new("RGB", (4, 4)).save(file, "EPS")
    monkeypatch.setattr("subprocess.check_call", lambda *_, **__: pytest.fail("a program was started"))
    for read in (decode_texture, encoded_image):
        with pytest.raises(UserError, match="no image of a kind that is known"):
            read(Texture("t", file.getvalue()), **({"is_srgb": True} if read is decode_texture else {}))
