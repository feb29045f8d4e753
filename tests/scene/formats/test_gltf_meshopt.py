"""meshoptimizer's codecs against what its own encoder was given, an encoder of ours, and formulas of the filters."""

import numpy as np
import pytest

from slepian_prt.scene.formats.gltf_meshopt import FILTERS, decode_attributes
from slepian_prt.scene.formats.gltf_meshopt_indices import decode_sequence, decode_triangles
from tests.numerics import assert_exact
from tests.scene.formats import meshopt_streams as streams

SAME = "the codec is lossless"


@pytest.mark.parametrize("stream", [streams.ATTRIBUTES_0, streams.ATTRIBUTES_1], ids=["version 0", "version 1"])
def test_attributes_of_the_reference_encoder(stream):
    assert_exact(decode_attributes(stream, 300, 16), streams.mixed_attributes(), SAME)


def test_indices_of_the_reference_encoder():
    wanted = streams.strip_indices()
    assert_exact(decode_sequence(streams.SEQUENCE, len(wanted)), wanted, SAME)


def test_triangles_of_the_reference_encoder():
    """The encoder turns triangles, so that they begin with another corner; their order and winding stay."""
    wanted = streams.grid_triangles().reshape(-1, 3)
    came = decode_triangles(streams.TRIANGLES, wanted.size).reshape(-1, 3)
    turned = [np.stack([np.roll(row, -int(row.argmin())) for row in rows]) for rows in (came, wanted)]
    assert_exact(turned[0], turned[1], SAME)


def test_triangles_that_start_again():
    """Code 0xfe with a byte 0 counts new vertices from 0 again, where streams were joined."""
    stream = bytes([0xE1, 0xF0, 0xFE, 0x00]) + bytes(16)
    assert_exact(decode_triangles(stream, 6), [0, 1, 2, 0, 1, 2], SAME)


# --- An encoder of ours, from the text of the extension: any width that a mode has will do, as bytes may escape. ----


def pack_group(values, width):
    """16 bytes as fields of ``width`` bits, then those that do not fit."""
    if width in (0, 8):
        return bytes(map(int, values)) if width else b""
    escape = (1 << width) - 1
    fields = [min(int(value), escape) for value in values]
    per = 8 // width
    packed = bytearray()
    for start in range(0, 16, per):
        order = range(per) if width == 1 else range(per - 1, -1, -1)
        packed.append(sum(fields[start + k] << (width * slot) for slot, k in enumerate(order)))
    return bytes(packed) + bytes(int(value) for value in values if value >= escape)


