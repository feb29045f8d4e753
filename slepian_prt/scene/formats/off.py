"""OFF files, the text format of Geomview."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError
from slepian_prt.machine.file_content import read_content
from slepian_prt.scene.formats.assembly import Polygons, Vertices, assemble
from slepian_prt.scene.formats.colors import decode_srgb
from slepian_prt.scene.formats.files import to_utf8
from slepian_prt.scene.formats.parts import MeshFile
from slepian_prt.scene.formats.text import Lines, parse_numbers, split_lines

_KEYWORD = re.compile(rb"\s*(?P<ST>ST)?(?P<C>C)?(?P<N>N)?(?P<four>4)?(?P<n>n)?OFF(?P<binary>\s+BINARY)?(?=[\s\d]|\Z)")


# More lines than any file has, as an integer.
_MOST = 1e18


def read_off(path: Path) -> MeshFile:
    """Read an OFF file with the normals (N) and colours (C) of its vertices.

    A line holds one vertex or one face. Without colours, which only the ends of lines tell apart, they may be spread
    over lines in any other way.

    Colours of integers are display values of 8 bits (sRGB), and those with a decimal point are linear. Colours of
    faces are left out, and so are texture coordinates (ST), as OFF names no texture.

    Raises
    ------
    UserError
        Not an OFF file, a binary one, one in other than three dimensions, fewer or more lines than it declares, or
        faces that name vertices which do not exist.

    References
    ----------
    Geomview manual, "OFF Files".
    """
    text = to_utf8(read_content(path))
    if b"#" in text:
        text = re.sub(rb"#[^\r\n]*", lambda comment: b" " * len(comment[0]), text)
    text = text.removeprefix(b"\xef\xbb\xbf")
    keyword = _read_keyword(path, text)
    lines = split_lines(re.sub(rb"\S", b" ", keyword[0]) + text[keyword.end() :])
    filled = np.flatnonzero(lines.words > 0)
    if not filled.size:
        raise UserError(f"{path}: has no counts of vertices and faces after 'OFF' (is it cut off?); export it again")
    counts = _read_numbers(path, lines, filled[:1])
    if len(counts) not in (2, 3) or np.any(~(counts <= _MOST) | (counts < 0) | (counts != np.trunc(counts))):
        words = lines.read(int(filled[0])).decode("latin-1")[:60]
        raise UserError(
            f"{path}: line {filled[0] + 1}: '{words}' are no counts of vertices, faces and edges; export it again"
        )
    vertex_count, face_count = int(counts[0]), int(counts[1])
    filled = filled[1:]
    if len(filled) != vertex_count + face_count:
        split = _split_rows(lines, filled, vertex_count, face_count, _count_columns(keyword))
        lines, filled = split or (lines, filled)
    if len(filled) != vertex_count + face_count:
        raise UserError(
            f"{path}: declares {vertex_count} vertices and {face_count} faces, and has {len(filled)} lines for them "
            "(is it cut off?); export it again with one vertex or face in each line"
        )
    notes: list[str] = []
    vertices = _read_vertices(path, lines, filled[:vertex_count], keyword, notes)
    polygons = _read_faces(path, lines, filled[vertex_count:])
    return assemble(path, vertices, polygons, notes=notes)


def _read_keyword(path: Path, text: bytes) -> re.Match[bytes]:
    keyword = _KEYWORD.match(text)
    if not keyword:
        raise UserError(
            f"{path}: cannot be read as a mesh: it does not begin with 'OFF'; check that it is an .off file"
        )
    word = keyword[0].split()[0].decode()
    if keyword["binary"]:
        raise UserError(f"{path}: is a binary OFF file; save it as text")
    if keyword["four"] or keyword["n"]:
        raise UserError(f"{path}: is a {word} file, whose vertices are not in three dimensions; export it as OFF")
    return keyword


def _count_columns(keyword: re.Match[bytes]) -> int:
    """Numbers that a vertex has at least."""
    return 3 + 3 * bool(keyword["N"]) + 3 * bool(keyword["C"]) + 2 * bool(keyword["ST"])


def _split_rows(
    lines: Lines, filled: NDArray[np.int64], vertices: int, faces: int, width: int
) -> tuple[Lines, NDArray[np.int64]] | None:
    """The rows of a file without colours, each in a line of its own; None if the numbers of it are others."""
    words = lines.text[lines.starts[filled[0]] :].split() if filled.size else []
    if width * vertices + faces > len(words):
        return None
    begins = [width * number for number in range(vertices)]
    at = width * vertices
    for _ in range(faces):
        if at >= len(words) or not words[at].isdigit() or len(words[at]) > 18:
            return None
        begins.append(at)
        at += 1 + int(words[at])
    if at != len(words):
        return None
    rows = [b" ".join(words[begin:end]) for begin, end in zip(begins, [*begins[1:], at], strict=True)]
    split = split_lines(b"\n".join(rows))
    return split, np.arange(len(rows), dtype=np.int64)


def _read_numbers(path: Path, lines: Lines, rows: NDArray[np.int64]) -> NDArray[np.float64]:
    """All numbers in some lines."""
    chosen = np.zeros(len(lines.words), dtype=bool)
    chosen[rows] = True
    numbers = parse_numbers(lines.select(chosen), int(lines.words[rows].sum()))
    if numbers is None:
        bad = lines.find_bad_number(rows)
        if bad:
            raise UserError(f"{path}: line {bad[0] + 1}: '{bad[1]}' is not a number; export it again")
        raise UserError(f"{path}: its numbers cannot be read; export it again")
    return numbers


def _read_vertices(
    path: Path, lines: Lines, rows: NDArray[np.int64], keyword: re.Match[bytes], notes: list[str]
) -> Vertices:
    """Vertices in columns: coordinates, then normals, colours and texture coordinates as the keyword says."""
    words = lines.words[rows]
    width = int(words[0]) if len(words) else 3
    normals, colored, mapped = bool(keyword["N"]), bool(keyword["C"]), bool(keyword["ST"])
    least = _count_columns(keyword)
    wrong = np.flatnonzero((words != width) | (words < least))
    if wrong.size:
        wanted = width if width >= least else f"{least} or more"
        raise UserError(
            f"{path}: line {rows[wrong[0]] + 1}: has {words[wrong[0]]} numbers, and a vertex has {wanted}; "
            "export it again"
        )
    table = _read_numbers(path, lines, rows).reshape(-1, width)
    colors = None
    if colored:
        begin = 3 + 3 * normals
        values = table[:, begin : begin + 3]
        end = width - 2 * mapped
        first = b"".join(lines.read(int(row)) for row in rows[:1]).split()[begin:end]
        # One is white as a float and nearly black as a byte: the way it is written tells.
        whole = not any(c in word for word in first for c in b".eE") and np.all(values == np.trunc(values))
        colors = decode_srgb(values / 255) if whole else values.astype(np.float32)
    elif width > least:
        notes.append(f"{width - least} further numbers of each vertex left out")
    return Vertices(table[:, :3].copy(), table[:, 3:6].copy() if normals else None, colors)


def _read_faces(path: Path, lines: Lines, rows: NDArray[np.int64]) -> Polygons:
    """Polygons of lines that hold a number of corners, those, and perhaps a colour."""
    words = lines.words[rows]
    numbers = _read_numbers(path, lines, rows)
    begins = np.cumsum(words) - words
    sizes = numbers[begins]
    wrong = np.flatnonzero(~((sizes >= 0) & (sizes < words) & (sizes == np.trunc(sizes))))
    if wrong.size:
        raise UserError(
            f"{path}: line {rows[wrong[0]] + 1}: begins with {sizes[wrong[0]]:g}, which is not how many corners follow "
            "(is it cut off?); export it again"
        )
    counts = sizes.astype(np.int64)
    place = np.arange(len(numbers)) - np.repeat(begins, words)
    corners = numbers[(place > 0) & (place <= np.repeat(counts, words))]
    bad = np.flatnonzero((corners != np.trunc(corners)) | ~(np.abs(corners) < 2**31))
    if bad.size:
        line = rows[np.searchsorted(np.cumsum(counts), bad[0], side="right")] + 1
        raise UserError(f"{path}: line {line}: vertex {corners[bad[0]]} is no integer; export it again")
    return Polygons(counts, corners.astype(np.int64))
