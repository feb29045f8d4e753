"""The tables of a PLY file: elements, their properties, and lists of any length."""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError
from slepian_prt.machine.file_content import read_content
from slepian_prt.scene.formats.files import to_utf8
from slepian_prt.scene.formats.text import parse_numbers, split_lines

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "long": "i8", "int64": "i8",
    "ulong": "u8", "uint64": "u8", "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip

# Codes of the struct module, in standard sizes.
_CODES = {"i1": "b", "u1": "B", "i2": "h", "u2": "H", "i4": "i", "u4": "I", "i8": "q", "u8": "Q", "f8": "d"}

_LINE = re.compile(rb"([^\r\n]*)(?:\r\n|\r|\n)")
_LONGEST_HEADER = 1 << 20

_ORDERS = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}


@dataclass(frozen=True)
class Property:
    """A column: NumPy types of its values, and of its counts if it holds lists."""

    name: str
    type: str
    count: str | None = None


@dataclass(frozen=True)
class Element:
    """A table."""

    name: str
    count: int
    properties: tuple[Property, ...]


@dataclass(frozen=True)
class Header:
    """What stands before the tables.

    Attributes
    ----------
    order : str
        "=" for text, "<" and ">" for binary numbers.
    elements : tuple of Element
    comments : tuple of str
    size : int
        Its bytes.
    """

    order: str
    elements: tuple[Element, ...]
    comments: tuple[str, ...]
    size: int


@dataclass(frozen=True, eq=False)
class Lists:
    """Lists one after the other: ``values`` (total,), of which each row has ``sizes`` (N,)."""

    sizes: NDArray[np.int64]
    values: NDArray[Any]


Table = dict[str, "NDArray[Any] | Lists"]


def read_tables(path: Path) -> tuple[Header, dict[str, Table]]:
    """Read all tables.

    Returns
    -------
    header : Header
    tables : dict
        Of the columns of each element: (N,) arrays in the type of the file (float64 in text), or `Lists`.

    Raises
    ------
    UserError
        Not a PLY file, a malformed header, more or fewer numbers than it declares, or numbers that cannot be read.
    """
    raw = to_utf8(read_content(path))
    header = read_header(path, raw)
    if header.order == "=":
        body, order = _read_text(path, raw, header), "="
    else:
        body, order = np.frombuffer(raw, dtype=np.uint8)[header.size :], header.order
    tables: dict[str, Table] = {}
    at = 0
    for element in header.elements:
        element = _as_stored(element, order)
        least = sum(np.dtype(p.count or p.type).itemsize for p in element.properties)
        if element.count * least > len(body) - at:
            raise _truncated(path, element)
        table, at = _read_table(path, element, body, at)
        tables.setdefault(element.name, table)
    if at < len(body) and (order == "=" or body[at:].tobytes().strip(b"\0\t\n\r ")):  # some writers pad
        left = f"{(len(body) - at) // 8} numbers" if order == "=" else f"{len(body) - at} bytes"
        raise UserError(f"{path}: has {left} more than its header declares; export it again")
    return header, tables


def read_header(path: Path, raw: bytes) -> Header:
    """Read what ends with end_header."""
    if raw[:3] != b"ply" or raw[3:4] not in (b"\n", b"\r", b" "):
        raise UserError(f"{path}: cannot be read as a mesh: it does not begin with 'ply'; check that it is a .ply file")
    order, comments, elements = None, [], list[tuple[str, int, list[Property]]]()
    for number, row in enumerate(_LINE.finditer(raw, 0, _LONGEST_HEADER), 1):
        line = row[1].decode("latin-1").strip()
        keyword, *words = line.split() or [""]
        if keyword == "end_header":
            at = row.end()
            break
        if keyword in ("comment", "obj_info"):
            comments.append(line[len(keyword) :].strip())
        elif keyword == "format" and words[:1] and words[0] in _ORDERS:
            order = _ORDERS[words[0]]
        elif keyword == "element" and len(words) == 2 and words[1].isdecimal() and len(words[1]) < 20:
            elements.append((words[0], int(words[1]), []))
        elif keyword == "property" and elements and _is_property(words):
            kinds = [_TYPES[word] for word in words[:-1] if word != "list"]
            elements[-1][2].append(Property(words[-1], kinds[-1], kinds[0] if len(kinds) == 2 else None))
        elif keyword in ("format", "element", "property"):
            raise UserError(f"{path}: line {number} of its header, '{line[:60]}', is not understood; export it again")
        elif line and line != "ply":
            comments.append(line)  # some writers forget the word
    else:
        raise UserError(f"{path}: its header has no end_header (is it cut off?); export it again")
    if order is None:
        raise UserError(f"{path}: its header names no format (ascii, binary_little_endian …); export it again")
    found = tuple(Element(name, count, tuple(properties)) for name, count, properties in elements)
    return Header(order, found, tuple(comments), at)


