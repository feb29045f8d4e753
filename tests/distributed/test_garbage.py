import gc
import signal
import threading
import weakref

import pytest

from slepian_prt.distributed.garbage import collect_whole, collect_young, collected_by_this_thread


class Cycle:
    """Garbage that only a collection frees; it tells which thread did."""

    def __init__(self, freed: list[str]) -> None:
        self.itself = self
        weakref.finalize(self, lambda: freed.append(threading.current_thread().name))


def allocate() -> None:
    """Enough for Python to collect, were it to."""
    for _ in range(5):
        kept = [[] for _ in range(20_000)]
        del kept


def in_another_thread() -> None:
    thread = threading.Thread(target=allocate, name="another")
    thread.start()
    thread.join()


def test_another_thread_frees_what_it_did_not_make():
    """What the block is for, shown without it."""
    freed: list[str] = []
    gc.collect()
    Cycle(freed)
    in_another_thread()
    assert freed == ["another"]


def test_this_thread_frees_its_garbage():
    freed: list[str] = []
    with collected_by_this_thread():
        Cycle(freed)
        in_another_thread()
        assert freed == []
        collect_young()
        assert freed == ["MainThread"]
        Cycle(freed)
        with collected_by_this_thread():  # as of a crew that is handed on
            Cycle(freed)
        assert len(freed) == 1
    assert freed == 3 * ["MainThread"]
    assert gc.isenabled()


def test_who_collects_by_himself_goes_on_so():
    gc.disable()
    try:
        with collected_by_this_thread():
            pass
        assert not gc.isenabled()
    finally:
        gc.enable()


def test_an_interrupt_is_not_lost_in_what_others_have_called():
    """Python swallows what is raised in callbacks of the collector, which Dask has."""

    def interrupt(phase: str, _: dict[str, int]) -> None:
        if phase == "start":
            signal.raise_signal(signal.SIGINT)

    handler = signal.signal(signal.SIGINT, signal.default_int_handler)
    gc.callbacks.append(interrupt)
    try:
        with pytest.raises(KeyboardInterrupt), collected_by_this_thread():
            collect_young()
        assert gc.isenabled()
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        gc.callbacks.remove(interrupt)
        signal.signal(signal.SIGINT, handler)


def test_callbacks_of_others_are_left_alone():
    """Dask adds and removes its own from a thread of its own; it failed where the list was another for a moment."""
    seen: list[tuple[str, bool]] = []

    def look(phase: str, _: dict[str, int]) -> None:
        seen.append((phase, look in gc.callbacks))

    gc.callbacks.append(look)
    try:
        with collected_by_this_thread():
            collect_young()
    finally:
        gc.callbacks.remove(look)
    assert seen == 2 * [("start", True), ("stop", True)]


def test_what_was_there_before_is_looked_at_only_if_that_is_wanted():
    """To look through all that a worker has imported, after each task, took more time than most tasks."""
    freed: list[str] = []
    gc.collect()
    with collected_by_this_thread():
        first = Cycle(freed)
        gc.freeze()  # as a block that begins with it there
        del first
        collect_young()
        assert freed == []
        collect_whole()
        assert freed == ["MainThread"]
    second = Cycle(freed)
    with collected_by_this_thread(whole=True):
        del second
        assert len(freed) == 1
    assert freed == 2 * ["MainThread"]
