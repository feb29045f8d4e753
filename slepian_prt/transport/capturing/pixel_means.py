"""Means over the paths of all pixels, on disk: passes add to them block by block, and work that is killed goes on."""

from __future__ import annotations

import contextlib
import errno
import logging
import math
import mmap
import os
import struct
import tempfile
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slepian_prt.cache_folder import locked_cache_file, note_kept
from slepian_prt.errors import UserError
from slepian_prt.sphere.harmonics import num_coefficients

log = logging.getLogger(__name__)

SUFFIX = ".capture"


class BlockMeans(NamedTuple):
    """What paths bring to n pixels, divided by their number.

    Attributes
    ----------
    vectors : (n, 3, (L+1)²) float32
    background : (n, 3) float32
        As of `Film`.
    moments : (n, 3) float32
        Mean square of the throughput of paths.
    rays : (n,) float32
        Segments traced for each pixel in a pass.
    """

    vectors: NDArray[np.float32]
    background: NDArray[np.float32]
    moments: NDArray[np.float32]
    rays: NDArray[np.float32]


class PixelMeans:
    """Means over passes: of the vectors, of their squares in each degree, of the background.

    Two copies take turns: a block is written to the one that its last finished pass is not in, and only then counted,
    with a checksum of what was written, so that what is there when a process is killed is always whole. A block whose
    checksums are all others, because the disk or somebody changed it, is traced again.

    Parameters
    ----------
    file : binary file
        Of this capture alone, read and written; empty, or as it was left.
    pixels, per_block, bandlimit : int
    """

    def __init__(self, file: IO[bytes], pixels: int, per_block: int, bandlimit: int) -> None:
        self.bandlimit, self._pixels, self._per_block = bandlimit, pixels, per_block
        self.blocks = -(-pixels // per_block)
        size, bands = num_coefficients(bandlimit), bandlimit + 1
        shapes = ((2, self.blocks, 3), (2, pixels, 3, size), (2, pixels, 3, bands), (2, pixels, 7))
        begins = np.concatenate([[0], np.cumsum([_padded(4 * math.prod(shape)) for shape in shapes])])
        _allocate(file, int(begins[-1]))
        kinds = (np.uint32, np.float32, np.float32, np.float32)
        tables: list[NDArray[Any]] = [
            np.memmap(file, kind, "r+", int(begin), shape)
            for kind, begin, shape in zip(kinds, begins, shapes, strict=False)
        ]
        # Of both copies of a block: its passes, the checksum of its numbers, and that of these and the block's own.
        self._heads, self._vectors, self._squares, self._others = tables
        self._done = np.array([self._find(block) for block in range(self.blocks)], dtype=np.int64)
        lost = int(np.sum((self._done == 0) & self._heads.any(axis=(0, 2))))
        if lost:
            log.warning("%s: %d of %d blocks of pixels are damaged and are traced again", file.name, lost, self.blocks)

    def passes(self, block: int) -> int:
        """How many passes a block has."""
        return int(self._done[block])

    def pixels(self, block: int) -> NDArray[np.int64]:
        """The pixels of a block."""
        rows = self._rows(block)
        return np.arange(rows.start, rows.stop)

    def add(self, block: int, means: BlockMeans) -> None:
        """Let one more pass count for a block; the arrays of ``means`` are used up."""
        done, rows = self.passes(block), self._rows(block)
        others = np.concatenate([means.background, means.moments, means.rays[:, None]], axis=1)
        squares = self._by_degree(means.vectors)
        for table, new in ((self._vectors, means.vectors), (self._squares, squares), (self._others, others)):
            if done:
                before = table[(done - 1) % 2, rows]
                new -= before
                new *= np.float32(1.0 / (done + 1))
                np.add(before, new, out=table[done % 2, rows])
            else:
                table[0, rows] = new
        self._heads[done % 2, block] = self._head(done + 1, block)
        self._done[block] = done + 1

    def _find(self, block: int) -> int:
        """How many passes a block has on disk that are as they were written."""
        found = 0
        for copy in range(2):
            done = int(self._heads[copy, block, 0])
            fits = done > found and (done - 1) % 2 == copy
            if fits and np.array_equal(self._heads[copy, block], self._head(done, block)):
                found = done
        return found

    def _head(self, done: int, block: int) -> NDArray[np.uint32]:
        """What says that a block has so many passes, from what there is of them."""
        rows, checksum = self._rows(block), 0
        for table in (self._vectors, self._squares, self._others):
            checksum = zlib.crc32(np.ascontiguousarray(table[(done - 1) % 2, rows]).data, checksum)
        own = zlib.crc32(struct.pack("<4Q", done, block, self._pixels, self.bandlimit), checksum)
        return np.array([done, checksum, own], dtype=np.uint32)

    def means(self, block: int) -> tuple[BlockMeans, NDArray[np.float32]]:
        """Means over all passes of a block, and the variance of a coefficient of each degree (n, 3, L+1).

        The variance is that of the mean of P passes, unbiased, from how much they differ; zero of one pass, which does
        not tell it.
        """
        done, rows = self.passes(block), self._rows(block)
        vectors, squares, others = (
            table[(done - 1) % 2, rows] for table in (self._vectors, self._squares, self._others)
        )
        spread = np.maximum(squares - self._by_degree(vectors), 0.0) if done > 1 else np.zeros_like(squares)
        counts = 2.0 * np.arange(self.bandlimit + 1) + 1.0
        variance = (spread / (max(done - 1, 1) * counts)).astype(np.float32)
        return BlockMeans(vectors, others[:, :3], others[:, 3:6], others[:, 6]), variance

    def vectors(self) -> NDArray[np.float32]:
        """(V, 3, (L+1)²) means of all pixels, which have as many passes each, where they are on disk."""
        return np.asarray(self._vectors[(self.passes(0) - 1) % 2])

    def _rows(self, block: int) -> slice:
        return slice(block * self._per_block, min((block + 1) * self._per_block, self._pixels))

    def _by_degree(self, vectors: NDArray[np.float32]) -> NDArray[np.float32]:
        """(n, 3, L+1) sums of squares over the orders of each degree."""
        return np.asarray(np.add.reduceat(np.square(vectors), np.arange(self.bandlimit + 1) ** 2, axis=2))


def _allocate(file: IO[bytes], size: int) -> None:
    """Make a file so long, on a disk that has the space: one that is full later on would end the process."""
    before = os.fstat(file.fileno())
    try:
        if hasattr(os, "posix_fallocate"):
            disk = os.fstatvfs(file.fileno())
            # Asked before: what does not fit would fill the disk before it fails.
            if size - 512 * before.st_blocks > disk.f_bavail * disk.f_frsize:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            os.posix_fallocate(file.fileno(), 0, size)
        file.truncate(size)
    except OSError as error:
        with contextlib.suppress(OSError):
            file.truncate(before.st_size)
        raise UserError(
            f"{file.name}: cannot be written ({error.strerror or error}), and takes {size / 1e9:.1f} GB; free some "
            "space, capture fewer pixels or a lower `bandlimit`, or set SLEPIAN_PRT_CACHE to a folder on another disk"
        ) from None


def _padded(size: int) -> int:
    """Bytes up to where something else can be mapped."""
    return -(-size // mmap.ALLOCATIONGRANULARITY) * mmap.ALLOCATIONGRANULARITY


@contextlib.contextmanager
def kept_means(fingerprint: str, pixels: int, per_block: int, bandlimit: int) -> Iterator[PixelMeans]:
    """Means in the cache folder, gone when the with-block ends well, and there for the same capture when it does not.

    Without a folder that can be written, or while another process captures the same, they are in a temporary file.
    """
    file = locked_cache_file(f"{fingerprint}{SUFFIX}")
    if file is None:
        log.info("no folder to keep finished work in, or another process does the same; if stopped, it starts again")
        with tempfile.TemporaryFile(prefix="slepian_prt-") as temporary:
            yield PixelMeans(temporary, pixels, per_block, bandlimit)
        return
    with file:
        path = Path(file.name)
        with path.open("r+b") as both:  # what is opened to append cannot be mapped for writing
            means = PixelMeans(both, pixels, per_block, bandlimit)
            try:
                yield means
            except BaseException:
                if any(means.passes(block) for block in range(means.blocks)):
                    note_kept()
                raise
        with contextlib.suppress(OSError):
            path.unlink()
