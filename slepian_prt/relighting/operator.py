"""The matrix that lighting is multiplied with, of a compressed transfer."""

from __future__ import annotations

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.compression.operator import TransferOperator


def transfer_operator(packed: CompressedTransfer) -> TransferOperator:
    """Radiance for unit albedo as a linear operator on lighting; made at the first use of a transfer, then kept."""
    return packed.operator
