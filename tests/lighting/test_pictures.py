"""Pictures encoded for a screen, against a writer of every kind of PNG, and Pillow's own turning."""

import io
import logging
import struct
import zlib

import numpy as np
import pytest
from PIL import Image, ImageOps

from slepian_prt.errors import UserError
from slepian_prt.lighting.environment import read_environment
from slepian_prt.lighting.formats.pictures import upright
from slepian_prt.lighting.map_files import file_rows
from slepian_prt.lighting.projection import project_environment
from tests.numerics import assert_exact

# A table in float64, rounded once.
ROUNDED = {"rtol": np.finfo(np.float32).eps, "atol": 0.0}

ORIENTATION = 0x0112


def from_srgb(v):
    """IEC 61966-2-1."""
    return np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4)


def chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))


def packed(rows: np.ndarray, depth: int) -> bytes:
    """Rows of (H, W, C) numbers, each after the filter 0."""
    out = b""
    for row in rows:
        if depth == 16:
            out += b"\0" + row.astype(">u2").tobytes()
        else:
            bits = np.unpackbits(row.astype(np.uint8).reshape(-1, 1), axis=1)[:, 8 - depth :]
            out += b"\0" + np.packbits(bits.ravel()).tobytes()
    return out


def write_png(path, numbers, depth, kind, *chunks, interlaced=False):
    """(H, W, C) numbers of ``depth`` bits; kind 0 grey, 2 colours, 3 palette, 4 and 6 with alpha."""
    height, width = numbers.shape[:2]
    passes = [(0, 0, 1, 1)]
    if interlaced:  # Adam7
        passes = [(0, 0, 8, 8), (0, 4, 8, 8), (4, 0, 8, 4), (0, 2, 4, 4), (2, 0, 4, 2), (0, 1, 2, 2), (1, 0, 2, 1)]
    data = b"".join(packed(numbers[y::down, x::across], depth) for y, x, down, across in passes)
    header = struct.pack(">IIBBBBB", width, height, depth, kind, 0, 0, interlaced)
    pixels = chunk(b"IDAT", zlib.compress(data))
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + b"".join(chunks) + pixels + chunk(b"IEND", b""))
    return path


def gamma(value: float) -> bytes:
    return chunk(b"gAMA", struct.pack(">I", round(value * 1e5)))


# --- PNG -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("interlaced", [False, True])
@pytest.mark.parametrize("alpha", [False, True])
@pytest.mark.parametrize("colours", [False, True])
@pytest.mark.parametrize("depth", [8, 16])
def test_numbers_of_8_and_16_bits(depth, colours, alpha, interlaced, tmp_path, rng):
    numbers = rng.integers(0, 2**depth, (16, 32, (3 if colours else 1) + alpha))
    numbers[0, 0] = 0
    kind = 2 * colours + 4 * alpha
    path = write_png(tmp_path / "map.png", numbers, depth, kind, interlaced=interlaced)
    expected = from_srgb(numbers[..., : 3 if colours else 1] / (2**depth - 1))
    np.testing.assert_allclose(read_environment(path).texels, np.broadcast_to(expected, (16, 32, 3)), **ROUNDED)
    rows = file_rows(path)
    np.testing.assert_allclose(rows.read(3, 5), np.broadcast_to(expected[3:5], (2, 32, 3)), **ROUNDED)


@pytest.mark.parametrize("interlaced", [False, True])
@pytest.mark.parametrize("depth", [1, 2, 4])
def test_grey_of_few_bits(depth, interlaced, tmp_path, rng):
    numbers = rng.integers(0, 2**depth, (16, 32, 1))
    path = write_png(tmp_path / "map.png", numbers, depth, 0, interlaced=interlaced)
    expected = np.broadcast_to(from_srgb(numbers / (2**depth - 1)), (16, 32, 3))
    np.testing.assert_allclose(read_environment(path).texels, expected, **ROUNDED)


