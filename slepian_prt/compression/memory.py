"""How much memory coding takes, told before the work begins."""

from __future__ import annotations

from typing import TYPE_CHECKING

from slepian_prt.compression.projection import Projection
from slepian_prt.machine.memory import check_estimate, held_memory
from slepian_prt.sphere.harmonics import num_coefficients
from slepian_prt.transport.memory import estimate_transfer

if TYPE_CHECKING:
    from slepian_prt.compression.settings import CompressionSettings
    from slepian_prt.transport.planned import PlannedScene
    from slepian_prt.transport.transfer import Transfer

_MIB = 1 << 20

# Measured at 33,000 to 50,000 vertices and bandlimits 10 and 20, beside what tracing takes: the coder, and all that is
# made of each byte of coefficients.
_BASE = 100 * _MIB
_COPIES = 7.8

# How many functions there will be is not known before a pilot: at usual tolerances a third of all harmonics to half.
_SHARE = 0.33

# Part of what is estimated of coding that is needed in any case: before the number of functions is known, and after.
# Blocks are let go as they are coded.
_LEAST_BEFORE, _LEAST = 0.25, 0.5

_REMEDY = "raise `tolerance`, lower `bandlimit` or give a mesh of fewer vertices"


def check_coding_memory(projection: Projection, beside: int) -> None:
    """Raise UserError for coefficients that clearly cannot be coded in the memory that is allowed.

    Parameters
    ----------
    projection : Projection
    beside : int
        Bytes of all else.
    """
    learned = projection.learned
    sizes = learned.clusters.sizes
    numbers = sum(basis.count * int(size) for basis, size in zip(projection.bases, sizes, strict=True))
    coding = _BASE + _COPIES * 4 * numbers * learned.channels
    _check(beside, coding, _LEAST, int(sizes.sum()), learned.bandlimit)


def check_scene_memory(planned: PlannedScene, settings: CompressionSettings) -> None:
    """Raise UserError for vectors that are held all at once and clearly cannot be compressed, before they are traced.

    Parameters
    ----------
    planned : PlannedScene
        Of `needs_all_vectors` or without `by_blocks`.
    settings : CompressionSettings
    """
    count, plan = len(planned.scene.receivers), planned.plan
    channels = 3 if plan.view is not None else plan.channels
    coding = _usual(settings, count, channels, planned.settings.bandlimit)
    _check(estimate_transfer(planned), coding, _LEAST_BEFORE, count, planned.settings.bandlimit)


def check_vectors_memory(transfer: Transfer, settings: CompressionSettings) -> None:
    """The same of vectors that are there."""
    count, channels, _ = transfer.vectors.shape
    _check(
        held_memory(), _usual(settings, count, channels, transfer.bandlimit), _LEAST_BEFORE, count, transfer.bandlimit
    )


def _usual(settings: CompressionSettings, count: int, channels: int, bandlimit: int) -> float:
    """Bytes that compression takes with as many functions as are asked for, or usual."""
    size = num_coefficients(bandlimit)
    functions = size if settings.basis == "none" else settings.terms or _SHARE * size
    return _BASE + _COPIES * 4 * count * channels * min(functions, size)


def _check(beside: float, coding: float, sure: float, count: int, bandlimit: int) -> None:
    work = f"compressing {count} vertices at bandlimit {bandlimit}"
    check_estimate(beside + coding, work, _REMEDY, least=0.8 * beside + sure * coding)
