"""Forked processes, in which the threads that Mitsuba waits for are missing."""

from __future__ import annotations

import os
import sys

from slepian_prt.errors import UserError

_forked = False


def check_not_forked() -> None:
    """Raise UserError in a process that was forked from one in which Mitsuba was loaded: there it waits for ever."""
    if _forked:
        raise UserError(
            "Mitsuba must be started anew, and waits for ever in a process that was forked from one that has imported "
            "it: start processes with the method 'spawn' (multiprocessing.get_context('spawn')), or fork before that"
        )


def _after_fork() -> None:
    global _forked
    _forked = "drjit" in sys.modules


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)
