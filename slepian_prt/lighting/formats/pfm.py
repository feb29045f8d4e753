"""Portable float maps: rows of float32 from the bottom up."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slepian_prt.lighting.map_rows import Rows, check_shape

_HEADER = re.compile(rb"P([Ff])\s+(\d{1,18})\s+(\d{1,18})\s+([-+.\deE]+)\s")


def pfm_size(path: Path) -> tuple[int, int]:
    """Height and width that a file says it has; ValueError if it is none."""
    header = _read_header(path)
    return int(header[3]), int(header[2])


def _read_header(path: Path) -> re.Match[bytes]:
    with path.open("rb") as file:
        header = _HEADER.match(file.read(256))
    if header is None:
        raise ValueError("its header is none of a .pfm")
    return header


def pfm_rows(path: Path) -> Rows:
    """A .pfm file (P. Debevec's, as in netpbm's manual), grey or in colours.

    The sign of its scale says the order of bytes, its size is a factor of the texels, as in Mitsuba.
    """
    header = _read_header(path)
    channels = 3 if header[1] == b"F" else 1
    width, height, scale = int(header[2]), int(header[3]), float(header[4])
    check_shape(str(path), height, width)
    if not math.isfinite(scale) or scale == 0.0:
        raise ValueError(f"its scale is {scale:g}")
    kind, begin = np.dtype("<f4" if scale < 0.0 else ">f4"), header.end()
    if path.stat().st_size < begin + 4 * channels * width * height:
        raise ValueError("it is cut short")
    stored = np.memmap(path, kind, "r", begin, (height, width, channels))

    def read(begin: int, end: int) -> NDArray[np.float32]:
        part = stored[height - end : height - begin][::-1].astype(np.float32)
        with np.errstate(over="ignore", invalid="ignore"):  # infinite texels are told of later
            part *= np.float32(abs(scale))
        return np.broadcast_to(part, (*part.shape[:2], 3))

    return Rows(path.stem, str(path), height, width, read)
