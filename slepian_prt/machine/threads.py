"""How many threads work gets: those of BLAS, our own, and Mitsuba's. Decided here and nowhere else.

BLAS gets one, for all sizes. Its threads spin while they wait for each other: that costs the last of them a time slice
wherever another process wants the cores, at each of the thousands of products and decompositions of a run. On two
cores, clustered PCA of 9,216 vertices took 8.2 s with two threads on an idle machine, 1.6 s with one, and 2.9 s beside
two busy loops; plain compression gained a quarter from the second (`scripts/benchmark loaded`). What gains from more
cores is cut into blocks that do not wait for each other, for threads of our own (`map_in_threads`), which degrade as
all programs do. So results do not depend on the number of cores either.
"""

from __future__ import annotations

import os
import sys
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from threading import Lock, local
from typing import Any, TypeVar

from slepian_prt.errors import UserError
from slepian_prt.machine.cores import usable_cores
from slepian_prt.machine.variables import variable_set

Item = TypeVar("Item")
Result = TypeVar("Result")

# The environment variable that says how many threads work may use.
THREADS = "SLEPIAN_PRT_THREADS"

# What libraries of BLAS are told before they are loaded, so that they start no threads at all.
_BLAS_VARIABLES = (
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "BLIS_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
)


# Of a process that has the machine with others of the same work.
_share: list[int] = []


def thread_count() -> int:
    """Threads that work may use: what ``SLEPIAN_PRT_THREADS`` says, or as many as there are `usable_cores`.

    In workers that share a machine, no more than their share.

    Raises
    ------
    UserError
        The variable is no number of threads.
    """
    given = os.environ.get(THREADS)
    return min([usable_cores() if not given else check_threads(given, THREADS), *_share])


def take_share(count: int) -> None:
    """From now on, as long as this process lives, `thread_count` is that at most."""
    _share[:] = [count]


def most_threads(count: int) -> int:
    """So many, or what ``SLEPIAN_PRT_THREADS`` says where that is less."""
    given = os.environ.get(THREADS)
    return min(count, check_threads(given, THREADS)) if given else count


def check_threads(count: Any, name: str = "threads") -> int:
    """Return it as an int; raise UserError unless it is a whole number from 1 to 1024."""
    try:
        number = int(count)
    except (TypeError, ValueError):
        number = 0
    if not 1 <= number <= 1024 or (isinstance(count, float) and count != number):
        raise UserError(f"{name} must be a whole number from 1 to 1024, not {count!r}")
    return number


@contextmanager
def count_given(count: int) -> Iterator[None]:
    """Within the block, `thread_count` is that, also in processes that are started; raise as `check_threads`."""
    with variable_set(THREADS, str(check_threads(count))):
        yield


def map_in_threads(
    function: Callable[[Item], Result], items: Iterable[Item], most: int | None = None
) -> Iterator[Result]:
    """Results of all items, in order, from several threads with one of BLAS each; few items are taken ahead.

    Parameters
    ----------
    function : callable
        That lets go of Python's lock for most of its time, as NumPy and SciPy do.
    items : iterable
    most : int, optional
        Of threads, where each takes much memory.
    """
    count = thread_count() if most is None else min(thread_count(), most)

    def work(item: Item) -> Result:
        with one_blas_thread():  # also those libraries that have a number for each thread
            return function(item)

    with one_blas_thread():
        if count == 1:
            yield from map(function, items)
            return
        with ThreadPoolExecutor(count) as pool:
            pending: deque[Future[Result]] = deque()
            try:
                for item in items:
                    pending.append(pool.submit(work, item))
                    if len(pending) > 2 * count:
                        yield pending.popleft().result()
                while pending:
                    yield pending.popleft().result()
            finally:
                for future in pending:
                    future.cancel()


def run_in_threads(function: Callable[[Item], object], items: Iterable[Item], most: int | None = None) -> None:
    """As `map_in_threads`, where nothing is returned."""
    for _ in map_in_threads(function, items, most):
        pass


