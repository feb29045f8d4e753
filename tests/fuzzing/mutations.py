"""Damage that any file can have: bytes flipped, cut, inserted and doubled, and numbers of text that are others."""

from __future__ import annotations

import random
import re
from collections.abc import Callable

# Numbers that readers trip over, as text.
NUMBERS = (
    b"0", b"-1", b"1", b"2", b"255", b"65536", b"2147483647", b"2147483648", b"4294967295", b"9223372036854775807",
    b"9223372036854775808", b"18446744073709551616", b"1000000000000000000", b"1e308", b"-1e308", b"1e-320", b"1e400",
    b"nan", b"-nan", b"inf", b"-inf", b"", b".", b"1.5", b"0x10", b"1_0", b"1,5", b"9" * 400,
)  # fmt: skip

# The same in the bytes of headers.
WORDS = (0, 1, 2, 127, 255, 256, 65535, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFE, 0xFFFFFFFF)

_NUMBER = re.compile(rb"(?<![\w.])[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?")

Mutation = Callable[[bytes, random.Random], bytes]


def flip(content: bytes, random: random.Random) -> bytes:
    """Some bytes are others."""
    changed = bytearray(content)
    for _ in range(random.choice((1, 1, 2, 5, 20))):
        if changed:
            changed[random.randrange(len(changed))] ^= 1 << random.randrange(8)
    return bytes(changed)


def replace(content: bytes, random: random.Random) -> bytes:
    """A few bytes next to each other are arbitrary."""
    at, length = random.randrange(len(content) + 1), random.choice((1, 2, 4, 8, 40))
    return content[:at] + random.randbytes(length) + content[at + length :]


def cut(content: bytes, random: random.Random) -> bytes:
    """The end is missing."""
    return content[: random.randrange(len(content) + 1)]


def drop(content: bytes, random: random.Random) -> bytes:
    """A piece is missing."""
    at = random.randrange(len(content) + 1)
    return content[:at] + content[at + random.choice((1, 2, 3, 4, 12, 100)) :]


def insert(content: bytes, random: random.Random) -> bytes:
    """Bytes that do not belong there."""
    at, length = random.randrange(len(content) + 1), random.choice((1, 2, 4, 100))
    return content[:at] + random.choice((random.randbytes(length), bytes(length), b"\xff" * length)) + content[at:]


def double(content: bytes, random: random.Random) -> bytes:
    """A piece is there several times."""
    at = random.randrange(len(content) + 1)
    end = min(len(content), at + random.choice((1, 4, 16, 64, 1000)))
    return content[:end] + content[at:end] * random.choice((1, 1, 3, 50)) + content[end:]


def word(content: bytes, random: random.Random, within: int | None = None) -> bytes:
    """A number of two, four or eight bytes near the beginning is one that readers trip over."""
    size = random.choice((2, 4, 4, 4, 8))
    last = min(len(content), within or len(content)) - size
    if last < 0:
        return content
    at = random.randrange(last + 1)
    value = random.choice(WORDS) % (1 << 8 * size)
    return content[:at] + value.to_bytes(size, random.choice(("little", "big"))) + content[at + size :]


def number(content: bytes, random: random.Random) -> bytes:
    """A number of the text is another."""
    found = list(_NUMBER.finditer(content))
    if not found:
        return word(content, random)
    chosen = random.choice(found)
    return content[: chosen.start()] + random.choice(NUMBERS) + content[chosen.end() :]


def lines(content: bytes, random: random.Random) -> bytes:
    """A line of the text is missing, doubled or elsewhere."""
    rows = content.split(b"\n")
    at = random.randrange(len(rows))
    row = rows.pop(at)
    for _ in range(random.choice((0, 2, 1))):
        rows.insert(random.choice((at, random.randrange(len(rows) + 1))), row)
    return b"\n".join(rows)


ANY: tuple[Mutation, ...] = (flip, replace, cut, drop, insert, double, word)
TEXT: tuple[Mutation, ...] = (number, number, number, lines, flip, cut, drop, insert, double)


def mutate(content: bytes, random: random.Random, kinds: tuple[Mutation, ...] = ANY) -> bytes:
    """One kind of damage, now and then two or three, of those given."""
    for _ in range(random.choice((1, 1, 1, 2, 3))):
        content = random.choice(kinds)(content, random)
    return content
