"""``slepian-prt precompute``."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from slepian_prt.cli.backend import variant_option
from slepian_prt.cli.messages import note, say
from slepian_prt.cli.options import (
    KEPT_ORDER,
    clamp_option,
    environment_option,
    grouping_options,
    output_option,
    scene_argument,
    together,
    transport_options,
)
from slepian_prt.cli.values import Names, read_light, settings_of
from slepian_prt.errors import UserError

if TYPE_CHECKING:
    from slepian_prt.compression.settings import CompressionSettings
    from slepian_prt.transport.settings import TransportSettings

# How to compress: fields of `CompressionSettings`.
_compression_options = together(
    click.option(
        "--basis",
        type=Names("basis"),
        default="adapted",
        show_default=True,
        help="Functions to compress with.",
    ),
    click.option("--tolerance", type=float, help="Wanted relative error.  [default: 0.02]"),
    click.option("--terms", type=int, help="Instead: this many functions in every cap."),
    click.option("--truncate", type=Names("truncate"), help="Instead: at the cap's Shannon number."),
    click.option("--epsilon", type=float, help="Concentration that --truncate counts down to.  [default: 0.01]"),
    click.option(
        "--light-prior",
        multiple=True,
        metavar="1/(l+1)|MAP",
        help="Errors count under light of such a spectrum: falling, or that of a map; maps may be given several times.",
    ),
    click.option(
        "--refine/--no-refine",
        default=None,
        help="Principal axes inside the coefficients of each cap.  [default: where it makes the file smaller]",
    ),
    click.option(
        "--coding",
        type=Names("coding"),
        help="Coefficients: predicted, rounded, entropy-coded; or plain.  [default: coded; by --terms float32]",
    ),
    click.option(
        "--exact-mesh",
        is_flag=True,
        default=False,
        help="Positions and albedo to the bit, normals in float32.  [default: to 1/65535 of the model, 0.25 degrees]",
    ),
)

_keep_order_option = click.option(
    "--keep-order",
    is_flag=True,
    help="Vertices in the order of SCENE, not in that of the file, which is 2 bytes smaller for each; always for up "
    f"to {KEPT_ORDER:,} vertices.",
)

_goal_options = together(
    click.option(
        "--max-error",
        type=float,
        metavar="E",
        help="Choose rays, bandlimit and tolerance: the fastest whose radiance is off by at most E (0.05 is 5 %) under "
        "--environment or light of the --light-prior.",
    ),
    click.option("--max-seconds", type=float, metavar="S", help="Choose them: the most exact that takes at most S."),
    environment_option("Map that the goal is about"),
    clamp_option,
)


@click.command()
@scene_argument
@output_option()
@_goal_options
@transport_options
@_compression_options
@_keep_order_option
@grouping_options
@variant_option
@click.pass_context
def precompute(
    context: click.Context,
    scene: str,
    output: str,
    max_error: float | None,
    max_seconds: float | None,
    environment: tuple[str, ...],
    light_prior: tuple[str, ...],
    clamp_negative: bool,
    keep_order: bool,
    **options: Any,
) -> None:
    """Precompute the transfer of SCENE (ply, obj, stl, off, glb, gltf or Mitsuba xml), compress it, write one file.

    Stopped or killed, the same command goes on from the blocks of vertices that were finished.

    With --max-error or --max-seconds, rays, bandlimit and tolerance are chosen from a pilot, unless they are given, and
    what came of it is verified on vertices held out.
    """
    from slepian_prt import files
    from slepian_prt.accuracy.goal import Goal
    from slepian_prt.compression.settings import CompressionSettings
    from slepian_prt.transport.settings import TransportSettings

    started = time.perf_counter()
    transport = settings_of(TransportSettings, options)
    aimed = max_error is not None or max_seconds is not None
    if environment and not aimed:
        raise UserError("`environment` says what `max_error` and `max_seconds` are about; give one of them too")
    if clamp_negative and not environment and not light_prior:
        note("`clamp_negative` has no effect without a map: give `environment` or `light_prior`")
    prior = None
    if light_prior and not aimed:
        prior = read_light((), light_prior, clamp_negative).prior(transport.bandlimit)
    settings = settings_of(CompressionSettings, options, light_prior=prior)
    settings.check(transport.bandlimit)
    files.check_writable(output, scene)
    if Path(output).suffix.lower() != ".prt":
        raise UserError(f"{output}: transfer files end in .prt; name the output so")
    if aimed:
        from slepian_prt.cli.goal import precompute_toward

        given = {
            name: options[name]
            for name in ("samples", "bandlimit")
            if context.get_parameter_source(name) is ParameterSource.COMMANDLINE
        }
        goal = Goal(max_error, max_seconds, **given)
        goal.check()
        light = read_light(environment, light_prior, clamp_negative)
        precompute_toward(scene, output, goal, light, settings, transport, started, keep_order=keep_order)
    else:
        _precompute(scene, output, settings, transport, keep_order=keep_order)


def _precompute(
    scene: str, output: str, settings: CompressionSettings, transport: TransportSettings, *, keep_order: bool
) -> None:
    """As asked for."""
    from slepian_prt.cli.terminal import describe, print_plan, progress
    from slepian_prt.compression.noise import finest_tolerance
    from slepian_prt.compression.stream import precompute_compressed

    with progress("transport", "vertices") as (advance, report):
        packed = precompute_compressed(scene, settings, transport, on_plan=print_plan, advance=advance, report=report)
    if transport.bounces is not None and packed.bounces < transport.bounces:
        note(f"`bounces={transport.bounces}` has no effect: no light between surfaces is simulated (see the plan)")
    packed.save(output, keep_order=keep_order or packed.vertex_count <= KEPT_ORDER)
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
