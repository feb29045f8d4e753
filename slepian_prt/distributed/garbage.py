"""Python's garbage, beside threads of Dask: objects of Mitsuba are freed by the thread that works with Mitsuba.

Python collects cycles in whatever thread allocates next. If that is Dask's, what frees an object of Mitsuba waits there
for a lock of Dr.Jit, whose holder waits for the interpreter: for ever.
"""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def collected_by_this_thread() -> Iterator[None]:
    """Within the block no other thread collects garbage; this one does when it ends, and by `collect_young`.

    What is there already is left out (`gc.freeze`), so that this takes little time.
    """
    if not gc.isenabled():  # by a block around this one, or by the user
        yield
        return
    gc.disable()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()
        _collect(2)
        gc.enable()


def collect_young() -> None:
    """Collect what has become garbage lately."""
    _collect(1)


def _collect(generation: int) -> None:
    """Without what Dask has called before and after: an interrupt that comes meanwhile would be lost in it."""
    callbacks = gc.callbacks[:]
    gc.callbacks.clear()
    try:
        gc.collect(generation)
    finally:
        gc.callbacks[:] = callbacks
