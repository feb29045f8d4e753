"""``slepian-prt spectrum``."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING

import click

from slepian_prt.errors import UserError

if TYPE_CHECKING:
    from slepian_prt.evaluation.error_identity import IdentityRow
    from slepian_prt.evaluation.spectra import Spectrum

_SHOWN = 12

_NAMES = (
    ("shannon", "Shannon number N"),
    ("n_g", "generalised, N_g (Lessig & Fiume 2010, base-10 logarithms)"),
    ("n_g_natural", "generalised, natural logarithms"),
    ("n_ref", "two-term asymptotics, N_ref"),
    ("szego", "by Szegő's theorem (after Mahajan et al. 2007)"),
    ("n_ref_transport", "two-term asymptotics of the kernel's own band"),
)


@click.command()
@click.option("--bandlimit", required=True, type=int, help="Highest degree L, up to 500.")
@click.option("--half-angle", required=True, type=float, metavar="DEG", help="Half-angle of the cap, in degrees.")
@click.option("--kernel", default="slepian", show_default=True, help="slepian, diffuse or phong:EXPONENT.")
@click.option("--epsilon", default=0.01, show_default=True, help="Concentration down to which functions count.")
@click.option("--radial", is_flag=True, help="Only radially symmetric functions, those of order 0.")
@click.option("--check", is_flag=True, help="Check the error of a random signal against the paper's identity.")
@click.option("--json", "json_file", type=click.Path(), help="Write all eigenvalues and numbers to this file.")
@click.option("--plot", "plot_file", type=click.Path(), help="Write a plot to this .png.")
def spectrum(
    bandlimit: int,
    half_angle: float,
    kernel: str,
    epsilon: float,
    radial: bool,
    check: bool,
    json_file: str | None,
    plot_file: str | None,
) -> None:
    """Eigenvalues of the concentration problem on a cap, and the Shannon numbers that estimate their count."""
    from slepian_prt import files
    from slepian_prt.evaluation import spectra
    from slepian_prt.evaluation.error_identity import check_size

    if not 0.0 <= half_angle <= 180.0:
        raise UserError(f"half_angle must be between 0 and 180 degrees, not {half_angle:g}")
    for path in (json_file, plot_file):
        if path is not None:
            files.check_writable(path)
    if json_file is not None and plot_file is not None and Path(json_file).resolve() == Path(plot_file).resolve():
        raise UserError(f"{json_file}: `json` and `plot` must be two files")
    if plot_file is not None and Path(plot_file).suffix.lower() != ".png":
        raise UserError(f"{plot_file}: plots are written as .png")
    if check:
        check_size(bandlimit)
    result = spectra.spectrum(bandlimit, math.radians(half_angle), kernel, epsilon, radially_symmetric=radial)
    content = result.as_dict()
    rows = _measure_identity(result) if check else []
    if check:
        content["error_identity"] = [_identity_row(x) for x in rows]
    # Files first: who reads what is printed may stop before its end.
    if json_file is not None:
        with files.atomic_output(json_file) as file:
            file.write((json.dumps(content, indent=1) + "\n").encode())
    if plot_file is not None:
        picture = spectra.plot_spectrum(result)
        with files.atomic_output(plot_file) as file:
            file.write(picture)
    _print_numbers(result)
    if check:
        _print_identity(rows)


def _print_numbers(result: Spectrum) -> None:
    from slepian_prt.slepian.concentration import SMALLEST_KNOWN

    functions = "radially symmetric functions" if result.radially_symmetric else "functions"
    angle = math.degrees(result.half_angle)
    click.echo(
        f"L = {result.bandlimit}, half-angle {angle:g} degrees, {result.dimension} {functions}, kernel {result.kernel}"
    )
    click.echo(f"concentrations above {result.epsilon:g}: {result.numbers['count']:.0f}")
    if "transport_count" in result.numbers:
        count = result.numbers["transport_count"]
        click.echo(f"eigenvalues of transport above {result.epsilon:g} of the first: {count:.0f}")
    click.echo(
        f"effective dimension {result.effective_dimension} of {result.dimension}, coherence {result.coherence:.2f}"
    )
    for name, text in _NAMES:
        if name in result.numbers and not (name == "szego" and result.kernel == "slepian"):  # where it is N
            click.echo(f"{result.numbers[name]:10.2f}  {text}")
    click.echo(f"first eigenvalues{'' if result.kernel == 'slepian' else ', relative to the first'} (order m):")
    for value, order in zip(result.eigenvalues[:_SHOWN], result.orders[:_SHOWN], strict=True):
        shown = f"{value:.10g}" if value >= SMALLEST_KNOWN else f"below {SMALLEST_KNOWN:g}"
        click.echo(f"  {shown}  (m = {order:+d})")


def _measure_identity(result: Spectrum) -> list[IdentityRow]:
    from slepian_prt.evaluation import error_identity, spectra

    return error_identity.measure_identity(
        result.bandlimit,
        result.half_angle,
        spectra.terms_to_check(result),
        kernel=spectra.parse_kernel(result.kernel, result.bandlimit),
        radially_symmetric=result.radially_symmetric,
    )


def _identity_row(row: IdentityRow) -> dict[str, float | None]:
    """For JSON, which has no word for infinity."""
    difference = row.difference if math.isfinite(row.difference) else None
    return {"terms": row.terms, "quadrature": row.quadrature, "identity": row.identity, "difference": difference}


def _print_identity(rows: list[IdentityRow]) -> None:
    click.echo(
        "squared error of a random signal over the cap with its first K functions, by quadrature and as the sum of"
    )
    click.echo("squared coefficients times eigenvalues of the others (Lessig & Fiume 2010, Sec. 3):")
    click.echo("     K   by quadrature    as the sum   difference")
    for row in rows:
        click.echo(f"{row.terms:6d}  {row.quadrature:14.7g}{row.identity:14.7g}{row.difference:13.1e}")