def encode_attributes(elements, version, rng):
    """All modes, drawn at random from those that can hold the data."""
    count, stride = elements.shape
    steps = np.diff(elements.astype(np.int64), axis=0, prepend=elements[:1].astype(np.int64))
    steps = (steps + 128) % 256 - 128
    codes = np.where(steps < 0, -2 * steps - 1, 2 * steps)
    out = bytearray([0xA0 + version])
    most = min(8192 // stride & ~15, 256)
    for begin in range(0, count, most):
        block = codes[begin : begin + most]
        padded = np.zeros((-(-len(block) // 16) * 16, stride), dtype=np.int64)
        padded[: len(block)] = block
        body, control = bytearray(), [0] * stride
        for k in range(stride):
            column = padded[:, k].reshape(-1, 16)
            control[k] = 0 if version == 0 else int(rng.choice([0, 1, 3] if column.any() else [0, 1, 2, 3]))
            if version and control[k] >= 2:
                body += bytes(block[:, k].astype(np.uint8)) if control[k] == 3 else b""
                continue
            widths = ((0, 1, 2, 4), (1, 2, 4, 8))[control[k]] if version else (0, 2, 4, 8)
            picks = [int(rng.integers(1 if group.any() else 0, 4)) for group in column]
            header = bytearray(-(-len(picks) // 4))
            for i, pick in enumerate(picks):
                header[i // 4] |= pick << (i % 4 * 2)
            body += header + b"".join(pack_group(g, widths[p]) for g, p in zip(column, picks, strict=True))
        if version:
            out += bytes(sum(control[4 * c + k] << 2 * k for k in range(4)) for c in range(stride // 4))
        out += body
    tail = elements[0].astype(np.uint8).tobytes() + bytes(stride // 4 if version else 0)
    return bytes(out) + bytes(max(0, (24 if version else 32) - len(tail))) + tail


@pytest.mark.parametrize("version", [0, 1])
@pytest.mark.parametrize(("count", "stride"), [(1, 4), (16, 12), (33, 8), (257, 4), (65, 256)])
def test_attributes_in_all_modes(version, count, stride):
    rng = np.random.default_rng(count + version)
    elements = np.cumsum(rng.integers(-2, 3, (count, stride)) * rng.integers(0, 30, (count, 1)), axis=0) % 256
    elements[:, 1] = 5
    stream = encode_attributes(elements, version, rng)
    assert_exact(decode_attributes(stream, count, stride), elements, SAME)


def test_the_example_of_the_extension():
    """16 differences in 4 bits, two of them in whole bytes behind."""
    packed = bytes.fromhex("175ff0bc77a9210034b5")
    stream = b"\xa0" + (b"\x02" + packed + b"\x00" * 3) + bytes(32)
    deltas = [-1, -4, -3, 26, -91, 0, -6, 6, -4, -4, 5, -5, 1, -1, 0, 0]
    assert_exact(decode_attributes(stream, 16, 4)[:, 0], np.cumsum(deltas) % 256, SAME)


@pytest.mark.parametrize(
    ("stream", "count", "message"),
    [
        (streams.ATTRIBUTES_0[:-40], 300, "end early"),
        (streams.ATTRIBUTES_0, 280, "bytes too many"),
        (streams.ATTRIBUTES_0, 10**12, "end early"),
        (streams.ATTRIBUTES_1[:-1] + b"\x03", 300, "channel mode"),
        (b"\xa3" + streams.ATTRIBUTES_1[1:], 300, "version 0 or 1"),
        (b"", 300, "version 0 or 1"),
        (b"\xa0", 0, "end early"),
    ],
)
def test_broken_attributes(stream, count, message):
    with pytest.raises(ValueError, match=message):
        decode_attributes(stream, count, 16)


@pytest.mark.parametrize(
    ("decode", "stream", "count", "message"),
    [
        (decode_triangles, b"", 3, "version 1"),
        (decode_triangles, streams.TRIANGLES[:-30], 213, "table|end early|another length"),
        (decode_triangles, streams.TRIANGLES, 10**12, "no triangles|end early"),
        (decode_triangles, b"\xe1\x00" + bytes(16), 3, "before the first"),
        (decode_triangles, b"\xe1\xff\xff" + b"\x80" * 6 + bytes(16), 3, "more than 5 bytes"),
        (decode_sequence, streams.SEQUENCE, 51, "52 indices in place of 51"),
        (decode_sequence, b"\xd1" + b"\xff" * 6 + b"\x00" + bytes(4), 1, "more than 5 bytes"),
        (decode_sequence, b"\xd1", 1, "version 1"),
    ],
)
def test_broken_indices(decode, stream, count, message):
    with pytest.raises(ValueError, match=message):
        decode(stream, count)


# --- Filters, against the numbers that went in; half a step of the coarser of both roundings, and one of the output. --


@pytest.mark.parametrize(("stride", "bits"), [(4, 8), (4, 5), (8, 12), (8, 16)])
def test_octahedral_filter(stride, bits):
    rng = np.random.default_rng(bits)
    unit = rng.normal(size=(200, 3))
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    flat = unit / np.abs(unit).sum(axis=1, keepdims=True)
    below = flat[:, 2] < 0
    xy = flat[:, :2].copy()
    xy[below] = (1 - np.abs(flat[below][:, 1::-1])) * np.where(flat[below, :2] < 0, -1, 1)
    one = (1 << bits - 1) - 1
    dtype = f"<i{stride // 4}"
    packed = np.column_stack([np.round(xy * one), np.full(200, one), np.arange(200) % 100]).astype(dtype)
    out = FILTERS["OCTAHEDRAL"][1](packed.view(np.uint8)).view(dtype)
    assert_exact(out[:, 3], packed[:, 3], "it is kept as it is")
    largest = np.iinfo(dtype).max
    # On the octahedron a step moves a direction by at most sqrt(3) of itself in each of two coordinates.
    assert np.abs(out[:, :3] / largest - unit).max() < 2 * 3**0.5 * 0.5 / one + 1.5 / largest


@pytest.mark.parametrize("bits", [4, 12, 16])
def test_quaternion_filter(bits):
    rng = np.random.default_rng(bits)
    unit = rng.normal(size=(200, 4))
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    largest = np.abs(unit).argmax(axis=1)
    unit *= np.sign(np.take_along_axis(unit, largest[:, None], axis=1))
    others = np.take_along_axis(unit, (largest[:, None] + [1, 2, 3]) % 4, axis=1)
    one = (1 << bits - 1) - 1
    packed = np.column_stack([np.round(others * 2**0.5 * one), (one & ~3) | largest]).astype("<i2")
    out = FILTERS["QUATERNION"][1](packed.view(np.uint8)).view("<i2") / 32767
    # The largest component is at least 1/2: it errs by no more than the sum of the others' errors.
    assert np.abs(out - unit).max() < 3 * 0.5 / one / 2**0.5 + 2 / 32767


def test_exponential_filter():
    mantissas, exponents = np.meshgrid([-(2**23), -77, 0, 1, 2**23 - 1], [-100, -3, 0, 20, 100])
    words = (exponents.astype(np.int64) << 24 | mantissas & 0xFFFFFF).ravel().astype("<u4")
    out = FILTERS["EXPONENTIAL"][1](words[:, None].view(np.uint8)).view("<f4")
    assert_exact(out.ravel(), np.ldexp(mantissas.astype(np.float64), exponents).ravel(), "products with powers of two")


@pytest.mark.parametrize(("stride", "bits"), [(4, 8), (4, 5), (8, 12), (8, 16)])
def test_color_filter(stride, bits):
    rng = np.random.default_rng(bits)
    rgb = rng.integers(0, 1 << bits, (200, 3))
    red, green, blue = rgb.T
    co = red - blue
    # Only colours whose halves are whole, so that the filter gives them back as they were.
    keep = (co % 2 == 0) & (((red + blue) // 2 + green) % 2 == 0)
    red, green, blue, co = (values[keep] for values in (red, green, blue, co))
    middle = (red + blue) // 2
    cg = (green - middle) // 2
    alpha = rng.integers(0, 1 << bits - 1, keep.sum())
    unsigned = f"<u{stride // 4}"
    packed = np.column_stack([middle + cg, co // 2, cg, alpha | 1 << bits - 1]).astype(np.int64).astype(unsigned)
    out = FILTERS["COLOR"][1](packed.view(np.uint8)).view(unsigned).astype(np.float64)
    scale = np.iinfo(unsigned).max / ((1 << bits) - 1)
    wanted = np.column_stack([red, green, blue, alpha << 1 | alpha & 1]) * scale
    assert np.abs(out - wanted).max() <= 0.5 + 1e-2  # rounded from floats of 24 bits
