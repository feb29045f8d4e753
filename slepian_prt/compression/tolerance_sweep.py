"""The same transfer compressed with several tolerances, sharing all that can be shared."""

from __future__ import annotations

import time
from dataclasses import replace

from slepian_prt.compression.blocks import CapBlocks
from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.compression.encoder import WarmStart
from slepian_prt.compression.grouping import Grouping
from slepian_prt.compression.learning import LearnedBases, learn_bases, pilot_of
from slepian_prt.compression.noise import coded_within_noise
from slepian_prt.compression.projection import choose_projection, narrow, widen
from slepian_prt.compression.settings import CompressionSettings
from slepian_prt.compression.stored_mesh.transfers import as_stored
from slepian_prt.compression.stream import compress, encode_transfer, project_transfer
from slepian_prt.compression.tracing import Projected
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
        self._learned: LearnedBases | None = None
        self._finest: Projected | None = None

    def compress(self, tolerance: float, warm_start: WarmStart | None = None) -> CompressedTransfer:
        """With one tolerance; ``seconds`` holds what it took apart from what others had done.

        Parameters
        ----------
        tolerance : float
        warm_start : WarmStart, optional
            Of the same tolerance on much the same vectors: tried first. Faster, and as small within a few per cent.
        """
        transfer, settings = self._transfer, replace(self._settings, tolerance=tolerance)
        if settings.needs_all_vectors or settings.resolved_coding != "coded":
            return compress(transfer, **{**vars(settings), "clusters": self._grouping})
        started = time.perf_counter()
        projected = self._project(coded_within_noise(settings, transfer))
        return encode_transfer(transfer, projected, started, warm_start=warm_start, keep_decoded=True)

    def _project(self, settings: CompressionSettings) -> Projected:
        transfer, grouping = self._transfer, self._grouping
        if self._learned is None:
            vectors = transfer.vectors[pilot_of(grouping, transfer.seed)]
            self._learned = learn_bases(
                settings,
                as_stored(transfer, exact=settings.exact_mesh).mesh.receivers,
                grouping,
                transfer.bandlimit,
                transfer.seed,
                vectors,
                toward_view=transfer.toward_view,
            )
        learned = self._learned.with_tolerance(settings.resolved_tolerance)
        return self._narrowed(learned) or self._project_anew(learned)

    def _narrowed(self, learned: LearnedBases) -> Projected | None:
        """From what was projected for a finer tolerance, if there is such."""
        finest = self._finest
        projection = None if finest is None else choose_projection(learned)
        while finest is not None and projection is not None:
            assert isinstance(finest.blocks, CapBlocks)  # of vectors that are here
            found = narrow(finest.projection, finest.blocks.store, projection)
            if found is None:
                return None
            projected = Projected(found[0], found[0].caps(found[1]))
            projection = widen(projected.projection, projected.blocks)
            if projection is None:
                return projected
        return None

    def _project_anew(self, learned: LearnedBases) -> Projected:
        self._finest = project_transfer(self._transfer, learned)
        return self._finest
