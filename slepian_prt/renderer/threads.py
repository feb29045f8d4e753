"""Threads of Mitsuba's pool."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from slepian_prt.machine.threads import THREADS, count_given, thread_count
from slepian_prt.renderer.forks import check_not_forked

# What the pool had before it was first looked at: as many as the machine shows, or what the user has set.
_first: list[int] = []


def size_pool() -> None:
    """Let Mitsuba's pool, if it is there, have the threads that work may use.

    Without a number that is given, no more than it came with.
    """
    dr = sys.modules.get("drjit")
    if dr is None:
        return
    if not _first:
        _first.append(dr.thread_count())
    wanted = thread_count() if os.environ.get(THREADS) else min(_first[0], thread_count())
    if dr.thread_count() != wanted:
        dr.set_thread_count(wanted)


def size_pool_once() -> None:
    """`size_pool` at the first use of Mitsuba, so that what the user sets later stays."""
    if not _first:
        size_pool()


@contextmanager
def threads_limited(count: int | None) -> Iterator[None]:
    """Work within the block, also of processes that it starts, uses so many threads; None changes nothing.

    Raises
    ------
    UserError
        Not a whole number from 1 to 1024.
    """
    if count is None:
        yield
        return
    try:
        with count_given(count):
            size_pool()
            yield
    finally:
        size_pool()


@contextmanager
def two_threads() -> Iterator[None]:
    """At least two threads while a file may be read or written: with one, Mitsuba waits for ever at an EXR file.

    Its reader gives the lines of the picture to a pool in which nobody but itself is left, as on a machine with one
    core or in one of several workers (Mitsuba 3.9.1, ``EXRThreadPool``).

    Raises
    ------
    UserError
        In a forked process, whose pool has no threads at all.
    """
    check_not_forked()
    import drjit as dr

    size_pool_once()
    if (before := dr.thread_count()) > 1:
        yield
        return
    dr.set_thread_count(2)
    try:
        yield
    finally:
        dr.set_thread_count(before)
