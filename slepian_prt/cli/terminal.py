"""What is shown on a terminal: progress and tables."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Literal, TextIO

import click

from slepian_prt.cli.commands import with_flags
from slepian_prt.errors import printable

if TYPE_CHECKING:
    from slepian_prt.compression.compressed import CompressedTransfer
    from slepian_prt.transport.effects import Effect

Side = Literal["left", "right"]


@contextmanager
def progress(name: str, unit: str) -> Iterator[tuple[Callable[[int, int], None], Callable[[str], None]]]:
    """A bar with rate and time left on a terminal; nothing in a pipe.

    Yields advance(done now, total), and report(text), which names what is done before or after on a line of its own.
    """
    if not _is_terminal(sys.stderr):
        yield lambda _done, _total: None, lambda _what: None
        return
    from slepian_prt.cli.progress import progress_bar

    with progress_bar(name, unit) as shown:
        yield shown


def _is_terminal(stream: TextIO) -> bool:
    """Whether Rich has something to do there; a pipe does without it, which takes a tenth of a second to import."""
    return stream.isatty() or bool(os.environ.get("FORCE_COLOR"))


def print_plan(effects: Sequence[Effect]) -> None:
    """The effects plan as a table."""
    rows = []
    for effect in effects:
        amount = "unknown" if effect.contribution is None else f"{effect.contribution:.3f}"
        if effect.confidence:
            amount += f" ± {effect.confidence:.3f}"
        rows.append([effect.name, effect.verdict, amount, _rays(effect.rays), effect.reason])
    print_table(
        {"effect": "left", "verdict": "left", "contribution": "right", "cost": "right", "reason": "left"},
        [[with_flags(cell) for cell in row] for row in rows],
    )


def describe(packed: CompressedTransfer) -> str:
    """What a transfer file holds, in short."""
    return (
        f"{len(packed.mesh.positions)} vertices, {packed.basis}, {packed.terms:.4g} functions of "
        f"{(packed.bandlimit + 1) ** 2} in {len(packed.bases)} caps, {packed.bytes_per_vertex:.2f} bytes per vertex, "
        f"{packed.file_bytes_per_vertex:.2f} with the mesh and all"
    )


def print_table(headings: Mapping[str, Side], rows: Sequence[Sequence[str]], *, spare: Sequence[str] = ()) -> None:
    """To standard output; in a pipe as wide as it needs.

    On a terminal that is too narrow, the columns ``spare`` are left out, from the first on, until the rest fits.
    """
    from rich.cells import cell_len

    rows = [[printable(cell) for cell in row] for row in rows]
    cells = dict(zip(headings, zip(*rows, strict=True), strict=True)) if rows else dict.fromkeys(headings, ())
    whole = {name: max(map(cell_len, [name, *cells[name]])) for name in headings}
    if not _is_terminal(sys.stdout):
        for row in (tuple(headings), *rows):
            pads = (" " * (whole[name] - cell_len(cell)) for name, cell in zip(headings, row, strict=True))
            sides = zip(row, pads, headings.values(), strict=True)
            click.echo("  ".join(pad + cell if side == "right" else cell + pad for cell, pad, side in sides))
        return
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    console = Console()
    # Numbers are not wrapped, headings only between words.
    least = {
        name: max(map(cell_len, [*name.split(), *(cells[name] if headings[name] == "right" else ())]), default=0)
        for name in headings
    }
    for name in spare:
        if _width(least) <= console.width:
            break
        del least[name]
    table = Table(box=None, pad_edge=False, header_style="bold")
    fits = _width({name: whole[name] for name in least}) <= console.width
    for name, width in least.items():
        table.add_column(name, justify=headings[name], width=None if fits or headings[name] == "left" else width)
    for row in zip(*(cells[name] for name in least), strict=True):
        table.add_row(*map(Text, row))
    console.print(table)


def _width(columns: Mapping[str, int]) -> int:
    return sum(columns.values()) + 2 * (len(columns) - 1)


def _rays(count: int) -> str:
    """A number of rays to two digits."""
    for size, unit in ((10**9, "G"), (10**6, "M"), (10**3, "k")):
        if count >= size:
            return f"{count / size:.2g} {unit}rays" if count < 10 * size else f"{count / size:.0f} {unit}rays"
    return f"{count} rays" if count else "none"
