"""Textures of mesh files, filtered: the mean over a patch costs no more than one lookup."""

from __future__ import annotations

import io
import math
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from slepian_prt.errors import UserError
from slepian_prt.lighting.formats.whole_pictures import load_whole
from slepian_prt.machine.file_content import is_file
from slepian_prt.machine.memory import check_memory
from slepian_prt.scene.formats.parts import Texture, Wrap

_CODES = np.arange(256) / 255.0
_FROM_SRGB = np.where(_CODES <= 0.04045, _CODES / 12.92, ((_CODES + 0.055) / 1.055) ** 2.4).astype(np.float32)
_LINEAR = _CODES.astype(np.float32)

# Formats that any reader of meshes knows, by Pillow's names, with their suffixes.
_WIDELY_READ = {"PNG": ".png", "JPEG": ".jpg"}

# Kinds that Pillow starts another program for (Ghostscript).
_NOT_READ = ("EPS",)

# Texture coordinates beyond this are rubbish, and float32 has no fractions there.
_LARGEST_UV = 2.0**24

# What a texel takes while it is decoded, in bytes, at most.
_TEXEL = 32

# Texels that are decoded from 8 bits at a time.
_TEXELS = 1 << 22

# Pillow's modes of more than 8 bits, and the number that stands for white; 32 bits hold what PNG and PNM have, 16.
_WHITE = {"I;16": 65535.0, "I;16L": 65535.0, "I;16B": 65535.0, "I": 65535.0, "F": 1.0}


class FilteredTexture:
    """A pyramid of an image, each level half as fine as the one before; its texels are means of linear values.

    Parameters
    ----------
    texture : Texture
    is_srgb : bool
        Whether the image is encoded, as colours are.
    finest : int
        Level from which on it is kept: 0 is the image itself.

    Raises
    ------
    UserError
        It is missing, or no image.
    """

    def __init__(self, texture: Texture, *, is_srgb: bool, finest: int = 0) -> None:
        self._wrap = texture.wrap
        level = decode_texture(texture, is_srgb=is_srgb, finest=finest)
        self._levels = [level]
        while max(level.shape[:2]) > 1:
            height, width = (_shrunk(size, 1) for size in level.shape[:2])
            level = _averaged(level, area_weights(level.shape[0], height), area_weights(level.shape[1], width))
            self._levels.append(level)

    def mean(self, uv: NDArray, areas: NDArray) -> NDArray[np.float32]:
        """(n, 3) means about points (n, 2) over patches of such parts of the image, (n,)."""
        texels = [math.log2(level.shape[0] * level.shape[1]) for level in self._levels]
        wanted = -np.log2(np.clip(areas, 2.0**-60, 1.0))
        level = np.interp(wanted, texels[::-1], np.arange(len(texels))[::-1])
        below = level.astype(np.int64)
        part = (level - below)[:, None].astype(np.float32)
        result = np.zeros((len(uv), 3), dtype=np.float32)
        for number in range(len(self._levels)):
            for weight, chosen in ((1.0 - part, below == number), (part, below == number - 1)):
                rows = np.flatnonzero(chosen & (weight[:, 0] > 0.0))
                if rows.size:
                    result[rows] += weight[rows] * self._lookup(number, uv[rows])
        return result

    def _lookup(self, number: int, uv: NDArray) -> NDArray[np.float32]:
        """(n, 3) one level, bilinear."""
        level = self._levels[number]
        size = np.array([level.shape[1], level.shape[0]])
        place = uv * size - 0.5
        low = np.floor(place).astype(np.int64)
        part = (place - low).astype(np.float32)
        columns, rows = (
            [_wrapped(low[:, axis] + step, int(size[axis]), self._wrap[axis]) for step in (0, 1)] for axis in (0, 1)
        )
        u, v = part[:, :1], part[:, 1:]
        top = (1.0 - u) * level[rows[0], columns[0]] + u * level[rows[0], columns[1]]
        bottom = (1.0 - u) * level[rows[1], columns[0]] + u * level[rows[1], columns[1]]
        return np.asarray((1.0 - v) * top + v * bottom)


def usable_uv(uv: NDArray) -> NDArray[np.float64]:
    """Texture coordinates as they are, but for those that are not finite or too large to say where in an image."""
    return np.asarray(np.clip(np.nan_to_num(np.asarray(uv, dtype=np.float64)), -_LARGEST_UV, _LARGEST_UV))


def decode_texture(texture: Texture, *, is_srgb: bool, finest: int = 0) -> NDArray[np.float32]:
    """(H, W, 3) linear values of a texture; ``finest`` is how often it is halved.

    Raises
    ------
    UserError
        It is missing, or no image.
    """
    codes = _decode(texture)
    height, width = (_shrunk(size, finest) for size in codes.shape[:2])
    return _first_level(codes, _FROM_SRGB if is_srgb else _LINEAR, height, width)


