"""What a scene has and transport leaves out: rows of the effects plan."""

from __future__ import annotations

from typing import NamedTuple


class LeftOut(NamedTuple):
    """An effect that is not simulated.

    Attributes
    ----------
    name : str
    share : float or None
        Part of the surface that has it; None where it is not known.
    reason : str
    """

    name: str
    share: float | None = None
    reason: str = "only reflection of distant light by diffuse surfaces is simulated"
