"""Radiance pictures (.hdr, .pic): four bytes a texel, three mantissas and the exponent that they share.

G. Ward, "Real Pixels", Graphics Gems II, 1991; and "Radiance File Formats", which comes with Radiance. A texel is
m 2^(e - 136), without the half that Radiance adds to m: so does Mitsuba, and the same file must light the same.
"""

from __future__ import annotations

import logging
import math
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slepian_prt.lighting.formats.primaries import to_srgb, xyz_to_srgb
from slepian_prt.lighting.map_rows import Rows, check_shape
from slepian_prt.machine.file_content import read_content
from slepian_prt.machine.memory import check_memory

log = logging.getLogger(__name__)

# Scanlines of other lengths are never stored by component.
_SHORTEST, _LONGEST = 8, 32767

_LONGEST_HEADER = 1 << 20

# Texels for each byte of a large file: four times what runs of components reach. Repetitions of Radiance 1 have no end.
_MOST_PER_BYTE = 64

_RESOLUTION = re.compile(rb"\s*([-+])([XY])\s+(\d{1,18})\s+([-+])([XY])\s+(\d{1,18})\s*")


@dataclass(frozen=True)
class _Header:
    """What stands before the texels.

    Attributes
    ----------
    to_radiance : (3, 3)
        From the numbers of texels to linear sRGB radiance.
    by_column : bool
        Whether scanlines are columns.
    mirrored, upside_down : bool
    height, width, size : int
        Of the map, and of the header in bytes.
    """

    to_radiance: NDArray[np.float64]
    by_column: bool
    mirrored: bool
    upside_down: bool
    height: int
    width: int
    size: int


def radiance_size(path: Path) -> tuple[int, int]:
    """Height and width that a picture says it has; ValueError if it is none."""
    header = _parse_header(path, read_content(path, _LONGEST_HEADER))
    return header.height, header.width


def radiance_rows(path: Path) -> Rows:
    """A Radiance picture as the radiance that it was made from, held as bytes.

    EXPOSURE and COLORCORR, each as often as it is there, are divided out; PRIMARIES and XYZ are brought to sRGB; a
    picture without PRIMARIES is taken as sRGB. All eight orders of texels, and both run-length codings or none, are
    read. VIEW and PIXASPECT say nothing of a map of all directions. GAMMA is not of the format, whose numbers are
    linear; where it is not 1, that is said.
    """
    data = read_content(path)
    header = _parse_header(path, data)
    check_shape(str(path), header.height, header.width)
    count, length = (header.width, header.height) if header.by_column else (header.height, header.width)
    try:
        texels = _decode(data, header.size, count, length)
    except IndexError:
        raise ValueError("it is cut short") from None
    if header.by_column:
        texels = texels.transpose(1, 0, 2)
    texels = texels[:: -1 if header.upside_down else 1, :: -1 if header.mirrored else 1]
    powers = np.ldexp(np.float32(1.0), np.arange(256) - 136)
    powers[0] = 0.0
    factors = np.diagonal(header.to_radiance)
    by_channel = bool((header.to_radiance == np.diag(factors)).all())

    def read(begin: int, end: int) -> NDArray[np.float32]:
        part = texels[begin:end]
        linear = part[..., :3] * powers[part[..., 3]][..., None]
        with np.errstate(over="ignore", invalid="ignore"):  # what becomes infinite is told of later
            if by_channel:
                return np.asarray(linear * factors.astype(np.float32))
            return np.asarray((linear @ header.to_radiance.T).astype(np.float32))

    return Rows(path.stem, str(path), header.height, header.width, read)


