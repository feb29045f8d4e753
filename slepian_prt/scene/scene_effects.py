"""What a Mitsuba scene has and transport leaves out, from what became of its shapes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from slepian_prt.scene import materials
from slepian_prt.scene.left_out import LeftOut


class ShapeOutcome(NamedTuple):
    """What became of a shape of the scene.

    Attributes
    ----------
    shape : Mitsuba shape
        As the scene has it.
    name : str
    area : float
        Of its surface.
    sides : 0, 1 or 2
        That light is computed on.
    reason : str
        Why that is none, or not both of a surface that reflects on both.
    """

    shape: Any
    name: str
    area: float
    sides: int
    reason: str = ""


def effects_left_out(mi: Any, outcomes: Sequence[ShapeOutcome], *, view: bool) -> tuple[LeftOut, ...]:
    """Rows of the plan about shapes and their materials."""
    rows: list[str] = []
    for outcome in outcomes:
        shape, name = outcome.shape, outcome.name
        if shape.is_emitter():
            rows.append(f"light emitted by shape '{name}'")
        if outcome.sides:
            rows.extend(materials.left_out(mi, shape.bsdf(), name, view=view))
        else:
            rows.append(f"light received by shape '{name}' ({outcome.reason})")
    return tuple(map(LeftOut, rows))