def start_with_one_blas_thread() -> None:
    """For a process that is ours alone, before NumPy is imported: BLAS starts without threads to wait for."""
    os.environ.update(dict.fromkeys(_BLAS_VARIABLES, "1"))


class _Counts:
    """Who needs one thread, and what libraries had before, by their files."""

    def __init__(self) -> None:
        self.users = 0
        self.before: dict[str, int] = {}

    def leave(self, libraries: Iterable[Any]) -> None:
        """Set back what the libraries had if nobody needs one thread any more."""
        self.users = max(0, self.users - 1)
        if self.users > 0:
            return
        for library in libraries:
            # What somebody has set meanwhile stays.
            if library.filepath in self.before and library.get_num_threads() == 1:
                _set_threads(library, self.before[library.filepath])
        self.before.clear()


class _CountsOfThread(local, _Counts):
    """Those of the thread that asks."""


class _OneThread:
    """Libraries of BLAS with one thread each while anybody needs it, and as they were after the last has left.

    `threadpoolctl.threadpool_limits` sets back what each block has found, so that of two threads whose blocks overlap
    one takes the limit from the other, and the last leaves it behind. (So does one of the user's own that begins in
    another thread while a block of ours goes on, and ends after it: it sets back our one. Nothing can be done here.)
    An OpenBLAS built with OpenMP has a number for each thread that calls it: there each has its own limit.
    """

    def __init__(self) -> None:
        self._libraries: list[Any] = []
        self._modules = -1
        self._lock = Lock()
        self._all, self._own = _Counts(), _CountsOfThread()

    def forget_others(self) -> None:
        """In a forked process, where the thread that forked is left alone.

        What the libraries had is known still, and set back after the next block: their own threads are best not
        started while a process is being forked.
        """
        self._lock = Lock()
        self._all.users = self._own.users

    def __enter__(self) -> None:
        with self._lock:
            # Importing SciPy loads a BLAS of its own, also within a block.
            if self._modules != len(sys.modules):
                self._find()
            self._all.users += 1
            self._own.users += 1
            for library in self._libraries:
                self._limit(library)

    def __exit__(self, *_: object) -> None:
        with self._lock:
            for counts, libraries in ((self._all, self._shared()), (self._own, self._separate())):
                counts.leave(libraries)

    def _find(self) -> None:
        """The libraries that are loaded; it takes a quarter of a millisecond, as long as to relight a small model."""
        from threadpoolctl import ThreadpoolController

        self._libraries = [found for found in ThreadpoolController().lib_controllers if found.user_api == "blas"]
        self._modules = len(sys.modules)

    def _limit(self, library: Any) -> None:
        """Also where others are in a block: what is set within it, as other blocks end, would count for them."""
        threads = library.get_num_threads()
        if threads is not None and threads > 1:
            counts = self._own if _counts_each_thread(library) else self._all
            counts.before.setdefault(library.filepath, threads)
            _set_threads(library, 1)

    def _shared(self) -> list[Any]:
        return [library for library in self._libraries if not _counts_each_thread(library)]

    def _separate(self) -> list[Any]:
        return [library for library in self._libraries if _counts_each_thread(library)]


def _counts_each_thread(library: Any) -> bool:
    return library.internal_api == "openblas" and library.threading_layer == "openmp"


def _set_threads(library: Any, count: int) -> None:
    """From any thread.

    threadpoolctl 3.8 passes over all but the first thread that sets the number of an OpenBLAS with threads of its own
    as long as that thread lives, which is mostly the main thread; the library itself heeds all of them.
    """
    getattr(library, "_real_set_num_threads", library.set_num_threads)(count)


_one_thread = _OneThread()
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=lambda: _one_thread.forget_others())


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Products and decompositions within the block run in the thread that asks for them; also a decorator.

    For any number of threads at once, whose blocks may overlap.
    """
    with _one_thread:
        yield


def keep_one_blas_thread() -> None:
    """From now on, as long as the process lives: in workers, which are ours alone."""
    _one_thread.__enter__()
