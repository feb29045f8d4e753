"""PNG, JPEG and other pictures of 8 or 16 bits, which are encoded for a screen."""

from __future__ import annotations

import io
import logging
import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageCms

from slepian_prt.errors import UserError
from slepian_prt.lighting.formats.png_encoding import MAGIC, PngEncoding, decode_srgb, read_encoding
from slepian_prt.lighting.formats.primaries import to_srgb
from slepian_prt.lighting.formats.whole_pictures import load_whole
from slepian_prt.lighting.map_rows import Rows, check_shape, check_size
from slepian_prt.machine.memory import check_memory
from slepian_prt.renderer.variants import bitmap_module

log = logging.getLogger(__name__)

# What Pillow knows; it reads no more than 8 bits, so that PNG of 16 bits are Mitsuba's.
_FORMATS = ("PNG", "JPEG", "WEBP", "BMP", "DIB", "TGA", "GIF", "PPM")

# What a texel takes while it is decoded, in bytes, at most.
_TEXEL = 20

# As they are, so that alpha changes no colour.
_CHANNELS = {"1": "L", "L": "L", "LA": "L", "CMYK": "RGB", "YCbCr": "RGB", "P": "RGB", "PA": "RGB"}
_CHANNELS |= dict.fromkeys(("RGB", "RGBA", "RGBX"), "RGB")

_ORIENTATION = 0x0112

# Of an Ultra HDR picture: Adobe's name space, and that of ISO 21496-1.
_GAIN_MAPS = (b"http://ns.adobe.com/hdr-gain-map/", b"urn:iso:std:iso:ts:21496:-1")


def picture_rows(path: Path) -> Rows:
    """A picture as linear light in [0, 1], held as it is encoded.

    - PNG as `read_encoding` says, others as sRGB; another ICC profile of 8 bits is converted to sRGB, and said.
    - Turned upright as its EXIF data say. Alpha is ignored: colours are as they are.
    - The gain map of an Ultra HDR picture is not applied, which is said.
    """
    with path.open("rb") as file:
        encoding = read_encoding(path) if file.read(len(MAGIC)) == MAGIC else None
    texels, orientation = _decode(path, encoding)
    texels = upright(texels, orientation)
    height, width = texels.shape[:2]
    numbers = np.arange(np.iinfo(texels.dtype).max + 1) / np.iinfo(texels.dtype).max
    table = (decode_srgb if encoding is None else encoding.decode)(numbers).astype(np.float32)
    primaries = None if encoding is None else encoding.chromaticities
    convert = None if primaries is None or texels.shape[2] == 1 else to_srgb(primaries)

    def read(begin: int, end: int) -> NDArray[np.float32]:
        linear = table[texels[begin:end]]
        if convert is not None:
            linear = linear @ convert.T.astype(np.float32)
        return np.broadcast_to(linear, (*linear.shape[:2], 3))

    return Rows(path.stem, str(path), height, width, read)


def upright(texels: NDArray, orientation: int) -> NDArray:
    """A picture (H, W, C) as it is meant to be seen, from the orientation that EXIF gives (CIPA DC-008, 1 to 8)."""
    if orientation >= 5:
        texels = texels.transpose(1, 0, 2)
    down = orientation in (3, 4, 7, 8)
    across = orientation in (2, 3, 6, 7)
    return texels[:: -1 if down else 1, :: -1 if across else 1]


