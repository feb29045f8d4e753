"""Who gets how many threads."""

import threading
import time

import pytest

from slepian_prt.errors import UserError
from slepian_prt.machine import threads
from slepian_prt.machine.cores import usable_cores
from slepian_prt.machine.threads import count_given, map_in_threads, one_blas_thread, thread_count


class Library:
    """One of BLAS, as threadpoolctl has them; the real one may heed the first thread that it was set by alone."""

    filepath, internal_api, threading_layer, threads = "libblas.so", "openblas", "pthreads", 3

    def get_num_threads(self) -> int:
        return self.threads

    def set_num_threads(self, count: int) -> None:
        self.threads = count


@pytest.fixture
def library(monkeypatch) -> Library:
    """All that there is, with three threads."""
    blas, counted = Library(), threads._OneThread()
    monkeypatch.setattr(counted, "_find", lambda: counted._libraries.__setitem__(slice(None), [blas]))
    monkeypatch.setattr(threads, "_one_thread", counted)
    return blas


def test_the_variable_counts_for_work_and_what_it_starts(monkeypatch):
    monkeypatch.delenv(threads.THREADS, raising=False)
    assert thread_count() == usable_cores()
    with count_given(5):
        assert thread_count() == 5
        with count_given(2):
            assert thread_count() == 2
        assert thread_count() == 5
    assert thread_count() == usable_cores()
    monkeypatch.setenv(threads.THREADS, "many")
    with pytest.raises(UserError, match="SLEPIAN_PRT_THREADS must be a whole number from 1 to 1024, not 'many'"):
        thread_count()


def test_blocks_that_overlap_leave_blas_as_it_was(library):
    """The first to begin ends first: with limits that each set back what they found, one thread would stay."""
    began, end_first = threading.Event(), threading.Event()

    def first() -> None:
        with one_blas_thread():
            began.set()
            end_first.wait()

    other = threading.Thread(target=first)
    other.start()
    began.wait()
    with one_blas_thread():
        end_first.set()
        other.join()
        assert library.threads == 1
    assert library.threads == 3


def test_blas_is_as_it_was_after_an_error(library):
    with pytest.raises(ZeroDivisionError), one_blas_thread():
        raise ZeroDivisionError
    assert library.threads == 3


def test_results_come_in_order_and_items_are_taken_as_they_are_needed():
    taken = []

    def items():
        for i in range(100):
            taken.append(i)
            yield i

    def slow(i: int) -> int:
        time.sleep(0.001 * (i % 3))
        return i * i

    with count_given(3):
        results = map_in_threads(slow, items())
        assert [next(results) for _ in range(4)] == [0, 1, 4, 9]
        assert len(taken) <= 4 + 2 * 3 + 1
        assert list(results) == [i * i for i in range(4, 100)]


@pytest.mark.parametrize("count", [1, 3])
def test_errors_of_threads_are_raised(count):
    with count_given(count), pytest.raises(ZeroDivisionError):
        list(map_in_threads(lambda i: 1 // i, [1, 2, 0, 3]))


def test_a_library_with_a_number_for_each_thread_is_limited_in_each(library, monkeypatch):
    """As an OpenBLAS that is built with OpenMP."""
    numbers = threading.local()
    monkeypatch.setattr(library, "threading_layer", "openmp", raising=False)
    monkeypatch.setattr(library, "get_num_threads", lambda: getattr(numbers, "count", 3), raising=False)
    monkeypatch.setattr(library, "set_num_threads", lambda count: setattr(numbers, "count", count), raising=False)
    meet = threading.Barrier(2, timeout=20)

    def within(_: int) -> int:
        meet.wait()
        return library.get_num_threads()

    with count_given(2):
        assert list(map_in_threads(within, range(2))) == [1, 1]
    assert library.get_num_threads() == 3


def test_a_forked_process_has_the_number_of_the_user_again_after_its_first_block(library):
    with one_blas_thread():
        pass
    threads._one_thread._all.users = 4  # of threads that are not there
    threads._one_thread._all.before["libblas.so"] = 3
    library.threads = 1
    threads._one_thread.forget_others()
    with one_blas_thread():
        assert library.threads == 1
    assert library.threads == 3
