"""Maps that claim more than they hold: one line, before memory is taken."""

import os
import struct

import numpy as np
import pytest

from slepian_prt.errors import UserError
from slepian_prt.lighting.environment import read_environment
from slepian_prt.lighting.formats.sizes import picture_size
from slepian_prt.lighting.light_text import read_light_text
from slepian_prt.machine import memory
from slepian_prt.machine.memory import memory_limited
from tests.fuzzing import maps

HDR = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n"


def with_window(content: bytes, name: bytes, *corners: int) -> bytes:
    """An .exr whose window is another."""
    at = content.index(name + b"\0box2i\0") + len(name) + 11
    return content[:at] + struct.pack("<4i", *corners) + content[at + 16 :]


EXR = maps.seeds()["none.exr"]
ATTRIBUTES = b"".join(b"a%d\0b\0\0\0\0\0" % k for k in range(10_001))
BAD = {
    "many.exr": (EXR[:8] + ATTRIBUTES + EXR[8:], "more than 10000 attributes"),
    "zero.hdr": (HDR + b"-Y 0 +X 0\n", "is 0 x 0 texels"),
    "low.hdr": (HDR + b"-Y 0 +X 16\n", "is 16 x 0 texels"),
    "digits.hdr": (HDR + b"-Y " + b"9" * 5000 + b" +X 16\n", "no line of resolution"),
    "repeats.hdr": (
        HDR + b"-Y 8192 +X 16384\n" + (bytes(4) + b"\1\1\1\xff\1\1\1\xff") * 8192,
        "bytes for 8192 scanlines",
    ),
    "cut.hdr": (maps.seeds()["packed.hdr"][:-30], "cut short"),
    "huge.hdr": (HDR + b"-Y 1000000000 +X 2000000000\n", "at most 65536 x 32768"),
    "huge.exr": (with_window(EXR, b"dataWindow", 0, 0, 10**9, 10**9), "at most 65536 x 32768"),
    "black.exr": (with_window(EXR, b"displayWindow", 0, 0, 65535, 32767), "of which it holds 16 x 8"),
    "digits.pfm": (b"PF\n" + b"9" * 200 + b" 8\n-1.0\n", "header is none of a .pfm"),
    "format.hdr": (b"#?RADIANCE\nFORMAT=" + b"x" * 5000 + b"\n\n-Y 8 +X 16\n", "its FORMAT is"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_maps_claim_is_refused(name, tmp_path):
    content, message = BAD[name]
    (tmp_path / name).write_bytes(content)
    with pytest.raises(UserError, match=message) as told:
        read_environment(tmp_path / name)
    assert len(str(told.value)) < 400


@pytest.mark.parametrize("name", [name for name in maps.seeds() if not name.endswith(".txt")])
def test_maps_larger_than_memory_are_not_read(name, tmp_path, monkeypatch):
    monkeypatch.setattr(memory, "_LEAST", 1)
    (tmp_path / name).write_bytes(maps.seeds()[name])
    assert read_environment(tmp_path / name).texels.shape == (8, 16, 3)
    with memory_limited(100), pytest.raises(UserError, match="of memory"):
        read_environment(tmp_path / name)


@pytest.mark.parametrize("name", ["tiled.exr", "plain.hdr", "colour.pfm", "colour.png", "photo.jpg", "photo.bmp"])
def test_sizes_are_told_without_the_pixels(name, tmp_path):
    (tmp_path / name).write_bytes(maps.seeds()[name])
    assert picture_size(tmp_path / name) == (8, 16)
    (tmp_path / name).write_bytes(b"no picture")
    assert picture_size(tmp_path / name) is None


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes here")
def test_pipes_are_not_waited_for(tmp_path):
    for name, read in (("a.hdr", read_environment), ("a.txt", read_light_text)):
        os.mkfifo(tmp_path / name)
        with pytest.raises(UserError, match="is a pipe or a device"):
            read(tmp_path / name)


def test_a_scale_beyond_floats_warns_of_nothing(tmp_path, recwarn):
    zeros = np.zeros((8, 16, 3), dtype="<f4").tobytes()
    (tmp_path / "a.pfm").write_bytes(b"PF\n16 8\n-1e300\n" + zeros)
    with pytest.raises(UserError, match="NaN or infinite"):
        read_environment(tmp_path / "a.pfm")
    assert not recwarn.list
