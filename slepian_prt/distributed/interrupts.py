"""Interrupts that wait: Ctrl-C comes when a block has ended, where in between it would be lost or hit the wrong."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from slepian_prt.signals import ENDING, end, end_at_once


@contextmanager
def interrupts_held() -> Iterator[None]:
    """Ctrl-C within the block is raised at its end; in other threads than the main one, which hear of none, nothing.

    So are other signals that end a program and that somebody listens to in Python. A second Ctrl-C ends the command at
    once.
    """
    is_main = threading.current_thread() is threading.main_thread()
    # None: a handler of something else than Python.
    handlers = {number: signal.getsignal(number) for number in ENDING} if is_main else {}
    held = {number: handler for number, handler in handlers.items() if callable(handler)}
    came: list[int] = []

    def hold(number: int, _frame: FrameType | None) -> None:
        if number == signal.SIGINT and came and held[number] is end:
            end_at_once(number)
        came.append(number)

    try:
        for number in held:
            signal.signal(number, hold)
        yield
    finally:
        for number, handler in held.items():
            signal.signal(number, handler)
    if came:
        signal.raise_signal(came[0])
