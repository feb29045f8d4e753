"""The effects plan: what of light transport a scene calls for, decided before any heavy work."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from slepian_prt.scene.scenes import Scene
from slepian_prt.transport.visibility import blocked_fraction, shadowed_vertices

SIMULATED, OMITTED, NOT_SIMULATED = "simulated", "omitted", "not simulated"

_PILOT_VERTICES = 256
_PILOT_RAYS = 256


@dataclass(frozen=True)
class Effect:
    """One row of the plan.

    Attributes
    ----------
    name : str
    verdict : str
        ``simulated``; ``omitted`` because it contributes nothing; or ``not simulated``, which this method cannot do.
    contribution : float or None
        Estimated part of the received light that it changes, where that can be told.
    confidence : float or None
        Half-width of the 95 % confidence interval of ``contribution``.
    reason : str
    """

    name: str
    verdict: str
    contribution: float | None
    confidence: float | None
    reason: str

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)


def plan_effects(mi: Any, scene: Scene, seed: int = 0) -> tuple[Effect, ...]:
    """Decide what to simulate, from exact geometric tests and a pilot of a few hundred vertices."""
    shadowed = np.flatnonzero(shadowed_vertices(scene))
    receivers = int(scene.mesh.receivers.sum())
    if shadowed.size == 0:
        blocked, half_width = 0.0, 0.0
        reason = "convex: nothing reaches above any vertex's tangent plane, so no ray is traced"
        rows = [Effect("shadows", OMITTED, 0.0, 0.0, reason)]
    else:
        rng = np.random.default_rng(seed)
        pilot = rng.choice(shadowed, min(_PILOT_VERTICES, shadowed.size), replace=False)
        fractions = blocked_fraction(mi, scene, pilot, _PILOT_RAYS, seed) * (shadowed.size / receivers)
        blocked = float(fractions.mean())
        half_width = 1.96 * float(fractions.std()) / math.sqrt(pilot.size)
        reason = f"{shadowed.size} of {receivers} vertices can be shadowed; the others need no rays"
        rows = [Effect("shadows", SIMULATED, blocked, half_width, reason)]
    albedo = float(scene.mesh.albedo[scene.mesh.receivers].max(initial=0.0))
    if blocked * albedo == 0.0:
        rows.append(Effect("interreflection", OMITTED, 0.0, 0.0, "no blocked direction sees a surface that reflects"))
    else:
        rows.append(
            Effect(
                "interreflection",
                NOT_SIMULATED,
                albedo * blocked,
                albedo * half_width,
                "direct light only; the contribution is a bound, albedo x blocked part",
            )
        )
    rows.append(Effect("colour", OMITTED, 0.0, 0.0, "direct light: one channel, the albedo applied when relighting"))
    rows += [
        Effect(what, NOT_SIMULATED, None, None, "only diffuse reflection of distant light is simulated")
        for what in scene.not_simulated
    ]
    return tuple(rows)
