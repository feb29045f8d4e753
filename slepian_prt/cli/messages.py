"""Remarks on standard error."""

from __future__ import annotations

import click

from slepian_prt.cli.commands import with_flags


def note(text: str) -> None:
    """A remark on standard error; parameters that it names become flags."""
    click.echo(f"note: {with_flags(text)}", err=True)
