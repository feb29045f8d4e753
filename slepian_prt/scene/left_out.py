"""What a scene has and transport leaves out: rows of the effects plan."""

from __future__ import annotations

from typing import NamedTuple

# Not held at the vertices of a file. What is gathered is in pictures all the same, as long as they are drawn from the
# scene itself: the integrator follows rays there.
NOT_SIMULATED, GATHERED = "not simulated", "gathered"

# What interpolation between vertices loses of a texture, relative RMS, is told from this on.
TEXTURE_LOST = 0.05


class LeftOut(NamedTuple):
    """An effect that transfer at vertices does not hold.

    Attributes
    ----------
    name : str
    share : float or None
        Part of the surface that has it; None where it is not known.
    reason : str
    verdict : str
        ``not simulated``, or ``gathered`` where pictures of the scene have it.
    by_paths : bool
        Whether indirect light toward a camera has it, where that is simulated.
    """

    name: str
    share: float | None = None
    reason: str = "only what diffuse surfaces reflect is simulated"
    verdict: str = NOT_SIMULATED
    by_paths: bool = False
