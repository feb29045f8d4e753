"""The beginning of a stream of Draco: how many faces and vertices it tells of, for which Draco takes memory at once.

Source: Draco Bitstream Specification 2.2, "Header Decoder", "Metadata Decoder" and "Connectivity Decoder".
"""

from __future__ import annotations

# "DRACO", version, and that it is a triangle mesh: clouds of points take memory for as many as they claim.
_BEGIN = b"DRACO\x02\x02\x01"
_METHODS, _METADATA, _DEEPEST = (0, 1), 0x8000, 16


def draco_counts(data: bytes) -> tuple[int, int]:
    """Faces and vertices that a triangle mesh of bitstream 2.2 says to have.

    Raises
    ------
    ValueError
        It is none.
    """
    if len(data) < len(_BEGIN) + 3 or not data.startswith(_BEGIN) or data[8] not in _METHODS:
        raise ValueError("not a triangle mesh of Draco")
    place, flags = len(_BEGIN) + 3, int.from_bytes(data[9:11], "little")
    if flags & ~_METADATA:
        raise ValueError("not a triangle mesh of Draco")
    if flags:
        place = _behind_metadata(data, place)
    if data[8] == 0:  # in sequence: faces, vertices
        faces, place = _varint(data, place)
        return faces, _varint(data, place)[0]
    vertices, place = _varint(data, place + 1)  # behind the way of traversal
    return _varint(data, place)[0], vertices


def _behind_metadata(data: bytes, place: int) -> int:
    """Names and values of attributes, then those of the whole, each with more of the same inside."""
    attributes, place = _varint(data, place)
    for _ in range(attributes):
        place = _behind_block(data, _varint(data, place)[1])
    return _behind_block(data, place)


def _behind_block(data: bytes, place: int, depth: int = 0) -> int:
    if depth > _DEEPEST:
        raise ValueError("metadata of Draco are nested too deeply")
    entries, place = _varint(data, place)
    for _ in range(entries):
        size, place = _varint(data, _behind_name(data, place))
        place = _within(data, place + size)
    inside, place = _varint(data, place)
    for _ in range(inside):
        place = _behind_block(data, _behind_name(data, place), depth + 1)
    return place


def _behind_name(data: bytes, place: int) -> int:
    return _within(data, _within(data, place + 1) + data[place])


def _within(data: bytes, place: int) -> int:
    if place >= len(data):
        raise ValueError("Draco's header is cut short")
    return place


def _varint(data: bytes, place: int) -> tuple[int, int]:
    """A number in groups of seven bits, the lowest first, and the place behind it."""
    number = 0
    for shift in range(0, 35, 7):
        byte = data[_within(data, place)]
        number |= (byte & 0x7F) << shift
        place += 1
        if byte < 0x80:
            return number, place
    raise ValueError("a number of Draco's header")
