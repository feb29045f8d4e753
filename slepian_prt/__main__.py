"""The command's entry: what ends it is one line also while the imports run, and nobody need read what it prints."""

import contextlib
import os
import sys

from slepian_prt.signals import heard, last_words, status_of
from slepian_prt.streams import kept_streams


def main() -> None:
    """Run the command and exit with its status."""
    try:
        with heard():
            status = _run()
    except KeyboardInterrupt as interrupt:
        status = status_of(interrupt)
        _tell(last_words(interrupt))
    sys.exit(status)


def _run() -> int:
    try:
        with kept_streams():
            from slepian_prt.cli import main as run
            from slepian_prt.machine.threads import start_with_one_blas_thread

            start_with_one_blas_thread()
            return run()
    except OSError as error:
        _tell(f"standard output: cannot be written ({error.strerror or error}); free some space")
        return 2


def _tell(text: str) -> None:
    with contextlib.suppress(OSError):  # nobody is there to read it
        os.write(2, f"slepian-prt: {text}\n".encode())


if __name__ == "__main__":
    main()
