"""Attempts in a process of their own, which may die of one: told before and after each, on a pipe.

Run as ``python -m tests.fuzzing.child MODULE KIND FOLDER FIRST COUNT PIPE``, KIND being one of the module's KINDS. Two
lines for each attempt: its seed, then what came of it as JSON, [outcome, text]; ``refused`` and ``read`` are well, all
else is a fault.
"""

from __future__ import annotations

import gc
import json
import logging
import os
import resource
import shutil
import sys
import tempfile
import traceback
import warnings
from importlib import import_module
from pathlib import Path
from random import Random
from typing import IO

from slepian_prt.errors import UserError
from slepian_prt.machine.memory import memory_limited
from tests.fuzzing.attempts import Kind

# Beyond what the process has when it begins: files of a few kB need far less, whatever they claim. What is checked
# before it is taken must be told within the first, so that nothing fails for the second.
_ALLOWED = 1 << 30
_MEMORY = 3 << 29


def main(module: str, name: str, folder: str, first: str, count: str, pipe: str) -> None:
    """Run attempts."""
    kind, seeds = import_module(module).KINDS[name], Path(folder)
    logging.getLogger("slepian_prt").addHandler(logging.NullHandler())  # notes of ours are no fault
    warnings.simplefilter("error")
    with tempfile.TemporaryDirectory() as own, open(int(pipe), "w", buffering=1) as told:
        _attempt(name, kind, seeds, Path(own), 0)  # what is imported late counts for nobody
        _limit_memory()
        for seed in range(int(first), int(first) + int(count)):
            told.write(f"{seed}\n")
            outcome = _attempt(name, kind, seeds, Path(own), seed)
            told.write(f"{json.dumps(outcome)}\n")


def _attempt(name: str, kind: Kind, seeds: Path, own: Path, seed: int) -> tuple[str, str]:
    """What came of a seed."""
    place = own / str(seed)
    place.mkdir()
    with tempfile.TemporaryFile() as said:
        before = [os.dup(1), os.dup(2)]
        os.dup2(said.fileno(), 1)
        os.dup2(said.fileno(), 2)
        try:
            outcome = _outcome(kind, place, seeds, Random(f"{name} {seed}"))
        finally:
            sys.stdout.flush()
            sys.stderr.flush()
            for descriptor, kept in zip((1, 2), before, strict=True):
                os.dup2(kept, descriptor)
                os.close(kept)
        outcome = _with_output(outcome, said)
    if outcome[0] in ("read", "refused"):
        shutil.rmtree(place)
    else:
        kept = seeds.parent / f"fault-{name}-{seed}"
        shutil.rmtree(kept, ignore_errors=True)
        shutil.move(place, kept)
    return outcome


def _outcome(kind: Kind, place: Path, seeds: Path, random: Random) -> tuple[str, str]:
    try:
        with memory_limited(_ALLOWED):
            kind.attempt(place, seeds, random)
    except UserError as error:
        text = str(error)
        well = text.isprintable() and len(text) < 600
        return ("refused" if well else "no line"), text[:1000]
    except (Exception, SystemExit, KeyboardInterrupt) as error:
        at = traceback.extract_tb(error.__traceback__)[-1]
        return type(error).__name__, f"{error} ({Path(at.filename).name}:{at.lineno})"[:1000]
    finally:
        gc.collect()
    return "read", ""


def _with_output(outcome: tuple[str, str], said: IO[bytes]) -> tuple[str, str]:
    said.seek(0)
    output = said.read(1000).decode(errors="replace").strip()
    return ("output", output) if output and outcome[0] in ("read", "refused") else outcome


def _limit_memory() -> None:
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    size = pages * resource.getpagesize() + _MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (size, resource.getrlimit(resource.RLIMIT_AS)[1]))


if __name__ == "__main__":
    main(*sys.argv[1:])
