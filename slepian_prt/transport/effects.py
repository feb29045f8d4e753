"""The effects plan: what of light transport a scene calls for, decided before any heavy work."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError
from slepian_prt.scene.scene import Scene
from slepian_prt.scene.view import View
from slepian_prt.slepian.kernels import cosine_lobe
from slepian_prt.transport.directions import direction_set
from slepian_prt.transport.interreflection import GATHER_SHARE, gather_operator
from slepian_prt.transport.visibility import VisibilityTracer, nodes_for, shadowed_vertices

SIMULATED, OMITTED, NOT_SIMULATED = "simulated", "omitted", "not simulated"
EFFECTS = ("shadows", "interreflection", "colour")

# An effect that changes less than this part of the received light is left out.
TOLERANCE = 0.005

_PILOT_VERTICES = 256
_PILOT_NODES = 256
_CONFIDENCE = 1.96  # standard errors to either side: 95 %


@dataclass(frozen=True)
class Effect:
    """One row of the plan.

    Attributes
    ----------
    name : str
    verdict : str
        ``simulated``; ``omitted`` because it contributes too little or was not asked for; or ``not simulated``, which
        this method (or this scene) cannot do.
    contribution : float or None
        Part of the received light, in the mean over the surface under a constant environment, that simulating it
        changes; for interreflection at most. None where it is not known.
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
        return asdict(self)


@dataclass(frozen=True, eq=False)
class Plan:
    """What to simulate.

    Attributes
    ----------
    effects : tuple of Effect
        The rows that are shown and stored.
    shadowed : (n,)
        Vertices to trace visibility for.
    nodes : int
        Directions that each of them looks in at first.
    interreflection : bool
    channels : 1 or 3
    """

    effects: tuple[Effect, ...]
    shadowed: NDArray[np.int64]
    nodes: int
    interreflection: bool
    channels: int


@dataclass(frozen=True)
class _Estimate:
    """A mean over the surface with the half-width of its confidence interval."""

    mean: float
    half_width: float

    @classmethod
    def of(cls, values: NDArray, share: float) -> _Estimate:
        """From values at a random pilot of the vertices that make up ``share`` of all; they are 0 at the others."""
        if values.size == 0:
            return cls(0.0, 0.0)
        return cls(share * float(values.mean()), share * _CONFIDENCE * float(values.std()) / math.sqrt(values.size))


def check_effects(effects: str) -> None:
    """Raise UserError unless this is ``auto``, ``direct``, ``all``, ``none`` or a list of effects."""
    if effects in ("auto", "direct", "all", "none"):
        return
    named = [name.strip() for name in effects.split(",")] if isinstance(effects, str) else [effects]
    for name in named:
        if name not in EFFECTS:
            raise UserError(
                f"effects must be auto, direct, all, none, or some of {', '.join(EFFECTS)} with commas between; not "
                f"{effects!r}"
            )
    for name, needed in (("interreflection", "shadows"), ("colour", "interreflection")):
        if name in named and needed not in named:
            raise UserError(f"effects: {name} needs {needed}; add it, as in `effects={needed},{','.join(named)}`")


