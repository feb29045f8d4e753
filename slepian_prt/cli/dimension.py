"""``slepian-prt dimension``."""

from __future__ import annotations

import math
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from slepian_prt.cli.backend import machine_options
from slepian_prt.cli.messages import note, say
from slepian_prt.cli.options import camera_options, output_option, transport_options, width_option
from slepian_prt.cli.values import read_transfer, settings_of

if TYPE_CHECKING:
    from slepian_prt.compression.compressed import CompressedTransfer
    from slepian_prt.evaluation.dimension.estimate import EffectiveDimension
    from slepian_prt.transport.transfer import Transfer

# Fewer vertices than these do not tell what happens in a neighbourhood.
_FEW = 12

# Files of transfer; any other is a model.
_TRACED = (".prt", ".npz")

# Rows of the plan about surfaces that vertices do not hold, or not all of.
_OF_SURFACES = ("glossy reflection of ", "mirror reflection of ", "transmission through ", "light received by ")


@click.command()
@click.argument("file", type=click.Path(), metavar="FILE|SCENE")
@output_option("Picture (.png), coloured mesh (.ply) or arrays (.npz).")
@click.option("--error", default=0.05, show_default=True, help="What the counted functions may leave, relative.")
@click.option(
    "--neighbourhood",
    default=0.05,
    show_default=True,
    help="Radius of neighbourhoods, as a part of the diagonal of the model's bounding box.",
)
@width_option("Of a picture", 800)
@camera_options
@click.option(
    "--background",
    default="white",
    show_default=True,
    metavar="COLOUR|transparent",
    help="Of a picture: a name or #rrggbb.",
)
@transport_options
@machine_options
@click.pass_context
def dimension(
    context: click.Context,
    file: str,
    output: str,
    error: float,
    neighbourhood: float,
    width: int | None,
    background: str,
    **options: Any,
) -> None:
    """How many functions light transport takes in the neighbourhood of each point of a model, as a picture in colour.

    FILE is a transfer file (.prt, or .npz of Transfer.save); a SCENE (mesh or Mitsuba xml) is traced as by precompute.
    """
    from slepian_prt.cli.terminal import progress
    from slepian_prt.evaluation.dimension.estimate import check_error, check_neighbourhood, effective_dimension
    from slepian_prt.evaluation.dimension.files import PICTURE, check_dimension_output, write_dimension
    from slepian_prt.evaluation.dimension.limits import remark_on_error
    from slepian_prt.relighting.drawing.pictures import Finish
    from slepian_prt.relighting.files.wishes import check_source
    from slepian_prt.scene.view import Aim

    aim, finish = settings_of(Aim, options), Finish(background)
    check_error(error), check_neighbourhood(neighbourhood)
    check_dimension_output(output, finish, file, parameters=options["parameters"])
    given = [name for name in context.params if context.get_parameter_source(name) is ParameterSource.COMMANDLINE]
    if Path(output).suffix.lower() != PICTURE:
        _note_unused(given, ("width", "background", *_names(Aim)), f"on {Path(output).suffix.lower()} files")
    transfer = _transfer(file, given, options)
    if Path(file).suffix.lower() in _TRACED:
        check_source(output, transfer, file)
    with progress("effective dimension", "vertices") as (advance, _):
        result = effective_dimension(transfer, error, neighbourhood, advance=advance)
    remarks = write_dimension(output, transfer, result, width, aim, finish)
    for remark in filter(None, (*remarks, remark_on_error(transfer, result.error))):
        note(remark)
    if 0 < result.members < _FEW:
        note(
            f"neighbourhoods have {result.members} vertices (the median), too few to tell: give a larger "
            "`neighbourhood`, or a finer mesh"
        )
    _note_left_out(transfer)
    say(f"{output}: {_in_words(result, any(part.sides == 2 for part in transfer.parts))}")


def _transfer(file: str, given: list[str], options: dict[str, Any]) -> Transfer | CompressedTransfer:
    """What is in the file, or what is traced."""
    from slepian_prt.transport.settings import TransportSettings

    names = _names(TransportSettings)
    suffix = Path(file).suffix.lower()
    if suffix in _TRACED:
        _note_unused(given, names, f"on transfer that is traced already, as {file} is")
    if suffix == ".prt":
        return read_transfer(file)
    if suffix == ".npz":
        from slepian_prt.transport.transfer_file import load_transfer

        return load_transfer(file)
    from slepian_prt.cli.terminal import progress
    from slepian_prt.transport.transfer import precompute

    with progress("transport", "vertices") as (advance, _):
        return precompute(file, **{name: options[name] for name in names}, advance=advance)


def _note_left_out(transfer: Transfer | CompressedTransfer) -> None:
    """Name surfaces of which vertices hold a part of the reflection, or none."""
    if rows := [effect.name for effect in transfer.effects if effect.name.startswith(_OF_SURFACES)]:
        note(f"what surfaces reflect diffusely is counted, all else is left out: {'; '.join(rows)}")


def _names(settings: Any) -> tuple[str, ...]:
    return tuple(field.name for field in fields(settings))


def _note_unused(given: list[str], names: tuple[str, ...], where: str) -> None:
    if unused := [f"`{name}`" for name in given if name in names]:
        note(f"{', '.join(unused)} {'has' if len(unused) == 1 else 'have'} no effect {where}")


def _in_words(result: EffectiveDimension, two_sided: bool) -> str:
    low, middle, high = (math.ceil(result.quantile(part)) for part in (0.05, 0.5, 0.95))
    what = (
        f"effective dimension of transport over neighbourhoods of {100.0 * result.neighbourhood:.3g} % of the model's "
        f"size, error {100.0 * result.error:.3g} %"
    )
    if middle == 0:
        return f"{what}: none, no light arrives anywhere"
    return (
        f"{what}: median {middle} of {result.functions} "
        f"(coherence {1.0 - middle / result.functions:.2f}), 5 % of the surface at most {low}, 5 % at least {high}"
        f"{'; of what has two sides fronts alone count' if two_sided else ''}"
    )
