"""Blocks of transfer vectors from workers."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.transport.by_workers.scene import Asked, OpenScene, RemoteScene
from slepian_prt.transport.estimator import Estimator, TransferBlock
from slepian_prt.transport.planned import PlannedScene


def _estimator(planned: PlannedScene) -> Estimator[Any]:
    return planned.estimator()


def _block(scene: OpenScene, item: tuple[Asked | None, NDArray[np.int64]]) -> TransferBlock:
    asked, vertices = item
    source = scene.tool(asked, _estimator)
    return source.project(source.trace(vertices))


class RemoteEstimator(Estimator[TransferBlock]):
    """An estimator whose blocks are traced and projected by workers.

    Parameters
    ----------
    here : Estimator
        The same in this process, which says what the blocks are.
    remote : RemoteScene
    """

    def __init__(self, here: Estimator[Any], remote: RemoteScene) -> None:
        self._here, self._remote, self._rays = here, remote, 0
        self.scene, self.bandlimit = here.scene, here.bandlimit

    @property
    def channels(self) -> int:
        """Of the vectors."""
        return self._here.channels

    @property
    def axes(self) -> NDArray[np.float64]:
        """(V, 3) what transport is concentrated about."""
        return self._here.axes

    @property
    def rays(self) -> int:
        """Number traced so far."""
        return self._rays

    @property
    def block_size(self) -> int:
        """Receivers that are traced at a time."""
        return self._here.block_size

    def pieces(self, receivers: NDArray[np.int64] | None = None) -> list[NDArray[np.int64]]:
        """All receivers, or some, in pieces of about as much work each."""
        return self._here.pieces(receivers)

    def trace(self, vertices: NDArray) -> TransferBlock:
        """Transfer of some receivers, by a worker."""
        (block,) = self.blocks([vertices])
        return block

    def project(self, samples: TransferBlock) -> TransferBlock:
        """What was traced: it is projected already."""
        return samples

    def blocks(self, pieces: Iterable[NDArray], finish: Callable[[TransferBlock], Any] = lambda block: block) -> Any:
        """As of `Estimator`; ``finish`` is called here."""
        for block in self._remote.in_order(self._remote.submit(_block, list(pieces))):
            self._rays += block.rays
            yield finish(block)
