"""The statements of an OBJ file as arrays."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from slepian_prt.errors import UserError
from slepian_prt.machine.file_content import read_content
from slepian_prt.scene.formats.colors import decode_srgb
from slepian_prt.scene.formats.files import decode, to_utf8
from slepian_prt.scene.formats.text import Lines, parse_numbers, split_lines

_NAMES = ("vertex", "texture coordinates", "normal")


@dataclass(frozen=True, eq=False)
class Statements:
    """What an OBJ file says.

    Attributes
    ----------
    positions : (V, 3) float64
    colors : (V, 3) float32 or None
        Linear.
    uv : (T, 2) float64
        v runs up.
    normals : (N, 3) float64
    sizes : (P,) int64
        Numbers of corners of the polygons.
    corners : (C, 3) int64
        Position, texture coordinates and normal of each corner, from 0 on; -1 for none.
    lines : (P,) int64
        Where the polygons are among the lines of the file.
    others : tuple of (int, str, str)
        Line, keyword and the rest of every other statement but groups and comments.
    dangling : tuple of str
        What faces name and the file has none of: texture coordinates, normals. They count as not named.
    line_of : callable or None
        The line of the file, from 1 on, where a polygon is.
    """

    positions: NDArray[np.float64]
    colors: NDArray[np.float32] | None
    uv: NDArray[np.float64]
    normals: NDArray[np.float64]
    sizes: NDArray[np.int64]
    corners: NDArray[np.int64]
    lines: NDArray[np.int64]
    others: tuple[tuple[int, str, str], ...]
    dangling: tuple[str, ...] = ()
    line_of: Callable[[int], int] | None = None


@dataclass(frozen=True, eq=False)
class _Source:
    """Lines, with continued ones joined, and the text before that, in which lines are counted."""

    path: Path
    raw: bytes
    lines: Lines

    def number_of(self, line: int) -> int:
        """From 1 on."""
        return self.raw.count(b"\n", 0, int(self.lines.begins[line])) + 1

    def refuse(self, line: int, what: str) -> UserError:
        return UserError(f"{self.path}: line {self.number_of(line)}: {what}; export it again")

    def parse(
        self,
        chosen: NDArray[np.bool_],
        keyword: bytes,
        count: int,
        dtype: DTypeLike = np.float64,
        edit: Callable[[bytes], bytes] = bytes,
    ) -> NDArray[Any]:
        """The numbers after the keyword of some lines, of which an edit leaves only those."""
        text = self.lines.select(chosen).replace(keyword, b" " * len(keyword))
        numbers = parse_numbers(edit(text), count, dtype)
        if numbers is None:
            raise self.refuse_numbers(chosen, keyword, dtype, edit)
        return numbers

    def refuse_numbers(
        self, chosen: NDArray[np.bool_], keyword: bytes, dtype: DTypeLike, edit: Callable[[bytes], bytes]
    ) -> UserError:
        """About the first word that is no number."""
        bad = self.lines.find_bad_number(np.flatnonzero(chosen), len(keyword), dtype, edit)
        if bad:
            return self.refuse(bad[0], f"'{bad[1]}' is not a number of the kind that belongs there")
        return UserError(f"{self.path}: its numbers cannot be read; export it again")


def read_statements(path: Path) -> Statements:
    """Read the statements of an OBJ file.

    Raises
    ------
    UserError
        Numbers that cannot be read, or are too few, or name what does not exist.
    """
    source = _split(path)
    lines = source.lines
    a, b, c = (lines.characters(k) for k in range(3))
    is_v = (a == ord("v")) & (b <= 32)
    is_vt = (a == ord("v")) & (b == ord("t")) & (c <= 32)
    is_vn = (a == ord("v")) & (b == ord("n")) & (c <= 32)
    is_f = (a == ord("f")) & (b <= 32)
    positions, colors = _read_positions(source, is_v)
    uv = _read_columns(source, is_vt, b"vt", 1)[0]
    uv = np.concatenate([uv, np.zeros((len(uv), 2))], axis=1)[:, :2]
    normals = _read_columns(source, is_vn, b"vn", 3)[0][:, :3]
    sizes, corners = _read_corners(source, is_f)
    dangling = _resolve(source, is_f, sizes, corners, (is_v, is_vt, is_vn))
    silent = np.isin(a, list(b"gos")) & (b <= 32)
    rest = (lines.words > 0) & ~(is_v | is_vt | is_vn | is_f | silent | (a == ord("#")))
    others = []
    for line in np.flatnonzero(rest).tolist():
        keyword, *after = decode(lines.read(line)).split(maxsplit=1)
        others.append((line, keyword, after[0] if after else ""))
    faces = np.flatnonzero(is_f)

    def line_of(polygon: int) -> int:
        return source.number_of(int(faces[polygon]))

    return Statements(positions, colors, uv, normals, sizes, corners, faces, tuple(others), dangling, line_of)


def _split(path: Path) -> _Source:
    """Lines without comments at their ends; each character stays where it is in the file."""
    raw = to_utf8(read_content(path))
    if b"\r" in raw:
        raw = raw.replace(b"\r\n", b" \n").replace(b"\r", b"\n")
    text = raw.replace(b"\\ \n", b"   ").replace(b"\\\n", b"  ") if b"\\" in raw else raw
    lines = split_lines(text)
    marks = np.flatnonzero(np.frombuffer(lines.text, dtype=np.uint8) == ord("#"))
    at = np.searchsorted(lines.ends, marks, side="right")
    # Names may hold the mark ("usemtl Material #25"), numbers are cut off there.
    inline = (marks > lines.begins[at]) & np.isin(lines.characters(0)[at], list(b"vf"))
    if inline.any():
        data = bytearray(lines.text)
        for mark, line in zip(marks[inline].tolist(), at[inline].tolist(), strict=True):
            end = int(lines.ends[line]) - 1
            data[mark:end] = b" " * (end - mark)
        lines = split_lines(bytes(data))
    return _Source(path, raw, lines)


def _read_columns(
    source: _Source, chosen: NDArray[np.bool_], keyword: bytes, least: int
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """(N, columns) numbers, zero where a line has fewer, and how many each has."""
    words = source.lines.words[chosen] - 1
    if len(words) and words.min() < least:
        line = int(np.flatnonzero(chosen)[np.argmax(words < least)])
        raise source.refuse(line, f"'{decode(source.lines.read(line))[:40]}' has fewer than {least} numbers")
    numbers = source.parse(chosen, keyword, int(words.sum()))
    width = int(words.max(initial=least))
    if np.all(words == width):
        return numbers.reshape(-1, width), words
    table = np.zeros((len(words), width))
    table[np.arange(width) < words[:, None]] = numbers
    return table, words


def _read_positions(
    source: _Source, chosen: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], NDArray[np.float32] | None]:
    table, words = _read_columns(source, chosen, b"v", 3)
    positions = np.ascontiguousarray(table[:, :3])
    colored = words >= 6
    if not colored.any():
        return positions, None
    display = np.where(colored[:, None], table[:, 3:6], 1.0)
    if display.max() > 1:
        display[colored] /= 255
    return positions, decode_srgb(display)


def _read_corners(source: _Source, chosen: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Sizes of the polygons, and (C, 3) indices as they are written; 0 for those that are not."""
    sizes = source.lines.words[chosen] - 1
    text = source.lines.select(chosen)
    if b"/" not in text:
        only = source.parse(chosen, b"f", int(sizes.sum()), np.int64)
        return sizes, np.stack([only, np.zeros_like(only), np.zeros_like(only)], axis=1)
    if text.count(b"f") != len(sizes):
        raise source.refuse_numbers(chosen, b"f", np.int64, _fill_in)
    data = np.frombuffer(text, dtype=np.uint8)
    begun = data > 32
    begun[1:] &= data[:-1] <= 32
    begun &= data != ord("f")
    marks = np.flatnonzero(data == ord("/"))
    slashes = np.diff(np.searchsorted(marks, np.flatnonzero(begun)), append=len(marks))
    wrong = np.flatnonzero((slashes > 2) | (data[begun] == ord("/")))
    if wrong.size:
        line = int(np.flatnonzero(chosen)[np.searchsorted(np.cumsum(sizes), wrong[0], side="right")])
        word = text[np.flatnonzero(begun)[wrong[0]] :].split(maxsplit=1)[0]
        raise source.refuse(line, f"'{decode(word)[:40]}' is no corner of a face")
    numbers = source.parse(chosen, b"f", len(slashes) + int(slashes.sum()), np.int64, _fill_in)
    if np.all(slashes == slashes[0]):
        corners = numbers.reshape(len(slashes), -1)
        return sizes, np.pad(corners, [(0, 0), (0, 3 - corners.shape[1])])
    corners = np.zeros((len(slashes), 3), dtype=np.int64)
    corners[np.arange(3) <= slashes[:, None]] = numbers
    return sizes, corners


