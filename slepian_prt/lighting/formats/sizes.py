"""How large a picture says it is, from the first bytes of its file, before another program reads it."""

from __future__ import annotations

import struct
import warnings
from pathlib import Path

from slepian_prt.lighting.formats.exr_header import read_headers
from slepian_prt.lighting.formats.pfm import pfm_size
from slepian_prt.lighting.formats.radiance import radiance_size
from slepian_prt.machine.file_content import read_content

_PNG = b"\x89PNG\r\n\x1a\n"


def picture_size(path: Path) -> tuple[int, int] | None:
    """Height and width of the largest part; None for what is no picture of a kind that is known, or damaged.

    Raises
    ------
    UserError
        The file cannot be read.
    """
    start = read_content(path, 24)
    try:
        if start.startswith(b"\x76\x2f\x31\x01"):
            windows = [part.data for part in read_headers(path)]
            largest = max(windows, key=lambda window: max(window.height, window.width))
            return largest.height, largest.width
        if start.startswith(b"#?"):
            return radiance_size(path)
        if start.startswith((b"PF", b"Pf")):
            return pfm_size(path)
        if start.startswith(_PNG):
            width, height = struct.unpack(">II", start[16:24])
            return height, width
        return _pillow_size(path)
    except (ValueError, struct.error):
        return None


def _pillow_size(path: Path) -> tuple[int, int] | None:
    from PIL import Image

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with Image.open(path, formats=("JPEG", "BMP", "TGA", "PPM")) as image:
                return int(image.height), int(image.width)
    except Image.DecompressionBombError:
        return 1 << 16, 1 << 16
    except Exception:  # no picture; Pillow raises much more than OSError on damaged files
        return None
