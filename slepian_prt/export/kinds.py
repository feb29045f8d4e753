"""What can be exported, and whether it can be written there: asked before any work, and without a renderer."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from slepian_prt.errors import UserError, check_choice
from slepian_prt.scene.named_files import check_output_file

if TYPE_CHECKING:
    from slepian_prt.compression.compressed import CompressedTransfer

TRANSFER, OCCLUSION, BENT_NORMALS, SKY_VISIBILITY, FIRST_DEGREE, GAMES202 = (
    "transfer", "occlusion", "bent-normals", "sky-visibility", "l1", "games202",
)  # fmt: skip

# Transfer itself, and what engines have a place for already.
KINDS = (TRANSFER, OCCLUSION, BENT_NORMALS, SKY_VISIBILITY, FIRST_DEGREE, GAMES202)

# How the bytes of vertices are carried.
ATTRIBUTES = ("bytes", "float", "texture")

# Bytes per vertex, where nothing else is asked for.
FUNCTIONS = 16

GLB, PLY, TEXT = ".glb", ".ply", ".txt"

# The highest degree that is needed.
_LEAST_BANDLIMIT = {BENT_NORMALS: 1, SKY_VISIBILITY: 2, FIRST_DEGREE: 1}


def check_export(
    output: str | Path, what: str, functions: int | None, attributes: str | None, inputs: Sequence[str | Path] = ()
) -> None:
    """Raise UserError unless that can be exported to such a file, and none of the inputs is in its place."""
    check_choice(what, "what", KINDS)
    suffixes = {TRANSFER: (GLB,), GAMES202: (TEXT,)}.get(what, (GLB, PLY))
    suffix = Path(output).suffix.lower()
    if suffix not in suffixes:
        others = {
            PLY: f"; `what=occlusion` and the like are written as {PLY} too",
            TEXT: f"; `what={GAMES202}` is written as {TEXT}",
        }.get(suffix, "")
        found = f"not '{suffix}'" if suffix else "which its name has to end in"
        raise UserError(f"{output}: {what} is written as {' or '.join(suffixes)}, {found}{others}")
    if attributes is not None:
        check_choice(attributes, "attributes", ATTRIBUTES)
    if what != TRANSFER:
        for name, value in (("functions", functions), ("attributes", attributes)):
            if value is not None:
                raise UserError(f"`{name}` is about `what=transfer` and has no effect on {what}; leave it out")
    check_output_file(output, *inputs)


def check_exportable(packed: CompressedTransfer, what: str, file: str | Path = "") -> None:
    """Raise UserError for transfer that engines could not show, or that has no such part."""
    name = str(file) or packed.name
    if packed.film_outline is not None:
        raise UserError(
            f"{name}: holds the pixels of a camera, which are no model; `slepian-prt view` opens it in a browser, and "
            "`slepian-prt relight` writes pictures"
        )
    if packed.toward_view:
        raise UserError(
            f"{name}: holds transfer toward a camera, which is right from there alone; precompute it again without "
            "`view`, or write pictures with `slepian-prt relight`"
        )
    least = _LEAST_BANDLIMIT.get(what, 0)
    if packed.bandlimit < least:
        raise UserError(
            f"{name}: has bandlimit {packed.bandlimit}, and `what={what}` needs {least}; precompute it again"
        )
