"""``slepian-prt capture``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from slepian_prt.cli.backend import machine_options
from slepian_prt.cli.messages import note, say
from slepian_prt.cli.options import (
    clamp_option,
    crew_options,
    environment_option,
    output_option,
    parameters_option,
    scene_argument,
    seed_option,
)
from slepian_prt.cli.values import read_maps, settings_of
from slepian_prt.cli.workers import crew_of
from slepian_prt.errors import UserError

if TYPE_CHECKING:
    from slepian_prt.transport.transfer import Transfer


@click.command()
@scene_argument
@output_option("A transfer file .prt, or the coefficients as channels of an .exr.")
@click.option("--sensor", metavar="CAMERA", help="Of the scene, by id or number.  [default: the first]")
@click.option("--bandlimit", default=10, show_default=True, help="Highest degree L of the spherical harmonics.")
@click.option("--samples", type=int, help="Paths of each pixel.  [default: 256]")
@click.option(
    "--max-error",
    type=float,
    metavar="E",
    help="Instead: as many as bring the noise of the relit picture down to E (0.05 is 5 %) under --environment.",
)
@click.option("--max-seconds", type=float, metavar="S", help="Instead: as many as take S.")
@environment_option("Map that the noise is about")
@clamp_option
@click.option("--tolerance", type=float, help="Wanted relative error of coding.  [default: that of the noise]")
@click.option("--no-smooth", is_flag=True, help="Keep the noise as it is.")
@machine_options
@parameters_option
@seed_option
@crew_options
def capture(
    scene: str,
    output: str,
    environment: tuple[str, ...],
    clamp_negative: bool,
    tolerance: float | None,
    no_smooth: bool,
    **options: Any,
) -> None:
    """Render a camera of SCENE (Mitsuba xml) once: its picture under any light comes from that file, by relight.

    All that Mitsuba's paths bring is in it: mirrors, glass, caustics, hair, media, depth of field. Stopped or killed,
    the same command goes on from the blocks of pixels that were finished.
    """
    from slepian_prt.cli.terminal import progress
    from slepian_prt.compression.film_compression import check_tolerance, compress_film, film_of
    from slepian_prt.lighting.formats.coefficient_layers import write_coefficients
    from slepian_prt.scene.named_files import check_output_file
    from slepian_prt.transport.capturing.capture import open_capture
    from slepian_prt.transport.capturing.settings import CaptureSettings

    settings = settings_of(CaptureSettings, options, smooth=not no_smooth)
    check_tolerance(tolerance)
    check_output_file(output, scene, *environment, parameters=options["parameters"])
    suffix = Path(output).suffix.lower()
    if suffix not in (".prt", ".exr"):
        raise UserError(f"{output}: captures are written as .prt, or their coefficients as .exr; name the output so")
    if environment and settings.max_error is None:
        raise UserError("`environment` says what `max_error` is about; give that too, and relight the file afterwards")
    power = _mean_power(environment, clamp_negative, settings.bandlimit)
    with (
        crew_of(options) as crew,
        progress("paths", "pixels") as (advance, report),
        open_capture(scene, settings, power, advance, report, crew) as transfer,
    ):
        film = film_of(transfer)
        if suffix == ".exr":
            write_coefficients(output, transfer.vectors, film.background, film.width, film.height)
        else:
            report("coding")
            compress_film(transfer, tolerance).save(output)
    _say_what_came_of_it(output, transfer, settings.max_error, power)


def _mean_power(environment: tuple[str, ...], clamp_negative: bool, bandlimit: int) -> Any:
    """Power per harmonic of the maps, each as bright as the others; None without any."""
    if not environment:
        return None
    from slepian_prt.lighting.projection import project_environment
    from slepian_prt.lighting.spectrum import measured_prior

    lights = [project_environment(one, bandlimit) for one in read_maps(environment, clamp_negative)]
    return measured_prior(lights, bandlimit, ", ".join(environment)).weights ** 2


def _say_what_came_of_it(output: str, transfer: Transfer, wanted: float | None, power: Any) -> None:
    from slepian_prt.compression.film_compression import film_of, noise_of

    film, noise = film_of(transfer), noise_of(transfer, power)
    if wanted is not None and noise > wanted:
        note(f"a noise of {wanted:g} was not reached; it is {noise:.2g} after {transfer.samples} samples of each pixel")
    pixels = film.width * film.height
    size = Path(output).stat().st_size
    say(
        f"{output}: {film.width} x {film.height} pixels of camera '{film.name}', {transfer.samples} paths of each in "
        f"{transfer.seconds['transport']:.1f} s, noise {noise:.2g}, {size / pixels:.1f} bytes per pixel"
    )
