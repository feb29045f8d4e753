"""How much memory coding takes, told before the work begins."""

from __future__ import annotations

from slepian_prt.compression.projection import Projection
from slepian_prt.machine.memory import check_memory, held_memory

_MIB = 1 << 20

# Measured at 33,000 to 50,000 vertices and bandlimits 10 and 20, beside what tracing takes: the coder, and all that is
# made of each byte of coefficients.
_BASE = 100 * _MIB
_COPIES = 7.8


def check_coding_memory(projection: Projection, beside: int | None = None) -> None:
    """Raise UserError for coefficients that cannot be coded in the memory that is allowed.

    Parameters
    ----------
    projection : Projection
    beside : int, optional
        Bytes of all else; by default what the process holds now.
    """
    learned = projection.learned
    sizes = learned.clusters.sizes
    numbers = sum(basis.count * int(size) for basis, size in zip(projection.bases, sizes, strict=True))
    need = _BASE + int(_COPIES * 4 * numbers * learned.channels)
    check_memory(
        need + (held_memory() if beside is None else beside),
        f"compressing {int(sizes.sum())} vertices at bandlimit {learned.bandlimit}",
        "raise `tolerance`, lower `bandlimit` or give a mesh of fewer vertices",
    )
