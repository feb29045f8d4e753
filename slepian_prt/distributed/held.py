"""On workers: values that all tasks share, one of them opened, and the calls of functions on it."""

from __future__ import annotations

import contextlib
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from slepian_prt.distributed.garbage import collect_whole, collected_by_this_thread


@dataclass(frozen=True)
class Shared:
    """A value that workers hold, by the name under which they do."""

    name: str


class NotHeldError(Exception):
    """No worker has the value any more: those that had it died."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.name = name


# Values of this process, as they came.
_values: dict[str, Any] = {}

# The value that is open, if any: scenes are big, so that another one closes it.
_open: dict[str, tuple[Any, contextlib.ExitStack]] = {}

# Held by who uses the open value or closes it: a worker may have several threads of Dask, and a process several
# workers, whose tasks are done one after the other: threads of Mitsuba are those of the process.
_at_work = threading.Lock()

# How many threads of Mitsuba a task begins with, once that is said.
_threads: list[int] = []


def call(function: Callable[[Any, Any], Any], shared: Shared | None, item: Any) -> Any:
    """A task: the function, of the opened value and an item."""
    with _at_work, collected_by_this_thread():
        _set_threads()
        return function(None if shared is None else _opened(shared.name), item)


def keep(name: str, dask_worker: Any = None) -> None:
    """Hold a value that Dask has brought here, whatever Dask does with its own copy."""
    if name in dask_worker.data:
        _values[name] = dask_worker.data[name]


def use_threads(count: int) -> None:
    """Let tasks that begin from now on have so many threads of Mitsuba; one that runs keeps those that it has."""
    _threads[:] = [count]


async def forget(prefix: str, dask_worker: Any = None) -> None:
    """Give up the values whose names begin so; one that is open is closed by a thread of tasks, after what runs."""
    for name in _beginning(_values, prefix):
        del _values[name]
    dask_worker.executors["default"].submit(_close_after_work, prefix)


def value_of(shared: Shared) -> Any:
    """A value as it came, beside the one that is open; for tasks that have its handle among their items."""
    return _value(shared.name)


def _opened(name: str) -> Any:
    if name not in _open:
        value = _value(name)
        _close("")
        stack = contextlib.ExitStack()
        with _threads_to_load():
            opened = stack.enter_context(value.open()) if hasattr(value, "open") else value
        _open[name] = opened, stack
    return _open[name][0]


def _set_threads() -> None:
    drjit = sys.modules.get("drjit")
    if drjit is not None and _threads and drjit.thread_count() != _threads[0]:
        drjit.set_thread_count(_threads[0])


@contextlib.contextmanager
def _threads_to_load() -> Iterator[None]:
    """Two threads of Mitsuba's, where there is one: with it alone Mitsuba 3.9 waits for ever when it reads an .exr."""
    drjit = sys.modules.get("drjit")
    before = 0 if drjit is None else drjit.thread_count()
    if drjit is None or before != 1:
        yield
        return
    drjit.set_thread_count(2)
    try:
        yield
    finally:
        drjit.set_thread_count(before)


def _close_after_work(prefix: str) -> None:
    with _at_work, collected_by_this_thread():
        _close(prefix)


def _close(prefix: str) -> None:
    closed = _beginning(_open, prefix)
    for name in closed:
        _open.pop(name)[1].close()
    if closed:
        collect_whole()  # here, and not by Dask's thread later on


def _beginning(names: Iterable[str], prefix: str) -> list[str]:
    return [name for name in names if name.startswith(prefix)]


def _value(name: str) -> Any:
    """From this process, or another worker."""
    if name not in _values:
        from distributed import get_worker
        from distributed.utils import sync

        worker = get_worker()
        _values[name] = sync(worker.loop, _fetch, worker, name)
    return _values[name]


async def _fetch(worker: Any, name: str) -> Any:
    from distributed.utils_comm import gather_from_workers

    if name in worker.data:
        return worker.data[name]
    holders = await worker.scheduler.who_has(keys=[name])
    data, *_ = await gather_from_workers(holders, rpc=worker.rpc)
    if name not in data:
        raise NotHeldError(name)
    return data[name]
