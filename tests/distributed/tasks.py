"""What workers do in tests."""

import contextlib
import os
import signal
import time
from collections.abc import Iterator

from slepian_prt.errors import UserError

# Of this process: how often values were opened and closed.
OPENED = {"opened": 0, "closed": 0}


class Table:
    """A value that is opened."""

    def __init__(self, *numbers: int) -> None:
        self.numbers = numbers

    @contextlib.contextmanager
    def open(self) -> Iterator[tuple[int, ...]]:
        OPENED["opened"] += 1
        yield self.numbers
        OPENED["closed"] += 1


class ThreadsToLoad:
    """A value that is opened to how many threads Mitsuba has meanwhile."""

    @contextlib.contextmanager
    def open(self) -> Iterator[int]:
        yield threads(None, 0)


def same(value: int, _: object) -> int:
    return value


def look_up(numbers: tuple[int, ...], item: int) -> tuple[int, int]:
    """The number, and the process that found it."""
    return numbers[item], os.getpid()


def look_up_slowly(numbers: tuple[int, ...], item: int) -> tuple[int, int]:
    time.sleep(0.1)
    return look_up(numbers, item)


def add(_: object, items: list[tuple[int, int]]) -> int:
    return sum(number for number, _ in items)


def opened(_: object, __: int) -> dict[str, int]:
    time.sleep(0.05)  # so that each worker gets one
    return OPENED | {"process": os.getpid()}


def closed_meanwhile(_: object, seconds: float) -> int:
    """How many values were closed in this process while the task ran."""
    before = OPENED["closed"]
    time.sleep(seconds)
    return OPENED["closed"] - before


def wait(_: object, seconds: float) -> float:
    time.sleep(seconds)
    return seconds


def refuse(_: object, item: int) -> int:
    """UserError for 1, a fault for 2."""
    if item == 1:
        raise UserError("item 1 is none; give another")
    if item == 2:
        raise ZeroDivisionError("of a worker")
    return item


def die(_: object, __: int) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def threads(_: object, __: int) -> int:
    import drjit

    return drjit.thread_count()
