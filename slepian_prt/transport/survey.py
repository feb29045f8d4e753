"""A first look at a scene, from which the plan is made: exact geometric tests, and a pilot of some vertices."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from slepian_prt.machine.threads import one_blas_thread
from slepian_prt.scene.scene import Scene
from slepian_prt.scene.view import View
from slepian_prt.slepian.kernels import cosine_lobe
from slepian_prt.sphere.harmonics import bandlimit_of, degrees
from slepian_prt.transport.directions import direction_set
from slepian_prt.transport.effects import (
    NOT_SIMULATED,
    OMITTED,
    SIMULATED,
    TOLERANCE,
    Effect,
    Estimate,
    Plan,
    part_of_light,
    wanted_effects,
)
from slepian_prt.transport.interpolation import interpolation_error
from slepian_prt.transport.interreflection import GATHER_SHARE, gather_operator
from slepian_prt.transport.occlusion import OcclusionTables
from slepian_prt.transport.path_plan import PathPilot, decide, look_at_paths
from slepian_prt.transport.visibility import VisibilitySamples, VisibilityTracer, nodes_for, shadowed_vertices

# Blocked part of the light from which on a scene is an interior.
_INTERIOR = 0.5

# Interpolation between vertices is worth a remark from this error on.
_BETWEEN = 0.05

_PILOT_VERTICES = 256
_PILOT_NODES = 256


@dataclass(frozen=True)
class PilotVisibility:
    """What a few hundred vertices see.

    Attributes
    ----------
    blocked, reflecting, tint : Estimate
        Parts of the hemisphere, cosine-weighted: that show surfaces; the same, times the albedo of what is seen; and
        the largest difference between colour channels of that.
    backs : float
        The part that shows backs of receivers that reflect and hold no light.
    changes : float
        Edges of the direction set along which visibility changes, over the root of its nodes.
    between : float
        Relative RMS by which light between vertices differs from what is interpolated.
    tail : callable
        Gives the part of the energy of the transfer that lies in degrees above a bandlimit.
    """

    blocked: Estimate
    reflecting: Estimate
    tint: Estimate
    backs: float
    changes: float
    between: float
    tail: Callable[[int], float]


@dataclass(frozen=True, eq=False)
class SurveyedScene:
    """A scene that is traced as its survey wants it.

    Attributes
    ----------
    scene : Scene
    """

    scene: Scene


@dataclass(frozen=True, eq=False)
class Survey(SurveyedScene):
    """What plans are made from, whatever the numbers that are asked for.

    Attributes
    ----------
    receivers, possible : indices of vertices
        That light can reach, and those of them that something reaches above the tangent plane of.
    pilot : PilotVisibility
    paths : PathPilot
        What comes by way of mirrors, glass and the like.
    possible_with_media : indices of vertices
        As ``possible``, where the boundaries of media count.
    """

    receivers: NDArray[np.int64]
    possible: NDArray[np.int64]
    pilot: PilotVisibility
    paths: PathPilot
    possible_with_media: NDArray[np.int64]

    @classmethod
    def of(cls, scene: Scene, seed: int = 0, *, paths: bool = True) -> Survey:
        """Look at a scene; the pilot is chosen at random by ``seed``. Toward a camera no ``paths`` are looked at."""
        receivers = np.flatnonzero(scene.receivers.active)
        possible = np.flatnonzero(shadowed_vertices(scene))
        with one_blas_thread():  # the plan is in the file, which is not to depend on the number of cores
            pilot = _trace_pilot(scene, possible, receivers.size, seed)
        if pilot.blocked.mean > _INTERIOR:
            scene = scene.in_robust_mode  # where little light comes in, what slips through counts
        if not paths:
            return cls(scene, receivers, possible, pilot, PathPilot.none(), possible)
        traced = scene.with_media
        reached = possible if traced is scene else np.flatnonzero(shadowed_vertices(traced))
        return cls(scene, receivers, possible, pilot, look_at_paths(traced, reached, receivers.size, seed), reached)

    def nodes(self, samples: float) -> int:
        """Directions that a vertex looks in at first, so that it takes ``samples`` rays on average."""
        return nodes_for(samples, self.pilot.changes)

    def plan(self, bandlimit: int, samples: int, effects: str = "auto", view: View | None = None) -> Plan:
        """Decide what to simulate.

        Parameters
        ----------
        bandlimit, samples : as `precompute`
        effects : str
            See `wanted_effects`.
        view : View, optional
            Camera that transfer is wanted toward.

        Raises
        ------
        UserError
            Unknown effects.
        """
        return _Decisions(self, bandlimit, samples, effects, view).plan()


class _Decisions:
    """The verdict on each effect, for one question to a survey."""

    def __init__(self, survey: Survey, bandlimit: int, samples: int, effects: str, view: View | None) -> None:
        self._survey, self._scene, self._pilot = survey, survey.scene, survey.pilot
        self._bandlimit, self._samples, self._view = bandlimit, samples, view
        self._effects, self._wanted = effects, wanted_effects(effects)

    def plan(self) -> Plan:
        shadows, shadowed = self._shadows()
        interreflection = self._interreflection()
        bounces = interreflection.verdict == SIMULATED
        reflected = self._pilot.reflecting.mean if bounces else 0.0
        paths, path_plan = decide(self._survey.paths, self._pilot.blocked, reflected, self._effects, self._samples)
        if path_plan is not None and path_plan.media:
            more = (self._survey.possible_with_media.size - shadowed.size) * self._survey.nodes(self._samples)
            paths = [replace(row, rays=row.rays + more) if row.name == "media" else row for row in paths]
            shadowed = self._survey.possible_with_media
        rows, channels = [shadows, interreflection, *paths], 1
        if self._view is not None:
            rows.insert(1, self._toward_view(self._view))
        else:
            colour = self._colour(bounces, () if path_plan is None else path_plan.effects)
            channels = 3 if colour.verdict == SIMULATED else 1
            rows += [colour, self._tail()]
        if bounces and self._pilot.backs > TOLERANCE:
            name, reason = "light reflected by the backs of surfaces", "their vertices carry light on the front only"
            rows.append(Effect(name, NOT_SIMULATED, self._pilot.backs, None, 0, reason))
        if self._pilot.between > _BETWEEN:
            rows.append(self._between())
        left_out = [row for row in self._scene.not_simulated if not (bounces and row.by_paths)]
        rows += [Effect(row.name, row.verdict, row.share, None, 0, row.reason) for row in left_out]
        estimator = "direct" if self._view is None else "view"
        nodes = self._survey.nodes(self._samples)
        return Plan(tuple(rows), estimator, shadowed, nodes, bounces, channels, self._view, path_plan)

    def _is_forced(self, effect: str) -> bool:
        return self._wanted is not None and effect in self._wanted

    def _is_unwanted(self, effect: str) -> bool:
        return self._wanted is not None and effect not in self._wanted

    def _shadows(self) -> tuple[Effect, NDArray[np.int64]]:
        """The row about shadows, and which vertices are traced."""
        pilot, possible, receivers = self._pilot, self._survey.possible, self._survey.receivers
        nodes = self._survey.nodes(self._samples)
        rays = round(possible.size * (nodes + 2.0 * pilot.changes * math.sqrt(nodes)))
        blocked = pilot.blocked
        if self._is_unwanted("shadows"):
            row = Effect("shadows", OMITTED, blocked.mean, blocked.half_width, rays, "not asked for")
            return row, np.zeros(0, dtype=np.int64)
        if self._is_forced("interreflection") and possible.size == 0:
            reason = "asked for; nothing reaches above any vertex's tangent plane, so no ray can be blocked"
            return Effect("shadows", SIMULATED, 0.0, 0.0, receivers.size * nodes, reason), receivers
        if possible.size == 0:
            reason = "convex: nothing reaches above any vertex's tangent plane, so no ray is traced"
            return Effect("shadows", OMITTED, 0.0, 0.0, 0, reason), possible
        scene = self._scene
        slips = "none slips" if scene.is_robust else f"fewer than one in {_in_round(scene.slipping.mean()):,} slips"
        reason = (
            f"{possible.size} of {receivers.size} vertices can be shadowed; the others need no rays; "
            f"{slips} between triangles"
        )
        return Effect("shadows", SIMULATED, blocked.mean, blocked.half_width, rays, reason), possible

    def _interreflection(self) -> Effect:
        """Radiance never exceeds that of a constant environment, so indirect light is at most what is seen, times ρ."""
        if self._view is not None:
            return self._indirect_toward_view()
        pilot = self._pilot
        most = pilot.reflecting.mean
        part = part_of_light(pilot.reflecting, pilot.blocked)
        bound, half_width = part.mean, part.half_width
        rays = round(self._survey.possible.size * max(1.0, GATHER_SHARE * self._samples))

        def row(verdict: str, reason: str) -> Effect:
            return Effect("interreflection", verdict, bound, half_width, rays, reason)

        if self._is_unwanted("interreflection"):
            return row(OMITTED, f"not asked for (`effects={self._effects}`)")
        if self._is_forced("interreflection"):
            return row(SIMULATED, "asked for")
        if most == 0.0:
            reason = "no blocked direction sees a surface that reflects"
            return Effect("interreflection", OMITTED, 0.0, 0.0, 0, reason)
        if not self._scene.has_materials:
            reason = "nothing says what its albedo is; `albedo` sets it (this bound is for an albedo of 1)"
            return row(OMITTED, reason)
        if bound + half_width < TOLERANCE:
            return row(OMITTED, f"at most {bound + half_width:.1%} of the light")
        return row(SIMULATED, "blocked directions see surfaces that reflect; the contribution is a bound")

    def _indirect_toward_view(self) -> Effect:
        """What is blocked shows surfaces that may shine as the sky does, whatever they are made of."""
        blocked = self._pilot.blocked
        # The first ray of each path, and two more of those that are blocked, are about right.
        rays = round(len(self._scene.receivers) * self._samples * (1.0 + 2.0 * blocked.mean))

        def row(verdict: str, reason: str) -> Effect:
            return Effect("interreflection", verdict, blocked.mean, blocked.half_width, rays, reason)

        if self._is_unwanted("interreflection"):
            return row(OMITTED, f"not asked for (`effects={self._effects}`)")
        if self._is_forced("interreflection"):
            return row(SIMULATED, "asked for")
        if blocked.mean + blocked.half_width < TOLERANCE:
            return row(OMITTED, f"at most {blocked.mean + blocked.half_width:.1%} of the light")
        return row(SIMULATED, "paths go on from what blocks the sky, by all materials; the contribution is a bound")

    def _colour(self, bounces: bool, paths: tuple[str, ...]) -> Effect:
        tint, brought = self._pilot.tint, self._survey.paths.tint(paths)
        tint = Estimate(tint.mean + brought.mean, tint.half_width + brought.half_width) if paths else tint

        def row(verdict: str, reason: str) -> Effect:
            return Effect("colour", verdict, tint.mean, tint.half_width, 0, reason)

        if not bounces and not paths:
            reason = "direct light: one channel, the albedo applied when relighting"
            return Effect("colour", OMITTED, 0.0, 0.0, 0, reason)
        if self._is_forced("colour"):
            return row(SIMULATED, "asked for: three channels")
        if self._is_unwanted("colour"):
            return row(OMITTED, f"not asked for (`effects={self._effects}`); their mean stands for all")
        gray = bool(np.ptp(self._scene.receivers.albedo, axis=1).max(initial=0.0) == 0.0)
        if (gray and brought.mean == 0.0) or tint.mean + tint.half_width < TOLERANCE:
            return row(OMITTED, "surfaces reflect all channels alike onto each other: one channel")
        return row(SIMULATED, "surfaces of different colours light each other: three channels")

    def _toward_view(self, view: View) -> Effect:
        """Glossy reflection is all that a view is for: it is never left out."""
        rays = len(self._scene.receivers) * max(8, self._samples)
        reason = f"asked for: all that materials reflect toward camera '{view.name}', but mirrors and glass"
        return Effect("glossy reflection", SIMULATED, None, None, rays, reason)

    def _between(self) -> Effect:
        coarseness = self._scene.coarseness
        left = (
            f"edges are up to {coarseness:.2g} times as long as they should be, as more vertices would be too many"
            if coarseness > 1.0
            else "subdivide the faces to see more of it"
        )
        reason = (
            f"{len(self._scene.receivers)} vertices, and light is computed at vertices: what is interpolated between "
            f"them is off by this relative RMS; {left}"
        )
        return Effect("light between vertices", NOT_SIMULATED, self._pilot.between, None, 0, reason)

    def _tail(self) -> Effect:
        amount = math.sqrt(self._pilot.tail(self._bandlimit))
        reason = f"relative RMS of the transfer beyond bandlimit {self._bandlimit}; smooth light meets less of it"
        return Effect(f"degrees above {self._bandlimit}", OMITTED, amount, None, 0, reason)


def _trace_pilot(scene: Scene, possible: NDArray, receivers: int, seed: int) -> PilotVisibility:
    if possible.size == 0:
        return PilotVisibility(Estimate(), Estimate(), Estimate(), 0.0, 0.0, 0.0, _tail_of_cosine)
    chosen = np.random.default_rng(seed).choice(possible, min(_PILOT_VERTICES, possible.size), replace=False)
    share = possible.size / receivers
    directions = direction_set(_PILOT_NODES)
    tracer = VisibilityTracer(scene, directions, seed)
    samples = tracer.trace(chosen)
    blocked, energy = _blocked_and_energy(OcclusionTables(directions, 1), samples)
    gather = gather_operator(scene, _PILOT_NODES, chosen, None, seed)
    reflected = gather.weights @ scene.receivers.albedo.astype(np.float64)

    def tail(bandlimit: int) -> float:
        if energy == 0.0:
            return 0.0
        local = _open_in_frames(OcclusionTables(directions, max(1, bandlimit)), samples)
        by_degree = np.bincount(degrees(bandlimit_of(local.shape[1])), np.sum(local**2, axis=0))
        kept = float(by_degree[: bandlimit + 1].sum())
        return share * max(0.0, 1.0 - kept / energy) + (1.0 - share) * _tail_of_cosine(bandlimit)

    return PilotVisibility(
        Estimate.of(blocked, share),
        Estimate.of(reflected.max(axis=1), share),
        Estimate.of(np.ptp(reflected, axis=1), share),
        share * gather.backs,
        tracer.changes / chosen.size / math.sqrt(directions.size),
        interpolation_error(scene, seed),
        tail,
    )


def _in_round(part: float) -> int:
    """A number, of one digit and noughts, of which one is no less than the part."""
    whole = int(1.0 / part)
    digits = 10 ** (len(str(whole)) - 1)
    return whole // digits * digits


def _open_in_frames(tables: OcclusionTables, samples: VisibilitySamples) -> NDArray[np.float64]:
    """(n, (L+1)²) transfer vectors in the vertices' own frames."""
    return (tables.nodes.sum(axis=0) - tables.blocked_in_frames(samples)).astype(np.float64)


def _blocked_and_energy(tables: OcclusionTables, samples: VisibilitySamples) -> tuple[NDArray[np.floating], float]:
    """Blocked part of each hemisphere, (n,), and over all vertices the energy of transfer, ∫ (V (n·ω)₊ / π)² dω.

    The tables must reach degree 1.
    """
    blocked = tables.blocked_in_frames(samples)[:, 0] * math.sqrt(4.0 * math.pi)
    # t_10 in the vertex's frame is (1/π) ∫ V (n·ω)₊² dω times the √(3/4π) of y_10.
    first = _open_in_frames(tables, samples)[:, 2]
    return blocked, float(first.sum()) / math.sqrt(3.0 / (4.0 * math.pi)) / math.pi


def _tail_of_cosine(bandlimit: int) -> float:
    """Part of the clamped cosine's energy above the bandlimit."""
    l = np.arange(bandlimit + 1)
    kept = float(np.sum(cosine_lobe(bandlimit) ** 2 * (2 * l + 1) / (4.0 * math.pi)))
    return max(0.0, 1.0 - kept / (2.0 / (3.0 * math.pi)))
