"""Arrays of a page: what readers get back is what was put in, in Python and in a browser."""

from __future__ import annotations

import numpy as np
import pytest

from slepian_prt.viewer.buffers import Buffers
from tests.numerics import assert_exact
from tests.viewer.page_reader import decode

SAME = "coding loses nothing"


def integers(kind: str, shape: tuple[int, int]) -> np.ndarray:
    """Numbers of all sizes, the smallest and the largest among them."""
    rng, limits = np.random.default_rng(1), np.iinfo(kind)
    numbers = rng.integers(limits.min, limits.max, shape, dtype=kind, endpoint=True)
    numbers[0], numbers[1] = limits.max, limits.min
    numbers[2:6] >>= numbers.dtype.itemsize * 4
    return numbers


def floats(kind: str) -> np.ndarray:
    """Of both signs, subnormal ones, zeros and the largest."""
    limits = np.finfo(kind)
    values = np.array([0.0, -0.0, 1.0, -2.5, limits.max, -limits.max, limits.smallest_subnormal, limits.tiny / 2, 0.1])
    return values.astype(kind).reshape(3, 3)


def corners() -> np.ndarray:
    """Numbers that first appear in ascending order, as those of vertices in faces do."""
    return np.array([0, 1, 2, 2, 1, 3, 0, 3, 4, 5, 4, 0], dtype=np.uint32)


def clustered() -> np.ndarray:
    rows = integers("uint8", (40, 4))
    rows[:, -1] %= 3
    rows[7, -1] = 255
    return rows


CASES = [
    ("plain", floats("float64")),
    ("plain", floats("float32")),
    ("plain", np.frombuffer(b"any file", np.uint8)),
    ("planes", floats("float16")),
    ("planes", integers("uint32", (9, 2))),
    ("folded", integers("int16", (9, 2))),
    ("folded", integers("int32", (9, 1))),
    ("steps", integers("uint8", (9, 3))),
    ("steps", integers("uint16", (9, 3))),
    ("steps", integers("uint32", (9, 2))),
    ("clusters", clustered()),
    ("corners", corners()),
    ("corners", corners().astype(np.uint16)),
]
NAMES = [f"{coding} {values.dtype}" for coding, values in CASES]


@pytest.mark.parametrize(("coding", "values"), CASES, ids=NAMES)
def test_a_plain_reader_gets_back_what_was_put_in(coding, values):
    buffers = Buffers()
    buffers.add(np.zeros(3, np.uint8))
    entry = buffers.add(values, coding)["buffer"]
    assert entry["begin"] % 8 == 0
    assert_exact(decode(entry, buffers.content()).reshape(values.shape), values, SAME)


@pytest.mark.parametrize(("coding", "values"), CASES, ids=NAMES)
def test_a_browser_gets_back_what_was_put_in(modules, coding, values):
    buffers = Buffers()
    buffers.add(np.zeros(3, np.uint8))
    entry = buffers.add(values, coding)["buffer"]
    body = 'const { decodeBuffer } = await import("#payload"); return decodeBuffer(entry, bytes);'
    read = modules.run(body, entry=entry, bytes=buffers.content())
    # JavaScript has no float16: it gets the same numbers as float32.
    assert read.dtype == (np.float32 if values.dtype == np.float16 else values.dtype)
    assert_exact(read.reshape(values.shape), values, SAME)
    assert_exact(np.signbit(read), np.signbit(values.ravel()), "zeros have a sign")


def test_scaled_numbers(modules):
    buffers, places = Buffers(), np.array([[0, 1], [65535, 2], [7, 3]], dtype=np.uint16)
    entry = buffers.add(places, "steps", scale=0.25, offset=[-1.0, 8.0])["buffer"]
    wanted = places * 0.25 + [-1.0, 8.0]
    assert_exact(decode(entry, buffers.content()), wanted, "powers of two")
    body = 'const { decodeBuffer } = await import("#payload"); return decodeBuffer(entry, bytes);'
    assert_exact(modules.run(body, entry=entry, bytes=buffers.content()), wanted.ravel(), "powers of two")


@pytest.mark.parametrize("coding", ["plain", "planes", "steps", "clusters", "corners"])
def test_nothing_is_an_array_too(modules, coding):
    buffers = Buffers()
    entry = buffers.add(np.zeros((0, 2), np.uint8), coding)["buffer"]
    assert decode(entry, buffers.content()).size == 0
    body = 'const { decodeBuffer } = await import("#payload"); return decodeBuffer(entry, bytes);'
    assert modules.run(body, entry=entry, bytes=buffers.content()).size == 0
