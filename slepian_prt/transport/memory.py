"""How much memory transport takes, told before the work begins."""

from __future__ import annotations

from typing import TYPE_CHECKING

from slepian_prt.machine.memory import check_estimate, limit_given
from slepian_prt.sphere.harmonics import num_coefficients

if TYPE_CHECKING:
    from slepian_prt.transport.planned import PlannedScene

_MIB = 1 << 20

# Measured, in processes of their own, at 10,000 to 50,000 vertices and bandlimits 3 to 50:
# Python with Mitsuba and SciPy, a vertex with its mesh and the tracer's tree, one with the weights of those it sees,
# blocks that are traced, projected and waited for in float32s of their vectors, tables for each coefficient, and paths
# in flight.
_BASE = 205 * _MIB
_VERTEX = 600
_SEEN = 1500
_WAITING = 7
_TABLES = 3 * _MIB // 20
_PATHS = 200 * _MIB

REMEDY = "lower `bandlimit` or give a mesh of fewer vertices"

# Numbers of a block's vectors at most, and the limit from which on blocks are smaller than that.
NUMBERS_PER_BLOCK = 1 << 22
_WHOLE_BLOCKS = 1 << 30
_SMALLEST_PART = 32


def part_of_blocks() -> int:
    """1 for whole blocks, or a power of two: so many times smaller are they where little memory is allowed."""
    limit, part = limit_given(), 1
    while limit is not None and limit * part < _WHOLE_BLOCKS and part < _SMALLEST_PART:
        part *= 2
    return part


def estimate_tracing(planned: PlannedScene, bandlimit: int | None = None) -> int:
    """Bytes of a process that traces block after block and holds no vectors; of another bandlimit, if given."""
    count, size = len(planned.scene.receivers), _size(planned, bandlimit)
    waiting = 4 * _WAITING * min(count * size, NUMBERS_PER_BLOCK) // part_of_blocks()
    paths = 0 if planned.plan.paths is None else _PATHS // part_of_blocks()
    return _BASE + count * _VERTEX + size * _TABLES + waiting + paths


def _size(planned: PlannedScene, bandlimit: int | None) -> int:
    return num_coefficients(planned.settings.bandlimit if bandlimit is None else bandlimit)


def estimate_transfer(planned: PlannedScene, bandlimit: int | None = None) -> int:
    """Bytes of a process that holds all vectors; of another bandlimit, if given."""
    count, size, plan = len(planned.scene.receivers), _size(planned, bandlimit), planned.plan
    vectors = 4 * count * size
    bounced = plan.interreflection or plan.paths is not None
    channels = 3 if plan.view is not None else plan.channels
    held = vectors * channels + (vectors if bounced and channels == 3 else 0)
    return estimate_tracing(planned, bandlimit) + held + (count * _SEEN if bounced else 0)


def check_transfer_memory(planned: PlannedScene) -> None:
    """Raise UserError for vectors that clearly do not fit in the memory that is allowed."""
    bandlimit, count = planned.settings.bandlimit, len(planned.scene.receivers)
    check_estimate(
        estimate_transfer(planned),
        f"transfer of {count} vertices at bandlimit {bandlimit}, held all at once,",
        REMEDY,
    )
