"""Headers of OpenEXR files, and one part of a file as a file of its own.

OpenEXR's Python module tells neither the types of channels without their pixels, nor reads rows of any part but the
first. The layout is that of "OpenEXR File Layout" in OpenEXR's documentation.
"""

from __future__ import annotations

import mmap
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

# Bits of the version field.
_TILED, _DEEP, _SEVERAL = 0x200, 0x800, 0x1000

# Attributes of a part; OpenEXR takes seconds for 100,000 of them, and files of renderers have hundreds.
_MOST_ATTRIBUTES = 10_000

_KINDS = ("uint", "half", "float")


@dataclass(frozen=True)
class Window:
    """Columns ``left`` to ``right`` and rows ``top`` to ``bottom``, these included."""

    left: int
    top: int
    right: int
    bottom: int

    @property
    def width(self) -> int:
        return self.right - self.left + 1

    @property
    def height(self) -> int:
        return self.bottom - self.top + 1


@dataclass(frozen=True)
class Channel:
    """A channel: its full name, ``uint``, ``half`` or ``float``, and every how many columns and rows it has a value."""

    name: str
    kind: str
    sampling: tuple[int, int]


@dataclass(frozen=True)
class Part:
    """What one header says.

    Attributes
    ----------
    name, view : str
        Empty if it has none.
    views : tuple of str
        Of a part whose layers are views, the default first.
    tiled, deep, cube : bool
        ``cube`` is the layout of an environment map as six faces.
    channels : tuple of Channel
    data, display : Window
    chromaticities : (4, 2), or None
    begin, end : int
        Of the header's attributes in the file.
    chunks : int
        How many blocks of pixels it has; 0 if it does not say.
    """

    name: str
    view: str
    views: tuple[str, ...]
    tiled: bool
    deep: bool
    cube: bool
    channels: tuple[Channel, ...]
    data: Window
    display: Window
    chromaticities: NDArray[np.float64] | None
    begin: int
    end: int
    chunks: int


def read_headers(path: Path) -> tuple[Part, ...]:
    """The parts of a file.

    Raises
    ------
    ValueError
        A header that is cut short or damaged.
    """
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        try:
            return _parse(data)
        except (IndexError, KeyError, struct.error):
            raise ValueError("its header is cut short or damaged") from None


def _parse(data: mmap.mmap) -> tuple[Part, ...]:
    flags = struct.unpack_from("<I", data, 4)[0]
    at = 8
    parts: list[Part] = []
    while not parts or (flags & _SEVERAL and data[at]):
        begin, attributes = at, {}
        while data[at]:
            name, at = _word(data, at)
            _, at = _word(data, at)
            size = struct.unpack_from("<I", data, at)[0]
            if at + 4 + size > len(data):
                raise IndexError
            attributes[name] = data[at + 4 : at + 4 + size]
            at += 4 + size
            if len(attributes) > _MOST_ATTRIBUTES:
                raise ValueError(f"its header has more than {_MOST_ATTRIBUTES} attributes")
        at += 1
        parts.append(_part(attributes, flags, begin, at))
    return tuple(parts)


def _word(data: mmap.mmap | bytes, at: int) -> tuple[str, int]:
    """A string that ends in a zero, and the position after it."""
    end = data.find(b"\0", at)
    if end < 0:
        raise IndexError
    return data[at:end].decode("utf-8", "replace"), end + 1


def _part(attributes: dict[str, bytes], flags: int, begin: int, end: int) -> Part:
    text = {name: attributes.get(name, b"").decode("utf-8", "replace") for name in ("name", "view", "type")}
    chromaticities = None
    if "chromaticities" in attributes:
        chromaticities = np.array(struct.unpack("<8f", attributes["chromaticities"])).reshape(4, 2)
    return Part(
        name=text["name"],
        view=text["view"],
        views=_strings(attributes.get("multiView", b"")),
        tiled="tile" in text["type"] or bool(flags & _TILED),
        deep=text["type"].startswith("deep") or (bool(flags & _DEEP) and not text["type"]),
        cube=attributes.get("envmap") == b"\x01",
        channels=_channels(attributes["channels"]),
        data=Window(*struct.unpack("<4i", attributes["dataWindow"])),
        display=Window(*struct.unpack("<4i", attributes["displayWindow"])),
        chromaticities=chromaticities,
        begin=begin,
        end=end,
        chunks=struct.unpack("<i", attributes["chunkCount"])[0] if "chunkCount" in attributes else 0,
    )


def _strings(value: bytes) -> tuple[str, ...]:
    found, at = [], 0
    while at < len(value):
        size = struct.unpack_from("<I", value, at)[0]
        found.append(value[at + 4 : at + 4 + size].decode("utf-8", "replace"))
        at += 4 + size
    return tuple(found)


def _channels(value: bytes) -> tuple[Channel, ...]:
    found, at = [], 0
    while value[at]:
        name, at = _word(value, at)
        kind, _, across, down = struct.unpack_from("<iIii", value, at)
        at += 16
        found.append(Channel(name, _KINDS[kind], (across, down)))
    return tuple(found)


def extract_part(path: Path, parts: tuple[Part, ...], number: int, target: BinaryIO) -> None:
    """Write part ``number`` of a file of several as a file with that part alone, without holding it.

    The pixels stay compressed as they are: each block only loses the number of its part.

    Raises
    ------
    ValueError
        Pixels that are not all there.
    """
    part = parts[number]
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        tables = parts[-1].end + 1 + 8 * sum(before.chunks for before in parts[:number])
        if part.chunks <= 0 or tables + 8 * part.chunks > len(data):
            raise ValueError("it is cut short")
        offsets = np.frombuffer(data[tables : tables + 8 * part.chunks], "<u8")
        version = struct.unpack_from("<I", data, 4)[0] & ~(_SEVERAL | _TILED | _DEEP)
        header = data[:4] + struct.pack("<I", version | (_TILED if part.tiled else 0)) + data[part.begin : part.end]
        # Where a block says its size: after the number of its part and its first row, or its place among the tiles.
        before_size = 4 + (16 if part.tiled else 4)
        try:
            sizes = [before_size + struct.unpack_from("<I", data, int(at) + before_size)[0] for at in offsets]
        except struct.error:
            raise ValueError("it is cut short") from None
        if any(int(at) + 4 + size > len(data) for at, size in zip(offsets, sizes, strict=True)):
            raise ValueError("it is cut short")
        ends = np.cumsum(np.array(sizes, dtype=np.int64)) + len(header) + 8 * part.chunks
        target.write(header + (ends - sizes).astype("<u8").tobytes())
        for at, size in zip(offsets, sizes, strict=True):
            target.write(data[int(at) + 4 : int(at) + 4 + size])
