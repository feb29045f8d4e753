"""Precompute many scenes into one folder."""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from slepian_prt.cli.commands import with_flags
from slepian_prt.cli.messages import note, say
from slepian_prt.cli.options import together
from slepian_prt.cli.terminal import progress
from slepian_prt.cli.workers import crew_of
from slepian_prt.errors import UserError
from slepian_prt.signals import status_of, told

if TYPE_CHECKING:
    from slepian_prt.datasets.jobs import ScanResult, ScanSettings

set_options = together(
    click.option(
        "--from",
        "listed",
        type=click.Path(),
        metavar="LIST",
        help="Scenes that a text file names, a path on each line, relative to it; - is the standard input.",
    ),
    click.option(
        "--format",
        "formats",
        type=click.Choice(("prt", "pifu", "icon")),
        multiple=True,
        help="Into the folder: NAME.prt, or what the training of PIFu or ICON reads of an OBJ file, direct transfer of "
        "order 2; may be given several times.  [default: prt]",
    ),
    click.option("--json", "as_json", is_flag=True, help="Print a line of JSON for each scene of the folder."),
)

# Failures that are told at the end; results.jsonl has all.
_MOST_TOLD = 20


def into_folder(scenes: Sequence[str], listed: str | None, formats: Sequence[str], output: str) -> bool:
    """Whether a folder is wanted, not the file of one scene."""
    is_folder = output.endswith(("/", os.sep)) or (output != "" and Path(output).is_dir())
    if not is_folder and output.lower().endswith(".prt") and (len(scenes) > 1 or formats or listed is not None):
        what = f"{len(scenes)} scenes go" if len(scenes) > 1 else "a list goes" if listed is not None else "formats go"
        raise UserError(f"{output}: {what} into a folder; name one, or give one scene alone")
    return is_folder or len(scenes) != 1 or listed is not None or bool(formats)


def precompute_scans(
    scenes: Sequence[str],
    listed: str | None,
    folder: str,
    settings: ScanSettings,
    *,
    as_json: bool,
    options: Mapping[str, Any],
) -> int:
    """Do scenes, here or by workers; tell of each, and at the end of those that failed; 1 if there are any."""
    from slepian_prt.datasets.by_workers import mapped_by
    from slepian_prt.datasets.naming import read_list
    from slepian_prt.datasets.precompute_set import run_set
    from slepian_prt.datasets.records import NAME

    started = time.perf_counter()
    wanted = [*scenes, *(read_list(listed) if listed is not None else ())]
    if not wanted:
        raise UserError("no SCENE is given; name some, or a list of them by --from")
    count = len(dict.fromkeys(wanted))
    try:
        with crew_of(options) as crew, progress("scenes", "scenes") as (advance, _), _without_remarks():

            def tell(result: ScanResult) -> None:
                if as_json:
                    click.echo(result.as_line())
                elif not result.kept:
                    _tell(result)
                advance(1, count)

            advance(0, count)
            results = run_set(wanted, folder, settings, tell, map if crew is None else mapped_by(crew))
    except KeyboardInterrupt as interrupt:
        click.echo(f"slepian-prt: {told(interrupt)}; the same command goes on from what is in {folder}", err=True)
        return status_of(interrupt)
    failed = [result for result in results if result.failure is not None]
    kept = sum(result.kept for result in results)
    if not as_json:
        there = f", {kept} there already" if kept else ""
        seconds = time.perf_counter() - started
        say(f"{folder}: {count - kept - len(failed)} done{there}, {len(failed)} failed; {seconds:.1f} s in all")
    _tell_failures(failed, count, Path(folder) / NAME)
    return 1 if failed else 0


@contextmanager
def _without_remarks() -> Iterator[None]:
    """Remarks of the library are told with the scene that they are about."""
    handlers = logging.getLogger("slepian_prt").handlers

    def is_of_workers(record: logging.LogRecord) -> bool:
        return record.name.startswith("slepian_prt.distributed")

    for handler in handlers:
        handler.addFilter(is_of_workers)
    try:
        yield
    finally:
        for handler in handlers:
            handler.removeFilter(is_of_workers)


def _tell(result: ScanResult) -> None:
    if result.failure is None:
        error = "" if result.error is None else f", error {result.error:.2g}"
        seconds = f"{result.seconds['all']:.2f} s"
        say(f"{_shown(result.outputs[0])}: {result.vertices} vertices, {result.bytes} bytes{error}, {seconds}")
    for text in result.notes:
        note(_shown(f"{result.source}: {text}"))


def _tell_failures(failed: Sequence[ScanResult], count: int, records: Path) -> None:
    for result in failed[:_MOST_TOLD]:
        click.echo(f"slepian-prt: {_shown(with_flags(str(result.failure)))}", err=True)
    if failed:
        click.echo(f"slepian-prt: {len(failed)} of {count} scenes failed; {records} says why", err=True)


def _shown(text: str) -> str:
    """Whatever names of files hold."""
    return text.encode(errors="replace").decode()
