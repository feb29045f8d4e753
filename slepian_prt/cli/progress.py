"""A bar of progress, drawn by Rich."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task, TextColumn, TimeRemainingColumn
from rich.text import Text

from slepian_prt.errors import printable

# Whose progress the rate is of: workers bring their blocks in bursts, and seldom where they are big.
_SECONDS = 120.0


class _Rate(ProgressColumn):
    """Items per second."""

    def render(self, task: Task) -> Text:
        return Text(f"{task.speed:,.0f}/s" if task.speed else "", style="progress.data.speed")


@contextmanager
def progress_bar(name: str, unit: str) -> Iterator[tuple[Callable[[int, int], None], Callable[[str], None]]]:
    """As `slepian_prt.cli.terminal.progress`, on a terminal."""
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
    is_hidden = not console.is_terminal
    with Progress(*columns, console=console, disable=is_hidden, transient=True, speed_estimate_period=_SECONDS) as bar:
        task = None

        def advance(done: int, total: int) -> None:
            nonlocal task
            if task is None:
                task = bar.add_task(name, total=total)
            bar.update(task, advance=done, total=total)

        def report(what: str) -> None:
            if not is_hidden:
                if task is not None:
                    bar.update(task, visible=False)
                console.print(Text(printable(what), style="dim"))

        yield advance, report
