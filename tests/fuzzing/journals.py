"""Damaged and foreign blocks in a folder of them, as journals keep them; independent of the package."""

from __future__ import annotations

import random
import struct
import zlib
from pathlib import Path

_HEADER = struct.Struct("<4sIQQQ")  # mark, number of the block, vertices, coefficients, rays


def damage(folder: Path, random: random.Random) -> Path:
    """Spoil one of the blocks in a folder, and return which: some with the checksum that belongs to what they hold."""
    path = random.choice(sorted(folder.glob("*.block")))
    content = path.read_bytes()
    kinds = (_flipped, _cut, _longer, _emptied, _replaced, _header, _header, _values, _values, _exchanged, _folder)
    random.choice(kinds)(path, content, random)
    return path


def sealed(content: bytes) -> bytes:
    """Header and arrays with the checksum of both."""
    return content + struct.pack("<I", zlib.crc32(content))


def _flipped(path: Path, content: bytes, random: random.Random) -> None:
    spoilt = bytearray(content)
    spoilt[random.randrange(len(spoilt))] ^= 1 << random.randrange(8)
    path.write_bytes(spoilt)


def _cut(path: Path, content: bytes, random: random.Random) -> None:
    path.write_bytes(content[: random.randrange(len(content))])


def _longer(path: Path, content: bytes, random: random.Random) -> None:
    path.write_bytes(content + random.randbytes(random.randrange(1, 40)))


def _emptied(path: Path, content: bytes, random: random.Random) -> None:
    path.write_bytes(b"")


def _replaced(path: Path, content: bytes, random: random.Random) -> None:
    path.write_bytes(random.randbytes(random.randrange(1, 2000)))


def _header(path: Path, content: bytes, random: random.Random) -> None:
    """Numbers of the header, with the right checksum."""
    numbers = list(_HEADER.unpack_from(content))
    which = random.randrange(1, 5)
    huge = random.choice((0, 1, 2**31, 2**32 - 1) if which == 1 else (0, 1, 2**31, 2**60, 2**62, 2**63, 2**64 - 1))
    numbers[which] = random.choice((huge, max(0, numbers[which] - 1), numbers[which] + 1))
    path.write_bytes(sealed(_HEADER.pack(*numbers) + content[_HEADER.size : -4]))


def _values(path: Path, content: bytes, random: random.Random) -> None:
    """Numbers of the arrays, with the right checksum: floats that are not finite, vertices of others."""
    spoilt = bytearray(content[:-4])
    count, size = _HEADER.unpack_from(content)[2:4]
    begin, end = random.choice(
        [
            (_HEADER.size, _HEADER.size + 4 * count),
            (_HEADER.size + 4 * count, _HEADER.size + 16 * count),
            (_HEADER.size + 16 * count, _HEADER.size + 16 * count + 4 * size),
        ]
    )
    if end == begin:
        return
    at = begin + 4 * random.randrange((end - begin) // 4)
    spoilt[at : at + 4] = random.choice(
        (struct.pack("<f", float("nan")), struct.pack("<f", float("inf")), struct.pack("<i", -1), b"\xff\xff\xff\x7f")
    )
    path.write_bytes(sealed(bytes(spoilt)))


def _exchanged(path: Path, content: bytes, random: random.Random) -> None:
    """What another block holds, under this one's number and with the right checksum."""
    other = random.choice(sorted(path.parent.glob("*.block"))).read_bytes()
    number = _HEADER.unpack_from(content)[1]
    mark, _, *sizes = _HEADER.unpack_from(other)
    path.write_bytes(sealed(_HEADER.pack(mark, number, *sizes) + other[_HEADER.size : -4]))


def _folder(path: Path, content: bytes, random: random.Random) -> None:
    path.unlink()
    path.mkdir()
