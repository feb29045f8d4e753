"""Standard streams of the command: what nobody reads any more ends no work.

A terminal may be closed, a pipe end, a disk be full, while hours of work go on whose result is a file. A pipe may be
full that somebody holds and does not read: there the command waits, until a signal ends it.
"""

from __future__ import annotations

import contextlib
import errno
import io
import os
import select
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, TextIO

from slepian_prt.signals import is_ending

# Who read has gone: EPIPE of pipes, EIO of terminals, ENXIO and ENODEV of devices.
_GONE = (errno.EPIPE, errno.EIO, errno.ENXIO, errno.ENODEV)


@contextmanager
def kept_streams() -> Iterator[None]:
    """Standard output and error that take what cannot be written.

    Streams that were closed before we began lead nowhere: the next file that is opened would have their number, and
    what libraries print would end up in it. (Windows has neither.)

    Raises
    ------
    OSError
        At the end, if standard output could not be written and somebody still waits for it, as on a full disk.
    """
    if os.name != "posix":
        yield
        return
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # gets the lowest number that is free
    before = sys.stdout, sys.stderr
    streams = [_Patient(number, "wb", closefd=False) for number in (1, 2)]
    sys.stdout, sys.stderr = (_text(raw, stream) for raw, stream in zip(streams, before, strict=True))
    try:
        yield
    finally:
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(OSError, ValueError):
                stream.flush()
        sys.stdout, sys.stderr = before
    if streams[0].fault is not None:
        raise streams[0].fault


class _Patient(io.FileIO):
    """Takes all that is written, and keeps the fault of what could not be; when a signal has come it waits for nobody.

    Attributes
    ----------
    fault : OSError or None
        None also where nobody reads.
    """

    fault: OSError | None = None

    def write(self, data: Any) -> int:
        view = memoryview(data).cast("B")
        written: int | None = None
        if is_ending():
            if not select.select((), (self,), (), 0)[1]:
                return view.nbytes
            view = view[: select.PIPE_BUF]  # for which there is room
        try:
            written = super().write(view)
        except OSError as error:
            if error.errno not in _GONE:
                self.fault = error
            return view.nbytes
        return written  # None where it would have to wait


def _text(raw: io.FileIO, like: TextIO | None) -> TextIO:
    """A stream of text with the manners of the one that it replaces."""
    is_terminal = raw.isatty()
    return io.TextIOWrapper(
        io.BufferedWriter(raw),
        encoding=like.encoding if like else "utf-8",
        errors=like.errors if like else "backslashreplace",
        line_buffering=is_terminal or raw.fileno() == 2,
        write_through=bool(getattr(like, "write_through", False)),
    )