@pytest.mark.parametrize("transparent", [False, True])
@pytest.mark.parametrize("depth", [1, 2, 4, 8])
def test_palettes(depth, transparent, tmp_path, rng):
    palette = rng.integers(0, 256, (2**depth, 3))
    numbers = rng.integers(0, 2**depth, (16, 32, 1))
    chunks = [chunk(b"PLTE", palette.astype(np.uint8).tobytes())]
    if transparent:
        chunks.append(chunk(b"tRNS", rng.integers(0, 256, 2**depth, dtype=np.uint8).tobytes()))
    path = write_png(tmp_path / "map.png", numbers, depth, 3, *chunks)
    np.testing.assert_allclose(read_environment(path).texels, from_srgb(palette[numbers[..., 0]] / 255), **ROUNDED)


SRGB_CHUNK = chunk(b"sRGB", b"\0")


@pytest.mark.parametrize("depth", [8, 16])
@pytest.mark.parametrize(
    ("chunks", "decode"),
    [
        ([], from_srgb),
        ([SRGB_CHUNK], from_srgb),
        ([gamma(1.0)], lambda v: v),
        ([gamma(0.45455)], lambda v: v ** (1 / 0.45455)),
        ([gamma(0.5)], lambda v: v**2),
        ([gamma(1.0), SRGB_CHUNK], from_srgb),
        ([SRGB_CHUNK, gamma(1.0)], from_srgb),
        ([gamma(0.0)], from_srgb),
        ([gamma(1.0), chunk(b"cICP", bytes([1, 13, 0, 1]))], from_srgb),
        ([SRGB_CHUNK, chunk(b"cICP", bytes([1, 8, 0, 1]))], lambda v: v),
    ],
)
def test_how_numbers_are_encoded(chunks, decode, depth, tmp_path, rng):
    numbers = rng.integers(0, 2**depth, (16, 32, 3))
    path = write_png(tmp_path / "map.png", numbers, depth, 2, *chunks)
    np.testing.assert_allclose(read_environment(path).texels, decode(numbers / (2**depth - 1)), **ROUNDED)


@pytest.mark.parametrize("code", [False, True])
def test_primaries_of_a_png_are_followed(code, tmp_path):
    """ITU-R BT.2087 has the red of BT.2020 in BT.709; white stays white."""
    numbers = np.full((16, 32, 3), 255)
    numbers[2, 3] = [255, 0, 0]
    primaries = [0.3127, 0.3290, 0.708, 0.292, 0.170, 0.797, 0.131, 0.046]  # white comes first there
    chunks = [gamma(1.0), chunk(b"cHRM", struct.pack(">8I", *(round(1e5 * x) for x in primaries)))]
    if code:
        chunks = [chunk(b"cICP", bytes([9, 8, 0, 1]))]
    read = file_rows(write_png(tmp_path / "map.png", numbers, 8, 2, *chunks)).read(0, 16)
    np.testing.assert_allclose(read[5, 5], 1.0, atol=1e-6)
    np.testing.assert_allclose(read[2, 3], [1.6605, -0.1246, -0.0182], atol=1e-4)


@pytest.mark.parametrize(("code", "name"), [((9, 16), "PQ"), ((9, 18), "HLG"), ((22, 13), "cICP 22, 13")])
def test_encodings_of_another_range_are_refused(code, name, tmp_path):
    path = write_png(tmp_path / "map.png", np.zeros((16, 32, 3), int), 8, 2, chunk(b"cICP", bytes([*code, 0, 1])))
    with pytest.raises(UserError, match=f"encoded as {name}, which is not read"):
        read_environment(path)


