"""What became of the scans of a folder: ``results.jsonl``, a line of JSON for each, which one process writes."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterable, Iterator
from pathlib import Path

from slepian_prt.datasets.jobs import ScanResult
from slepian_prt.errors import UserError
from slepian_prt.files import add_line, atomic_output, forget_partial, is_own_file

NAME = "results.jsonl"


class Records:
    """The lines of a folder, which is opened by `open_records`.

    A line is added when a scan is done, so that work that is killed loses no more than the scan that it was at. The
    last line of a name is what counts; when the work ends, only these are kept.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / NAME
        text = self._path.read_bytes() if is_own_file(self._path) else b""
        lines = text.decode(errors="replace").split("\n")  # names may hold what splitlines() takes for ends of lines
        found = filter(None, map(ScanResult.from_line, lines))
        self._results = {result.name: result for result in found}

    def __getitem__(self, name: str) -> ScanResult | None:
        return self._results.get(name)

    def add(self, result: ScanResult) -> None:
        """Keep a result, on the disk at once."""
        self._results[result.name] = result
        add_line(self._path, result.as_line())

    def tidy(self, order: Iterable[str]) -> None:
        """Keep one line for each name: those of other work first, then in the order given."""
        ordered = dict.fromkeys(order)
        chosen = [name for name in self._results if name not in ordered]
        chosen += [name for name in ordered if name in self._results]
        with atomic_output(self._path) as file:
            file.write("".join(self._results[name].as_line() + "\n" for name in chosen).encode())


@contextlib.contextmanager
def open_records(folder: Path) -> Iterator[Records]:
    """The records of a folder, which is made if need be, while nobody else writes to it.

    Raises
    ------
    UserError
        The folder cannot be written to, or another process writes to it.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        held = os.open(folder, os.O_RDONLY) if os.name == "posix" else None
    except OSError as error:
        raise UserError(
            f"{folder}: cannot be written to ({error.strerror or error}); choose another folder for the output"
        ) from None
    try:
        if held is not None:
            _lock(held, folder)
        forget_partial(folder / NAME)
        yield Records(folder)
    finally:
        if held is not None:
            os.close(held)


def _lock(held: int, folder: Path) -> None:
    import fcntl

    try:
        fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise UserError(f"{folder}: another process writes to it; wait, or choose another folder") from None
    except OSError:  # a file system without locks
        pass
