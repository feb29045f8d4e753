"""Coefficients of all receivers between tracing and coding: in memory, or in a journal on disk.

Receivers come in blocks along the surface and are wanted cap by cap. A journal keeps each finished block in a file of
its own, with a checksum, so that work that was killed goes on where it was: blocks that are whole are kept, all others
done again. Several processes may keep blocks of the same job there.
"""

from __future__ import annotations

import contextlib
import logging
import os
import struct
import tempfile
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import IO, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from slepian_prt.cache_folder import locked_cache_folder
from slepian_prt.errors import UserError

log = logging.getLogger(__name__)

_HEADER = struct.Struct("<4sIQQQ")  # mark, number of the block, vertices, coefficients, rays
_CHECKSUM = struct.Struct("<I")  # of header and content, behind both
_MARK = b"BLK3"
_SUFFIX = ".block"
_ASIDE = ".damaged"

# Rays of a receiver are no more than so many for each that was asked for, and so many more: bisection takes as many as
# it needs, and small sets of directions are made larger.
_RAYS, _MORE_RAYS = 64, 1 << 14

# Vectors have at most 7803 numbers, of at most 1e12.
_LARGEST_ENERGY = 1e28


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


class Wanted(NamedTuple):
    """What a block has to be of.

    Attributes
    ----------
    receivers : (n,)
    caps : (n,)
        Of each.
    widths : (caps,)
        Coefficients of a receiver of each cap.
    samples : int
        Rays that were asked for from each.
    """

    receivers: NDArray[np.int64]
    caps: NDArray[np.integer]
    widths: NDArray[np.int64]
    samples: int

    def misfit(self, block: Block) -> str | None:
        """Why a block is not this one; None if it can be."""
        order = np.argsort(self.receivers, kind="stable")
        if not np.array_equal(np.sort(block.vertices), self.receivers[order]):
            return "it is of other vertices"
        caps = self.caps[order][np.searchsorted(self.receivers[order], block.vertices)]
        if np.any(np.diff(caps) < 0):
            return "its vertices are not sorted by cap"
        if block.coefficients.size != int(self.widths[caps].sum()):
            return f"it has {block.coefficients.size} coefficients, not {int(self.widths[caps].sum())}"
        if not all(np.isfinite(part).all() for part in (*block.statistics, block.coefficients)):
            return "it has numbers that are not finite"
        if any(part.min(initial=0.0) < 0.0 for part in block.statistics):
            return "it has negative norms"
        if max(float(part.max(initial=0.0)) for part in block.statistics) > _LARGEST_ENERGY:
            return "it has norms that no vector has"
        if block.rays > self.receivers.size * (_RAYS * self.samples + _MORE_RAYS):
            return f"it tells of {block.rays} rays for {self.receivers.size} vertices"
        return None


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
    """Blocks in a folder, which is made by `journal`: each is a file.

    Parameters
    ----------
    folder : path
    look : bool
        Whether to look at once for what is there; else blocks are found when they are asked for.
    """

    def __init__(self, folder: Path, *, look: bool = True) -> None:
        self.folder = folder
        self._counts: dict[int, int] = {}  # vertices of the blocks that were found to be whole
        for path in sorted(folder.glob(f"*{_SUFFIX}")) if look else ():
            if path.stem.isdigit():
                self.find(int(path.stem))

    def add(self, number: int, block: Block) -> None:
        """Keep a block."""
        sizes = block.vertices.size, block.coefficients.size
        arrays = (block.vertices, *block.statistics, block.coefficients)
        header = _HEADER.pack(_MARK, number, *sizes, block.rays)
        parts = [header, *(np.ascontiguousarray(array).tobytes() for array in arrays)]
        checksum = 0
        for part in parts:
            checksum = zlib.crc32(part, checksum)
        try:
            handle, name = tempfile.mkstemp(dir=self.folder)  # of this process alone
            try:
                with os.fdopen(handle, "wb") as file:
                    for part in (*parts, _CHECKSUM.pack(checksum)):
                        file.write(part)
                os.replace(name, self._path(number))
            except BaseException:
                with contextlib.suppress(OSError):
                    os.unlink(name)
                raise
        except OSError as error:
            raise UserError(
                f"{self.folder}: cannot be written ({error.strerror or error}); free some space, or set "
                "SLEPIAN_PRT_CACHE to a folder on another disk"
            ) from None
        self._counts[number] = block.vertices.size

    def find(self, number: int) -> Block | None:
        """A block, if it is here and whole; perhaps another process has made it.

        What is here and not whole is put aside with a note.
        """
        try:
            found = _read(self._path(number), number)
        except _NotABlock as error:
            found = None
            self.forget(number, str(error))
        if found is None:
            self._counts.pop(number, None)
        else:
            self._counts[number] = found.vertices.size
        return found

    def forget(self, number: int, reason: str) -> None:
        """Put a block aside that is not what was expected, and note the reason: its receivers are traced again."""
        self._counts.pop(number, None)
        path = self._path(number)
        log.warning("%s: is put aside and its block done again (%s)", path, reason)
        try:
            path.replace(path.with_suffix(_ASIDE))
        except OSError:  # it is gone, or nothing can be moved here: whoever adds the block replaces it
            with contextlib.suppress(OSError):
                path.unlink()

    def __iter__(self) -> Iterator[tuple[int, Block]]:
        for number in list(self._counts):
            found = self.find(number)
            if found is None:
                raise self._changed()
            yield number, found

    def part(self, number: int, vertices: slice, coefficients: slice) -> tuple[NDArray, NDArray]:
        after = _HEADER.size + 16 * self._counts[number]
        try:
            with self._path(number).open("rb") as file:
                parts = (
                    _slice(file, _HEADER.size, vertices, np.int32),
                    _slice(file, after, coefficients, np.float32),
                )
        except (OSError, ValueError):
            raise self._changed() from None
        return parts

    def _changed(self) -> UserError:
        return UserError(f"{self.folder}: changed while it was used; start again")

    def _path(self, number: int) -> Path:
        return self.folder / f"{number:06}{_SUFFIX}"


