"""Sums over the paths of all pixels, on disk: passes add to them block by block, and work that is killed goes on."""

from __future__ import annotations

import contextlib
import logging
import mmap
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import IO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError
from slepian_prt.files import locked_cache_file
from slepian_prt.sphere.harmonics import degrees, num_coefficients

log = logging.getLogger(__name__)

SUFFIX = ".capture"


class BlockSums(NamedTuple):
    """What the paths of one pass bring to n pixels, divided by their number.

    Attributes
    ----------
    vectors : (n, 3, (L+1)²) float32
    background : (n, 3) float32
        As of `Film`.
    rays : (n,) float32
        Segments traced for each pixel.
    """

    vectors: NDArray[np.float32]
    background: NDArray[np.float32]
    rays: NDArray[np.float32]


class PixelSums:
    """Sums over passes: of the vectors, of their squares in each degree, of the background.

    Two copies take turns: a block is written to the one that its last finished pass is not in, and only then counted,
    so that what is there when a process is killed is always whole.

    Parameters
    ----------
    file : binary file
        Of this capture alone, read and written; empty, or as it was left.
    pixels, per_block, bandlimit : int
    """

    def __init__(self, file: IO[bytes], pixels: int, per_block: int, bandlimit: int) -> None:
        self.bandlimit, self._pixels, self._per_block = bandlimit, pixels, per_block
        self._file, self.blocks = file, -(-pixels // per_block)
        self._width = 3 * num_coefficients(bandlimit) + 3 * (bandlimit + 1) + 4
        head = -(-4 * self.blocks // mmap.PAGESIZE) * mmap.PAGESIZE
        try:
            file.truncate(head + 2 * 4 * pixels * self._width)
        except OSError as error:
            raise UserError(
                f"{file.name}: cannot be written ({error.strerror or error}); free some space, or set "
                "SLEPIAN_PRT_CACHE to a folder on another disk"
            ) from None
        self._done = np.memmap(file, np.uint32, "r+", 0, (self.blocks,))
        self._rows = np.memmap(file, np.float32, "r+", head, (2, pixels, self._width))

    def passes(self, block: int) -> int:
        """How many passes a block has."""
        return int(self._done[block])

    def pixels(self, block: int) -> NDArray[np.int64]:
        """The pixels of a block."""
        return np.arange(block * self._per_block, min((block + 1) * self._per_block, self._pixels))

    def add(self, block: int, means: BlockSums) -> None:
        """Add one more pass to a block."""
        done, rows = self.passes(block), slice(int(self.pixels(block)[0]), int(self.pixels(block)[-1]) + 1)
        count, size = len(means.vectors), num_coefficients(self.bandlimit)
        squares = np.add.reduceat(means.vectors**2, np.arange(self.bandlimit + 1) ** 2, axis=2)
        parts = (
            means.vectors.reshape(count, 3 * size),
            squares.reshape(count, -1),
            means.background,
            means.rays[:, None],
        )
        new = np.concatenate(parts, axis=1)
        if done:
            new += self._rows[(done - 1) % 2, rows]
        self._rows[done % 2, rows] = new
        self._done[block] = done + 1

    def means(self, block: int) -> tuple[BlockSums, NDArray[np.float32]]:
        """Means over all passes of a block, and the variance of a coefficient of each degree (n, 3, L+1).

        The variance is that of the mean of P passes, unbiased, from how much they differ; zero of one pass, which does
        not tell it.
        """
        done, chosen = self.passes(block), self.pixels(block)
        rows = np.array(self._rows[(done - 1) % 2, chosen[0] : chosen[-1] + 1]) / np.float32(done)
        size, bands = num_coefficients(self.bandlimit), self.bandlimit + 1
        vectors = np.ascontiguousarray(rows[:, : 3 * size]).reshape(-1, 3, size)
        squares = rows[:, 3 * size : 3 * (size + bands)].reshape(-1, 3, bands)
        of_mean = np.add.reduceat(vectors**2, np.arange(bands) ** 2, axis=2)
        counts = np.bincount(degrees(self.bandlimit))
        variance = np.maximum(squares - of_mean, 0.0) / np.float32(max(done - 1, 1)) / counts.astype(np.float32)
        if done < 2:
            variance[:] = 0.0
        background = rows[:, 3 * (size + bands) : -1]
        return BlockSums(vectors, np.ascontiguousarray(background), rows[:, -1] * np.float32(done)), variance


@contextlib.contextmanager
def kept_sums(fingerprint: str, pixels: int, per_block: int, bandlimit: int) -> Iterator[PixelSums]:
    """Sums in the cache folder, gone when the with-block ends well, and there for the same capture when it does not.

    Without a folder that can be written, or while another process captures the same, they are in a temporary file.
    """
    file = locked_cache_file(f"{fingerprint}{SUFFIX}")
    if file is None:
        log.info("no folder to keep finished work in, or another process does the same; if stopped, it starts again")
        with tempfile.TemporaryFile(prefix="slepian_prt-") as temporary:
            yield PixelSums(temporary, pixels, per_block, bandlimit)
        return
    with file:
        path = Path(file.name)
        with path.open("r+b") as both:  # what is opened to append cannot be mapped for writing
            yield PixelSums(both, pixels, per_block, bandlimit)
        with contextlib.suppress(OSError):
            path.unlink()
