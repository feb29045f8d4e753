"""The table of commands, each loaded when it is used, and the flags they take."""

from __future__ import annotations

import re
from functools import cache
from importlib import import_module
from typing import Any

import click

# Each is a function of its name in the file of its name.
COMMANDS = (
    "capture", "compare", "dimension", "doctor", "export", "info", "precompute", "relight", "spectrum", "sweep", "view",
)  # fmt: skip


class Interrupted(BaseException):
    """The command was interrupted, told past click, which would print an empty line and forget by what."""


class _Commands(click.Group):
    """Imports a command's file when the command is asked for."""

    def invoke(self, ctx: click.Context) -> Any:
        """Run a command.

        Raises
        ------
        Interrupted
        """
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt as interrupt:
            raise Interrupted from interrupt

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        return _command(cmd_name) if cmd_name in COMMANDS else None

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """First sentences in full; click would cut them to one line."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, _command(name).get_short_help_str(limit=1000)) for name in COMMANDS])


@click.group(cls=_Commands, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(package_name="slepian_prt", prog_name="slepian-prt")
def cli() -> None:
    """Compressed precomputed radiance transfer: precompute, relight, and know what compression cost."""


def with_flags(text: str) -> str:
    """A sentence of the library, which names parameters, as one that names options.

    `max_error` becomes --max-error, `effects=direct` becomes --effects direct, `parameters={'spp': 16}` becomes
    -D spp=16, and so does the name at the beginning of "bandlimit must be …". What is no option of any command stays as
    it is.
    """
    return _NAMED.sub(_flag, text)


_ENTRY = re.compile(r"\{'(?P<name>\w+)': (?P<value>[^`]*)\}")
_NAMED = re.compile(r"`(?P<name>\w+)(?:=(?P<value>[^`]*))?`|^(?P<subject>\w+)(?= must be )")


def _flag(match: re.Match[str]) -> str:
    name, value, subject = match["name"], match["value"], match["subject"]
    flag = _flags().get(name or subject)
    if flag is None:
        return match[0]
    return flag if value is None else f"{flag} " + _ENTRY.sub(r"\g<name>=\g<value>", value)


@cache
def _flags() -> dict[str, str]:
    """The options of all commands, by the names of the library's parameters."""
    options = [option for name in COMMANDS for option in _command(name).params if isinstance(option, click.Option)]
    named = {str(option.name): option.opts[0] for option in options}
    flags = [flag for option in options for flag in option.opts]
    return named | {flag[2:].replace("-", "_"): flag for flag in flags if flag.startswith("--")}


def _command(name: str) -> click.Command:
    command = getattr(import_module(f"slepian_prt.cli.{name}"), name)
    assert isinstance(command, click.Command)
    return command
