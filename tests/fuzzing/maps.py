"""Small environment maps and lighting of every kind of file that is read, and damage to them."""

from __future__ import annotations

import io
import random
import struct
import tempfile
import zlib
from pathlib import Path

import numpy as np
import OpenEXR
from PIL import Image

from tests.fuzzing import mutations

_HEIGHT, _WIDTH = 8, 16


def seeds() -> dict[str, bytes]:
    """Files by name, all valid."""
    return {
        **_exr_files(),
        "plain.hdr": _hdr("-Y 8 +X 16", _rows_of_hdr(plain=True)),
        "packed.hdr": _hdr("-Y 8 +X 16", _rows_of_hdr(plain=False)),
        "exposed.hdr": _hdr("+Y 8 +X 16", _rows_of_hdr(plain=False), "EXPOSURE=2\nCOLORCORR=1 2 1\nGAMMA=1.0\n"),
        "colour.pfm": b"PF\n16 8\n-1.0\n" + _texels().astype("<f4").tobytes(),
        "grey.pfm": b"Pf\n16 8\n2.5\n" + _texels()[..., 0].astype(">f4").tobytes(),
        **_pictures(),
        "light.txt": b"".join(b"%.6f %.6f %.6f\n" % (k, k + 1, 0.5) for k in range(9)),
        "transport.txt": b"6\n" + b"0.5 0.1 0 0.2 0 0 -0.1 0 0 \n" * 6,
    }


def mutate(name: str, content: bytes, random: random.Random) -> bytes:
    """A file of this name, damaged; which kind is drawn."""
    suffix = Path(name).suffix
    if suffix == ".txt":
        return mutations.mutate(content, random, mutations.TEXT)
    if suffix in (".hdr", ".pfm") and random.random() < 0.6:
        end = content.index(b"\n16 8\n") + 10 if suffix == ".pfm" else content.index(b"X 16\n") + 5
        return mutations.mutate(content[:end], random, mutations.TEXT) + content[end:]
    if suffix == ".exr" and random.random() < 0.6:
        return mutations.word(content, random, within=600)
    if suffix == ".png" and random.random() < 0.6:
        return _change_chunk(content, random)
    return mutations.mutate(content, random)


def _texels() -> np.ndarray:
    return np.random.default_rng(8).random((_HEIGHT, _WIDTH, 3)).astype(np.float32)


def _exr_files() -> dict[str, bytes]:
    texels = _texels()
    colours = {name: texels[..., k].copy() for k, name in enumerate("RGB")}
    scan, tiles = {"type": OpenEXR.scanlineimage}, {"type": OpenEXR.tiledimage, "tiles": OpenEXR.TileDescription()}
    half = {name: values.astype(np.float16) for name, values in colours.items()}
    depth = OpenEXR.Part({**scan, "compression": OpenEXR.ZIP_COMPRESSION}, {"Z": texels[..., 0].copy()}, "depth")
    compressions = {"piz": "PIZ", "dwa": "DWAA", "b44": "B44", "pxr": "PXR24", "rle": "RLE", "none": "NO"}
    files = {
        f"{name}.exr": [OpenEXR.Part({**scan, "compression": getattr(OpenEXR, f"{kind}_COMPRESSION")}, half)]
        for name, kind in compressions.items()
    }
    zipped = {"compression": OpenEXR.ZIP_COMPRESSION}
    files["tiled.exr"] = [OpenEXR.Part({**tiles, **zipped}, colours)]
    files["parts.exr"] = [depth, OpenEXR.Part({**scan, **zipped}, colours, "rgba")]
    layers = {f"beauty.{name}": values for name, values in colours.items()}
    files["layers.exr"] = [OpenEXR.Part({**scan, **zipped}, {**layers, "Z": texels[..., 0].copy()})]
    return {name: _written(parts) for name, parts in files.items()}


def _written(parts: list[OpenEXR.Part]) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "map.exr"
        with OpenEXR.File(parts) as file:
            file.write(str(path))
        return path.read_bytes()


def _hdr(resolution: str, rows: bytes, more: str = "") -> bytes:
    return f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n{more}\n{resolution}\n".encode() + rows


def _rows_of_hdr(*, plain: bool) -> bytes:
    rgbe = np.random.default_rng(4).integers(2, 140, (_HEIGHT, _WIDTH, 4), dtype=np.uint8)
    rgbe[:, 8:] = rgbe[:, 8:9]
    if plain:
        return rgbe.tobytes()
    packed = b""
    for row in rgbe:
        packed += bytes([2, 2, 0, _WIDTH])
        for channel in row.T:
            packed += bytes([8, *channel[:8].tolist(), 128 + 8, int(channel[8])])
    return packed


def _pictures() -> dict[str, bytes]:
    codes = (255 * _texels()).astype(np.uint8)
    colour, grey = Image.fromarray(codes), Image.fromarray(codes[..., 0])
    deep = Image.fromarray(codes[..., 0].astype(np.uint16) * 257)
    images = {
        "colour.png": (colour, "PNG"), "grey.png": (grey, "PNG"), "deep.png": (deep, "PNG"),
        "palette.png": (colour.quantize(16), "PNG"), "alpha.png": (colour.convert("RGBA"), "PNG"),
        "photo.jpg": (colour, "JPEG"), "photo.webp": (colour, "WEBP"), "photo.bmp": (colour, "BMP"),
        "photo.tga": (colour, "TGA"), "photo.gif": (colour.quantize(16), "GIF"), "photo.ppm": (colour, "PPM"),
    }  # fmt: skip
    found = {}
    for name, (image, kind) in images.items():
        stream = io.BytesIO()
        image.save(stream, kind)
        found[name] = stream.getvalue()
    return found


def _change_chunk(content: bytes, random: random.Random) -> bytes:
    """A chunk of a PNG changed, doubled or gone, mostly with a checksum that is right."""
    chunks, at = [], 8
    while at + 12 <= len(content):
        size = struct.unpack_from(">I", content, at)[0]
        chunks.append((content[at + 4 : at + 8], content[at + 8 : at + 8 + size]))
        at += 12 + size
    number = random.randrange(len(chunks))
    kind, data = chunks[number]
    what = random.random()
    if what < 0.2:
        del chunks[number]
    elif what < 0.4:
        extra = random.choice((b"gAMA", b"cHRM", b"iCCP", b"cICP", b"sRGB", b"eXIf", b"tEXt", b"zTXt", b"PLTE"))
        chunks.insert(number, (extra, random.randbytes(random.choice((0, 1, 4, 32, 100)))))
    elif what < 0.5:
        chunks.insert(number, (kind, data))
    else:
        chunks[number] = kind, mutations.mutate(data, random)
    written = content[:8]
    for kind, data in chunks:
        checksum = zlib.crc32(kind + data) if random.random() < 0.95 else 0
        written += struct.pack(">I", len(data)) + kind + data + struct.pack(">I", checksum)
    return written
