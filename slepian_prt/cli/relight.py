"""``slepian-prt relight``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from slepian_prt.cli.backend import machine_options
from slepian_prt.cli.messages import note, say
from slepian_prt.cli.options import (
    clamp_option,
    environment_option,
    file_argument,
    fixed_lights_option,
    output_option,
    picture_options,
    rotate_option,
    width_option,
)
from slepian_prt.cli.values import Names, read_transfer, settings_of


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
@fixed_lights_option
@click.option("--turn-directional", is_flag=True, help="Turn directional lamps with the map; their shadows get soft.")
@width_option("Of a picture", 800)
@picture_options
@click.option(
    "--scene",
    type=click.Path(),
    metavar="PATH",
    help="What FILE was made from: its textures, mirrors, glass are drawn.",
)
@click.option("--spp", type=int, metavar="N", help="Samples of each pixel of such pictures.")
@click.option(
    "--format",
    "kind",
    type=click.Choice(["png", "exr", "npz", "ply", "glb"]),
    default="png",
    show_default=True,
    help="Of the files in a folder.",
)
@output_option()
@machine_options
def relight(
    file: str,
    environment: tuple[str, ...],
    rotate: float,
    turntable: int | None,
    window: str | None,
    window_width: float | None,
    clamp_negative: bool,
    fixed_lights: dict[str, float] | float,
    turn_directional: bool,
    width: int | None,
    scene: str | None,
    spp: int | None,
    kind: str,
    output: str,
    **options: Any,
) -> None:
    """Relight a transfer FILE: radiance per vertex (.npz), coloured mesh (.ply, .glb) or picture (.png, .exr).

    Several lights (maps, or --turntable) give a folder of such files, one .npz, or a film (.mp4).
    """
    from slepian_prt.relighting.drawing.pictures import MAP, TRANSPARENT, Finish
    from slepian_prt.relighting.files.outputs import write_relit
    from slepian_prt.relighting.files.wishes import Wish, check_film, check_output, check_source
    from slepian_prt.relighting.series import Lights, relight_series
    from slepian_prt.scene.view import Aim

    options["background"] = options["background"] or TRANSPARENT
    aim, finish = settings_of(Aim, options), settings_of(Finish, options)
    wish = Wish(f".{kind}", width, aim, finish, scene, spp)
    drawn = wish.draws(output)
    lights = Lights(
        environment, rotate, turntable, window, window_width, clamp_negative, aim.axis,
        shown=drawn and finish.background == MAP, fixed_lights=fixed_lights,
        turn_directional=turn_directional,
    )  # fmt: skip
    check_output(output, [file, *environment, *([scene] if scene else [])], lights.names, wish, several=lights.several)
    packed = read_transfer(file)
    check_source(output, packed, file, lights.names if lights.several else (), wish.suffix)
    check_film(output, packed, wish)
    series = relight_series(packed, lights, file, note)
    write_relit(output, packed, series, wish, note, file)
    shone = ", ".join(Path(path).name for path in environment) or "the light of the scene"
    several = f", {len(series.names)} results" if lights.several else ""
    what, told = ("vertices", "") if packed.film is None else ("pixels", f", noise {packed.noise(series.lighting):.2g}")
    say(f"{output}: {len(packed.mesh.positions)} {what} under {shone}{several}{told}")
