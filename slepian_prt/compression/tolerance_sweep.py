"""The same transfer compressed with several tolerances, sharing all that can be shared."""

from __future__ import annotations

import time
from dataclasses import replace

from slepian_prt.compression.checkpoint import MemoryStore
from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.compression.encoder import Encoder, WarmStart
from slepian_prt.compression.grouping import Grouping
from slepian_prt.compression.settings import CompressionSettings
from slepian_prt.compression.stream import compress, finished, projected
from slepian_prt.transport.transfer import Transfer


class ToleranceSweep:
    """One basis and grouping on the vectors of one transfer.

    Bases are learnt once, vectors projected once for the finest tolerance, if it comes first, and every coding may
    start from the step of another that is much the same.

    Parameters
    ----------
    transfer : Transfer
    settings : CompressionSettings
        All but the tolerance.
    grouping : Grouping
    """

    def __init__(self, transfer: Transfer, settings: CompressionSettings, grouping: Grouping) -> None:
        self._transfer, self._settings, self._grouping = transfer, settings, grouping
        self._work: Encoder | None = None
        self._finest: tuple[Encoder, MemoryStore] | None = None

    def compressed(self, tolerance: float, start: WarmStart | None = None) -> CompressedTransfer:
        """With one tolerance; ``seconds`` holds what it took apart from what others had done.

        Parameters
        ----------
        tolerance : float
        start : WarmStart, optional
            Of the same tolerance on much the same vectors: tried first. Faster, and as small within a few per cent.
        """
        transfer, settings = self._transfer, replace(self._settings, tolerance=tolerance)
        if settings.needs_all_vectors or settings.codes != "coded":
            return compress(transfer, **{**vars(settings), "clusters": self._grouping})
        started = time.perf_counter()
        if self._work is None:
            self._work = Encoder(
                settings,
                transfer.mesh,
                self._grouping,
                transfer.bandlimit,
                transfer.seed,
                toward_view=transfer.toward_view,
            )
            self._work.learn(lambda vertices: transfer.vectors[vertices])
        work = self._work.asked(tolerance)
        work.start, work.keeps = start, True
        store = None if self._finest is None else work.narrowed(*self._finest)
        while store is not None and work.widened(store, {}):
            store = None if self._finest is None else work.narrowed(*self._finest)
        if store is None:
            store = projected(transfer, work)
            self._finest = work, store
        return finished(transfer, work, store, started)
