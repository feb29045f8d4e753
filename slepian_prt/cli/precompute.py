"""``slepian-prt precompute``."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from slepian_prt.cli.backend import machine_options
from slepian_prt.cli.messages import note, say
from slepian_prt.cli.options import crew_options, grouping_options, output_option, transport_options
from slepian_prt.cli.precompute_options import compression_options, goal_options, keep_order_option
from slepian_prt.cli.scans import into_folder, precompute_scans, set_options
from slepian_prt.cli.values import read_light, settings_of
from slepian_prt.cli.workers import crew_of
from slepian_prt.errors import UserError
from slepian_prt.files import KEPT_ORDER

if TYPE_CHECKING:
    from slepian_prt.compression.settings import CompressionSettings
    from slepian_prt.distributed.crew import Crew
    from slepian_prt.transport.settings import TransportSettings

_GIVEN = ParameterSource.COMMANDLINE


@click.command()
@click.argument("scenes", nargs=-1, type=click.Path(), metavar="SCENE...")
@output_option("File of one scene (.prt), or folder of any number of them.")
@set_options
@goal_options
@transport_options
@compression_options
@keep_order_option
@grouping_options
@crew_options
@machine_options
@click.pass_context
def precompute(
    context: click.Context,
    scenes: tuple[str, ...],
    output: str,
    listed: str | None,
    formats: tuple[str, ...],
    as_json: bool,
    max_error: float | None,
    max_seconds: float | None,
    environment: tuple[str, ...],
    light_prior: tuple[str, ...],
    clamp_negative: bool,
    keep_order: bool,
    **options: Any,
) -> int:
    """Precompute the transfer of each SCENE (ply, obj, stl, off, glb, gltf or Mitsuba xml), compress it, write a file.

    Stopped or killed, the same command goes on from the blocks of vertices that were finished.

    Several scenes, or those of a list, go into a folder, each into a file of its name, and results.jsonl there tells of
    each. What is there already is not done again. A scene that fails does not stop the others; the exit status is 1.

    With --max-error or --max-seconds, rays, bandlimit and tolerance are chosen from a pilot, unless they are given, and
    what came of it is verified on vertices held out.

    With --workers or --scheduler, blocks of vertices, or the scenes of a folder, are shared among processes and
    machines; the files are the same.
    """
    from slepian_prt.accuracy.goal import Goal
    from slepian_prt.compression.settings import CompressionSettings
    from slepian_prt.transport.settings import TransportSettings

    started = time.perf_counter()
    transport = settings_of(TransportSettings, options)
    given = {name: options[name] for name in ("samples", "bandlimit") if context.get_parameter_source(name) is _GIVEN}
    goal = Goal(max_error, max_seconds, **given) if max_error is not None or max_seconds is not None else None
    if environment and goal is None:
        raise UserError("`environment` says what `max_error` and `max_seconds` are about; give one of them too")
    if clamp_negative and not environment and not light_prior:
        note("`clamp_negative` has no effect without a map: give `environment` or `light_prior`")
    prior = None
    if light_prior and goal is None:
        prior = read_light((), light_prior, clamp_negative).prior(transport.bandlimit)
    settings = settings_of(CompressionSettings, options, light_prior=prior)
    settings.check(transport.bandlimit)
    is_set = into_folder(scenes, listed, formats, output)
    if not is_set:
        _check_one(scenes[0], output, as_json, transport)
    light = None
    if goal is not None:
        goal.check()
        light = read_light(environment, light_prior, clamp_negative)
    if is_set:
        from slepian_prt.datasets.jobs import ScanSettings

        kept_order = sys.maxsize if keep_order else KEPT_ORDER
        asked = ScanSettings(formats or ("prt",), transport, settings, goal, light, kept_order, given.get("samples"))
        return precompute_scans(scenes, listed, output, asked, as_json=as_json, options=options)
    with crew_of(options) as crew:
        if goal is None or light is None:
            _precompute(scenes[0], output, settings, transport, crew, keep_order=keep_order)
        else:
            from slepian_prt.cli.goal import precompute_toward

            precompute_toward(scenes[0], output, goal, light, settings, transport, crew, started, keep_order=keep_order)
    return 0


def _check_one(scene: str, output: str, as_json: bool, transport: TransportSettings) -> None:
    """What is asked of a single file."""
    from slepian_prt.scene.named_files import check_output_file

    check_output_file(output, scene, parameters=transport.parameters)
    if Path(output).suffix.lower() != ".prt":
        raise UserError(f"{output}: transfer files end in .prt; name the output so, or with a / at its end as a folder")
    if as_json:
        raise UserError("--json tells of scenes that go into a folder; name the output with a / at its end")


def _precompute(
    scene: str,
    output: str,
    settings: CompressionSettings,
    transport: TransportSettings,
    crew: Crew | None,
    *,
    keep_order: bool,
) -> None:
    """As asked for."""
    from slepian_prt.cache_folder import work_kept
    from slepian_prt.cli.terminal import describe, print_plan, progress
    from slepian_prt.compression.noise import finest_tolerance
    from slepian_prt.compression.stream import compress_scene

    with work_kept():
        with progress("transport", "vertices") as (advance, report):
            packed = compress_scene(
                scene, settings, transport, on_plan=print_plan, advance=advance, report=report, crew=crew
            )
        packed.save(output, keep_order=keep_order or packed.vertex_count <= KEPT_ORDER)
    if transport.bounces is not None and packed.bounces < transport.bounces:
        note(f"`bounces={transport.bounces}` has no effect: no light between surfaces is simulated (see the plan)")
    error = settings.expected_error(packed.expected)
    wanted = settings.resolved_tolerance
    if packed.path_noise is not None:
        wanted = max(wanted, finest_tolerance(packed.path_noise, packed.expected.total, settings.light_prior))
    if not settings.by_number and error > 1.01 * wanted:
        note(f"a tolerance of {wanted:g} cannot be met with basis {packed.basis} here; the error is {error:.2g}")
    under = f" under light of {packed.prior}" if packed.prior else ""
    say(
        f"{output}: {describe(packed)}, predicted error {error:.2g}{under}; {packed.rays_traced} rays in "
        f"{packed.seconds['transport']:.1f} s, compressed in {packed.seconds['compress']:.1f} s"
    )