@dataclass(frozen=True, eq=False)
class Survey:
    """A first look at a scene: exact geometric tests, and a pilot of a few hundred vertices.

    Attributes
    ----------
    scene : Scene
    receivers, possible : indices of vertices
        That light can reach, and those of them that something reaches above the tangent plane of.
    pilot : _Pilot
    """

    scene: Scene
    receivers: NDArray[np.int64]
    possible: NDArray[np.int64]
    pilot: _Pilot

    @classmethod
    def of(cls, scene: Scene, seed: int = 0) -> Survey:
        receivers = np.flatnonzero(scene.mesh.receivers.active)
        possible = np.flatnonzero(shadowed_vertices(scene))
        return cls(scene, receivers, possible, _look(scene, possible, receivers.size, seed))

    def nodes(self, samples: float) -> int:
        """Directions that a vertex looks in at first, so that it takes ``samples`` rays on average."""
        return nodes_for(samples, self.pilot.changes)

    def plan(self, bandlimit: int, samples: int, effects: str = "auto", view: View | None = None) -> Plan:
        """Decide what to simulate.

        Parameters
        ----------
        bandlimit, samples : as `precompute`
        effects : str
            ``auto``; ``direct`` (shadows only); ``all``; ``none``; or effects by name, with commas between.
        view : View, optional
            Camera that transfer is wanted toward.

        Raises
        ------
        UserError
            Unknown effects.
        """
        check_effects(effects)
        forced = {"auto": None, "direct": {"shadows"}, "all": set(EFFECTS), "none": set()}.get(effects)
        if effects not in ("auto", "direct", "all", "none"):
            forced = {name.strip() for name in effects.split(",")}
        scene, pilot = self.scene, self.pilot
        rows, shadowed, nodes = _shadows(pilot, self.possible, self.receivers, samples, forced)
        if view is not None:
            rows.append(_toward_view(scene, view, samples))
        interreflection, row = _interreflection(scene, pilot, self.possible.size, samples, forced, effects, view)
        rows.append(row)
        channels = 3
        if view is None:
            channels, row = _colour(scene, pilot, interreflection, forced, effects)
            rows += [row, _tail(pilot, bandlimit)]
        if interreflection and pilot.backs > TOLERANCE and any(scene.two_sided):
            rows.append(
                Effect(
                    "light reflected by the backs of surfaces",
                    NOT_SIMULATED,
                    pilot.backs,
                    None,
                    0,
                    "vertices carry light on their front only",
                )
            )
        rows += [
            Effect(
                what, NOT_SIMULATED, None, None, 0, "only reflection of distant light by diffuse surfaces is simulated"
            )
            for what in scene.not_simulated
        ]
        return Plan(tuple(rows), shadowed, nodes, interreflection, channels)


@dataclass(frozen=True)
class _Pilot:
    """What a few hundred vertices see.

    Attributes
    ----------
    blocked, reflecting, tint : _Estimate
        Parts of the hemisphere, cosine-weighted: that show surfaces; the same, times the albedo of what is seen; and
        the largest difference between colour channels of that.
    backs : float
        The part that shows the backs of receivers.
    changes : float
        Edges of the net along which visibility changes, over the root of its nodes.
    tail : callable
        Gives the part of the energy of the transfer that lies in degrees above a bandlimit.
    """

    blocked: _Estimate
    reflecting: _Estimate
    tint: _Estimate
    backs: float
    changes: float
    tail: Callable[[int], float]


def _look(scene: Scene, possible: NDArray, receivers: int, seed: int) -> _Pilot:
    nothing = _Estimate(0.0, 0.0)
    if possible.size == 0:
        return _Pilot(nothing, nothing, nothing, 0.0, 0.0, _tail_of_cosine)
    chosen = np.random.default_rng(seed).choice(possible, min(_PILOT_VERTICES, possible.size), replace=False)
    share = possible.size / receivers
    net = direction_set(_PILOT_NODES)
    tracer = VisibilityTracer(scene, 1, net, seed)
    looked = tracer.look(chosen)
    fractions, energy, _ = tracer.surveyed(looked)
    gather = gather_operator(scene, _PILOT_NODES, chosen, None, seed)
    seen = gather.weights @ scene.mesh.albedo.astype(np.float64)

    def tail(bandlimit: int) -> float:
        if energy == 0.0:
            return 0.0
        kept = VisibilityTracer(scene, max(1, bandlimit), net, seed).surveyed(looked)[2][: bandlimit + 1].sum()
        return share * max(0.0, 1.0 - float(kept) / energy) + (1.0 - share) * _tail_of_cosine(bandlimit)

    return _Pilot(
        _Estimate.of(fractions, share),
        _Estimate.of(seen.max(axis=1), share),
        _Estimate.of(np.ptp(seen, axis=1), share),
        share * gather.backs,
        tracer.changes / chosen.size / math.sqrt(net.size),
        tail,
    )


def _shadows(
    pilot: _Pilot, possible: NDArray, receivers: NDArray, samples: int, forced: set[str] | None
) -> tuple[list[Effect], NDArray, int]:
    nodes = nodes_for(samples, pilot.changes)
    rays = round(possible.size * (nodes + 2.0 * pilot.changes * math.sqrt(nodes)))
    blocked = pilot.blocked
    if forced is not None and "shadows" not in forced:
        row = Effect("shadows", OMITTED, blocked.mean, blocked.half_width, rays, "not asked for")
        return [row], np.zeros(0, dtype=np.int64), nodes
    if forced is not None and "interreflection" in forced and possible.size == 0:
        reason = "asked for; nothing reaches above any vertex's tangent plane, so no ray can be blocked"
        rays = receivers.size * nodes
        return [Effect("shadows", SIMULATED, 0.0, 0.0, rays, reason)], receivers, nodes
    if possible.size == 0:
        reason = "convex: nothing reaches above any vertex's tangent plane, so no ray is traced"
        return [Effect("shadows", OMITTED, 0.0, 0.0, 0, reason)], possible, nodes
    reason = f"{possible.size} of {receivers.size} vertices can be shadowed; the others need no rays"
    return [Effect("shadows", SIMULATED, blocked.mean, blocked.half_width, rays, reason)], possible, nodes


