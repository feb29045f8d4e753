"""OpenEXR files, by blocks of rows."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError
from slepian_prt.lighting.formats.exr_header import Part, Window, extract_part, read_headers
from slepian_prt.lighting.formats.exr_layers import choose_layer
from slepian_prt.lighting.formats.primaries import to_srgb
from slepian_prt.lighting.map_rows import Rows, check_shape, check_size

# Texels of a map of which little more than the header may be there: the others are black, and would still take time.
_MOST_BLACK = 1 << 26


def exr_rows(path: Path) -> Rows:
    """An OpenEXR file: scanlines or tiles (the finest level), of one part or several, `choose_layer` says of which.

    The map is the display window. What of it the data window does not hold is black, and what it holds beyond is cut
    off. Alpha is ignored, ``chromaticities`` are followed.

    Raises
    ------
    UserError, ValueError
        Not one image of a latitude-longitude map, or damaged.
    """
    parts = read_headers(path)
    layer = choose_layer(path, parts)
    part = parts[layer.part]
    if part.cube:
        raise UserError(f"{path}: is an environment map as the six faces of a cube; convert it to latitude-longitude")
    data, display = part.data, part.display
    check_size(str(path), data.height, data.width)
    check_shape(str(path), display.height, display.width)
    if display.height * display.width > max(_MOST_BLACK, 4 * data.height * data.width):
        raise UserError(
            f"{path}: is {display.width} x {display.height} texels, of which it holds {data.width} x {data.height}; "
            "make it smaller, or write all of them"
        )
    convert = None if part.chromaticities is None else to_srgb(part.chromaticities)
    names = [channel.name for channel in layer.channels]
    image = _open(path, parts, layer.part)
    held = Window(
        max(data.left, display.left),
        max(data.top, display.top),
        min(data.right, display.right),
        min(data.bottom, display.bottom),
    )

    def read(begin: int, end: int) -> NDArray[np.float32]:
        texels = np.zeros((end - begin, display.width, len(names)), dtype=np.float32)
        top, bottom = max(held.top, display.top + begin), min(held.bottom, display.top + end - 1)
        if top <= bottom and held.width > 0:
            rows = slice(top - display.top - begin, bottom - display.top - begin + 1)
            columns = slice(held.left - display.left, held.right - display.left + 1)
            stored = _stored_rows(image, names, data, top, bottom)
            for number, channel in enumerate(stored):
                texels[rows, columns, number] = channel[:, held.left - data.left : held.right - data.left + 1]
        if convert is not None and len(names) == 3:
            with np.errstate(invalid="ignore", over="ignore"):  # infinite texels are told of later
                texels = texels @ convert.T.astype(np.float32)
        return np.broadcast_to(texels, (*texels.shape[:2], 3))

    return Rows(path.stem, str(path), display.height, display.width, read)


def _stored_rows(image: Any, names: list[str], data: Window, top: int, bottom: int) -> list[NDArray[np.float32]]:
    """(rows, width of the data window) of each channel."""
    import Imath

    kind = Imath.PixelType(Imath.PixelType.FLOAT)
    try:
        with _without_complaints():
            rows = image.channels(names, kind, top, bottom)
    except (OSError, RuntimeError):
        raise ValueError("its pixels are cut short or damaged") from None
    return [np.frombuffer(row, np.float32).reshape(bottom - top + 1, data.width) for row in rows]


def _open(path: Path, parts: tuple[Part, ...], number: int) -> Any:
    """OpenEXR's reader of rows, which only knows first parts: others are copied, compressed, to a file of their own."""
    import OpenEXR

    if number == 0:
        with _without_complaints():
            return OpenEXR.InputFile(str(path))
    # The open file can be read on when its name is gone; Windows keeps it, and the folder.
    with tempfile.TemporaryDirectory(prefix="slepian_prt-", ignore_cleanup_errors=True) as folder:
        alone = Path(folder) / "part.exr"
        with alone.open("wb") as target:
            extract_part(path, parts, number, target)
        try:
            with _without_complaints():
                return OpenEXR.InputFile(str(alone))
        except Exception:  # its message names a file that is gone
            raise ValueError(f"its part {number} is damaged") from None


@contextmanager
def _without_complaints() -> Iterator[None]:
    """Nothing on standard error: OpenEXR's C++ code prints there, besides raising, what it finds damaged.

    It holds the interpreter's lock meanwhile, so that nothing else that Python prints is lost.
    """
    try:
        kept = os.dup(2)
    except OSError:  # closed: nothing can be printed
        yield
        return
    try:
        with open(os.devnull, "wb") as nowhere:
            os.dup2(nowhere.fileno(), 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
