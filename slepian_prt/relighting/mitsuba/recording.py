"""Recording a kernel of Dr.Jit's while the objects that it may call stay the same."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Lock

_lock = Lock()
_recordings = 0  # that are under way
_collects = False  # whether Python collected garbage before the first of them


@contextmanager
def without_collection() -> Iterator[None]:
    """Within the block Python collects no garbage, in which there may be scenes.

    A call of a method of materials, emitters or shapes is recorded for all that there are in the process. Where there
    was one for one call and are several for another, of the same kernel, Dr.Jit (1.5.0) gives two functions one name,
    LLVM reports an "invalid redefinition of function", and the process is aborted. A scene that refers to itself is
    let go by Python's collector, which may come in the middle of a recording.
    """
    global _recordings, _collects
    with _lock:
        if _recordings == 0:
            _collects = gc.isenabled()
            gc.disable()
        _recordings += 1
    try:
        yield
    finally:
        with _lock:
            _recordings -= 1
            if _recordings == 0 and _collects:
                gc.enable()
