"""Textures of mesh files, filtered: the mean over a patch costs no more than one lookup."""

from __future__ import annotations

import io
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError
from slepian_prt.scene.formats.parts import Texture, Wrap

_CODES = np.arange(256) / 255.0
_FROM_SRGB = np.where(_CODES <= 0.04045, _CODES / 12.92, ((_CODES + 0.055) / 1.055) ** 2.4).astype(np.float32)
_LINEAR = _CODES.astype(np.float32)

# Rows that are decoded from 8 bits at a time.
_ROWS = 256


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
        codes = _decode(texture)
        self.height, self.width = codes.shape[:2]
        table = _FROM_SRGB if is_srgb else _LINEAR
        level = _reduced(codes, table, 2 ** min(finest, int(math.log2(max(1, min(codes.shape[:2]))))))
        self._levels = [level]
        while max(level.shape[:2]) > 1:
            level = _halved(level)
            self._levels.append(level)
        self._finest = finest

    def mean(self, uv: NDArray, texels: NDArray) -> NDArray[np.float32]:
        """(n, 3) means about points (n, 2) over patches of so many texels of the image, (n,)."""
        # Half the logarithm of an area is that of a length.
        level = 0.5 * np.log2(np.maximum(texels, 1.0)) - self._finest
        level = np.clip(level, 0.0, len(self._levels) - 1.0)
        below = np.minimum(level.astype(np.int64), len(self._levels) - 1)
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


def image_size(texture: Texture) -> tuple[int, int]:
    """Height and width of a texture, without decoding it.

    Raises
    ------
    UserError
        It is missing, or no image.
    """
    with _opened(texture) as image:
        return int(image.height), int(image.width)


def _opened(texture: Texture) -> Any:
    from PIL import Image

    source = texture.source if isinstance(texture.source, Path) else io.BytesIO(texture.source)
    if isinstance(source, Path) and not source.is_file():
        raise UserError(f"texture {texture.name}: there is no file {source}")
    try:
        return Image.open(source)
    except Exception as error:  # Pillow raises much more than OSError on damaged files
        raise _unreadable(texture, error) from None


def _unreadable(texture: Texture, error: Exception) -> UserError:
    reason = " ".join(str(error).split()) or type(error).__name__
    return UserError(f"texture {texture.name}: cannot be read as an image ({reason})")


def _decode(texture: Texture) -> NDArray[np.uint8]:
    """(H, W, 3) as it is encoded."""
    with _opened(texture) as image:
        try:
            if image.mode in ("I;16", "I;16B", "I;16L", "I", "F"):
                codes = np.asarray(image, dtype=np.float64)
                gray = np.clip(codes / (65535.0 if codes.max(initial=0.0) > 255.0 else 255.0), 0.0, 1.0)
                return np.repeat((255.0 * gray + 0.5).astype(np.uint8)[:, :, None], 3, axis=2)
            return np.asarray(image.convert("RGB"))
        except Exception as error:
            raise _unreadable(texture, error) from None


def _reduced(codes: NDArray[np.uint8], table: NDArray, factor: int) -> NDArray[np.float32]:
    """Linear values, means over squares of ``factor`` texels; what does not fill a square at the ends is left out."""
    height, width = codes.shape[0] // factor, codes.shape[1] // factor
    result = np.empty((height, width, 3), dtype=np.float32)
    for begin in range(0, height, _ROWS):
        rows = codes[begin * factor : min(begin + _ROWS, height) * factor, : width * factor]
        squares = table[rows].reshape(-1, factor, width, factor, 3)
        result[begin : begin + len(squares)] = squares.mean(axis=(1, 3))
    return result


def _halved(level: NDArray[np.float32]) -> NDArray[np.float32]:
    """Half as many rows and columns, at least one; of an odd number the last is counted twice."""
    for axis in (0, 1):
        count = level.shape[axis]
        if count > 1:
            if count % 2:
                level = np.concatenate([level, level.take([-1], axis=axis)], axis=axis)
            level = 0.5 * (level.take(range(0, count, 2), axis=axis) + level.take(range(1, count + 1, 2), axis=axis))
    return level


def _wrapped(index: NDArray[np.int64], size: int, wrap: Wrap) -> NDArray[np.int64]:
    if wrap == "repeat":
        return np.asarray(index % size)
    if wrap == "clamp":
        return np.asarray(np.clip(index, 0, size - 1))
    index = index % (2 * size)
    return np.asarray(np.where(index < size, index, 2 * size - 1 - index))
