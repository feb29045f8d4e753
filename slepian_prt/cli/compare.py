"""``slepian-prt compare``."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from slepian_prt.cli.backend import machine_options
from slepian_prt.cli.messages import say
from slepian_prt.cli.options import (
    clamp_option,
    crew_options,
    environment_option,
    grouping_options,
    noise_option,
    output_option,
    picture_options,
    rotate_option,
    scene_argument,
    transport_options,
    width_option,
)
from slepian_prt.cli.values import read_maps, settings_of
from slepian_prt.cli.workers import crew_of
from slepian_prt.errors import UserError

if TYPE_CHECKING:
    from slepian_prt.evaluation.sweep.results import Sweep


@click.command()
@scene_argument
@environment_option("Map")
@output_option("Folder for report.html, results.json, figures.")
@click.option("--basis", "bases", multiple=True, help="Only these methods; may be given several times.")
@click.option("--all", "all_methods", is_flag=True, help="All methods, which takes about five times as long.")
@click.option("--terms", "terms", multiple=True, type=int, help="Numbers of functions; may be given several times.")
@transport_options
@grouping_options
@rotate_option
@clamp_option
@width_option("Of the pictures", 400)
@picture_options
@noise_option(0.01)
@click.option(
    "--sweep",
    "swept",
    type=click.Path(),
    metavar="FILE",
    help="The sweep.json of this scene: its fronts are shown too.",
)
@crew_options
@click.option("--viewer", is_flag=True, help="Beside the report, a page to turn model and light in: viewer.html.")
@machine_options
def compare(
    scene: str,
    environment: tuple[str, ...],
    output: str,
    swept: str | None,
    bases: tuple[str, ...],
    all_methods: bool,
    terms: tuple[int, ...],
    rotate: float,
    clamp_negative: bool,
    width: int | None,
    noise: float,
    viewer: bool,
    **options: Any,
) -> None:
    """Compare methods on SCENE: errors against full SH and path-traced references, as a report and as JSON.

    Without --basis or --all: the adapted basis, the paper's, spherical harmonics and principal components. The light of
    adapted+light is the mean spectrum of the maps.
    """
    from slepian_prt.cli.terminal import print_plan, progress
    from slepian_prt.compression.settings import CompressionSettings
    from slepian_prt.evaluation.compare import compare as run
    from slepian_prt.evaluation.methods import DEFAULT_METHODS, DEFAULT_TERMS, METHODS, check_methods
    from slepian_prt.evaluation.report import check_report, write_report
    from slepian_prt.relighting.drawing.pictures import Finish
    from slepian_prt.scene.view import Aim
    from slepian_prt.transport.settings import TransportSettings
    from slepian_prt.viewer.pages import PageWish

    transport = settings_of(TransportSettings, options)
    grouping = settings_of(CompressionSettings, options)
    grouping.check(transport.bandlimit)
    options["background"] = options["background"] or "white"
    aim, finish = settings_of(Aim, options), settings_of(Finish, options)
    if all_methods and bases:
        raise UserError("`all` is all methods, `basis` some of them; give one of the two")
    check_methods(bases)
    for k in terms:
        CompressionSettings(terms=k).check(transport.bandlimit)
    inputs = [scene, *environment, *([] if swept is None else [swept])]
    check_report(output, inputs, [Path(path).stem for path in environment], transport.parameters)
    sweep = None if swept is None else _read_sweep(swept, scene)
    maps = read_maps(environment, clamp_negative, rotate, aim.up)
    with crew_of(options) as crew, progress("transport", "vertices") as (advance, report):
        comparison = run(
            scene,
            maps,
            transport=transport,
            grouping=grouping,
            methods=bases or (tuple(METHODS) if all_methods else DEFAULT_METHODS),
            terms=terms or DEFAULT_TERMS,
            width=width,
            noise=noise,
            aim=aim,
            finish=finish,
            report=report,
            on_plan=print_plan,
            advance=advance,
            client=crew,
        )
    wish = PageWish(aim=aim) if viewer else None
    page = write_report(comparison, output, "slepian-prt " + shlex.join(sys.argv[1:]), sweep, wish)
    lights = f"{len(comparison.views)} environment{'s' if len(comparison.views) > 1 else ''}"
    say(f"{page}: {len(comparison.methods)} methods, {lights}, {comparison.seconds:.0f} s")


def _read_sweep(file: str, scene: str) -> Sweep:
    from slepian_prt.evaluation.sweep.results import Sweep

    sweep = Sweep.read(file)
    if Path(sweep.source).name != Path(scene).name:
        raise UserError(f"{file}: is a sweep of {sweep.source}, not of {scene}; name that of this scene")
    return sweep
