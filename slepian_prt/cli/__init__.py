"""The command line: each command in the file of its name; here they are run, and what ends them gets one line."""

from __future__ import annotations

import logging
import os
import traceback
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import click

from slepian_prt.cli.commands import Interrupted, cli, with_flags
from slepian_prt.cli.messages import note
from slepian_prt.errors import UserError, printable
from slepian_prt.signals import last_words, status_of

__all__ = ["cli", "main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; 0, or 2 for a user's mistake with one line about it, or 1 for a fault of ours."""
    try:
        with _remarks():
            outcome = cli.main(args=arguments, prog_name="slepian-prt", standalone_mode=False)
        return outcome if isinstance(outcome, int) else 0
    except UserError as error:
        return _fail(2, with_flags(str(error)))
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(error.format_message())
        return 0
    except click.UsageError as error:
        command = error.ctx.command_path if error.ctx else "slepian-prt"
        sentence = " ".join(error.format_message().split()).rstrip(".")  # Click lists choices in lines
        return _fail(2, f"{sentence}; see {command} --help")
    except click.ClickException as error:
        return _fail(2, error.format_message())
    except (Interrupted, KeyboardInterrupt, click.Abort) as ended:
        interrupt = ended.__cause__ or ended
        return _fail(status_of(interrupt), last_words(interrupt))
    except OSError as error:  # where no sentence was foreseen for it
        if os.environ.get("SLEPIAN_PRT_DEBUG"):
            traceback.print_exc()
        where = error.filename or "a file"
        return _fail(
            2, f"{where}: cannot be used ({error.strerror or error}); see that its folder is there and has space left"
        )
    except MemoryError:
        return _fail(1, "out of memory; try a lower --bandlimit or fewer --samples")
    except Exception as error:
        if os.environ.get("SLEPIAN_PRT_DEBUG"):
            traceback.print_exc()
        reason = " ".join(str(error).split())
        return _fail(
            1, f"internal error, {type(error).__name__}: {reason} (SLEPIAN_PRT_DEBUG=1 shows where; please report it)"
        )


def _fail(code: int, message: str) -> int:
    click.echo(f"slepian-prt: {printable(message)}", err=True)
    return code


@contextmanager
def _remarks() -> Iterator[None]:
    """Remarks of the library go to standard error, each once."""
    log, handler = logging.getLogger("slepian_prt"), _Remarks()
    level = log.level
    log.setLevel(logging.INFO)
    log.addHandler(handler)
    try:
        yield
    finally:
        log.removeHandler(handler)
        log.setLevel(level)


class _Remarks(logging.Handler):
    def __init__(self) -> None:
        super().__init__()
        self._made: set[str] = set()

    def emit(self, record: logging.LogRecord) -> None:
        text = record.getMessage()
        if text not in self._made:
            self._made.add(text)
            note(text)
