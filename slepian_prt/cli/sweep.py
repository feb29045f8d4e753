"""``slepian-prt sweep``."""

from __future__ import annotations

import shlex
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from slepian_prt.cli.backend import machine_options
from slepian_prt.cli.messages import note, say
from slepian_prt.cli.options import (
    albedo_option,
    clamp_option,
    crease_option,
    crew_options,
    effects_option,
    environment_option,
    noise_option,
    output_option,
    parameters_option,
    rotate_option,
    scene_argument,
    seed_option,
)
from slepian_prt.cli.values import Several, read_maps, settings_of
from slepian_prt.cli.workers import crew_of

if TYPE_CHECKING:
    from slepian_prt.evaluation.sweep.results import Sweep


def _axis(flag: str, kind: type, metavar: str, default: str | None, what: str) -> Any:
    """An option of several values, each of which is tried."""
    return click.option(
        flag, type=Several(kind), default=default, show_default=default is not None, metavar=f"{metavar},…", help=what
    )


@click.command()
@scene_argument
@environment_option("Map")
@output_option("Folder for sweep.html, .json, .csv, plots.")
@_axis("--samples", int, "N", "64,256,1024", "Rays per vertex.")
@_axis("--bandlimit", int, "L", "5,10", "Highest degrees.")
@_axis("--clusters", int, "N", "96", "Numbers of caps.")
@_axis("--basis", str, "NAME", "adapted", "Functions to compress with.")
@_axis("--tolerance", float, "E", "0.2,0.05,0.02", "Of compression.")
@_axis("--bounces", int, "N", None, "Of light between surfaces.  [default: until the rest is below 0.1 %]")
@effects_option
@albedo_option
@crease_option
@parameters_option
@seed_option
@rotate_option
@clamp_option
@machine_options
@noise_option(0.005)
@crew_options
def sweep(
    scene: str,
    environment: tuple[str, ...],
    output: str,
    samples: tuple[int, ...],
    bandlimit: tuple[int, ...],
    clusters: tuple[int, ...],
    basis: tuple[str, ...],
    tolerance: tuple[float, ...],
    bounces: tuple[int, ...] | None,
    rotate: float,
    clamp_negative: bool,
    noise: float,
    **options: Any,
) -> None:
    """Accuracy against time and bytes on SCENE: every combination of settings, measured.

    Stopped or killed, the same command goes on from the settings that were finished.
    """
    from slepian_prt.cli.terminal import print_plan, progress
    from slepian_prt.evaluation.sweep.axes import Axes
    from slepian_prt.evaluation.sweep.report import check_sweep, write_sweep
    from slepian_prt.evaluation.sweep.results import find_setbacks
    from slepian_prt.evaluation.sweep.run import sweep as run
    from slepian_prt.transport.settings import TransportSettings

    axes = Axes(samples, bandlimit, clusters, basis, tolerance, bounces or (None,))
    axes.check()
    transport = settings_of(TransportSettings, options)
    check_sweep(output, [scene, *environment], transport.parameters)
    maps = read_maps(environment, clamp_negative, rotate)
    checkpoint = Path(output) / "sweep.partial.jsonl"
    with crew_of(options) as crew, progress("settings", "settings") as (advance, report):
        found = run(
            scene,
            maps,
            axes,
            transport,
            noise=noise,
            checkpoint=checkpoint,
            report=report,
            advance=advance,
            on_plan=print_plan,
            client=crew,
        )
    found = replace(found, command="slepian-prt " + shlex.join(sys.argv[1:]))
    page = write_sweep(found, output)
    for sentence in find_setbacks(found):
        note(sentence)
    _print_front(found)
    say(f"{page}: {len(found.points)} settings")


def _print_front(found: Sweep) -> None:
    """The settings that no other beats in error and time."""
    from slepian_prt.cli.terminal import print_table
    from slepian_prt.evaluation.sweep.report import describe

    print_table(
        {
            "environment": "left",
            "not beaten in time": "left",
            "error": "right",
            "seconds": "right",
            "bytes/vertex": "right",
        },
        [
            [
                row["environment"],
                row["setting"],
                f"{row['error']:.1%}",
                f"{row['seconds']:.2g}",
                f"{row['bytes_per_vertex']:.3g}",
            ]
            for row in describe(found)
        ],
    )
