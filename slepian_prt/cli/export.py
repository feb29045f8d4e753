"""``slepian-prt export``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from slepian_prt.cli.backend import machine_options
from slepian_prt.cli.messages import note, say
from slepian_prt.cli.options import clamp_option, file_argument, output_option, rotate_option
from slepian_prt.cli.values import read_transfer
from slepian_prt.errors import UserError
from slepian_prt.export.kinds import ATTRIBUTES, GAMES202, KINDS, check_export

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from slepian_prt.export.model import Exported


@click.command()
@file_argument
@click.option(
    "--as",
    "what",
    type=click.Choice(KINDS),
    default="transfer",
    show_default=True,
    help="Transfer, for a shader that relights it; or what engines have a place for, with its loss.",
)
@click.option(
    "--functions", type=int, metavar="K", help="Bytes per vertex of transfer: 8, 16, 24, 32 or more.  [default: 16]"
)
@click.option(
    "--attributes",
    type=click.Choice(ATTRIBUTES),
    help="How those are carried: float for Blender, texture for what keeps only texture coordinates.  [default: bytes]",
)
@click.option(
    "--environment",
    multiple=True,
    type=click.Path(),
    help="Map, or .txt of harmonics, to tell the loss under; may be given several times.",
)
@rotate_option
@clamp_option
@click.option("--scene", type=click.Path(), metavar="PATH", help="What FILE was made from: its textures are written.")
@click.option("--up", type=click.Choice(["y", "z"]), default="y", show_default=True, help="What is up in the model.")
@output_option("Where to write: .glb, or .ply for all but transfer; .txt for games202.")
@machine_options
def export(
    file: str,
    what: str,
    functions: int | None,
    attributes: str | None,
    environment: tuple[str, ...],
    rotate: float,
    clamp_negative: bool,
    scene: str | None,
    up: str,
    output: str,
) -> None:
    """Export a transfer FILE for engines: a model to be relit by a shader (.glb), or ambient occlusion and the like."""
    from slepian_prt.export.games202_files import check_games202
    from slepian_prt.export.model import export_model
    from slepian_prt.lighting.environment import check_names
    from slepian_prt.relighting.files.wishes import check_source

    if not environment and (rotate or clamp_negative):
        name = "rotate" if rotate else "clamp_negative"
        raise UserError(f"`{name}` is about a map to tell the loss under, and none is named; give `environment` too")
    inputs = [file, *environment, *([scene] if scene else [])]
    check_export(output, what, functions, attributes, inputs)
    check_names(environment)
    if what == GAMES202:
        check_games202(output, [Path(path).stem for path in environment], inputs)
    packed = read_transfer(file)
    check_source(output, packed, file)
    lights = _read_lights(environment, packed.bandlimit, rotate, clamp_negative, up)
    exported = export_model(
        packed, output, what, functions=functions, attributes=attributes, lights=lights, scene=scene, up=up, file=file,
        report=note,
    )  # fmt: skip
    say(f"{output}: {exported.vertices} vertices {_told(exported, what)}")


def _read_lights(
    paths: Sequence[str], bandlimit: int, rotate: float, clamp_negative: bool, up: str
) -> dict[str, NDArray]:
    """Coefficients of maps, or of lighting as text, as they stand; what was mended in them is noted."""
    from slepian_prt.lighting.environment import about_up
    from slepian_prt.lighting.fitting import each_remark_once
    from slepian_prt.lighting.projection import project_checked
    from slepian_prt.scene.view import up_rotation

    lights, stand = {}, up_rotation(up) @ about_up(rotate)
    with each_remark_once():
        for path in paths:
            lights[Path(path).stem], clamped = project_checked(
                path, bandlimit, rotate=stand, clamp_negative=clamp_negative, fitted_to="the transfer"
            )
            if clamped:
                note(f"{path}: {clamped} negative texels set to zero")
    return lights


def _told(exported: Exported, what: str) -> str:
    """What it costs."""
    measured = "".join(f", {error:.2%} under {name}" for name, error in exported.measured.items())
    return (
        f"as {what}, which costs {exported.error:.2%} of radiance here{measured}; "
        f"{exported.relit_error:.2%} with what the file lost"
    )