def encoded_image(texture: Texture) -> tuple[bytes, str]:
    """A texture as a PNG or JPEG file, and its suffix: as it is if it is one, else as a PNG of 8 bits.

    Raises
    ------
    UserError
        It is missing, or no image.
    """
    with _opened(texture) as image:
        kind, usual = image.format, image.mode in ("1", "L", "LA", "P", "RGB", "RGBA")
    if usual and kind in _WIDELY_READ:
        return texture.source if isinstance(texture.source, bytes) else texture.source.read_bytes(), _WIDELY_READ[kind]
    from PIL import Image

    stream = io.BytesIO()
    Image.fromarray(_decode(texture)).save(stream, "PNG")
    return stream.getvalue(), ".png"


def image_size(texture: Texture) -> tuple[int, int]:
    """Height and width of a texture, without decoding it.

    Raises
    ------
    UserError
        It is missing, or no image.
    """
    with _opened(texture) as image:
        return int(image.height), int(image.width)


@contextmanager
def _opened(texture: Texture) -> Iterator[Any]:
    """The image; whatever goes wrong while it is open is one line."""
    from PIL import Image, UnidentifiedImageError

    source = texture.source if isinstance(texture.source, Path) else io.BytesIO(texture.source)
    if isinstance(source, Path) and not is_file(source):
        raise UserError(f"texture {texture.name[:80]}: there is no file {str(source)[:500]}")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Pillow warns of large images and of odd ones that it reads well
            Image.init()
            known = [kind for kind in Image.ID if kind not in _NOT_READ]
            with Image.open(source, formats=known) as image:
                yield image
    except Image.DecompressionBombError:
        most = 2 * (Image.MAX_IMAGE_PIXELS or 0)
        raise UserError(f"texture {texture.name}: has more than {most} texels, the most that is read") from None
    except UnidentifiedImageError:  # its message tells an address in memory
        raise UserError(f"texture {texture.name}: is no image of a kind that is known, or damaged") from None
    except Exception as error:  # Pillow raises much more than OSError on damaged files
        reason = " ".join(str(error).split()) or type(error).__name__
        raise UserError(f"texture {texture.name}: cannot be read as an image ({reason})") from None


def _decode(texture: Texture) -> NDArray[np.uint8]:
    """(H, W, 3) as it is encoded."""
    with _opened(texture) as image:
        check_memory(_TEXEL * image.height * image.width, f"texture {texture.name}", "make it smaller")
        load_whole(image, lambda: _opened(texture))
        if image.mode not in _WHITE:
            return np.asarray(image.convert("RGB"))
        values = np.nan_to_num(np.asarray(image, dtype=np.float32)) / _WHITE[image.mode]
        gray = (255.0 * np.clip(values, 0.0, 1.0) + 0.5).astype(np.uint8)
        return np.repeat(gray[:, :, None], 3, axis=2)


def _shrunk(size: int, levels: int) -> int:
    """How many texels are left of so many; never none."""
    return -(-size // 2 ** min(levels, 60))


def area_weights(size: int, wanted: int) -> csr_array:
    """(wanted, size) means of texels over as many equal pieces of the image as are wanted, in parts of texels."""
    edges = np.arange(wanted + 1) * (size / wanted)
    first = np.minimum(edges[:-1].astype(np.int64), size - 1)
    last = np.minimum(np.ceil(edges[1:]).astype(np.int64), size)
    counts = last - first
    row = np.repeat(np.arange(wanted), counts)
    column = np.arange(row.size) - np.repeat(np.cumsum(counts) - counts, counts) + first[row]
    covered = np.minimum(column + 1, edges[row + 1]) - np.maximum(column, edges[row])
    weights = (np.maximum(covered, 0.0) * (wanted / size)).astype(np.float32)
    return csr_array((weights, (row, column)), shape=(wanted, size))


def _averaged(level: NDArray[np.float32], rows: csr_array, columns: csr_array) -> NDArray[np.float32]:
    """(H, W, 3) of texels (h, w, 3): means by weights (H, h) and (W, w)."""
    tall, wide = rows.shape[0], columns.shape[0]
    across = (rows @ level.reshape(len(level), -1)).reshape(tall, -1, 3)
    down = columns @ across.transpose(1, 0, 2).reshape(across.shape[1], -1)
    return np.ascontiguousarray(down.reshape(wide, tall, 3).transpose(1, 0, 2), dtype=np.float32)


def _first_level(codes: NDArray[np.uint8], table: NDArray, height: int, width: int) -> NDArray[np.float32]:
    """Linear values, means over equal pieces of the image; some rows at a time, to bound memory."""
    if (height, width) == codes.shape[:2]:
        return np.asarray(table[codes])
    rows, columns = area_weights(codes.shape[0], height), area_weights(codes.shape[1], width)
    each = max(1, int(_TEXELS * height / codes.size))
    result = np.empty((height, width, 3), dtype=np.float32)
    for begin in range(0, height, each):
        block = rows[begin : begin + each]
        low, high = int(block.indices.min()), int(block.indices.max()) + 1
        result[begin : begin + each] = _averaged(table[codes[low:high]], block[:, low:high], columns)
    return result


def _wrapped(index: NDArray[np.int64], size: int, wrap: Wrap) -> NDArray[np.int64]:
    if wrap == "repeat":
        return np.asarray(index % size)
    if wrap == "clamp":
        return np.asarray(np.clip(index, 0, size - 1))
    index = index % (2 * size)
    return np.asarray(np.where(index < size, index, 2 * size - 1 - index))
