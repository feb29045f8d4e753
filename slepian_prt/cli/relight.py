"""``slepian-prt relight``."""

from __future__ import annotations

from pathlib import Path

import click

from slepian_prt.cli.messages import note, say
from slepian_prt.cli.options import (
    clamp_option,
    environment_option,
    file_argument,
    output_option,
    rotate_option,
    width_option,
)
from slepian_prt.cli.values import Names


@click.command()
@file_argument
@environment_option("Map: .exr, .hdr or .png, twice as wide as high")
@rotate_option
@click.option("--turntable", type=int, metavar="N", help="N results, the light turned once about the up axis.")
@click.option("--window", type=Names("window"), help="Damp high degrees, against ringing of suns.")
@click.option(
    "--window-width",
    type=float,
    metavar="L",
    help="Degree that the window ends at.  [default: 0.1 % of vertices negative]",
)
@clamp_option
@width_option("Of a picture", 800)
@click.option(
    "--format",
    "kind",
    type=click.Choice(["png", "exr", "npz", "ply"]),
    default="png",
    show_default=True,
    help="Of the files in a folder.",
)
@output_option()
def relight(
    file: str,
    environment: tuple[str, ...],
    rotate: float,
    turntable: int | None,
    window: str | None,
    window_width: float | None,
    clamp_negative: bool,
    width: int | None,
    kind: str,
    output: str,
) -> None:
    """Relight a transfer FILE: radiance per vertex (.npz), coloured mesh (.ply) or picture (.png, .exr).

    Several lights (maps, or --turntable) give a folder of such files, one .npz, or a film (.mp4).
    """
    from slepian_prt.compression.prt_file import load
    from slepian_prt.relighting.outputs import check_output, write_relit
    from slepian_prt.relighting.series import Lights, relight_series

    lights = Lights(environment, rotate, turntable, window, window_width, clamp_negative)
    check_output(output, file, *environment, several=lights.several)
    packed = load(file)
    series = relight_series(packed, lights, file, note)
    write_relit(output, packed, series, f".{kind}", width, note)
    shone = ", ".join(Path(path).name for path in environment) or "the light of the scene"
    several = f", {len(series.names)} results" if lights.several else ""
    say(f"{output}: {len(packed.mesh.positions)} vertices under {shone}{several}")
