"""The same transfer compressed with several numbers of functions: bases are learnt once, which takes longest."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import replace

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.compression.grouping import Grouping, regroup
from slepian_prt.compression.settings import CompressionSettings
from slepian_prt.compression.stored_mesh.transfers import as_stored
from slepian_prt.compression.stream import encode_transfer, learn_from, project_transfer
from slepian_prt.transport.transfer import Transfer


def compress_to_terms(
    transfer: Transfer, settings: CompressionSettings, grouping: Grouping, terms: Sequence[int]
) -> Iterator[CompressedTransfer]:
    """What `compress` makes of each number of terms, one after another.

    The time that bases took counts in the ``seconds`` of each, as if it stood alone.

    Parameters
    ----------
    transfer : Transfer
    settings : CompressionSettings
        All but the number of terms; of a basis whose clusters do not depend on it, so not of ``cpca``.
    grouping : Grouping
    terms : sequence of int

    Raises
    ------
    UserError
        A number that the bandlimit does not have.
    """
    if settings.basis == "cpca":
        raise ValueError("clusters of cpca depend on the number of terms")
    seen = as_stored(transfer, exact=settings.exact_mesh)
    grouping = regroup(grouping, seen)
    learned, learning = None, 0.0
    for k in terms:
        of_k = replace(settings, terms=k)
        of_k.check(transfer.bandlimit)
        begin = time.perf_counter()
        if learned is None:
            learned = learn_from(seen, of_k, grouping)
            learning = time.perf_counter() - begin
            begin += learning
        projected = project_transfer(transfer, replace(learned, settings=of_k))
        yield encode_transfer(transfer, projected, begin - learning)