def _is_property(words: list[str]) -> bool:
    if len(words) == 4 and words[0] == "list":
        return words[1] in _TYPES and words[2] in _TYPES and _TYPES[words[1]][0] != "f"
    return len(words) == 2 and words[0] in _TYPES


def _as_stored(element: Element, order: str) -> Element:
    """The element with the types of its bytes; numbers of text are float64."""

    def stored(kind: str | None) -> str | None:
        return None if kind is None else "=f8" if order == "=" else order + kind

    properties = tuple(Property(p.name, stored(p.type) or "", stored(p.count)) for p in element.properties)
    return Element(element.name, element.count, properties)


def _read_text(path: Path, raw: bytes, header: Header) -> NDArray[np.uint8]:
    """The bytes of the numbers as float64."""
    text = raw[header.size :]
    lines = split_lines(text)
    numbers = parse_numbers(lines.text, int(lines.words.sum()))
    first = raw[: header.size].replace(b"\r\n", b"\n").replace(b"\r", b"\n").count(b"\n") + 1
    if numbers is None:
        bad = lines.find_bad_number(np.arange(len(lines.words)))
        if bad:
            raise UserError(f"{path}: line {first + bad[0]}: '{bad[1]}' is not a number; export it again")
        raise UserError(f"{path}: its numbers cannot be read; export it again")
    filled = np.flatnonzero(lines.words > 0)
    if len(filled) == sum(element.count for element in header.elements):
        _check_rows(path, header, lines.words[filled], numbers, first + filled)
    return numbers.view(np.uint8)


def _check_rows(
    path: Path, header: Header, words: NDArray[np.int64], numbers: NDArray[np.float64], line: NDArray[np.int64]
) -> None:
    """Raise UserError for the first of the rows, each in its line, that has other numbers than its element."""
    begins = np.cumsum(words) - words
    at = 0
    for element in header.elements:
        rows = slice(at, at + element.count)
        at += element.count
        begin, has = begins[rows], words[rows]
        wanted = np.zeros(len(has), dtype=np.int64)
        for p in element.properties:
            if p.count is not None:
                # Where the row has ended already it is too short anyway.
                count = numbers[np.minimum(begin + wanted, len(numbers) - 1)]
                is_count = (count >= 0) & (count < len(numbers)) & (count == np.trunc(count))  # or found bad later
                wanted += np.where(is_count, count, has - wanted - 1).astype(np.int64)
            wanted += 1
        wrong = np.flatnonzero(has != wanted)
        if wrong.size and (has[wrong[0]] > wanted[wrong[0]] or line[rows][wrong[0]] < line[-1]):  # else: cut off
            its = "a" if all(p.count is None for p in element.properties) else "this"
            raise UserError(
                f"{path}: line {line[rows][wrong[0]]}: has {has[wrong[0]]} numbers, and {its} {element.name} has "
                f"{wanted[wrong[0]]} by the header; export it again"
            )


def _truncated(path: Path, element: Element) -> UserError:
    return UserError(
        f"{path}: its header declares {element.count} rows of '{element.name}', and the file ends before them "
        "(is it cut off?); export it again"
    )


def _read_table(path: Path, element: Element, body: NDArray[np.uint8], at: int) -> tuple[Table, int]:
    """Columns of an element whose rows begin at a byte, and the byte after them."""
    table = _read_regular(element, body, at)
    if table is not None:
        return table
    offsets, sizes, end = _walk(path, element, body, at)
    columns: Table = {}
    for p, begins, counts in zip(element.properties, offsets, sizes, strict=True):
        values = _gather(body, begins, counts, np.dtype(p.type))
        columns.setdefault(p.name, values if p.count is None else Lists(counts, values))
    return columns, end


