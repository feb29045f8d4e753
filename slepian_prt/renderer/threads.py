"""Threads of Mitsuba's pool."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def two_threads() -> Iterator[None]:
    """At least two threads while a file may be read or written: with one, Mitsuba waits for ever at an EXR file.

    Its reader gives the lines of the picture to a pool in which nobody but itself is left, as on a machine with one
    core or in one of several workers (Mitsuba 3.9.1, ``EXRThreadPool``).
    """
    import drjit as dr

    if (before := dr.thread_count()) > 1:
        yield
        return
    dr.set_thread_count(2)
    try:
        yield
    finally:
        dr.set_thread_count(before)