# --- Turned ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("kind", ["JPEG", "PNG", "PNG 16", "WEBP"])
def test_pictures_are_turned_upright(kind, orientation, tmp_path, rng):
    tall = orientation >= 5
    stored = rng.integers(0, 256, (32, 16, 3) if tall else (16, 32, 3), dtype=np.uint8)
    exif = Image.Exif()
    exif[ORIENTATION] = orientation
    path = tmp_path / "map"
    if kind == "PNG 16":
        write_png(path, 257 * stored.astype(int), 16, 2, chunk(b"eXIf", exif.tobytes()[6:]))
    else:
        Image.fromarray(stored).save(path, kind, exif=exif, lossless=True)
    with Image.open(path) as image:
        expected = np.asarray(ImageOps.exif_transpose(image).convert("RGB"))
    assert expected.shape == (16, 32, 3)
    np.testing.assert_allclose(read_environment(path).texels, from_srgb(expected / 255), **ROUNDED)


def test_an_orientation_that_is_none_turns_nothing(tmp_path, rng):
    stored = rng.integers(0, 256, (16, 32, 3), dtype=np.uint8)
    exif = Image.Exif()
    exif[ORIENTATION] = 77
    Image.fromarray(stored).save(tmp_path / "map.png", exif=exif)
    np.testing.assert_allclose(read_environment(tmp_path / "map.png").texels, from_srgb(stored / 255), **ROUNDED)


def test_upside_down_panoramas_light_from_above(tmp_path):
    """As phones store them: the sky is in the last rows, and EXIF says turn by 180°."""
    stored = np.zeros((64, 128), np.uint8)
    stored[40:] = 255
    exif = Image.Exif()
    exif[ORIENTATION] = 3
    Image.fromarray(stored).save(tmp_path / "map.jpg", exif=exif)
    assert project_environment(tmp_path / "map.jpg", 1)[0, 1] < -1.0  # degree 1 along y has the sign -1


def test_turning_is_that_of_exif():
    """CIPA DC-008: which edges of what is seen the stored row 0 and column 0 are."""
    stored = np.arange(6).reshape(2, 3, 1)
    seen = {
        1: [[0, 1, 2], [3, 4, 5]],
        2: [[2, 1, 0], [5, 4, 3]],
        3: [[5, 4, 3], [2, 1, 0]],
        4: [[3, 4, 5], [0, 1, 2]],
        5: [[0, 3], [1, 4], [2, 5]],
        6: [[3, 0], [4, 1], [5, 2]],
        7: [[5, 2], [4, 1], [3, 0]],
        8: [[2, 5], [1, 4], [0, 3]],
    }
    for orientation, expected in seen.items():
        assert_exact(upright(stored, orientation)[..., 0], expected, because="integers")


# --- Other kinds -----------------------------------------------------------------------------------------------------


@pytest.fixture
def smooth() -> np.ndarray:
    """What lossy kinds keep well."""
    v, u = np.mgrid[0:32, 0:64]
    return np.stack([60 + 3 * v, 40 + 2 * u, 200 - 2 * v], axis=-1).astype(np.uint8)


@pytest.mark.parametrize("more", [{}, {"progressive": True}, {"subsampling": 0}])
@pytest.mark.parametrize("mode", ["RGB", "L", "CMYK"])
def test_kinds_of_jpeg(mode, more, smooth, tmp_path):
    picture = Image.fromarray(smooth).convert(mode)
    picture.save(tmp_path / "map.jpg", quality=100, **more)
    expected = from_srgb(np.asarray(picture.convert("RGB")) / 255)
    # Quality 100 and halved chroma of a smooth picture: a few units of 255, where sRGB is steepest 2.3 each.
    np.testing.assert_allclose(read_environment(tmp_path / "map.jpg").texels, expected, atol=4 * 2.3 / 255)


@pytest.mark.parametrize("name", ["map.webp", "map.bmp", "map.tga", "map.gif", "map.ppm", "map.exr"])
def test_other_pictures_are_srgb_whatever_their_names(name, smooth, tmp_path):
    kind = name.removeprefix("map.")
    picture = Image.fromarray(smooth).quantize(64) if kind == "gif" else Image.fromarray(smooth)
    picture.save(tmp_path / name, "PNG" if kind == "exr" else kind, lossless=True)
    expected = from_srgb(np.asarray(picture.convert("RGB")) / 255)
    np.testing.assert_allclose(read_environment(tmp_path / name).texels, expected, **ROUNDED)


