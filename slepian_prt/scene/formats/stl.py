"""STL files, binary and text: triangles, each with corners of its own."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError
from slepian_prt.machine.file_content import read_content
from slepian_prt.scene.formats.files import decode, to_utf8
from slepian_prt.scene.formats.joining import join_equal, join_near
from slepian_prt.scene.formats.parts import MeshFile, MeshPart
from slepian_prt.scene.formats.text import Lines, find_bad_number, parse_numbers, split_lines

_RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])

# Relative to the diagonal of the box: corners that writers move by float32 matrices differ by some 1e-7 of it.
_ROUNDING = 1e-6

# What has a square; far beyond what a mesh may have.
_LARGEST = 1e100

# First letters of the lines of a facet, and their words: facet, outer loop, three times vertex, endloop, endfacet.
_LETTERS = np.frombuffer(b"fovvvee", dtype=np.uint8)
_WORDS = np.array([5, 2, 4, 4, 4, 1, 1])

_NAME = re.compile(rb"^[ \t]*(end ?)?solid\b[^\n]*", re.MULTILINE)

_FACET = re.compile(
    rb"\s*facet\b(?:\s+normal(?:\s+\S+){3})?\s+outer\s+loop\s+(vertex(?:\s+\S+){3}\s+vertex(?:\s+\S+){3}"
    rb"\s+vertex(?:\s+\S+){3})\s+endloop\s*"
)


def read_stl(path: Path) -> MeshFile:
    """Read a binary or text STL file; all solids in it are one part.

    Corners of the same position become one vertex, also where they differ by rounding: by up to 10^-6 of the diagonal
    of the mesh, or four steps of float32 at its largest coordinate. Normals are computed later: those of the file are
    the faces', and its colours, which have two contradictory definitions, are left out.

    Raises
    ------
    UserError
        Not an STL file, or cut off, or numbers that cannot be read.

    References
    ----------
    3D Systems, StereoLithography Interface Specification, 1988.
    """
    raw = read_content(path)
    count = int.from_bytes(raw[80:84], "little") if len(raw) >= 84 else -1
    if count >= 0 and len(raw) == 84 + _RECORD.itemsize * count:
        corners = np.frombuffer(raw, dtype=_RECORD, offset=84)["corners"].reshape(-1, 3).astype(np.float64)
    elif re.match(rb"(\xef\xbb\xbf)?\s*solid\b", text := to_utf8(raw), re.IGNORECASE) and b"\0" not in text:
        corners = _read_text(path, text)
    elif count < 0:
        raise UserError(
            f"{path}: holds no mesh: neither a binary STL file nor text that begins with 'solid'; export it again"
        )
    else:
        raise UserError(
            f"{path}: its header counts {count} triangles, which take {84 + 50 * count} bytes, and the file has "
            f"{len(raw)} (is it cut off?); export it again"
        )
    positions, faces = _join(corners)
    return MeshFile((MeshPart(path.stem, positions, faces),))


def _join(corners: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    first, joined = join_equal(corners)
    positions, faces = corners[first], joined.reshape(-1, 3)
    if not len(positions) or not np.abs(positions).max() <= _LARGEST:  # which is refused later
        return positions, faces
    step = float(np.spacing(np.abs(positions).max().astype(np.float32)))
    tolerance = max(4 * step, _ROUNDING * float(np.linalg.norm(np.ptp(positions, axis=0))))
    first, joined = join_near(positions, faces, tolerance)
    return positions[first], joined[faces]


def _read_text(path: Path, raw: bytes) -> NDArray[np.float64]:
    """(3 T, 3) corners."""
    lines = split_lines(raw.lower())
    named = np.array([lines.characters(k) for k in range(4)])
    last = np.flatnonzero(lines.words > 0)[-1]
    if not re.match(rb"end ?solid\b", lines.read(last)):
        raise UserError(f"{path}: the file does not end with 'endsolid' (is it cut off?); export it again")
    ends = np.all(named[:3] == np.frombuffer(b"end", dtype=np.uint8)[:, None], axis=0) & (
        (named[3] == ord("s")) | (named[3] == ord(" "))
    )
    rest = (lines.words > 0) & ~ends & (named[0] != ord("s"))
    letters, words = named[0][rest], lines.words[rest]
    facets = len(letters) // len(_LETTERS)
    regular = np.array_equal(letters, np.tile(_LETTERS, facets)) and np.array_equal(words, np.tile(_WORDS, facets))
    if not regular:
        return _read_freely(path, lines).reshape(-1, 3)
    corners = rest & (named[0] == ord("v"))
    numbers = parse_numbers(lines.select(corners).replace(b"vertex", b" "), 9 * facets)
    if numbers is None:
        bad = lines.find_bad_number(np.flatnonzero(corners), len(b"vertex"))
        if bad:
            raise UserError(f"{path}: line {bad[0] + 1}: '{bad[1]}' is not a number; export it again")
        raise UserError(f"{path}: its numbers cannot be read; export it again")
    return numbers.reshape(-1, 3)


def _read_freely(path: Path, lines: Lines) -> NDArray[np.float64]:
    """Read facets whose lines are not the usual ones, or find what is wrong with one of them."""
    text = _NAME.sub(lambda line: b" " * len(line[0]), lines.text)  # names of solids may be any words
    *facets, rest = text.split(b"endfacet")
    numbers, at = [], 0
    for facet in [*facets, rest] if rest.strip() else facets:
        match = _FACET.fullmatch(facet)
        if not match:
            begin = at + len(facet) - len(facet.lstrip())
            raise _refuse(path, lines, begin, "the facet is cut off, or is no triangle")
        corners = match[1].replace(b"vertex", b" " * 6)
        values = parse_numbers(corners, 9)
        if values is None:
            words = list(re.finditer(rb"\S+", corners))
            bad = words[find_bad_number([word[0] for word in words]) or 0]
            raise _refuse(path, lines, at + match.start(1) + bad.start(), f"'{decode(bad[0])[:40]}' is not a number")
        numbers.append(values)
        at += len(facet) + len(b"endfacet")
    return np.concatenate([np.empty(0), *numbers])


def _refuse(path: Path, lines: Lines, at: int, what: str) -> UserError:
    line = lines.text.count(b"\n", 0, at) + 1
    return UserError(f"{path}: line {line}: {what}; export it again")
