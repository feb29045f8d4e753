"""Signals that end the command, all as Ctrl-C does: SIGTERM, and SIGHUP of a terminal that is closed.

Only the command's entry listens to them, `slepian_prt.__main__`; whoever uses the library keeps handlers of their own.
"""

from __future__ import annotations

import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

# Those that this system has.
ENDING = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
)  # fmt: skip

_WORDS = {"SIGTERM": "terminated", "SIGHUP": "the terminal was closed"}

# Whether a signal has ended the command, which only tells of it now.
_ending = False

# Whether the main thread is within `interrupts_held`.
_holding = False

# What an exception that was lost waits until it is raised once more.
_SECONDS_AGAIN = 0.05


class Ended(KeyboardInterrupt):
    """A signal ends the command.

    Attributes
    ----------
    number : int
        Of the signal.
    """

    def __init__(self, number: int) -> None:
        super().__init__()
        self.number = number


def status_of(interrupt: BaseException | None) -> int:
    """The exit status of a command that was interrupted, as shells have it."""
    return 128 + int(getattr(interrupt, "number", signal.SIGINT))


def is_ending() -> bool:
    """Whether a signal has ended the command: nothing may wait any more."""
    return _ending


def told(interrupt: BaseException | None) -> str:
    """What ended the command, in a word or two."""
    return _WORDS.get(signal.Signals(status_of(interrupt) - 128).name, "interrupted")


def last_words(interrupt: BaseException | None) -> str:
    """What ended the command, and what became of its outputs and of the work that it had finished."""
    files = sys.modules.get("slepian_prt.files")  # without it nothing is written
    cache = sys.modules.get("slepian_prt.cache_folder")  # nor kept without this
    stays = ["what was written by then stays"] if files is not None and files.may_have_written() else []
    if cache is not None and cache.keeps_work():
        stays += ["finished work is kept, and the same command goes on"]
    return "; ".join([told(interrupt), *(stays or ["nothing was written"])])


@contextmanager
def heard() -> Iterator[None]:
    """Raise `Ended` in the main thread for the first signal that is not ignored, as SIGHUP is under nohup.

    A Ctrl-C after it ends the process at once, whatever it is doing; so does SIGTERM after a Ctrl-C. What else comes
    is not heard: closed terminals, and ``timeout``, send signals twice. When the block has ended the process is about
    to, and each signal ends it at once.
    """
    changed = [number for number in ENDING if signal.getsignal(number) not in (signal.SIG_IGN, None)]
    hook = sys.unraisablehook
    sys.unraisablehook = lambda lost: _raise_again(lost, hook)
    try:
        for number in changed:
            signal.signal(number, end)
        yield
    finally:
        sys.unraisablehook = hook
        for number in changed:
            signal.signal(number, signal.SIG_DFL)


def end(number: int, _frame: FrameType | None = None) -> None:
    """The handler of `heard`."""
    global _ending
    _ending = True
    for other in ENDING:
        if signal.getsignal(other) is end:
            at_once = other == signal.SIGINT or (number == signal.SIGINT and other == signal.SIGTERM)
            signal.signal(other, signal.SIG_DFL if at_once else signal.SIG_IGN)
    raise Ended(number)


@contextmanager
def interrupts_held() -> Iterator[None]:
    """Signals within the block that somebody listens to in Python are heard at its end, where in between they would be
    lost or hit the wrong; in other threads than the main one, which hear of none, nothing.

    What came counts before an exception of the block, which it may have caused. A second Ctrl-C ends the command at
    once.
    """
    global _holding
    if _holding or threading.current_thread() is not threading.main_thread():
        yield
        return
    # None: a handler of something else than Python.
    handlers = {number: signal.getsignal(number) for number in ENDING}
    held = {number: handler for number, handler in handlers.items() if callable(handler)}
    came: list[int] = []

    def hold(number: int, _frame: FrameType | None) -> None:
        if number == signal.SIGINT and came and held[number] is end:
            end_at_once(number)
        came.append(number)

    _holding = True
    try:
        for number in held:
            signal.signal(number, hold)
        yield
    finally:
        _holding = False
        for number, handler in held.items():
            signal.signal(number, handler)
        if came:
            signal.raise_signal(came[0])


def end_at_once(number: int) -> None:
    """As the system ends what does not listen."""
    signal.signal(number, signal.SIG_DFL)
    signal.raise_signal(number)


def _raise_again(lost: Any, hook: Any) -> None:
    """Python drops exceptions of finalizers, with a traceback, and with them the signal that just then came."""
    if not isinstance(lost.exc_value, Ended):
        hook(lost)
        return
    number = lost.exc_value.number

    def send() -> None:
        time.sleep(_SECONDS_AGAIN)
        signal.raise_signal(number)

    signal.signal(number, end)
    threading.Thread(target=send, daemon=True).start()