@pytest.mark.parametrize("content", [b"P6\n32 16\n65535\n" + bytes(3072), b"P5\n# 255\n32 16\n1023\n" + bytes(1024)])
def test_pixmaps_of_more_than_8_bits_are_refused(content, tmp_path):
    (tmp_path / "map.ppm").write_bytes(content)
    with pytest.raises(UserError, match=r"is a PPM of a kind .* or depth that is not read"):
        read_environment(tmp_path / "map.ppm")


@pytest.mark.parametrize("kind", ["TIFF", "ICO", "PCX"])
def test_other_kinds_are_refused(kind, smooth, tmp_path):
    Image.fromarray(smooth).save(tmp_path / "map", kind)
    with pytest.raises(UserError, match="of no kind that is known"):
        read_environment(tmp_path / "map")


def test_a_gain_map_is_told(smooth, tmp_path, caplog):
    xmp = b'<x:xmpmeta xmlns:x="adobe:ns:meta/"><a xmlns:hdrgm="http://ns.adobe.com/hdr-gain-map/1.0/"/></x:xmpmeta>'
    Image.fromarray(smooth).save(tmp_path / "map.jpg", xmp=xmp)
    with caplog.at_level(logging.INFO, "slepian_prt"):
        read_environment(tmp_path / "map.jpg")
    assert "gain map is not applied" in caplog.text


# --- ICC profiles ----------------------------------------------------------------------------------------------------


def profile(gamma: float, space: bytes = b"RGB ") -> bytes:
    """An ICC profile, version 2, of sRGB's primaries (adapted to D50, as all are) and one gamma."""

    def xyz(*numbers: float) -> bytes:
        return b"XYZ \0\0\0\0" + struct.pack(">3i", *(round(65536 * x) for x in numbers))

    curve = b"curv\0\0\0\0" + struct.pack(">IH", 1, round(256 * gamma)) + b"\0\0"
    name = b"gamma only\0"
    tags = {
        b"desc": b"desc\0\0\0\0" + struct.pack(">I", len(name)) + name + bytes(78 + 1),
        b"wtpt": xyz(0.9642, 1.0, 0.8249),
    }
    if space == b"GRAY":
        tags[b"kTRC"] = curve
    else:
        tags |= {
            b"rXYZ": xyz(0.4360747, 0.2225045, 0.0139322),
            b"gXYZ": xyz(0.3850649, 0.7168786, 0.0971045),
            b"bXYZ": xyz(0.1430804, 0.0606169, 0.7141733),
            b"rTRC": curve,
            b"gTRC": curve,
            b"bTRC": curve,
        }
    table, body, at = struct.pack(">I", len(tags)), b"", 128 + 4 + 12 * len(tags)
    for kind, content in tags.items():
        content += bytes(-len(content) % 4)
        table += kind + struct.pack(">II", at + len(body), len(content))
        body += content
    size = at + len(body)
    head = struct.pack(">I4sI4s4s4s", size, b"\0\0\0\0", 0x02100000, b"mntr", space, b"XYZ ")
    head += bytes(12) + b"acsp" + bytes(28) + struct.pack(">3i", 63190, 65536, 54061)
    return head + bytes(128 - len(head)) + table + body


@pytest.mark.parametrize(
    ("kind", "space"),
    [("png", b"RGB "), ("jpg", b"RGB "), ("webp", b"RGB "), ("png", b"GRAY"), ("jpg", b"GRAY")],
)
def test_profiles_are_followed(kind, space, smooth, tmp_path, caplog):
    picture = Image.fromarray(smooth)
    if space == b"GRAY":
        picture = picture.convert("L")
    more = {"png": {}, "jpg": {"quality": 100, "subsampling": 0}, "webp": {"lossless": True}}[kind]
    picture.save(tmp_path / f"map.{kind}", icc_profile=profile(1.0, space), **more)
    with caplog.at_level(logging.INFO, "slepian_prt"):
        read = read_environment(tmp_path / f"map.{kind}").texels
    assert "converted from its ICC profile, gamma only, to sRGB" in caplog.text
    # Half of 1/255 of sRGB, 2.3 times at its steepest, for its 8 bits, and three times as much for those of JPEG.
    np.testing.assert_allclose(read, np.asarray(picture.convert("RGB")) / 255, atol=0.5 * 2.3 / 255 * 4)


