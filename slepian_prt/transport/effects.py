"""Effects of light transport, and the plan: which of them a scene calls for, decided before any heavy work."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError
from slepian_prt.scene.left_out import GATHERED, NOT_SIMULATED
from slepian_prt.scene.reflectance.path_effects import PATH_EFFECTS
from slepian_prt.scene.view import View

__all__ = [
    "GATHERED",
    "NOT_SIMULATED",
    "OMITTED",
    "SIMULATED",
    "TOLERANCE",
    "UNKNOWN",
    "Effect",
    "Estimate",
    "PathPlan",
    "Plan",
    "are_unknown",
    "wanted_effects",
]

SIMULATED, OMITTED = "simulated", "omitted"

# Of all that transfer of other programs may hold, which do not say.
UNKNOWN = "unknown"
EFFECTS = ("shadows", "interreflection", "colour", *PATH_EFFECTS)

# An effect that changes less than this part of the received light is left out.
TOLERANCE = 0.005

_CONFIDENCE = 1.96  # standard errors to either side: 95 %

# What `wanted_effects` takes beside lists of effects.
_PRESETS: dict[str, frozenset[str] | None] = {
    "auto": None,
    "direct": frozenset({"shadows"}),
    "all": frozenset(EFFECTS),
    "none": frozenset(),
}


@dataclass(frozen=True)
class Estimate:
    """A mean over the surface with the half-width of its 95 % confidence interval."""

    mean: float = 0.0
    half_width: float = 0.0

    @classmethod
    def of(cls, values: NDArray, share: float) -> Estimate:
        """From values at a random pilot of the vertices that make up ``share`` of all; they are 0 at the others."""
        if values.size == 0:
            return cls()
        return cls(share * float(values.mean()), share * _CONFIDENCE * float(values.std()) / math.sqrt(values.size))

    def times(self, factor: float) -> Estimate:
        """A multiple of it."""
        return Estimate(factor * self.mean, factor * self.half_width)


def part_of_light(most: Estimate, blocked: Estimate) -> Estimate:
    """What part of all light comes so, if ``most`` does at most, and the sky is ``blocked`` to a part."""
    direct = 1.0 - blocked.mean
    if most.mean <= 0.0:
        return Estimate()
    whole = most.mean + direct
    half_width = (direct * most.half_width + most.mean * blocked.half_width) / whole**2
    return Estimate(most.mean / whole, half_width)


@dataclass(frozen=True)
class Effect:
    """One row of the plan.

    Attributes
    ----------
    name : str
    verdict : str
        ``simulated``; ``omitted`` because it contributes too little or was not asked for; ``gathered``, which is not
        held at vertices but is in pictures that are drawn from the scene; ``not simulated``, which this method (or
        this scene) cannot do; or ``unknown``, the only row of transfer that another program made.
    contribution : float or None
        Part of the received light, in the mean over the surface under a constant environment, that simulating it
        changes; for interreflection at most; of materials, the part of the surface that has them. None where it is
        not known.
    confidence : float or None
        Half-width of the 95 % confidence interval of ``contribution``.
    rays : int
        Expected cost of simulating it, in rays.
    reason : str
    """

    name: str
    verdict: str
    contribution: float | None
    confidence: float | None
    rays: int
    reason: str

    def as_dict(self) -> dict[str, Any]:
        """The attributes by name, for JSON."""
        return asdict(self)


def are_unknown(effects: Sequence[Effect]) -> bool:
    """Whether transfer is of another program, which does not say what it simulated, nor with how many rays."""
    return any(effect.verdict == UNKNOWN for effect in effects)


@dataclass(frozen=True, eq=False)
class PathPlan:
    """Paths to follow from where rays of receivers meet what vertices do not hold.

    Attributes
    ----------
    effects : tuple of str
        By which they go on first; of `slepian_prt.transport.held_faces.PATHS`.
    receivers : (n,)
        That such things are before.
    samples : int
        First directions of each, an even number.
    """

    effects: tuple[str, ...]
    receivers: NDArray[np.int64]
    samples: int

    @property
    def media(self) -> bool:
        """Whether participating media are simulated, so that their boundaries stop other rays."""
        return "media" in self.effects


@dataclass(frozen=True, eq=False)
class Plan:
    """What to simulate.

    Attributes
    ----------
    effects : tuple of Effect
        The rows that are shown and stored.
    estimator : str
        What fills the transfer vectors; a key of `slepian_prt.transport.planned.ESTIMATORS`.
    shadowed : (n,)
        Receivers to trace visibility for.
    nodes : int
        Directions that each of them looks in at first.
    interreflection : bool
    channels : 1 or 3
        Of diffuse transfer.
    view : View or None
        The camera toward which all materials are simulated; None for diffuse transfer, which is the same to all sides.
    paths : PathPlan or None
        By way of mirrors, glass and the like.
    """

    effects: tuple[Effect, ...]
    estimator: str
    shadowed: NDArray[np.int64]
    nodes: int
    interreflection: bool
    channels: int
    view: View | None
    paths: PathPlan | None = None

    @property
    def shadows(self) -> Effect:
        """The row about shadows, which every plan has."""
        return next(effect for effect in self.effects if effect.name == "shadows")


def wanted_effects(effects: str) -> frozenset[str] | None:
    """The effects that are asked for by name; None if the scene decides.

    Parameters
    ----------
    effects : str
        ``auto``; ``direct`` (shadows only); ``all``; ``none``; or effects by name, with commas between.

    Raises
    ------
    UserError
        Something else, or an effect without another that it needs.
    """
    if effects in _PRESETS:
        return _PRESETS[effects]
    names = [name.strip() for name in effects.split(",")] if isinstance(effects, str) else [effects]
    if not set(names) <= set(EFFECTS):
        raise UserError(
            f"effects must be auto, direct, all, none, or some of {', '.join(EFFECTS)} with commas between; not "
            f"{effects!r}"
        )
    needs = {"interreflection": "shadows", "colour": "interreflection", **dict.fromkeys(PATH_EFFECTS, "shadows")}
    for name, needed in needs.items():
        if name in names and needed not in names:
            raise UserError(f"effects: {name} needs {needed}; add it, as in `effects={needed},{','.join(names)}`")
    return frozenset(names)