def _decode(path: Path, encoding: PngEncoding | None) -> tuple[NDArray[Any], int]:
    """(H, W, 1 or 3) numbers of 8 or 16 bits, and how they are turned."""
    with _quiet(), _opened(path) as image:
        check_size(str(path), image.height, image.width)
        check_memory(_TEXEL * image.height * image.width, f"{path}: its picture", "make it smaller")
        load_whole(image, lambda: _opened(path))  # first, since Pillow loads a PNG to find its orientation
        orientation = _given_orientation(image)
        check_shape(str(path), *((image.width, image.height) if orientation >= 5 else (image.height, image.width)))
        profiled = encoding is None or encoding.profiled
        if encoding is not None and encoding.depth == 16:
            if profiled:
                log.info("%s: its ICC profile is not applied to 16 bits; it is taken as sRGB", path)
            return _decode_with_mitsuba(path), orientation
        if image.mode not in _CHANNELS or (image.format == "PPM" and _is_deep_ppm(path)):
            raise UserError(
                f"{path}: is a {image.format} of a kind ({image.mode}) or depth that is not read; convert it to .exr"
            )
        if image.format in ("JPEG", "MPO") and _has_gain_map(path):
            log.info("%s: its gain map is not applied; the light is that of its ordinary picture", path)
        target = _CHANNELS[image.mode]
        profile = image.info.get("icc_profile")
        if image.mode in ("P", "PA"):
            image = image.convert("RGBA")
        if profile and profiled and image.mode != "1":
            image = _without_profile(path, image, profile)
            target = "L" if image.mode in ("L", "LA") else "RGB"
        texels = np.asarray(image.convert(target))
        return texels.reshape(*texels.shape[:2], -1), orientation


def _without_profile(path: Path, image: Any, profile: bytes) -> Any:
    """The picture in sRGB; itself, if its profile is that to within what 8 bits hold."""
    try:
        source = ImageCms.ImageCmsProfile(io.BytesIO(profile))
        mode = {"GRAY": "L", "CMYK": "CMYK"}.get(source.profile.xcolor_space.strip(), "RGB")
        plain = image.convert(mode) if mode != "CMYK" or image.mode == "CMYK" else image
        transform = ImageCms.buildTransform(source, ImageCms.createProfile("sRGB"), plain.mode, "RGB")
        probe = Image.fromarray(np.random.default_rng(0).integers(0, 256, (64, 64, len(mode)), np.uint8).squeeze())
        if mode != "CMYK":
            same = np.asarray(probe.convert("RGB"), dtype=int)
            if np.abs(np.asarray(ImageCms.applyTransform(probe, transform), dtype=int) - same).max() <= 2:
                return image
        converted = ImageCms.applyTransform(plain, transform)
        name = " ".join(ImageCms.getProfileDescription(source).split())
    except (ImageCms.PyCMSError, ImportError, OSError, ValueError) as error:
        reason = " ".join(str(error).split())
        log.info("%s: its ICC profile cannot be used (%s); it is taken as sRGB", path, reason)
        return image
    log.info("%s: converted from its ICC profile, %s, to sRGB", path, name or "without a name")
    return converted


def _is_deep_ppm(path: Path) -> bool:
    """Whether a .ppm has more than 8 bits, which Pillow drops, and Mitsuba 3.9 reads in the wrong order."""
    with path.open("rb") as file:
        words = re.sub(rb"#[^\n]*", b"", file.read(1024)).split()
    return len(words) > 3 and words[3].isdigit() and int(words[3]) > 255


def _decode_with_mitsuba(path: Path) -> NDArray[Any]:
    """(H, W, 1 or 3) numbers of 8 or 16 bits."""
    mi = bitmap_module()
    level = mi.log_level()
    mi.set_log_level(mi.LogLevel.Error)  # libpng warns of what does not matter here
    try:
        texels = np.array(mi.Bitmap(str(path)))
    except RuntimeError:
        raise ValueError("its pixels are cut short or damaged") from None
    finally:
        mi.set_log_level(level)
    texels = texels.reshape(*texels.shape[:2], -1)
    return texels[..., :3] if texels.shape[2] >= 3 else texels[..., :1]


def _given_orientation(image: Any) -> int:
    given = image.getexif().get(_ORIENTATION, 1)
    return given if given in range(1, 9) else 1


def _opened(path: Path) -> Any:
    try:
        return Image.open(path, formats=_FORMATS)
    except Image.UnidentifiedImageError:
        raise ValueError("it is of no kind that is known, or damaged") from None
    except Image.DecompressionBombError:
        most = 2 * Image.MAX_IMAGE_PIXELS
        raise UserError(
            f"{path}: has more than {most} texels, the most that is read of a picture; convert it to .exr"
        ) from None


def _has_gain_map(path: Path) -> bool:
    content = path.read_bytes()
    return any(name in content for name in _GAIN_MAPS)


@contextmanager
def _quiet() -> Iterator[None]:
    """Pillow warns of large pictures and of odd ones that it reads well."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield
