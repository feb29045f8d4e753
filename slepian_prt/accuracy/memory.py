"""How much memory the search for a goal takes, told before its pilot begins."""

from __future__ import annotations

from slepian_prt.accuracy.goal import Goal
from slepian_prt.machine.memory import check_estimate
from slepian_prt.transport.memory import REMEDY, estimate_tracing, estimate_transfer
from slepian_prt.transport.planned import PlannedScene

_MIB = 1 << 20

# Bandlimits that a search looks at under light as sharp as that of rooms and suns, and those that soft light ends with.
_USUAL, _SOFT = 20, 4

# Tables and vectors of candidates beside each other: 50,000 vertices under a studio took 1,150 MiB in all.
_CANDIDATES = 700 * _MIB


def check_pilot_memory(planned: PlannedScene, goal: Goal) -> None:
    """Raise UserError where not even the candidates of a low bandlimit fit in the memory that is allowed.

    Parameters
    ----------
    planned : PlannedScene
    goal : Goal
        The bandlimit that it gives counts; others are found by the search, which soft light ends early.
    """
    estimate = estimate_tracing if planned.by_blocks else estimate_transfer
    usual, soft = (
        estimate(planned, bandlimit if goal.bandlimit is None else goal.bandlimit) for bandlimit in (_USUAL, _SOFT)
    )
    count = len(planned.scene.receivers)
    check_estimate(usual + _CANDIDATES, f"the search for a goal, of {count} vertices,", REMEDY, least=0.8 * soft)
