"""Vertex data as meshoptimizer compresses them, decoded with numpy.

Source: the glTF extensions EXT_meshopt_compression and KHR_meshopt_compression, appendix A (mode 0, attributes: version
0 and 1) and appendix B (filters).

Bytes of the same place in consecutive elements follow each other as differences, in groups of 16, each with as many
bits as it needs. How long a group is depends on its content; so one pass in Python finds where they begin, a table
look-up each, and numpy reads them all at once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

_GROUP = 16  # elements

# Bits of a difference for each header of a group: in version 0, and in version 1 for control modes 0 and 1.
_BITS = {"0": (0, 2, 4, 8), "1.0": (0, 1, 2, 4), "1.1": (1, 2, 4, 8)}
_WIDTHS = (0, 1, 2, 4, 8)

# Control modes of version 1 that have no groups of their own.
_ZEROS, _LITERAL = 2, 3


def decode_attributes(data: bytes, count: int, stride: int) -> NDArray[np.uint8]:
    """(count, stride) bytes of a stream of mode ATTRIBUTES.

    Raises
    ------
    ValueError
        Not such a stream, or not of this many elements.
    """
    if not 0 < stride <= 256 or stride % 4:
        raise ValueError(f"a byteStride of {stride} for attributes, which is not 4, 8, … or 256")
    if data[:1] not in (b"\xa0", b"\xa1"):
        raise ValueError("attributes that do not begin as those of version 0 or 1 do")
    version = data[0] & 15
    channels = stride // 4 if version else 0
    tail = max(stride + channels, 24 if version else 32)
    end = len(data) - tail
    if end < 1:
        raise ValueError("attributes that end early")
    most = min(8192 // stride & ~15, 256)
    begins, widths = _find_groups(data, end, count, stride, most, version)
    deltas = _interleave(_read_groups(data, begins, widths), count, stride, most)
    baseline = np.frombuffer(data, np.uint8, stride, len(data) - stride - channels)
    modes = data[len(data) - channels :] if version else bytes(stride // 4)
    out = np.empty((count, stride), dtype=np.uint8)
    for channel, mode in enumerate(modes):
        four = slice(4 * channel, 4 * channel + 4)
        out[:, four] = _add_up(deltas[:, four], baseline[four], mode)
    return out


def _find_groups(
    data: bytes, end: int, count: int, stride: int, most: int, version: int
) -> tuple[NDArray[np.int64], NDArray[np.uint8]]:
    """Where each group begins, and its bits; in the order of the stream."""
    lengths = _group_lengths(data)
    kinds = {key: [tuple(bits[byte >> shift & 3] for shift in (0, 2, 4, 6)) for byte in range(256)]
             for key, bits in _BITS.items()}  # fmt: skip
    begins: list[int] = []
    widths = bytearray()
    at, left = 1, count
    while left > 0:
        block = min(left, most)
        left -= block
        groups = -(-block // _GROUP)
        control = data[at : at + stride // 4] if version else b""
        at += len(control)
        for k in range(stride):
            mode = control[k // 4] >> (k % 4 * 2) & 3 if version else 0
            if mode >= _ZEROS and version:
                begins.extend(range(at, at + _GROUP * groups, _GROUP) if mode == _LITERAL else [at] * groups)
                widths.extend([8 if mode == _LITERAL else 0] * groups)
                at += block if mode == _LITERAL else 0
                continue
            kind = kinds[f"1.{mode}" if version else "0"]
            header = data[at : at + -(-groups // 4)]
            at += len(header)
            bits = [width for byte in header for width in kind[byte]][:groups]
            widths.extend(bits)
            for width in bits:
                begins.append(at)
                at += lengths[width][at]
        if at > end:
            raise ValueError("attributes that end early")
    if at != end:
        raise ValueError(f"attributes with {end - at} bytes too many")
    return np.array(begins, dtype=np.int64), np.frombuffer(widths, dtype=np.uint8)


def _group_lengths(data: bytes) -> dict[int, bytes]:
    """For each width: the bytes of a group of that width, if it began at each byte of the stream (and 512 after it).

    A difference with all bits set stands for a whole byte behind the group.
    """
    # A block is at most 8192 bytes, with its headers; it may only be found too long once it is read.
    size = len(data) + 16384
    padded = np.zeros(size + 8, dtype=np.uint8)
    padded[: len(data)] = np.frombuffer(data, dtype=np.uint8)
    lengths = {0: bytes(size), 8: bytes([_GROUP]) * size}
    for width in (1, 2, 4):
        fields = [padded >> shift & (1 << width) - 1 for shift in range(0, 8, width)]
        escaped = np.add.reduce([field == (1 << width) - 1 for field in fields], dtype=np.int64)
        before = np.concatenate([[0], np.cumsum(escaped)])
        packed = _GROUP * width // 8
        lengths[width] = (packed + before[packed : packed + size] - before[:size]).astype(np.uint8).tobytes()
    return lengths


def _read_groups(data: bytes, begins: NDArray[np.int64], widths: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """(groups, 16) differences."""
    stream = np.frombuffer(data + bytes(2 * _GROUP), dtype=np.uint8)
    out = np.zeros((len(begins), _GROUP), dtype=np.uint8)
    whole = widths == 8
    out[whole] = stream[begins[whole, None] + np.arange(_GROUP)]
    for width in (1, 2, 4):
        chosen = widths == width
        begin = begins[chosen]
        packed = _GROUP * width // 8
        shifts = np.arange(0, 8, width, dtype=np.uint8)
        if width > 1:
            shifts = shifts[::-1]  # from the most significant bits; single bits from the least
        bits = stream[begin[:, None] + np.arange(packed)][:, :, None] >> shifts & (1 << width) - 1
        values = bits.reshape(-1, _GROUP)
        escaped = values == (1 << width) - 1
        place = begin[:, None] + packed + np.cumsum(escaped, axis=1) - 1
        out[chosen] = np.where(escaped, stream[place], values)
    return out


def _interleave(groups: NDArray[np.uint8], count: int, stride: int, most: int) -> NDArray[np.uint8]:
    """(count, stride) from groups (·, 16) that are sorted by block, place in the element, and element."""

    def blocks() -> Iterator[NDArray[np.uint8]]:
        full, rest = divmod(count, most)
        split = full * stride * (most // _GROUP)
        yield groups[:split].reshape(full, stride, most).transpose(0, 2, 1).reshape(-1, stride)
        if rest:
            yield groups[split:].reshape(stride, -1).T[:rest]

    return np.concatenate(list(blocks()))


def _add_up(deltas: NDArray[np.uint8], baseline: NDArray[np.uint8], mode: int) -> NDArray[np.uint8]:
    """(count, 4) bytes of a channel from their differences, the first to ``baseline`` (4,)."""
    kind, rotation = mode & 15, mode >> 4
    if kind > 2 or (kind < 2 and rotation):
        raise ValueError(f"attributes with an unknown channel mode ({mode})")
    dtype = np.dtype(("u1", "<u2", "<u4")[kind])
    steps = np.ascontiguousarray(np.concatenate([baseline[None], deltas])).view(dtype)
    if kind == 2:
        words = steps[1:]
        steps[1:] = words >> rotation | words << (32 - rotation) if rotation else words
        total = np.bitwise_xor.accumulate(steps, axis=0)
    else:
        steps[1:] = _unzigzag(steps[1:])
        total = np.cumsum(steps, axis=0, dtype=dtype)
    return total[1:].view(np.uint8)


def _unzigzag(values: NDArray) -> NDArray:
    """Signed differences (as unsigned ones that wrap) of 0, -1, 1, -2, … → 0, 1, 2, 3, …."""
    return np.where(values & 1, ~(values >> 1), values >> 1)


def _decode_octahedral(elements: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Unit vectors from two coordinates on the octahedron; the third number is 1, the fourth is kept."""
    whole = elements.view(_signed(elements.shape[1])).copy()
    largest = np.float32(np.iinfo(whole.dtype).max)
    values = whole.astype(np.float32)
    one = np.where(values[:, 2] == 0, np.float32(1), values[:, 2])
    x, y = values[:, 0] / one, values[:, 1] / one
    z = 1 - np.abs(x) - np.abs(y)
    below = np.minimum(z, 0)
    vectors = np.stack([x - np.copysign(below, x), y - np.copysign(below, y), z], axis=1)
    vectors *= largest / np.linalg.norm(vectors, axis=1, keepdims=True)
    whole[:, :3] = _round(vectors)
    return whole.view(np.uint8)


