"""Radiance pictures, against a writer of all codings and orders and the definition of a texel, m 2^(e - 136)."""

import itertools
import logging
import tracemalloc

import numpy as np
import pytest

from slepian_prt.errors import UserError
from slepian_prt.lighting.environment import read_environment
from slepian_prt.lighting.map_files import file_rows
from slepian_prt.renderer.variants import bitmap_module
from tests.numerics import assert_exact, assert_rounded

PLAIN = b"FORMAT=32-bit_rle_rgbe\n"

# The mantissas are decoded exactly, and a factor is applied in float32, in at most three products.
FLOAT = {"rtol": 4 * np.finfo(np.float32).eps, "atol": 0.0}


def encode(radiance: np.ndarray) -> np.ndarray:
    """(..., 4) bytes of radiance (..., 3), the largest mantissa in [128, 255]."""
    _, exponent = np.frexp(radiance.max(axis=-1, keepdims=True))
    mantissas = np.minimum(np.ldexp(radiance, 8 - exponent).round(), 255)
    return np.concatenate([mantissas, exponent + 128], axis=-1).astype(np.uint8)


def decode(texels: np.ndarray) -> np.ndarray:
    exponents = texels[..., 3:].astype(int)
    return np.where(exponents > 0, texels[..., :3] * 2.0 ** (exponents - 136), 0.0)


def flat(line: np.ndarray) -> bytes:
    return line.tobytes()


def repeated_texels(line: np.ndarray) -> bytes:
    """Radiance 1's coding: a texel, and how often it comes again, in base 256 from the lowest digit."""
    out = b""
    for _, group in itertools.groupby(line.tolist()):
        texel, *again = group
        out += bytes(texel)
        count = len(again)
        while count:
            out += bytes([1, 1, 1, count % 256])
            count //= 256
    return out


def repeated_bytes(line: np.ndarray) -> bytes:
    """Radiance 2's coding: each component by itself, runs of up to 127 and literals of up to 128."""
    out = bytes([2, 2, len(line) >> 8, len(line) & 255])
    for component in line.T:
        for value, group in itertools.groupby(component.tolist()):
            count = len(list(group))
            while count > 3:
                out += bytes([128 + min(count, 127), value])
                count -= min(count, 127)
            if count:
                out += bytes([count]) + bytes([value]) * count
    return out


def write(path, lines, header=PLAIN, size=b"-Y 8 +X 16", coding=flat):
    path.write_bytes(b"#?RADIANCE\n" + header + b"\n" + size + b"\n" + b"".join(coding(line) for line in lines))
    return path


@pytest.fixture
def texels(rng) -> np.ndarray:
    return encode(np.exp(rng.normal(size=(8, 16, 3))))


