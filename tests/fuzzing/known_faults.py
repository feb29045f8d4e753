"""Attempts that end as none may: seed n does the n-th of these. They show that each is seen."""

from __future__ import annotations

import os
import signal
import time
import warnings
from pathlib import Path
from random import Random

from slepian_prt.errors import UserError
from tests.fuzzing.attempts import Kind


def _read() -> None:
    pass


def _refused() -> None:
    raise UserError("scan.ply: holds 3 of 4 faces; export it again")


def _no_line() -> None:
    raise UserError("scan.ply: " + 1000 * "x")


def _other() -> None:
    raise KeyError("vertices")


def _exit() -> None:
    raise SystemExit(3)


def _memory() -> None:
    bytes(1 << 40)


def _output() -> None:
    os.write(2, b"libpng warning: iCCP")


def _warning() -> None:
    warnings.warn("image file could be decompression bomb", stacklevel=1)


def _crash() -> None:
    os.kill(os.getpid(), signal.SIGSEGV)


def _hang() -> None:
    time.sleep(1000.0)


ATTEMPTS = (_read, _refused, _no_line, _other, _exit, _memory, _output, _warning, _crash, _hang)
OUTCOMES = ("no line", "KeyError", "SystemExit", "MemoryError", "output", "UserWarning", "died", "hung")


def _attempt(folder: Path, _seeds: Path, _random: Random) -> None:
    ATTEMPTS[int(folder.name)]()


KINDS = {"faults": Kind(lambda _: None, _attempt)}
