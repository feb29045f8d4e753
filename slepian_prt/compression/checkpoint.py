"""Coefficients of all receivers between tracing and coding: in memory, or in a journal on disk.

Receivers come in blocks along the surface and are wanted cap by cap. A journal keeps each finished block with a
checksum, so that work that was killed goes on where it was: blocks that are whole are kept, all others done again.
"""

from __future__ import annotations

import contextlib
import io
import logging
import struct
import tempfile
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import IO, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError
from slepian_prt.files import locked_cache_file

log = logging.getLogger(__name__)

_HEADER = struct.Struct("<4sIQQQI")  # mark, number of the block, vertices, coefficients, rays, checksum
_MARK = b"BLK2"


class BlockStatistics(NamedTuple):
    """What is known of each receiver of a block, (n,) float32 each.

    Attributes
    ----------
    blocked : part of the hemisphere, cosine-weighted
    energy : squared norm of the (weighted) transfer vector
    missed : squared norm of what the bases miss of it
    """

    blocked: NDArray[np.float32]
    energy: NDArray[np.float32]
    missed: NDArray[np.float32]


class Block(NamedTuple):
    """What a block of receivers became.

    Attributes
    ----------
    vertices : (n,) int32, sorted by cap
    statistics : BlockStatistics
    coefficients : (m,) float32
        Of one receiver after the other, as many for each as its cap has.
    rays : int
        Traced for it.
    """

    vertices: NDArray[np.int32]
    statistics: BlockStatistics
    coefficients: NDArray[np.float32]
    rays: int


class Store(Protocol):
    """Where blocks are kept."""

    def add(self, number: int, block: Block) -> None:
        """Keep a block."""

    def __iter__(self) -> Iterator[tuple[int, Block]]:
        """All blocks, each with its number."""

    def part(self, number: int, vertices: slice, coefficients: slice) -> tuple[NDArray, NDArray]:
        """Some of a block's vertices with their coefficients."""


class MemoryStore:
    """Blocks in memory."""

    def __init__(self) -> None:
        self._blocks: dict[int, Block] = {}

    def add(self, number: int, block: Block) -> None:
        self._blocks[number] = block

    def __iter__(self) -> Iterator[tuple[int, Block]]:
        yield from self._blocks.items()

    def part(self, number: int, vertices: slice, coefficients: slice) -> tuple[NDArray, NDArray]:
        block = self._blocks[number]
        return block.vertices[vertices], block.coefficients[coefficients]


class Journal:
    """Blocks in a file, which is opened by `journal`."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        self._places: dict[int, tuple[int, int]] = {}  # where each block's arrays begin, and its number of vertices
        file.seek(0)
        ends = [0, *self._scan()]
        file.seek(ends[-1])
        file.truncate()

    def add(self, number: int, block: Block) -> None:
        content = b"".join(
            np.ascontiguousarray(array).tobytes() for array in (block.vertices, *block.statistics, block.coefficients)
        )
        sizes = block.vertices.size, block.coefficients.size
        try:
            self._file.seek(0, io.SEEK_END)
            begin = self._file.tell()
            self._file.write(_HEADER.pack(_MARK, number, *sizes, block.rays, zlib.crc32(content)) + content)
            self._file.flush()
        except OSError as error:
            raise UserError(
                f"{self._file.name}: cannot be written ({error.strerror or error}); free some space, or set "
                "SLEPIAN_PRT_CACHE to a folder on another disk"
            ) from None
        self._places[number] = begin + _HEADER.size, block.vertices.size

    def __iter__(self) -> Iterator[tuple[int, Block]]:
        for number, (begin, _) in self._places.items():
            self._file.seek(begin - _HEADER.size)
            found = self._read()
            if found is None:
                raise UserError(f"{self._file.name}: changed while it was used; start again")
            yield number, found[1]

    def part(self, number: int, vertices: slice, coefficients: slice) -> tuple[NDArray, NDArray]:
        begin, count = self._places[number]
        of_coefficients = begin + 16 * count
        return (
            self._array(begin + 4 * vertices.start, vertices.stop - vertices.start, np.int32),
            self._array(of_coefficients + 4 * coefficients.start, coefficients.stop - coefficients.start, np.float32),
        )

    def _array(self, begin: int, count: int, kind: type) -> NDArray:
        self._file.seek(begin)
        return np.frombuffer(self._file.read(4 * count), dtype=kind)

    def _scan(self) -> Iterator[int]:
        """Go over the blocks that are whole; yields where each ends."""
        while True:
            begin = self._file.tell()
            found = self._read()
            if found is None:
                return
            number, block = found
            self._places[number] = begin + _HEADER.size, block.vertices.size
            yield self._file.tell()

    def _read(self) -> tuple[int, Block] | None:
        """The block that begins here, if it is whole."""
        header = self._file.read(_HEADER.size)
        if len(header) < _HEADER.size:
            return None
        mark, number, count, size, rays, checksum = _HEADER.unpack(header)
        if mark != _MARK or count > 1 << 32 or size > 1 << 40:
            return None
        content = self._file.read(16 * count + 4 * size)
        if len(content) < 16 * count + 4 * size or zlib.crc32(content) != checksum:
            return None
        vertices = np.frombuffer(content, np.int32, count)
        statistics = BlockStatistics(*np.frombuffer(content, np.float32, 3 * count, 4 * count).reshape(3, -1))
        return number, Block(vertices, statistics, np.frombuffer(content, np.float32, size, 16 * count), rays)


@contextlib.contextmanager
def journal(fingerprint: str) -> Iterator[Journal]:
    """The journal of a job, which is gone when the job is done and stays when it is not.

    It lies in the user's cache folder, or where SLEPIAN_PRT_CACHE says. Without a folder that can be written, or while
    another process does the same job, it is a temporary file, and the job starts from the beginning.

    Parameters
    ----------
    fingerprint : str
        Of all that the blocks depend on.
    """
    file = locked_cache_file(f"{fingerprint}.blocks")
    if file is None:
        log.info("no folder to keep finished work in, or another process does the same; if stopped, it starts again")
        with tempfile.TemporaryFile(prefix="slepian_prt-") as temporary:
            yield Journal(temporary)
        return
    with file:
        kept = Journal(file)
        yield kept
        with contextlib.suppress(OSError):
            Path(file.name).unlink()