@pytest.mark.parametrize(
    ("coding", "length"),
    [(coding, length) for coding in (flat, repeated_texels) for length in (4, 16, 700)]
    + [(repeated_bytes, 8), (repeated_bytes, 700)],
)
def test_codings(coding, length, tmp_path, rng):
    lines = encode(np.exp(rng.normal(size=(length // 2, length, 3))))
    lines[:, length // 4 :] = lines[:, length // 4 : length // 4 + 1]  # runs longer than any code says at once
    lines[0, :2, 3] = 0  # black, whatever the mantissas
    path = write(tmp_path / "map.hdr", lines, size=b"-Y %d +X %d" % (length // 2, length), coding=coding)
    assert_exact(file_rows(path).read(0, length // 2), decode(lines), because="a shift of bits")


@pytest.mark.parametrize("y", [b"-Y 8", b"+Y 8"])
@pytest.mark.parametrize("x", [b"-X 16", b"+X 16"])
@pytest.mark.parametrize("by_column", [False, True])
@pytest.mark.parametrize("coding", [flat, repeated_bytes])
def test_orders_of_texels(y, x, by_column, coding, texels, tmp_path):
    rows = range(8) if y[:1] == b"-" else range(7, -1, -1)  # y decreases downwards
    columns = range(16) if x[:1] == b"+" else range(15, -1, -1)
    if by_column:
        lines, size = [np.array([texels[r, c] for r in rows]) for c in columns], x + b" " + y
    else:
        lines, size = [np.array([texels[r, c] for c in columns]) for r in rows], y + b" " + x
    path = write(tmp_path / "map.hdr", lines, size=size, coding=coding)
    assert_exact(read_environment(path).texels, decode(texels), because="a shift of bits")


@pytest.mark.parametrize(
    ("header", "factor"),
    [
        (b"EXPOSURE=0.117\n", 1 / 0.117),
        (b"EXPOSURE= 5e-1 \nEXPOSURE=4\n", 0.5),
        (b"COLORCORR=2 1 .5\n", [0.5, 1, 2]),
        (b"COLORCORR=2 1 1\nEXPOSURE=2\nCOLORCORR=1 4 1\n", [0.25, 0.125, 0.5]),
        (b"\tEXPOSURE=3\n# EXPOSURE=5\nVIEW= -vtl -vh 3\nPIXASPECT=0.5\nSOFTWARE=EXPOSURE=2\n", 1.0),
        (b"GAMMA=1.0\n", 1.0),
    ],
)
def test_what_was_done_to_the_picture_is_undone(header, factor, texels, tmp_path):
    path = write(tmp_path / "map.hdr", texels, header + PLAIN)
    np.testing.assert_allclose(read_environment(path).texels, decode(texels) * factor, **FLOAT)


def test_a_gamma_is_told(texels, tmp_path, caplog):
    with caplog.at_level(logging.INFO, "slepian_prt"):
        read = read_environment(write(tmp_path / "map.hdr", texels, b"GAMMA=2.2\n" + PLAIN)).texels
    assert "GAMMA=2.2 is ignored" in caplog.text
    assert_exact(read, decode(texels), because="a shift of bits")


def test_xyz_is_brought_to_srgb(tmp_path):
    """CIE XYZ of sRGB's white and red (IEC 61966-2-1)."""
    xyz = np.full((8, 16, 3), [0.9505, 1.0, 1.0891])
    xyz[3] = [0.4124, 0.2126, 0.0193]
    path = write(tmp_path / "map.hdr", encode(xyz), b"FORMAT=32-bit_rle_xyze\n")
    read = file_rows(path).read(0, 8)
    # Half a unit of the mantissa, 2^-9 to 2^-8, grows by at most Σ|m| = 5.3 of a row of the matrix.
    np.testing.assert_allclose(read[0, 0], 1.0, atol=5.3 * 2**-8)
    np.testing.assert_allclose(read[3, 5], [1.0, 0.0, 0.0], atol=5.3 * 2**-9)


def test_primaries_are_followed(tmp_path):
    """ITU-R BT.2087 has the red of BT.2020 in BT.709; white stays white."""
    stored = np.full((8, 16, 3), 0.5)
    stored[2, 3] = [1.0, 0.0, 0.0]
    primaries = b"PRIMARIES=0.708 0.292 0.170 0.797 0.131 0.046 0.3127 0.3290\n"
    read = file_rows(write(tmp_path / "map.hdr", encode(stored), primaries + PLAIN)).read(0, 8)
    np.testing.assert_allclose(read[5, 5], 0.5, atol=1e-6)
    np.testing.assert_allclose(read[2, 3], [1.6605, -0.1246, -0.0182], atol=1e-4)


def test_texels_are_those_of_mitsuba(texels, tmp_path):
    """The same file lights the same there; nothing is added to mantissas."""
    path = write(tmp_path / "map.hdr", texels, coding=repeated_bytes)
    theirs = np.array(bitmap_module().Bitmap(str(path)))
    assert_exact(read_environment(path).texels, theirs, because="a shift of bits")


DAMAGED = {
    "no resolution": (b"#?RADIANCE\n" + PLAIN + b"\n", "no line of resolution"),
    "nothing": (b"#?RADIANCE\n" + PLAIN + b"\n-Y 8 +X 16\n", "cut short"),
    "half a texel": (b"#?RADIANCE\n\n-Y 8 +X 16\n" + bytes(4 * 128 - 2), "cut short"),
    "a line too few": (b"#?RADIANCE\n\n-Y 8 +X 16\n" + bytes([9] * 4 * 112), "cut short"),
    "width": (
        b"#?RADIANCE\n\n-Y 8 +X 16\n" + bytes([2, 2, 0, 17] + [128 + 17, 1] * 4) * 8,
        "is 17 texels long, not 16",
    ),
    "run": (b"#?RADIANCE\n\n-Y 8 +X 16\n" + bytes([2, 2, 0, 16] + [128 + 17, 1] * 4) * 8, "run lengths"),
    "repeats nothing": (b"#?RADIANCE\n\n-Y 8 +X 16\n" + bytes([1, 1, 1, 16] * 8), "run lengths"),
    "no texels": (b"#?RADIANCE\n\n-Y 0 +X 0\n", "0 x 0 texels"),
    "absurd": (b"#?RADIANCE\n\n-Y 1000000000 +X 2000000000\n" + bytes(999), "2000000000 x 1000000000"),
    "square": (b"#?RADIANCE\n\n-Y 16 +X 16\n" + bytes(1024), "twice as wide as high"),
    "format": (b"#?RADIANCE\nFORMAT=32-bit_rle_spec\n\n-Y 8 +X 16\n", "'32-bit_rle_spec'"),
    "exposure": (b"#?RADIANCE\nEXPOSURE=0\n\n-Y 8 +X 16\n", "'EXPOSURE=0', not 1 positive numbers"),
    "correction": (b"#?RADIANCE\nCOLORCORR=1 1\n\n-Y 8 +X 16\n", "'COLORCORR=1 1', not 3 positive"),
    "primaries": (b"#?RADIANCE\nPRIMARIES=0 0 0 0 0 0 0 0\n\n-Y 8 +X 16\n", "no primaries"),
    "axes": (b"#?RADIANCE\n\n-Y 8 +Y 16\n" + bytes(512), "no line of resolution"),
}


@pytest.mark.parametrize("name", DAMAGED)
def test_damage_is_told_in_a_line(name, tmp_path, capfd):
    content, message = DAMAGED[name]
    (tmp_path / "map.hdr").write_bytes(content)
    with pytest.raises(UserError, match=r"map\.hdr: ") as caught:
        read_environment(tmp_path / "map.hdr")
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
    assert capfd.readouterr().err == ""


def test_no_memory_is_taken_for_texels_that_are_not_there(tmp_path):
    (tmp_path / "map.hdr").write_bytes(b"#?RADIANCE\n\n-Y 32768 +X 65536\n" + bytes(999))
    tracemalloc.start()
    try:
        with pytest.raises(UserError, match="cut short"):
            read_environment(tmp_path / "map.hdr")
        assert tracemalloc.get_traced_memory()[1] < 1 << 20
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("coding", [flat, repeated_texels, repeated_bytes])
def test_any_part_of_a_file_is_told_in_a_line(coding, texels, tmp_path):
    whole = write(tmp_path / "whole.hdr", texels, coding=coding).read_bytes()
    for size in range(0, len(whole), 7):
        (tmp_path / "map.hdr").write_bytes(whole[:size])
        with pytest.raises(UserError, match="cannot be read as an environment map"):
            read_environment(tmp_path / "map.hdr")


def test_more_than_float32_holds_after_the_exposure(tmp_path):
    path = write(tmp_path / "map.hdr", np.full((8, 16, 4), [200, 200, 200, 250], np.uint8), b"EXPOSURE=1e-30\n" + PLAIN)
    with pytest.raises(UserError, match="NaN or infinite"):
        read_environment(path)


def test_rows_are_those_of_the_whole(texels, tmp_path):
    rows = file_rows(write(tmp_path / "map.hdr", texels, b"EXPOSURE=3\n" + PLAIN))
    assert_rounded(rows.read(3, 6), decode(texels)[3:6] / 3.0, terms=2)
