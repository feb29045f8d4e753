"""Attempts in child processes, and what was wrong with them."""

from __future__ import annotations

import json
import os
import select
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).parent.parent.parent


@dataclass(frozen=True)
class Fault:
    """An attempt that ended as none may.

    Attributes
    ----------
    kind : str
    seed : int
    outcome : str
        Name of the exception, ``died``, ``hung``, ``output`` (of a library), or ``no line`` (a message that is none).
    text : str
    """

    kind: str
    seed: int
    outcome: str
    text: str

    def __str__(self) -> str:
        return f"{self.kind} {self.seed}: {self.outcome}: {self.text}"


@dataclass
class Findings:
    """What came of the attempts."""

    counts: Counter[str] = field(default_factory=Counter)
    faults: list[Fault] = field(default_factory=list)

    def add(self, outcome: str, fault: Fault) -> None:
        """Count an attempt; ``fault`` is kept if it is one."""
        well = outcome in ("read", "refused")
        self.counts[outcome if well else "fault"] += 1
        if not well:
            self.faults.append(fault)


def run(
    kind: str, folder: Path, first: int, count: int, *, module: str = "tests.fuzzing.attempts", patience: float = 60.0
) -> Findings:
    """Attempts of ``count`` seeds from ``first`` on.

    Parameters
    ----------
    kind : str
    folder : path
        What `prepare` made; inputs that were wrong are left beside it.
    first, count : int
    module : str
        Whose KINDS hold the kind.
    patience : float
        Seconds that one attempt may take, on a machine that does other things too.
    """
    findings = Findings()
    seed, end = first, first + count
    while seed < end:
        seed = _run_child((module, kind, str(folder)), seed, end, patience, findings)
    return findings


def prepare(kind: str, folder: Path) -> None:
    """Make what attempts begin with, in a child too: it takes Mitsuba, which is to fill no other process."""
    code = "import sys, pathlib, tests.fuzzing.attempts as a; a.KINDS[sys.argv[1]].prepare(pathlib.Path(sys.argv[2]))"
    folder.mkdir(parents=True)
    subprocess.run([sys.executable, "-c", code, kind, str(folder)], check=True, cwd=ROOT, env=_environment())


def _environment() -> dict[str, str]:
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    return {**os.environ, "PYTHONPATH": path, "OPENBLAS_NUM_THREADS": "1"}


def _run_child(what: tuple[str, str, str], first: int, end: int, patience: float, findings: Findings) -> int:
    """The seed to go on with, once the child has done all of them or ended at one."""
    kind = what[1]
    read, write = os.pipe()
    command = [sys.executable, "-m", "tests.fuzzing.child", *what, str(first), str(end - first), str(write)]
    child = subprocess.Popen(
        command, pass_fds=[write], cwd=ROOT, env=_environment(), stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
    )
    os.close(write)
    seed, ended = first, "died"
    try:
        for line in _lines(read, patience):
            if line.isdigit():
                seed = int(line)
                continue
            known, text = json.loads(line)
            findings.add(known, Fault(kind, seed, known, text))
            seed += 1
    except TimeoutError:
        ended = "hung"
    finally:
        os.close(read)
        if ended == "hung" or seed == end:
            child.kill()
        said = child.communicate()[1].decode(errors="replace")[-500:]
    if seed < end:
        findings.add(ended, Fault(kind, seed, ended, f"status {child.returncode} {said}".strip()))
    return seed + 1


def _lines(descriptor: int, patience: float) -> Iterator[str]:
    """Lines of a pipe until its end; raises TimeoutError when there is none for too long."""
    rest = b""
    while True:
        if not select.select([descriptor], [], [], patience)[0]:
            raise TimeoutError
        content = os.read(descriptor, 1 << 16)
        if not content:
            return
        *whole, rest = (rest + content).split(b"\n")
        yield from (line.decode() for line in whole)
