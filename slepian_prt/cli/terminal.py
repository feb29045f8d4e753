"""What is shown on a terminal: progress and tables."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Literal

from rich.cells import cell_len
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task, TextColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

from slepian_prt.cli.commands import with_flags

if TYPE_CHECKING:
    from slepian_prt.compression.compressed import CompressedTransfer
    from slepian_prt.transport.effects import Effect

Side = Literal["left", "right"]


class _Rate(ProgressColumn):
    """Items per second."""

    def render(self, task: Task) -> Text:
        return Text(f"{task.speed:,.0f}/s" if task.speed else "", style="progress.data.speed")


@contextmanager
def progress(name: str, unit: str) -> Iterator[tuple[Callable[[int, int], None], Callable[[str], None]]]:
    """A bar with rate and time left on a terminal; nothing in a pipe.

    Yields advance(done now, total), and report(text), which names what is done before or after on a line of its own.
    """
    console = Console(stderr=True)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn(unit),
        _Rate(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, disable=not console.is_terminal, transient=True) as bar:
        task = None

        def advance(done: int, total: int) -> None:
            nonlocal task
            if task is None:
                task = bar.add_task(name, total=total)
            bar.update(task, advance=done, total=total)

        def report(what: str) -> None:
            if console.is_terminal:
                if task is not None:
                    bar.update(task, visible=False)
                console.print(Text(what, style="dim"))

        yield advance, report


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
    cells = dict(zip(headings, zip(*rows, strict=True), strict=True)) if rows else dict.fromkeys(headings, ())
    whole = {name: max(map(cell_len, [name, *cells[name]])) for name in headings}
    console = Console()
    if not console.is_terminal:
        console = Console(width=_width(whole))
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
