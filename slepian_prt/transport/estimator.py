"""What estimators of transport have in common: blocks of vectors, traced in one thread and finished in another.

Rays keep all cores busy but for the gaps between kernels, in which NumPy and BLAS finish the blocks before.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, Generic, TypeVar, overload

import numpy as np
from numpy.typing import NDArray

from slepian_prt.machine.threads import one_blas_thread
from slepian_prt.scene.receivers import morton
from slepian_prt.scene.scene import Scene
from slepian_prt.sphere.harmonics import num_coefficients
from slepian_prt.transport.memory import NUMBERS_PER_BLOCK, part_of_blocks

# Blocks that may wait to be finished.
_BLOCKS_WAITING = 3

# Receivers of a block if none of them is traced.
_UNTRACED_PER_BLOCK = 8192

Item = TypeVar("Item")
Samples = TypeVar("Samples")
Result = TypeVar("Result")


@dataclass(frozen=True, eq=False)
class TransferBlock:
    """Transfer of some receivers.

    Attributes
    ----------
    vertices : (n,) int64
        Which receivers.
    vectors : (n, channels, (L+1)²) float32
        Real SH coefficients of their transfer functions.
    blocked : (n,) float32
        Part of each hemisphere, cosine-weighted, that shows no sky: exactly one where none of it is seen. Zero from
        estimators that do not know it.
    rays : int
        Traced for it.
    """

    vertices: NDArray[np.int64]
    vectors: NDArray[np.float32]
    blocked: NDArray[np.float32]
    rays: int


class Estimator(ABC, Generic[Samples]):
    """Fills blocks of transfer vectors for receivers: traces rays from a block, and projects what they found.

    Attributes
    ----------
    scene : Scene
    bandlimit : int
    """

    scene: Scene
    bandlimit: int

    @property
    @abstractmethod
    def channels(self) -> int:
        """Of the vectors."""

    @property
    @abstractmethod
    def axes(self) -> NDArray[np.float64]:
        """(V, 3) what transport is concentrated about; zero at receivers without any."""

    @property
    @abstractmethod
    def rays(self) -> int:
        """Number traced so far."""

    @property
    @abstractmethod
    def block_size(self) -> int:
        """Receivers that are traced at a time."""

    @abstractmethod
    def pieces(self, receivers: NDArray[np.int64] | None = None) -> list[NDArray[np.int64]]:
        """All receivers, or some, in pieces of about as much work each; see `cut_pieces`."""

    @abstractmethod
    def trace(self, vertices: NDArray) -> Samples:
        """Trace rays from some receivers; in the thread that Mitsuba was started in."""

    @abstractmethod
    def project(self, samples: Samples) -> TransferBlock:
        """Transfer vectors from what was traced, in any thread."""

    @overload
    def blocks(self, pieces: Iterable[NDArray]) -> Iterator[TransferBlock]: ...
    @overload
    def blocks(self, pieces: Iterable[NDArray], finish: Callable[[TransferBlock], Result]) -> Iterator[Result]: ...
    def blocks(self, pieces: Iterable[NDArray], finish: Callable[[TransferBlock], Any] = lambda block: block) -> Any:
        """Piece after piece of receivers, traced and projected; the next is traced while the last are projected.

        Parameters
        ----------
        pieces : iterable of (n,) indices of receivers
            All of `pieces`, or others.
        finish : callable, optional
            What to make of each block, in the thread that projects; its results are yielded then.

        Yields
        ------
        TransferBlock, or what ``finish`` makes of it; in the order of ``pieces``
        """
        if self.stays_on_device:
            return (finish(self.project(self.trace(piece))) for piece in pieces)
        return overlapped(pieces, self.trace, lambda samples: finish(self.project(samples)))

    @property
    def stays_on_device(self) -> bool:
        """Whether vectors are made where rays are traced, so that nothing would go on beside them in a thread."""
        return False

    def estimate(
        self, vertices: NDArray | None = None, advance: Callable[[int], None] = lambda _: None
    ) -> TransferBlock:
        """Transfer of some receivers, in the order given, or of all.

        Parameters
        ----------
        vertices : (n,) indices, optional
        advance : callable
            Given the number of receivers finished since its last call.
        """
        if vertices is None:
            vertices = np.arange(len(self.scene.receivers))
            rows = pieces = self.pieces()
        else:
            cuts = np.arange(self.block_size, vertices.size, self.block_size)
            rows = np.split(np.arange(vertices.size), cuts) if vertices.size else []
            pieces = [vertices[row] for row in rows]
        vectors = np.empty((vertices.size, self.channels, num_coefficients(self.bandlimit)), dtype=np.float32)
        blocked = np.empty(vertices.size, dtype=np.float32)
        rays = 0
        for row, block in zip(rows, self.blocks(pieces), strict=True):
            vectors[row], blocked[row] = block.vectors, block.blocked
            rays += block.rays
            advance(row.size)
        return TransferBlock(vertices, vectors, blocked, rays)


def overlapped(
    items: Iterable[Item], make: Callable[[Item], Samples], finish: Callable[[Samples], Result]
) -> Iterator[Result]:
    """Yield ``finish(make(item))`` of all items, in order, each finished while the next ones are made.

    ``make`` runs in the calling thread, ``finish`` in one other, and at most three results of ``make`` wait. What
    either raises is raised here. A caller that stops early drops what waits. BLAS gets one thread meanwhile, because
    those that it keeps spinning after a product would take the cores from the tracer: that alone cost a quarter of the
    time.
    """
    with one_blas_thread(), ThreadPoolExecutor(1) as worker:
        pending: deque[Future[Result]] = deque()
        try:
            for item in items:
                pending.append(worker.submit(finish, make(item)))
                while pending and (len(pending) > _BLOCKS_WAITING or pending[0].done()):
                    yield pending.popleft().result()
            while pending:
                yield pending.popleft().result()
        finally:
            for future in pending:
                future.cancel()


def receivers_per_block(rays: int, most_rays: int, numbers: int) -> int:
    """How many receivers of ``rays`` rays and ``numbers`` numbers in a transfer vector are traced together.

    Fewer where little memory is allowed.
    """
    return max(1, min(most_rays // rays, NUMBERS_PER_BLOCK // numbers) // part_of_blocks())


def cut_pieces(
    scene: Scene, traced: NDArray[np.bool_], block_size: int, receivers: NDArray[np.int64] | None = None
) -> list[NDArray[np.int64]]:
    """Receivers in pieces of about as much work; neighbours in space, which share the tracer's caches, together.

    Parameters
    ----------
    scene : Scene
    traced : (V,)
        Receivers that rays start from; the others cost little.
    block_size : int
        Of these, in a piece.
    receivers : (n,) indices, optional
        By default all.
    """
    if receivers is None:
        receivers = np.arange(len(scene.receivers))
    order = receivers[np.argsort(morton(scene.traced_positions[receivers]), kind="stable")]
    if order.size == 0:
        return []
    work = np.cumsum(np.where(traced[order], 1.0 / block_size, 1.0 / _UNTRACED_PER_BLOCK))
    cuts = np.searchsorted(work, np.arange(1, int(work[-1]) + 1), side="right")
    return [piece for piece in np.split(order, cuts) if piece.size]