def _slice(file: IO[bytes], begin: int, part: slice, kind: type) -> NDArray:
    """Some of the numbers of four bytes that begin there."""
    file.seek(begin + 4 * part.start)
    return np.frombuffer(file.read(4 * (part.stop - part.start)), dtype=kind, count=part.stop - part.start)


class _NotABlock(ValueError):
    """Says why a file is none."""


def _read(path: Path, number: int) -> Block | None:
    """The block of a file; None if it is not there.

    Raises
    ------
    _NotABlock
        Cut short, damaged, of another block or something else. Sizes are held against the length of the file before
        anything is made of them.
    """
    try:
        if not path.is_file():
            if path.exists():
                raise _NotABlock("it is no file")
            return None
        content = path.read_bytes()
    except FileNotFoundError:
        return None
    except OSError as error:
        raise _NotABlock(error.strerror or str(error)) from None
    if len(content) < _HEADER.size + _CHECKSUM.size:
        raise _NotABlock("it is cut short")
    mark, own, count, size, rays = _HEADER.unpack_from(content)
    end = _HEADER.size + 16 * count + 4 * size
    if mark != _MARK or own != number or len(content) != end + _CHECKSUM.size:
        raise _NotABlock("its header is that of another block, or of a file of another length")
    if zlib.crc32(memoryview(content)[:end]) != _CHECKSUM.unpack_from(content, end)[0]:
        raise _NotABlock("its checksum is another")
    vertices = np.frombuffer(content, np.int32, count, _HEADER.size)
    after = _HEADER.size + 4 * count
    statistics = BlockStatistics(*np.frombuffer(content, np.float32, 3 * count, after).reshape(3, -1))
    coefficients = np.frombuffer(content, np.float32, size, after + 12 * count)
    return Block(vertices, statistics, coefficients, rays)


@contextlib.contextmanager
def journal(fingerprint: str) -> Iterator[Journal]:
    """The journal of a job, which is gone when the job is done and stays when it is not.

    It lies in the user's cache folder, or where SLEPIAN_PRT_CACHE says. Without a folder that can be written, or while
    another process does the same job, it is in a temporary folder, and the job starts from the beginning.

    Parameters
    ----------
    fingerprint : str
        Of all that the blocks depend on.
    """
    with contextlib.ExitStack() as stack:
        folder = stack.enter_context(locked_cache_folder(f"{fingerprint}.blocks"))
        if folder is None:
            log.info("no folder to keep work in, or another process does the same; if stopped, it starts again")
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="slepian_prt-")))
        yield Journal(folder)
