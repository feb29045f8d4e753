"""``slepian-prt spectrum``."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING

import click

from slepian_prt.errors import UserError

if TYPE_CHECKING:
    from slepian_prt.evaluation.spectra import Spectrum

_SHOWN = 12


@click.command()
@click.option("--bandlimit", required=True, type=int, help="Highest degree L, up to 500.")
@click.option("--half-angle", required=True, type=float, metavar="DEG", help="Half-angle of the cap, in degrees.")
@click.option("--kernel", default="slepian", show_default=True, help="slepian, diffuse or phong:EXPONENT.")
@click.option("--epsilon", default=0.01, show_default=True, help="Concentration down to which functions count.")
@click.option("--json", "json_file", type=click.Path(), help="Write all eigenvalues and numbers to this file.")
@click.option("--plot", "plot_file", type=click.Path(), help="Write a plot to this .png.")
def spectrum(
    bandlimit: int, half_angle: float, kernel: str, epsilon: float, json_file: str | None, plot_file: str | None
) -> None:
    """Eigenvalues of the concentration problem on a cap, and the Shannon numbers that estimate their count."""
    from slepian_prt import files
    from slepian_prt.evaluation import spectra

    if not 0.0 <= half_angle <= 180.0:
        raise UserError(f"half_angle must be between 0 and 180 degrees, not {half_angle:g}")
    for path in (json_file, plot_file):
        if path is not None:
            files.check_writable(path)
    if plot_file is not None and Path(plot_file).suffix.lower() != ".png":
        raise UserError(f"{plot_file}: plots are written as .png")
    result = spectra.spectrum(bandlimit, math.radians(half_angle), kernel, epsilon)
    click.echo(f"L = {bandlimit}, half-angle {half_angle:g} degrees, {(bandlimit + 1) ** 2} functions, kernel {kernel}")
    click.echo(f"concentrations above {epsilon:g}: {result.numbers['count']:.0f}")
    _print_numbers(result, kernel)
    if json_file is not None:
        with files.atomic_output(json_file) as file:
            file.write((json.dumps(result.as_dict(), indent=1) + "\n").encode())
    if plot_file is not None:
        content = spectra.plot_spectrum(result)
        with files.atomic_output(plot_file) as file:
            file.write(content)


def _print_numbers(result: Spectrum, kernel: str) -> None:
    for name, text in (
        ("shannon", "Shannon number N"),
        ("n_g", "generalised, N_g (Lessig & Fiume 2010, base-10 logarithms)"),
        ("n_g_natural", "generalised, natural logarithms"),
        ("n_ref", "two-term asymptotics, N_ref"),
    ):
        click.echo(f"{result.numbers[name]:10.2f}  {text}")
    click.echo(f"first eigenvalues{'' if kernel == 'slepian' else ', relative to the first'} (order m):")
    for value, order in zip(result.eigenvalues[:_SHOWN], result.orders[:_SHOWN], strict=True):
        click.echo(f"  {value:.10g}  (m = {order:+d})")