def test_srgb_profiles_change_nothing(smooth, tmp_path, caplog):
    from PIL import ImageCms

    srgb = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    Image.fromarray(smooth).save(tmp_path / "map.png", icc_profile=srgb)
    with caplog.at_level(logging.INFO, "slepian_prt"):
        read = read_environment(tmp_path / "map.png").texels
    np.testing.assert_allclose(read, from_srgb(smooth / 255), **ROUNDED)
    assert caplog.text == ""


@pytest.mark.parametrize("depth", [8, 16])
def test_profiles_that_are_not_applied_are_told(depth, tmp_path, caplog, rng):
    numbers = rng.integers(0, 2**depth, (16, 32, 3))
    content = profile(1.0) if depth == 16 else b"nonsense"
    icc = chunk(b"iCCP", b"name\0\0" + zlib.compress(content))
    path = write_png(tmp_path / "map.png", numbers, depth, 2, gamma(1.0), icc)
    with caplog.at_level(logging.INFO, "slepian_prt"):
        read = read_environment(path).texels
    np.testing.assert_allclose(read, from_srgb(numbers / (2**depth - 1)), **ROUNDED)
    assert "it is taken as sRGB" in caplog.text


# --- Damaged ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["PNG", "PNG 16", "JPEG", "WEBP", "BMP", "TGA", "GIF", "PPM"])
def test_a_picture_cut_short(kind, tmp_path, rng, capfd):
    stored = rng.integers(0, 256, (16, 32, 3), dtype=np.uint8)
    if kind == "PNG 16":
        whole = write_png(tmp_path / "whole", 257 * stored.astype(int), 16, 2).read_bytes()
    else:
        buffer = io.BytesIO()
        Image.fromarray(stored).save(buffer, kind)
        whole = buffer.getvalue()
    for keep in (1, 10, 30, len(whole) // 2, int(0.9 * len(whole))):
        (tmp_path / "map").write_bytes(whole[:keep])
        with pytest.raises(UserError, match="cannot be read as an environment map") as caught:
            read_environment(tmp_path / "map")
        assert "\n" not in str(caught.value)
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize(
    ("size", "depth", "message"),
    [
        ((2000000000, 1000000000), 8, "at most|more than"),
        ((65535, 32767), 16, "more than 178956970"),
        ((0, 0), 8, "cannot be read"),
    ],
)
def test_sizes_that_no_map_has(size, depth, message, tmp_path):
    header = struct.pack(">IIBBBBB", *size, depth, 2, 0, 0, 0)
    content = chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(bytes(10))) + chunk(b"IEND", b"")
    (tmp_path / "map.png").write_bytes(b"\x89PNG\r\n\x1a\n" + content)
    with pytest.raises(UserError, match=message) as caught:
        read_environment(tmp_path / "map.png")
    assert "\n" not in str(caught.value)


@pytest.mark.slow
def test_large_pictures_are_read_without_a_warning(tmp_path):
    """Pillow warns from 89 million pixels on; maps of 16384 x 8192 have more. Only the header is needed here."""
    picture = Image.new("1", (16384, 8191))
    picture.save(tmp_path / "map.png")
    with pytest.raises(UserError, match="is 16384 x 8191 texels; a latitude-longitude map"):
        file_rows(tmp_path / "map.png")


def test_an_empty_map_is_told_as_empty(tmp_path):
    (tmp_path / "map.hdr").write_bytes(b"")
    with pytest.raises(UserError, match=r"\(the file is empty\)"):
        read_environment(tmp_path / "map.hdr")
