"""Indices as meshoptimizer compresses them, decoded.

Source: the glTF extensions EXT_meshopt_compression and KHR_meshopt_compression, appendix A (modes 1 and 2).
"""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

_MASK = 0xFFFFFFFF


def decode_sequence(data: bytes, count: int) -> NDArray[np.uint32]:
    """(count,) indices of a stream of mode INDICES: each a difference to one of two earlier ones.

    Raises
    ------
    ValueError
        Not such a stream, or not of this many indices.
    """
    if data[:1] not in (b"\xd0", b"\xd1") or len(data) < 5:
        raise ValueError("indices that do not begin as those of version 1 do")
    stream = np.frombuffer(data, dtype=np.uint8)[1:-4]
    ends = np.flatnonzero(stream < 0x80)
    if len(ends) != count or (count and ends[-1] != len(stream) - 1) or (not count and len(stream)):
        raise ValueError(f"{len(ends)} indices in place of {count}")
    lengths = np.diff(ends, prepend=-1)
    if count and lengths.max() > 5:
        raise ValueError("an index of more than 5 bytes")
    values = np.zeros(count, dtype=np.uint32)
    for byte in range(5):
        longer = lengths > byte
        values[longer] |= (stream[ends[longer] - lengths[longer] + 1 + byte] & 0x7F).astype(np.uint32) << 7 * byte
    second = (values & 1).astype(bool)
    deltas = np.where(values & 2, ~(values >> 2), values >> 2)
    tracks = [np.cumsum(np.where(chosen, deltas, 0), dtype=np.uint32) for chosen in (~second, second)]
    return np.where(second, tracks[1], tracks[0])


def decode_triangles(data: bytes, count: int) -> NDArray[np.uint32]:
    """(count,) indices of a stream of mode TRIANGLES: a byte a triangle that names recent edges and vertices.

    Raises
    ------
    ValueError
        Not such a stream, or not of this many indices.
    """
    if data[:1] != b"\xe1":
        raise ValueError("triangles that do not begin as those of version 1 do")
    triangles, rest = divmod(count, 3)
    if rest:
        raise ValueError(f"{count} indices, which are no triangles")
    if len(data) < 1 + triangles + 16:
        raise ValueError("triangles that end early")
    table = data[-16:]
    if table[-2:] != bytes(2) or any(byte >> 4 == 15 or byte & 15 == 15 for byte in table):
        raise ValueError("triangles with a table that is none")
    try:
        out, used = _follow(data, triangles, table)
    except IndexError:
        raise ValueError("triangles that end early or name edges before the first") from None
    if used != len(data) - 16:
        raise ValueError("triangles of another length than they say")
    return np.array(out, dtype=np.uint32)


def _follow(data: bytes, triangles: int, table: bytes) -> tuple[list[int], int]:
    """Corners of the triangles, and how many bytes they took. IndexError: an edge or a vertex before the first.

    One byte after the other: about 0.6 s for a million triangles.
    """
    edges: deque[tuple[int, int]] = deque(maxlen=16)
    vertices: deque[int] = deque(maxlen=16)
    push_edge, push_vertex = edges.appendleft, vertices.appendleft
    out: list[int] = []
    at = 1 + triangles
    fresh = last = 0
    for code in data[1:at]:
        low = code & 15
        if code < 0xF0:
            a, b = edges[code >> 4]
            if 0 < low < 13:
                c = vertices[low]
            else:
                if low == 0:
                    c = fresh
                    fresh = fresh + 1 & _MASK
                elif low == 15:
                    step, at = _read_step(data, at)
                    c = last = last + step & _MASK
                else:
                    c = last = last + (1 if low == 14 else -1) & _MASK
                push_vertex(c)
            push_edge((c, b))
            push_edge((a, c))
            out += (a, b, c)
            continue
        if code < 0xFE:
            pair = table[low]
        else:
            pair = data[at]
            at += 1
            fresh = fresh if pair else 0
        kinds = (15 if code == 0xFF else 0, pair >> 4, pair & 15)
        corners = []
        for kind in kinds:
            if kind == 0:
                corners.append(fresh)
                fresh = fresh + 1 & _MASK
            elif kind < 15:
                corners.append(vertices[kind - 1])
            else:
                step, at = _read_step(data, at)
                last = last + step & _MASK
                corners.append(last)
        a, b, c = corners
        edges.extendleft(((b, a), (c, b), (a, c)))
        vertices.extendleft(corner for kind, corner in zip(kinds, corners, strict=True) if kind in (0, 15))
        out += corners
    return out, at


def _read_step(data: bytes, at: int) -> tuple[int, int]:
    """A signed number of up to 5 bytes with 7 bits each, and where the next begins."""
    value = 0
    for shift in range(0, 35, 7):
        byte = data[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            value &= _MASK
            return (~(value >> 1) if value & 1 else value >> 1), at
    raise ValueError("an index of more than 5 bytes")
