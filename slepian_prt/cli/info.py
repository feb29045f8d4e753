"""``slepian-prt info``."""

from __future__ import annotations

import json
import math
import shutil
import sys
import textwrap
from typing import TYPE_CHECKING, Any

import click

from slepian_prt.cli.commands import with_flags
from slepian_prt.cli.options import file_argument, json_option
from slepian_prt.cli.values import read_transfer
from slepian_prt.errors import UserError, printable

if TYPE_CHECKING:
    from slepian_prt.compression.compressed import CompressedTransfer


@click.command()
@file_argument
@json_option
@click.option("--caps", "by_cap", is_flag=True, help="Effective dimension of the transport in each cap; decodes all.")
@click.option("--error", type=float, metavar="E", help="With --caps: what that leaves, relative.  [default: 0.05]")
def info(file: str, as_json: bool, by_cap: bool, error: float | None) -> None:
    """What a transfer FILE holds, what was simulated, and what error to expect; or what its caps are like."""
    if error is not None and not by_cap:
        raise UserError("`error` is about the dimension in caps; give --caps too")
    packed = read_transfer(file, check=False)
    content = _content(packed)
    whole = {**content, "effects": _effects(packed)}
    if by_cap:
        from slepian_prt.cli.caps import print_caps

        print_caps(packed, 0.05 if error is None else error, whole if as_json else None)
        return
    if as_json:
        click.echo(json.dumps(whole, indent=1))
        return
    from slepian_prt.cli.terminal import print_plan

    known = {name: value for name, value in (content | _in_words(packed, content)).items() if value is not None}
    width = max(map(len, known)) + 1
    for name, value in known.items():
        text = f"{value:.4g}" if isinstance(value, float) else printable(str(value))
        click.echo(_entry(f"{name:<{width}}", text))
    if packed.effects:
        print_plan(packed.effects)


def _entry(name: str, text: str) -> str:
    """A name with what it is, on a terminal in lines that need not be broken inside words."""
    if not sys.stdout.isatty():
        return name + text
    columns, indent = shutil.get_terminal_size().columns, " " * len(name)
    options: dict[str, Any] = {"break_long_words": False, "break_on_hyphens": False}
    return textwrap.fill(text, columns, initial_indent=name, subsequent_indent=indent, **options)


def _effects(packed: CompressedTransfer) -> list[dict[str, Any]]:
    return [
        {**effect.as_dict(), "name": with_flags(effect.name), "reason": with_flags(effect.reason)}
        for effect in packed.effects
    ]


def _content(packed: CompressedTransfer) -> dict[str, Any]:
    """All but the effects; None is what is not known."""
    from slepian_prt.transport.effects import are_unknown

    film = packed.film_outline
    content = {
        "source": packed.source,
        "parameters": dict(packed.parameters) or None,
        "vertices": packed.vertex_count,
        "faces": packed.face_count,
        "bandlimit": packed.bandlimit,
        "basis": packed.basis,
        "coding": packed.coding,
        "channels": packed.channels,
        "bounces": packed.bounces,
        "film": None if film is None else f"{film.width} x {film.height} of {film.name}",
        "noise": packed.noise(),
        "camera": None if packed.view is None else packed.view.name,
        "toward_camera": packed.toward_view,
        "lamps": list(packed.lamp_names) or None,
        "clusters": packed.cap_count,
        "paper_dimension": _paper_dimension(packed),
        "terms": packed.terms,
        "bytes_per_vertex": packed.bytes_per_vertex,
        "mesh_bytes_per_vertex": packed.mesh_bytes_per_vertex,
        "file_bytes_per_vertex": packed.file_bytes_per_vertex,
        "predicted_error": packed.predicted_error,
        "predicted_relit_error": packed.predicted_relit_error(),
        "path_noise": packed.path_noise,
        "light_prior": packed.prior or None,
        "predicted_error_under_prior": packed.predicted_error_under_prior,
        "verified_error": packed.verified or None,
        "verified_vertices": packed.verified_vertices or None,
        "verified_left_out": packed.verified_left_out or None,
        "samples": packed.samples,
        "seed": packed.seed,
        "rays_traced": packed.rays_traced,
        "seconds": packed.seconds,
        "notes": list(packed.notes),
    }
    foreign = ("bounces", "samples", "seed", "rays_traced") if are_unknown(packed.effects) else ()
    return content | dict.fromkeys(foreign)


def _paper_dimension(packed: CompressedTransfer) -> dict[str, Any] | None:
    """Of a cap of the median size; None where there is none of normals, or the file does not say how wide it is."""
    from slepian_prt.evaluation.dimension.caps import EPSILON, count_concentrations

    half_angle = packed.typical_half_angle
    if packed.film_outline is not None or half_angle is None:
        return None
    return {
        "count": count_concentrations(packed.bandlimit, half_angle),
        "functions": (packed.bandlimit + 1) ** 2,
        "half_angle_degrees": math.degrees(half_angle),
        "epsilon": EPSILON,
    }


def _paper_dimension_in_words(packed: CompressedTransfer, told: dict[str, Any] | None) -> str | None:
    from slepian_prt.evaluation.dimension.caps import describe_count

    if packed.film_outline is not None:
        return None
    if told is None:
        return "not in this older file; --caps tells it"
    counted = describe_count(told["count"], math.radians(told["half_angle_degrees"]))
    return f"{counted}, of {told['functions']} functions; --caps measures the transport"


def _in_words(packed: CompressedTransfer, content: dict[str, Any]) -> dict[str, str | None]:
    """What JSON has as lists and tables."""
    held_out = max(1, packed.verified_vertices)
    left_out = (
        f"{name} {count} {which} ({100.0 * count / held_out:.3g}%)"
        for name, counts in packed.verified_left_out.items()
        for which, count in counts.items()
    )
    return {
        "lamps": ", ".join(packed.lamp_names) or None,
        "paper_dimension": _paper_dimension_in_words(packed, content["paper_dimension"]),
        "seconds": ", ".join(f"{stage} {value:.2f}" for stage, value in packed.seconds.items()),
        "verified_error": ", ".join(f"{name} {error:.4g}" for name, error in packed.verified.items()) or None,
        "verified_left_out": ", ".join(left_out) or None,
        "notes": "; ".join(packed.notes) or "none",
    }