def _read_regular(element: Element, body: NDArray[np.uint8], at: int) -> tuple[Table, int] | None:
    """Columns of rows whose lists are as long as those of the first row; None if they are not."""
    fields: list[tuple[Any, ...]] = []
    lengths = []
    offset = at
    for number, p in enumerate(element.properties):
        kind, length = np.dtype(p.type), 1
        if p.count is not None:
            count = np.dtype(p.count)
            first = body[offset : offset + count.itemsize]
            if not element.count or len(first) < count.itemsize:
                return None
            value = float(first.view(count)[0])
            if not (0 <= value <= len(body)) or value != int(value):
                return None
            length = int(value)
            fields.append((f"count {number}", count))
            offset += count.itemsize
        fields.append((f"values {number}", kind, (length,)))
        lengths.append(length)
        offset += kind.itemsize * length
    end = at + element.count * (offset - at)
    if end > len(body):
        return None
    rows = np.ndarray(element.count, dtype=fields, buffer=body, offset=at)
    columns: Table = {}
    for number, (p, length) in enumerate(zip(element.properties, lengths, strict=True)):
        values = rows[f"values {number}"]
        if p.count is None:
            columns.setdefault(p.name, values[:, 0])
            continue
        if not np.all(rows[f"count {number}"] == length):
            return None
        columns.setdefault(p.name, Lists(np.full(element.count, length, dtype=np.int64), values.reshape(-1)))
    return columns, end


def _walk(
    path: Path, element: Element, body: NDArray[np.uint8], at: int
) -> tuple[list[NDArray[np.int64]], list[NDArray[np.int64]], int]:
    """Go from list to list: where the values of each property are in each row, how many, and where the rows end."""
    raw = body.tobytes()
    plan = []  # of each list: bytes before its count, how to read that, its bytes, and those of a value
    skip = 0
    for p in element.properties:
        size = np.dtype(p.type).itemsize
        if p.count is None:
            skip += size
            continue
        kind = np.dtype(p.count)
        read = struct.Struct(kind.str[0].replace("|", "<") + _CODES[kind.str[1:]]).unpack_from
        plan.append((skip, read, kind.itemsize, size))
        skip = 0
    found: list[list[int]] = [[] for _ in plan]
    many: list[list[int]] = [[] for _ in plan]
    steps = [(*step, begins.append, sizes.append) for step, begins, sizes in zip(plan, found, many, strict=True)]
    offset = at
    try:
        for _ in range(element.count):
            for before, read, width, size, begin, length in steps:
                value = read(raw, offset + before)[0]
                if not value >= 0 or value % 1:
                    raise UserError(f"{path}: a '{element.name}' has a list of {value} values; export it again")
                count = int(value)
                offset += before + width
                begin(offset)
                length(count)
                offset += count * size
            offset += skip
    except (struct.error, OverflowError):  # an offset beyond the end, or beyond all
        raise _truncated(path, element) from None
    if offset > len(raw):
        raise _truncated(path, element)
    return (*_place(element, found, many, at), offset)


def _place(
    element: Element, found: list[list[int]], many: list[list[int]], at: int
) -> tuple[list[NDArray[np.int64]], list[NDArray[np.int64]]]:
    """Where each property begins, scalars counted from the end of the list before them."""
    begins = [np.array(offsets, dtype=np.int64) for offsets in found]
    sizes = [np.array(lengths, dtype=np.int64) for lengths in many]
    ones = np.ones(element.count, dtype=np.int64)
    lists = [p for p in element.properties if p.count is not None]
    first = element.properties.index(lists[0])
    lead = sum(np.dtype(p.type).itemsize for p in element.properties[:first]) + np.dtype(lists[0].count or "").itemsize
    cursor = begins[0] - lead
    offsets, counts = [], []
    number = 0
    for p in element.properties:
        size = np.dtype(p.type).itemsize
        if p.count is None:
            offsets.append(cursor)
            counts.append(ones)
            cursor = cursor + size
        else:
            offsets.append(begins[number])
            counts.append(sizes[number])
            cursor = begins[number] + sizes[number] * size
            number += 1
    return offsets, counts


def _gather(
    body: NDArray[np.uint8], begins: NDArray[np.int64], counts: NDArray[np.int64], kind: np.dtype[Any]
) -> NDArray[Any]:
    """Values of lists at the given bytes, one list after the other."""
    places = np.cumsum(counts) - counts
    values = np.empty(int(counts.sum()), dtype=kind)
    if not len(counts):
        return values
    order = np.argsort(counts, kind="stable")
    lengths, firsts = np.unique(counts[order], return_index=True)
    for length, rows in zip(lengths.tolist(), np.split(order, firsts[1:]), strict=True):
        if length:
            taken = body[begins[rows, None] + np.arange(length * kind.itemsize)].view(kind)
            values[places[rows, None] + np.arange(length)] = taken
    return values
