"""Python's garbage, beside threads of Dask: objects of Mitsuba are freed by the thread that works with Mitsuba.

Python collects cycles in whatever thread allocates next. If that is Dask's, what frees an object of Mitsuba waits there
for a lock of Dr.Jit, whose holder waits for the interpreter: for ever.
"""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager

from slepian_prt.signals import interrupts_held


@contextmanager
def collected_by_this_thread(*, whole: bool = False) -> Iterator[None]:
    """Within the block no other thread collects garbage; this one does when it ends, and by `collect_young`.

    Of what was there before only if the ``whole`` is wanted: to look through it takes a tenth of a second.
    """
    if not gc.isenabled():  # by a block around this one, or by the user
        yield
        return
    gc.disable()
    gc.freeze()
    try:
        yield
    finally:
        with interrupts_held():
            if whole:
                gc.unfreeze()
            gc.collect()
            gc.unfreeze()
            gc.enable()


def collect_young() -> None:
    """Collect what has become garbage lately."""
    _collect(1)


def collect_whole() -> None:
    """Collect all that is garbage, also of before a block began."""
    gc.unfreeze()
    _collect(2)


def _collect(generation: int) -> None:
    """Dask has the collector call it before and after, where Python would swallow an interrupt."""
    with interrupts_held():
        gc.collect(generation)
