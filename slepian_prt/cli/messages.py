"""Sentences for the user: results on standard output, remarks on standard error; no name in them steers a terminal."""

from __future__ import annotations

import shutil
import sys
import textwrap

import click

from slepian_prt.cli.commands import with_flags
from slepian_prt.errors import printable


def say(text: str) -> None:
    """A result on standard output."""
    text = printable(text)
    click.echo(_fitted(text) if sys.stdout.isatty() else text)


def note(text: str) -> None:
    """A remark on standard error; parameters that it names become flags."""
    text = f"note: {with_flags(printable(text))}"
    click.echo(_fitted(text) if sys.stderr.isatty() else text, err=True)


def _fitted(text: str) -> str:
    """Lines that a terminal need not break inside words."""
    width = shutil.get_terminal_size().columns
    return textwrap.fill(text, width, subsequent_indent="    ", break_long_words=False, break_on_hyphens=False)
