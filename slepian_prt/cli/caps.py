"""What ``slepian-prt info --caps`` says: the caps of a file, and the dimension of transport in each."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from statistics import median
from typing import TYPE_CHECKING, Any

import click

from slepian_prt.cli.messages import note, say
from slepian_prt.cli.terminal import print_table

if TYPE_CHECKING:
    from slepian_prt.compression.compressed import CompressedTransfer
    from slepian_prt.evaluation.dimension.caps import CapDimension


def print_caps(packed: CompressedTransfer, error: float, content: dict[str, Any] | None) -> None:
    """A line for each cap, the largest dimension first, and one for all of them; or ``content`` and they as JSON."""
    from slepian_prt.evaluation.dimension.caps import cap_dimensions
    from slepian_prt.evaluation.dimension.limits import remark_on_error

    rows = cap_dimensions(packed, error)
    if remark := remark_on_error(packed, error):
        note(remark)
    if content is not None:
        click.echo(json.dumps({**content, "error": error, "caps": [_as_dict(row) for row in rows]}, indent=1))
        return
    print_table(
        {
            "cap": "right",
            "vertices": "right",
            "half-angle": "right",
            "by the paper": "right",
            "dimension": "right",
            "coherence": "right",
        },
        [
            [
                str(row.cap),
                str(row.vertices),
                f"{math.degrees(row.half_angle):.1f}",
                "none" if row.expected is None else str(row.expected),
                f"{row.dimension:.1f}",
                f"{row.coherence:.2f}",
            ]
            for row in rows
        ],
        spare=("vertices", "coherence"),
    )
    if rows:
        say(_in_words(rows, packed.bandlimit, error))


def _as_dict(row: CapDimension) -> dict[str, Any]:
    return {
        "cap": row.cap,
        "vertices": row.vertices,
        "half_angle_degrees": math.degrees(row.half_angle),
        "by_the_paper": row.expected,
        "dimension": row.dimension,
        "coherence": row.coherence,
    }


def _in_words(rows: Sequence[CapDimension], bandlimit: int, error: float) -> str:
    from slepian_prt.evaluation.dimension.caps import count_concentrations, describe_count

    functions = rows[0].functions
    measured = math.ceil(median(row.dimension for row in rows))
    text = (
        f"a cap has effective dimension {measured} of {functions}, coherence {1.0 - measured / functions:.2f} (the "
        f"median of {len(rows)}; error {100.0 * error:.3g} %)"
    )
    if rows[0].expected is None:
        return text
    middle = median(row.half_angle for row in rows)
    return f"{text}; the paper counts {describe_count(count_concentrations(bandlimit, middle), middle)}"