def _decode_quaternions(elements: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Unit quaternions from their three smaller numbers; the lowest two bits of the fourth say which is missing."""
    whole = elements.view("<i2")
    one = (whole[:, 3] | 3).astype(np.float32)[:, None]
    small = whole[:, :3] / one * np.float32(np.sqrt(0.5))
    large = np.sqrt(np.maximum(0, 1 - np.sum(small * small, axis=1, keepdims=True)))
    rounded = np.clip(_round(np.concatenate([large, small], axis=1) * np.float32(32767)), -32768, 32767)
    place = (np.arange(4) + (whole[:, 3:] & 3)) % 4
    out = np.empty(whole.shape, dtype="<i2")
    np.put_along_axis(out, place, rounded.astype("<i2"), axis=1)
    return out.view(np.uint8)


def _decode_exponential(elements: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Floats from a mantissa of 24 bits and an exponent of 8."""
    words = elements.view("<i4")
    return np.ldexp((words << 8 >> 8).astype("<f4"), words >> 24).astype("<f4").view(np.uint8)


def _decode_colors(elements: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """RGBA from Y, Co, Cg and an alpha whose highest bit tells how many bits they have."""
    signed = elements.view(_signed(elements.shape[1]))
    unsigned = signed.view(signed.dtype.str.replace("i", "u"))
    y, alpha = (unsigned[:, k].astype(np.int64) for k in (0, 3))
    orange, green = (signed[:, k].astype(np.int64) for k in (1, 2))
    bits = np.frexp(alpha.astype(np.float64))[1]
    scale = (1 << bits.astype(np.int64)) - 1
    coverage = alpha & scale >> 1
    rgba = np.stack([y + orange - green, y + green, y - orange - green, coverage << 1 | coverage & 1], axis=1)
    largest = np.iinfo(unsigned.dtype).max
    scaled = _round(rgba * np.float32(largest) / np.maximum(scale, 1)[:, None])
    return np.clip(scaled, 0, largest).astype(unsigned.dtype).view(np.uint8)


def _signed(stride: int) -> str:
    return "<i2" if stride == 8 else "i1"


def _round(values: NDArray) -> NDArray:
    """The nearest integers; halves away from zero."""
    return np.trunc(values + np.copysign(0.5, values))


# Each with the strides that it is for.
FILTERS: dict[str, tuple[range | tuple[int, ...], Callable[[NDArray[np.uint8]], NDArray[np.uint8]]]] = {
    "NONE": (range(4, 257, 4), lambda elements: elements),
    "OCTAHEDRAL": ((4, 8), _decode_octahedral),
    "QUATERNION": ((8,), _decode_quaternions),
    "EXPONENTIAL": (range(4, 257, 4), _decode_exponential),
    "COLOR": ((4, 8), _decode_colors),
}