def _fill_in(text: bytes) -> bytes:
    """The text of corners with blanks for slashes and 0 for indices that are left out."""
    text = text.replace(b"//", b"/0/")
    for blank in (b" ", b"\t", b"\n"):
        text = text.replace(b"/" + blank, b" 0" + blank)
    return (text + b"0" if text.endswith(b"/") else text).replace(b"/", b" ")


def _resolve(
    source: _Source,
    chosen: NDArray[np.bool_],
    sizes: NDArray[np.int64],
    corners: NDArray[np.int64],
    kinds: tuple[NDArray[np.bool_], ...],
) -> tuple[str, ...]:
    """Turn indices that count from 1, or back from the line of the face, into ones that count from 0, in place.

    Returns what is named and of which there is none. Normals and texture coordinates were then left out of the file
    that was exported; where only some are missing, the file is damaged.
    """
    dangling = []
    for k, (name, kind) in enumerate(zip(_NAMES, kinds, strict=True)):
        written = corners[:, k].copy()
        count = int(np.count_nonzero(kind))
        if not count and k and written.any():
            dangling.append(name if name.endswith("s") else f"{name}s")
            corners[:, k] = -1
            continue
        corners[:, k] -= 1
        if written.min(initial=0) < 0:
            before = np.repeat(np.cumsum(kind)[chosen], sizes)
            corners[:, k] = np.where(written < 0, before + written, corners[:, k])
        wrong = ((corners[:, k] < 0) | (corners[:, k] >= count)) & ((written != 0) | (k == 0))
        if not wrong.any():
            continue
        bad = int(np.argmax(wrong))
        line = int(np.flatnonzero(chosen)[np.searchsorted(np.cumsum(sizes), bad, side="right")])
        if written[bad] == 0:
            raise source.refuse(line, "a face names vertex 0, and OBJ files count from 1")
        there = f"are only {count} in the file" if count else "is none"
        if written[bad] < 0:
            there = "are not so many before it"
        raise source.refuse(line, f"a face names {name} {written[bad]}, and there {there}")
    return tuple(dangling)
