"""The lamps of a scene as transport takes them: the brightest by their own, all others as one."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError
from slepian_prt.lighting.fixed_lights import joined_name
from slepian_prt.lighting.lamps import UNSEEN, Lamp, lamps_of
from slepian_prt.lighting.projection import project_environment
from slepian_prt.scene.scene import Scene
from slepian_prt.slepian.kernels import cosine_lobe, zonal_vectors
from slepian_prt.transport.effects import NOT_SIMULATED, OMITTED, SIMULATED, Effect, Plan
from slepian_prt.transport.lamp_light import Group, samples_of, unshadowed_means

log = logging.getLogger(__name__)

# Lamps that are kept apart, at most; and receivers and samples for each that tell how bright they are.
MOST_LAMPS = 16
_PILOT, _PILOT_SAMPLES = 256, 8
# Lamps that are looked at together then.
_LAMPS_PER_BLOCK = 512
# Names of lamps in a row of the plan.
_NAMED = 4


@dataclass(frozen=True, eq=False)
class Lamps:
    """Lamps to simulate, n of them.

    Attributes
    ----------
    names, kinds : tuples of str
    emitted, directions : (n, 3) float64
        As of `FixedLights`.
    groups : list of Group
        The emitters of each.
    reached : (n,) float64
        Mean radiance of unit albedo that each would cause if nothing stood in its way.
    share : float or None
        What they would add to the light of the scene's environment, as part of both; None without one.
    left_out : tuple of Effect
        Rows about those that Mitsuba cannot sample.
    wanted : bool
        Whether their light is computed at all.
    """

    names: tuple[str, ...]
    kinds: tuple[str, ...]
    emitted: NDArray[np.float64]
    directions: NDArray[np.float64]
    groups: list[Group]
    reached: NDArray[np.float64]
    share: float | None
    left_out: tuple[Effect, ...]
    wanted: bool = True

    def add_rows(self, plan: Plan, samples: int) -> Plan:
        """The plan with rows about lamps before what it does not simulate."""
        if not self.names and not self.left_out:
            return plan
        own = (self._row(plan, samples),) if self.names else ()
        effects = plan.effects
        place = next((i for i, row in enumerate(effects) if row.verdict == NOT_SIMULATED), len(effects))
        return replace(plan, effects=(*effects[:place], *own, *self.left_out, *effects[place:]))

    def _row(self, plan: Plan, samples: int) -> Effect:
        toward, along = samples_of(self.groups, samples)
        rays = plan.shadowed.size * (along + sum(toward))
        named = ", ".join(f"'{name}'" for name in self.names[:_NAMED])
        more = f" and {len(self.names) - _NAMED} more" if len(self.names) > _NAMED else ""
        kinds = ", ".join(f"{self.kinds.count(kind)} {kind}" for kind in sorted(set(self.kinds)))
        name = f"light of {'lamps' if len(self.names) > 1 else 'lamp'} {named}{more}"
        if plan.view is not None:
            reason = "transfer toward a camera holds distant light only"
            return Effect(name, NOT_SIMULATED, self.share, None, 0, reason)
        if not self.wanted:
            return Effect(name, OMITTED, self.share, None, rays, "not asked for: what is measured is distant light")
        reason = f"kept apart from distant light; `fixed_lights` scales it when relighting ({kinds})"
        return Effect(name, SIMULATED, self.share, None, rays, reason)


def find_lamps(scene: Scene, seed: int) -> Lamps:
    """The lamps of a scene; none of a mesh file.

    Raises
    ------
    UserError
        As `lamps_of`.
    """
    loaded = scene.loaded
    found = [] if loaded is None else lamps_of(scene.mi, loaded, scene.path)
    unseen = [lamp for lamp in found if lamp.kind in UNSEEN]
    lamps = [lamp for lamp in found if lamp.kind not in UNSEEN and lamp.emitted.any()]
    for lamp in found:
        if not lamp.emitted.any():
            log.info("%s: lamp '%s' is set to 0 and left out", scene.path, lamp.name)
    reason = "it shines along its normals alone, so that no ray finds it, in Mitsuba's path tracer neither"
    left_out = tuple(
        Effect(f"light of lamp '{lamp.name}' ({lamp.kind})", NOT_SIMULATED, None, None, 0, reason) for lamp in unseen
    )
    groups = [_group(scene, [lamp], np.ones(1)) for lamp in lamps]
    receivers = _some_receivers(scene, seed)
    reached = _reached(scene, lamps, receivers)
    if len(lamps) > MOST_LAMPS:
        return _joined(scene, lamps, groups, reached, receivers, left_out)
    return Lamps(
        tuple(lamp.name for lamp in lamps),
        tuple(lamp.kind for lamp in lamps),
        np.array([lamp.emitted for lamp in lamps]).reshape(-1, 3),
        np.array([lamp.direction for lamp in lamps]).reshape(-1, 3),
        groups,
        reached,
        _share(scene, reached, receivers),
        left_out,
    )


def _group(scene: Scene, lamps: list[Lamp], weights: NDArray[np.float64]) -> Group:
    sampled = len(lamps) > 1 or scene.loaded.emitters()[lamps[0].place].get_shape() is not None
    return Group(np.array([lamp.place for lamp in lamps]), weights / weights.sum(), sampled)


def _joined(
    scene: Scene,
    lamps: list[Lamp],
    groups: list[Group],
    reached: NDArray[np.float64],
    receivers: NDArray[np.int64],
    left_out: tuple[Effect, ...],
) -> Lamps:
    """The brightest at the receivers by their own, in the order of the scene, and one for all others."""
    order = np.argsort(-reached, kind="stable")
    own, others = np.sort(order[: MOST_LAMPS - 1]), np.sort(order[MOST_LAMPS - 1 :])
    # A little of the mean, so that none of them is never looked at.
    weights = reached[others] + 0.1 * max(float(reached[others].mean()), 1e-30)
    rest = [lamps[i] for i in others]
    kinds = {lamp.kind for lamp in rest}
    return Lamps(
        (*(lamps[i].name for i in own), joined_name(others.size)),
        (*(lamps[i].kind for i in own), kinds.pop() if len(kinds) == 1 else "several"),
        np.array([*(lamps[i].emitted for i in own), np.mean([lamp.emitted for lamp in rest], axis=0)]),
        np.array([*(lamps[i].direction for i in own), np.zeros(3)]),
        [*(groups[i] for i in own), _group(scene, rest, weights)],
        np.append(reached[own], reached[others].sum()),
        _share(scene, reached, receivers),
        left_out,
    )


def _some_receivers(scene: Scene, seed: int) -> NDArray[np.int64]:
    active = np.flatnonzero(scene.receivers.active)
    if active.size <= _PILOT:
        return active
    return np.sort(np.random.default_rng(seed).choice(active, _PILOT, replace=False))


def _reached(scene: Scene, lamps: list[Lamp], receivers: NDArray[np.int64]) -> NDArray[np.float64]:
    """(n,) mean radiance of unit albedo, unshadowed."""
    if not lamps:
        return np.zeros(0)
    places = np.array([lamp.place for lamp in lamps])
    blocks = np.array_split(places, -(-places.size // _LAMPS_PER_BLOCK))
    try:
        return np.concatenate([unshadowed_means(scene, block, receivers, _PILOT_SAMPLES) for block in blocks])
    except RuntimeError as error:  # Dr.Jit looks at all emitters of the process, those of other scenes too
        reason = " ".join(str(error).split())
        raise UserError(f"{scene.path}: its lamps cannot be sampled ({reason}); correct or remove them") from None


def _share(scene: Scene, reached: NDArray[np.float64], receivers: NDArray[np.int64]) -> float | None:
    """Of all light that is not stopped, the part of the lamps; beside a sky, which degree 2 tells well enough."""
    if scene.environment is None or reached.size == 0:
        return None
    vectors = zonal_vectors(cosine_lobe(2), scene.receivers.normals[receivers])
    sky = float((vectors @ project_environment(scene.environment, 2).T).mean())
    return float(reached.sum() / (reached.sum() + max(sky, 0.0)))
