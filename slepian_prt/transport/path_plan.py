"""Which effects of mirrors, gloss, glass, opacity, leaves and media a scene calls for: what a pilot of paths tells."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from slepian_prt.paths.media import media_of
from slepian_prt.scene.mitsuba.instances import shapes_in
from slepian_prt.scene.reflectance.path_effects import DIFFUSE, path_effect
from slepian_prt.scene.scene import Scene
from slepian_prt.transport.effects import (
    NOT_SIMULATED,
    OMITTED,
    SIMULATED,
    TOLERANCE,
    Effect,
    Estimate,
    PathPlan,
    part_of_light,
    wanted_effects,
)
from slepian_prt.transport.first_rays import media_around
from slepian_prt.transport.held_faces import PATHS
from slepian_prt.transport.path_light import PathRays

# Vertices and first directions of the pilot.
_PILOT_VERTICES, _PILOT_SAMPLES = 256, 256

# Rows of the plan: their names where they are not those of the effects, and what paths go on from.
_NAMES = {DIFFUSE: "light reflected by shapes without vertices"}
_THINGS = {
    "media": "fog, smoke and the like",
    "opacity": "surfaces that are partly transparent, or have holes",
    "glass": "glass",
    "transmission": "leaves and other surfaces that light goes through diffusely",
    "mirrors": "mirrors",
    "gloss": "metals, coats and other glossy surfaces",
    DIFFUSE: "shapes without vertices",
}

# Fewest first directions of a receiver.
_FEWEST = 16


def first_directions(samples: int) -> int:
    """How many of them a receiver gets of ``samples`` rays: an even number, as they have halves."""
    return max(_FEWEST, samples + samples % 2)


@dataclass(frozen=True, eq=False)
class PathPilot:
    """What paths from some vertices bring, by the effect by which they go on first.

    Attributes
    ----------
    present : tuple of str
        Effects of `PATHS` that materials of the scene have.
    before : dict of str to (n,) indices
        Receivers that shapes with each of them are before.
    amounts : dict of str to (p, 3) float64
        At each vertex of the pilot, the light that comes so under a constant environment, by channel. What held
        surfaces send is at most their albedo.
    share : float
        Part of the receivers that the pilot was chosen from.
    followed : dict of str to float
        Rays that each of the first directions takes beyond the first, in the mean.
    failed : str
        Why Mitsuba cannot follow paths in the scene; empty if it can.
    """

    present: tuple[str, ...]
    before: dict[str, NDArray[np.int64]]
    amounts: dict[str, NDArray[np.float64]]
    share: float
    followed: dict[str, float]
    failed: str = ""

    @classmethod
    def none(cls) -> PathPilot:
        """Of a scene without such effects."""
        return cls((), {}, {}, 0.0, {})

    def contribution(self, effect: str) -> Estimate:
        """Of the largest channel, in the mean over the surface."""
        return Estimate.of(self.amounts[effect].max(axis=1), self.share)

    def tint(self, effects: Iterable[str]) -> Estimate:
        """The largest difference between channels of what some of them bring together."""
        chosen = [self.amounts[effect] for effect in effects]
        return Estimate.of(np.ptp(sum(chosen), axis=1), self.share) if chosen else Estimate()

    def rays(self, effect: str, samples: int) -> int:
        """What an effect alone costs."""
        return round(self.before[effect].size * first_directions(samples) * (1.0 + self.followed[effect]))

    def plan(self, effects: Iterable[str], samples: int) -> PathPlan | None:
        """Paths by some of the effects; None if nothing is left of them."""
        chosen = tuple(effect for effect in effects if self.before[effect].size)
        if not chosen:
            return None
        receivers = np.unique(np.concatenate([self.before[effect] for effect in chosen]))
        return PathPlan(chosen, receivers, first_directions(samples))


def decide(
    pilot: PathPilot, blocked: Estimate, reflected: float, effects: str, samples: int
) -> tuple[list[Effect], PathPlan | None]:
    """Rows about the effects of paths, and what to simulate of them.

    Parameters
    ----------
    pilot : PathPilot
    blocked : Estimate
        Part of the hemispheres that shows no sky.
    reflected : float
        Part of the light at receivers that others reflect, by which what paths bring is multiplied.
    effects : str
        As of `wanted_effects`.
    samples : int
        As of `precompute`.
    """
    wanted = wanted_effects(effects)
    if pilot.failed:
        reason = f"Mitsuba cannot follow paths here ({pilot.failed})"
        names = [_NAMES.get(effect, effect) for effect in pilot.present]
        return [Effect(name, NOT_SIMULATED, None, None, 0, reason) for name in names], None
    rows, chosen = [], []
    for effect in pilot.present:
        bound = part_of_light(pilot.contribution(effect).times(1.0 / max(1.0 - reflected, 0.1)), blocked)
        count = pilot.before[effect].size
        key = "interreflection" if effect == DIFFUSE else effect
        verdict = OMITTED
        if count == 0:
            reason = f"no vertex has {_THINGS[effect]} above its tangent plane"
        elif wanted is not None and key not in wanted:
            reason = f"not asked for (`effects={effects}`)"
        elif wanted is None and bound.mean + bound.half_width < TOLERANCE:
            reason = f"at most {bound.mean + bound.half_width:.1%} of the light"
        else:
            verdict = SIMULATED
            chosen.append(effect)
            asked = "asked for; " if wanted is not None else ""
            reason = (
                f"{asked}{count} vertices see {_THINGS[effect]}, from which paths go on; the contribution is a bound"
            )
        rays = pilot.rays(effect, samples)
        rows.append(Effect(_NAMES.get(effect, effect), verdict, bound.mean, bound.half_width, rays, reason))
    if wanted is not None and effects != "all":
        absent = [effect for effect in PATHS if effect in wanted and effect not in pilot.present]
        rows += [Effect(name, OMITTED, 0.0, 0.0, 0, "asked for, but nothing in the scene does it") for name in absent]
    return rows, pilot.plan(chosen, samples)


def look_at_paths(scene: Scene, possible: NDArray[np.int64], receivers: int, seed: int) -> PathPilot:
    """Follow paths from some of the ``possible`` vertices, which something reaches above the tangent plane of."""
    shapes = _shapes_by_effect(scene)
    if not shapes or possible.size == 0:
        return PathPilot.none()
    lit = possible[~scene.is_hidden[possible]]
    before = {effect: lit[_is_before(scene, lit, boxes)] for effect, boxes in shapes.items()}
    if media_of(scene.mi, scene.geometry):
        within = lit[np.array(media_around(scene, lit) != scene.mi.MediumPtr(None))]
        before["media"] = np.union1d(before.get("media", within), within)
    present = tuple(effect for effect in PATHS if effect in before)
    chosen = np.random.default_rng(seed).choice(possible, min(_PILOT_VERTICES, possible.size), replace=False)
    rays = PathRays(scene, _PILOT_SAMPLES, present, seed + 2)
    amounts = {effect: np.zeros((chosen.size, 3)) for effect in present}
    followed = dict.fromkeys(present, 0.0)
    done = 0
    albedo = scene.receivers.albedo.astype(np.float64)
    for block in rays.blocks(chosen):
        try:
            ends = rays.trace(block)
        except RuntimeError as error:  # of a material or a medium, such as a bump map of a texture without slopes
            reason = " ".join(str(error.__cause__ or error).split())
            return replace(PathPilot.none(), present=present, failed=reason)
        seen = np.einsum("nk,nkc->nc", ends.corners.weights, albedo[ends.corners.vertices])
        for lanes, numbers, values in (
            (ends.lanes, ends.effects, ends.throughput),
            (ends.held_lanes, ends.held_effects, ends.held_throughput * seen),
        ):
            for effect in present:
                some = numbers == 1 + PATHS.index(effect)
                np.add.at(amounts[effect], done + lanes[some] // ends.samples, values[some] / ends.samples)
        for effect in present:
            followed[effect] += ends.further[PATHS.index(effect)] / chosen.size / ends.samples
        done += block.size
    return PathPilot(present, before, amounts, possible.size / receivers, followed)


Box = tuple[NDArray[np.float64], NDArray[np.float64]]


def _shapes_by_effect(scene: Scene) -> dict[str, list[Box]]:
    """Boxes (low and high corners) of the shapes that send light on otherwise than vertices hold it, by effect."""
    found: dict[str, list[Box]] = {}
    if scene.loaded is None:
        return found
    mi = scene.mi
    in_groups = {path_effect(mi, member.bsdf()) for group in scene.groups for member in shapes_in(mi, group)}
    for number, shape in enumerate(scene.shapes):
        # Which group an instance is of, Mitsuba does not tell.
        effects = in_groups if shape.class_name() == "Instance" else {path_effect(mi, shape.bsdf())}
        for effect in effects - {None}:
            if effect != DIFFUSE or number >= len(scene.parts):  # else vertices hold all of it
                box = shape.bbox()
                corners = np.array(box.min, dtype=np.float64), np.array(box.max, dtype=np.float64)
                found.setdefault(str(effect), []).append(corners)
    return found


def _is_before(scene: Scene, vertices: NDArray[np.int64], boxes: list[Box]) -> NDArray[np.bool_]:
    """(n,) whether one of the boxes reaches above the tangent planes of vertices."""
    normals, positions = scene.receivers.normals[vertices], scene.traced_positions[vertices]
    heights = np.einsum("ij,ij->i", normals, positions) + 0.5 * scene.ray_heights[vertices]
    found = np.zeros(vertices.size, dtype=bool)
    left = np.arange(vertices.size)
    for low, high in boxes:
        reach = normals[left] @ (0.5 * (low + high)) + np.abs(normals[left]) @ (0.5 * (high - low))
        met = reach > heights[left]
        found[left[met]] = True
        left = left[~met]
    return found
