"""Members of zip archives, read no further than they were announced: nothing takes more memory than it is allowed to.

`zipfile` inflates what a member holds, not what the directory says of it, and holds a directory of any length.
"""

from __future__ import annotations

import ast
import math
import os
import re
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path
from textwrap import shorten
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.machine.memory import check_memory

# The directory of a hundred members takes a hundredth of that.
_LONGEST_DIRECTORY = 1 << 20

# The end of the directory: its mark, what we pass over, and the length of the directory; and that of large archives.
_END, _END64 = struct.Struct("<4s8xL6x"), struct.Struct("<4s36xQ8x")
_LOCATOR_SIZE, _LONGEST_COMMENT = 20, 1 << 16

# Headers of arrays: of version 1.0 without any padding they are far shorter.
_MAGIC = b"\x93NUMPY\x01\x00"
_LONGEST_HEADER = 1 << 10
_TYPE, _TEXT = re.compile("[<|][iufb][1248]"), re.compile(r"<U\d{1,9}")

# As NumPy writes them, with at most four axes.
_HEADER = re.compile(
    r"\{'descr': '([^']{1,12})', 'fortran_order': (False|True), 'shape': \(((?:\d{1,12}(?:, ?|(?=\)))){0,4})\), \}"
)

# A small array with its header.
_AT_ONCE = 1 << 12

# What takes less memory is read without asking how much there is.
_SMALL = 1 << 24


def open_archive(path: Path) -> zipfile.ZipFile:
    """A zip archive whose directory is of a length that we write.

    Raises
    ------
    OSError, zipfile.BadZipFile
    """
    with path.open("rb") as file:
        if not file.read(1):
            raise zipfile.BadZipFile("the file is empty")
        length = _directory_length(file)
    if length is not None and length > _LONGEST_DIRECTORY:
        raise zipfile.BadZipFile(f"a directory of {length} bytes")
    return zipfile.ZipFile(path)


def _directory_length(file: IO[bytes]) -> int | None:
    """As `zipfile` finds it; None where it finds none."""
    size = file.seek(0, os.SEEK_END)
    begin = max(0, size - _LONGEST_COMMENT - _END.size - _LOCATOR_SIZE - _END64.size)
    file.seek(begin)
    tail = file.read()
    at = len(tail) - _END.size
    if at < 0 or tail[at : at + 4] != b"PK\5\6" or tail[-2:] != b"\0\0":
        at = tail.rfind(b"PK\5\6")
        if at < 0 or at + _END.size > len(tail):
            return None
    length = int(_END.unpack_from(tail, at)[1])
    large = at - _LOCATOR_SIZE - _END64.size
    if large >= 0 and tail[at - _LOCATOR_SIZE :].startswith(b"PK\6\7") and tail[large:].startswith(b"PK\6\6"):
        length = max(length, int(_END64.unpack_from(tail, large)[1]))
    return length


def members_of(archive: zipfile.ZipFile) -> dict[str, zipfile.ZipInfo]:
    """Members by their names.

    Raises
    ------
    ValueError
        Two of a name.
    """
    found = {member.filename: member for member in archive.infolist()}
    if len(found) != len(archive.infolist()):
        raise ValueError("two members of the same name")
    return found


def read_member(archive: zipfile.ZipFile, member: zipfile.ZipInfo, most: int) -> bytes:
    """All of a member that holds so many bytes at most.

    Raises
    ------
    ValueError
        It holds more, or is packed in a way that we do not write.
    """
    _check_packing(member)
    if member.file_size > most:
        raise ValueError(f"{member.filename} of {member.file_size} bytes")
    with archive.open(member) as file:
        content = file.read(member.file_size)
        _check_end(file, member, len(content))
    return content


class Misfit(ValueError):
    """Something that is whole, but does not belong to what else there is."""


def read_array(
    archive: zipfile.ZipFile, member: zipfile.ZipInfo, expect: Callable[[np.dtype[Any], tuple[int, ...]], None]
) -> NDArray:
    """The array of a member.

    Parameters
    ----------
    archive, member
    expect : callable
        Raises Misfit for types and shapes that are not expected; called before the numbers are read.

    Raises
    ------
    ValueError
        It is no array, or longer or shorter than its header says; Misfit if it is not as expected.
    UserError
        It needs more memory than there is.
    """
    _check_packing(member)
    with archive.open(member) as file:
        start = file.read(min(member.file_size, _AT_ONCE))
        descr, shape, is_turned, begin = _read_header(start)
        if not _TYPE.fullmatch(descr):
            raise ValueError(f"{member.filename} of type {shorten(descr, 20)}")
        dtype = np.dtype(descr)
        expect(dtype, shape)
        size = dtype.itemsize * math.prod(shape)
        if begin + size != member.file_size:
            raise ValueError(f"{member.filename} of {member.file_size} bytes where {begin + size} are told of")
        if size > _SMALL:
            check_memory(size, archive.filename or "the file", "make it again with fewer vertices")
        array = np.empty(shape[::-1] if is_turned else shape, dtype)
        octets = array.reshape(-1).view(np.uint8)
        there = len(start) - begin
        octets[:there] = np.frombuffer(start, np.uint8, offset=begin)
        done = file.readinto(octets[there:].data)  # type: ignore[attr-defined]
        _check_end(file, member, len(start) + done)
    return array.T if is_turned else array


def read_text(archive: zipfile.ZipFile, member: zipfile.ZipInfo, most: int) -> str:
    """The text that a member holds as an array without axes; it has so many bytes at most.

    Raises
    ------
    ValueError
        It holds something else, or more.
    """
    content = read_member(archive, member, most)
    descr, shape, _, begin = _read_header(content)
    if not _TEXT.fullmatch(descr) or shape or len(content) - begin != 4 * int(descr[2:]):
        raise ValueError(f"{member.filename} is no text")
    return content[begin:].decode("utf-32-le").rstrip("\0")


def _read_header(content: bytes) -> tuple[str, tuple[int, ...], bool, int]:
    """Type, shape, whether the first axis varies first, and where the numbers begin."""
    length = int.from_bytes(content[len(_MAGIC) : len(_MAGIC) + 2], "little")
    begin = len(_MAGIC) + 2 + length
    if not content.startswith(_MAGIC) or length > _LONGEST_HEADER or begin > len(content):
        raise ValueError("no array of version 1.0, or one with a header that is too long")
    header = content[len(_MAGIC) + 2 : begin].decode("latin1").strip()
    usual = _HEADER.fullmatch(header)
    if usual:  # quicker than what follows
        descr, order, axes = usual.groups()
        return descr, tuple(int(n) for n in axes.split(",") if n.strip()), order == "True", begin
    try:
        values = ast.literal_eval(header)
        descr, is_turned, shape = values["descr"], values["fortran_order"], values["shape"]
    except (SyntaxError, RecursionError, MemoryError, KeyError, TypeError):
        raise ValueError("header of an array") from None
    plain = isinstance(shape, tuple) and len(shape) <= 4 and all(type(n) is int and 0 <= n < 1 << 40 for n in shape)
    if not plain or not isinstance(is_turned, bool) or not isinstance(descr, str):
        raise ValueError("header of an array")
    return descr, shape, is_turned, begin


def _check_packing(member: zipfile.ZipInfo) -> None:
    if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED) or member.flag_bits & 1:
        raise ValueError(f"{member.filename} is packed or encrypted in another way")


def _check_end(file: IO[bytes], member: zipfile.ZipInfo, done: int) -> None:
    """That all was there; what is read last tells `zipfile` to compare the checksum."""
    if done != member.file_size or file.read(1):
        raise ValueError(f"{member.filename} is cut short")