def _parse_header(path: Path, data: bytes) -> _Header:
    """Lines up to that of the resolution; later ones of EXPOSURE and COLORCORR multiply earlier ones."""
    applied, matrix = np.ones(3), np.eye(3)
    kind = b"32-bit_rle_rgbe"
    at = 0
    while True:
        end = data.find(b"\n", at, _LONGEST_HEADER)
        if end < 0:
            raise ValueError("its header has no line of resolution, as -Y 512 +X 1024")
        line, at = data[at:end].rstrip(b"\r"), end + 1
        if (found := _RESOLUTION.fullmatch(line)) and found[2] != found[5]:
            break
        name, _, value = line.partition(b"=")
        if name == b"EXPOSURE":
            applied *= _numbers(name, value, 1)
        elif name == b"COLORCORR":
            applied *= _numbers(name, value, 3)
        elif name == b"PRIMARIES":
            converted = to_srgb(_numbers(name, value, 8, positive=False))
            matrix = np.eye(3) if converted is None else converted
        elif name == b"FORMAT":
            kind = value.strip()
        elif name == b"GAMMA" and value.strip() not in (b"1", b"1.0", b"1.00"):
            log.info("%s: GAMMA=%s is ignored; a Radiance picture is linear", path, value.strip().decode("latin-1"))
    if kind == b"32-bit_rle_xyze":
        matrix = xyz_to_srgb()
    elif kind != b"32-bit_rle_rgbe":
        raise ValueError(f"its FORMAT is {kind.decode('latin-1')[:40]!r}, not 32-bit_rle_rgbe or 32-bit_rle_xyze")
    by_column = found[2] == b"X"
    signs, sizes = {found[2]: found[1], found[5]: found[4]}, {found[2]: int(found[3]), found[5]: int(found[6])}
    # Y goes up in Radiance: decreasing is from the top.
    mirrored, upside_down = signs[b"X"] == b"-", signs[b"Y"] == b"+"
    return _Header(matrix / applied, by_column, mirrored, upside_down, sizes[b"Y"], sizes[b"X"], at)


def _numbers(name: bytes, value: bytes, count: int, positive: bool = True) -> list[float]:
    try:
        numbers = [float(word) for word in value.split()[:count]]
    except ValueError:
        numbers = []
    if len(numbers) < count or not all(math.isfinite(x) and (x > 0.0 or not positive) for x in numbers):
        text = (name + b"=" + value).decode("latin-1")[:80]
        raise ValueError(f"its header says {text!r}, not {count} {'positive ' if positive else ''}numbers")
    return numbers


def _decode(data: bytes, at: int, count: int, length: int) -> NDArray[np.uint8]:
    """(count, length, 4) bytes of scanlines from position ``at``; IndexError if the data end before."""
    if len(data) - at < 4 * count:  # before memory is taken
        raise IndexError
    if count * length > max(1 << 24, _MOST_PER_BYTE * len(data)):
        raise ValueError(f"it has {len(data)} bytes for {count} scanlines of {length} texels")
    check_memory(4 * count * length, f"a picture of {count} x {length} texels", "make it smaller")
    texels = np.empty((count, length, 4), dtype=np.uint8)
    for number in range(count):
        start = data[at : at + 4]
        if start[:2] == b"\x02\x02" and start[2] < 128 and _SHORTEST <= length <= _LONGEST:
            if (said := start[2] << 8 | start[3]) != length:
                raise ValueError(f"its scanline {number} is {said} texels long, not {length}")
            line, at = _by_component(data, at + 4, 4 * length)
            texels[number] = np.frombuffer(line, np.uint8).reshape(4, length).T
        else:
            at = _by_texel(data, at, texels[number])
    return texels


def _by_component(data: bytes, at: int, count: int) -> tuple[bytearray, int]:
    """``count`` bytes from run-length codes, and the position after these."""
    line = bytearray()
    while len(line) < count:
        code = data[at]
        if code > 128:
            line += data[at + 1 : at + 2] * (code - 128)
            at += 2
        else:
            line += data[at + 1 : at + 1 + code]
            at += 1 + code
    if len(line) != count:
        raise ValueError("its run lengths do not fit its scanlines")
    return line, at


def _by_texel(data: bytes, at: int, line: NDArray[np.uint8]) -> int:
    """Fill a scanline (length, 4) of plain texels and of Radiance 1's repetitions; the position after it.

    Mantissas 1, 1, 1 repeat the texel before; the exponent is how often, in ever higher bytes for those that follow
    each other.
    """
    length = len(line)
    stored = np.frombuffer(data, np.uint8, min(4 * length, (len(data) - at) // 4 * 4), at).reshape(-1, 4)
    marks = np.flatnonzero((stored[:, :3] == 1).all(axis=1))
    done = taken = 0
    shift, after = 0, -1
    for mark in marks.tolist():
        plain = min(mark - taken, length - done)
        line[done : done + plain] = stored[taken : taken + plain]
        done, taken = done + plain, taken + plain
        if done == length:
            return at + 4 * taken
        shift = shift + 8 if mark == after else 0
        times = int(stored[mark, 3]) << shift
        if done == 0 or times > length - done:
            raise ValueError("its run lengths do not fit its scanlines")
        line[done : done + times] = line[done - 1]
        done, taken, after = done + times, taken + 1, mark + 1
        if done == length:
            return at + 4 * taken
    plain = length - done
    if len(stored) - taken < plain:
        raise IndexError
    line[done:] = stored[taken : taken + plain]
    return at + 4 * (taken + plain)