def _interreflection(
    scene: Scene,
    pilot: _Pilot,
    possible: int,
    samples: int,
    forced: set[str] | None,
    effects: str,
    view: View | None,
) -> tuple[bool, Effect]:
    """Radiance never exceeds that of a constant environment, so indirect light is at most what is seen, times ρ."""
    direct, most = 1.0 - pilot.blocked.mean, pilot.reflecting.mean
    bound = half_width = 0.0
    if most > 0.0:
        bound = most / (most + direct)
        half_width = (direct * pilot.reflecting.half_width + most * pilot.blocked.half_width) / (most + direct) ** 2
    rays = round(possible * max(1.0, GATHER_SHARE * samples))

    def row(verdict: str, reason: str) -> Effect:
        return Effect("interreflection", verdict, bound, half_width, rays, reason)

    if view is not None and most > 0.0:
        return False, row(
            NOT_SIMULATED, "transfer toward a camera holds direct light only; the contribution is a bound"
        )
    if forced is not None and "interreflection" not in forced:
        return False, row(OMITTED, f"not asked for (`effects={effects}`)")
    if forced is not None:
        return True, row(SIMULATED, "asked for")
    if most == 0.0:
        reason = "no blocked direction sees a surface that reflects"
        return False, Effect("interreflection", OMITTED, 0.0, 0.0, 0, reason)
    if not scene.has_materials:
        reason = "a mesh file says nothing about its albedo; `albedo` sets it (this bound is for an albedo of 1)"
        return False, row(OMITTED, reason)
    if bound + half_width < TOLERANCE:
        return False, row(OMITTED, f"at most {bound + half_width:.1%} of the light")
    return True, row(SIMULATED, "blocked directions see surfaces that reflect; the contribution is a bound")


def _colour(
    scene: Scene, pilot: _Pilot, interreflection: bool, forced: set[str] | None, effects: str
) -> tuple[int, Effect]:
    tint = pilot.tint

    def row(verdict: str, reason: str) -> Effect:
        return Effect("colour", verdict, tint.mean, tint.half_width, 0, reason)

    if not interreflection:
        reason = "direct light: one channel, the albedo applied when relighting"
        return 1, Effect("colour", OMITTED, 0.0, 0.0, 0, reason)
    if forced is not None and "colour" in forced:
        return 3, row(SIMULATED, "asked for: three channels")
    if forced is not None:
        return 1, row(OMITTED, f"not asked for (`effects={effects}`); their mean stands for all")
    gray = bool(np.ptp(scene.mesh.albedo, axis=1).max(initial=0.0) == 0.0)
    if gray or tint.mean + tint.half_width < TOLERANCE:
        return 1, row(OMITTED, "surfaces reflect all channels alike onto each other: one channel")
    return 3, row(SIMULATED, "surfaces of different colours light each other: three channels")


def _toward_view(scene: Scene, view: View, samples: int) -> Effect:
    """Glossy reflection is all that a view is for: it is never left out."""
    rays = len(scene.mesh.positions) * max(8, samples)
    reason = f"asked for: all that materials reflect toward camera '{view.name}', but mirrors and glass"
    return Effect("glossy reflection", SIMULATED, None, None, rays, reason)


def _tail(pilot: _Pilot, bandlimit: int) -> Effect:
    amount = math.sqrt(pilot.tail(bandlimit))
    reason = f"relative RMS of the transfer beyond bandlimit {bandlimit}; smooth light meets less of it"
    return Effect(f"degrees above {bandlimit}", OMITTED, amount, None, 0, reason)


def _tail_of_cosine(bandlimit: int) -> float:
    """Part of the clamped cosine's energy above the bandlimit."""
    l = np.arange(bandlimit + 1)
    kept = float(np.sum(cosine_lobe(bandlimit) ** 2 * (2 * l + 1) / (4.0 * math.pi)))
    return max(0.0, 1.0 - kept / (2.0 / (3.0 * math.pi)))
