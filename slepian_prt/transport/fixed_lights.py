"""Light of lamps at all receivers of a scene, direct and by way of other surfaces."""

from __future__ import annotations

import logging
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError
from slepian_prt.lighting.fixed_lights import FixedLights
from slepian_prt.transport.interior import InteriorVertices
from slepian_prt.transport.interreflection import Bounces, reflectance_of
from slepian_prt.transport.lamp_light import LampTracer
from slepian_prt.transport.planned import PlannedScene

log = logging.getLogger(__name__)

# Effects by which light passes unbent; `lamp_paths` has what is bent, and scattered.
_STRAIGHT = {"media", "opacity", "glass"}

# Noise of a lamp that is worth a remark.
_NOISY = 0.02


def direct_fixed_lights(planned: PlannedScene, interior: InteriorVertices) -> tuple[FixedLights | None, int]:
    """Direct light of the lamps of a planned scene, and the rays that it took; None without lamps, or if unwanted.

    Receivers that nothing can shadow are lit without rays, those inside other geometry as their neighbours are.

    Raises
    ------
    UserError
        Light that is negative or not finite somewhere.
    """
    scene, lamps = planned.scene, planned.lamps
    if not lamps.groups or not lamps.wanted or planned.plan.view is not None:
        return None, 0
    count = len(scene.receivers)
    shadowed = np.zeros(count, dtype=bool)
    shadowed[planned.plan.shadowed] = True
    hidden = scene.is_hidden if planned.plan.shadowed.size else np.zeros(count, dtype=bool)
    direct = np.zeros((len(lamps.groups), count, 3), dtype=np.float32)
    lit, rays = scene.receivers.active & ~hidden, 0
    squared_noise = np.zeros(len(lamps.groups))
    if planned.remote is None:
        trace = lamp_tracer(planned).trace
    else:
        from slepian_prt.transport.by_workers.lamps import LampsByWorkers

        trace = LampsByWorkers(planned).trace
    for chosen, shadows in ((np.flatnonzero(lit & shadowed), True), (np.flatnonzero(lit & ~shadowed), False)):
        if chosen.size:
            traced = trace(chosen, shadows=shadows)
            direct[:, chosen] = traced.radiance
            squared_noise += traced.squared_noise
            rays += traced.rays
    _check(scene.path, lamps.names, direct)
    power = [np.sum(np.square(light, dtype=np.float64)) for light in direct]
    noise = np.sqrt(squared_noise / np.maximum(power, 1e-300))
    for name, reached, light, relative in zip(lamps.names, lamps.reached, direct, noise, strict=True):
        interior.fill(light)
        _remark(scene.path, name, float(reached), light, float(relative))
    dark = np.zeros(direct.shape, dtype=np.float32)  # takes no memory until it is written to
    fixed = FixedLights(lamps.names, lamps.kinds, lamps.emitted, direct, dark, lamps.directions)
    return fixed, rays


def lamp_tracer(planned: PlannedScene) -> LampTracer:
    """What samples the lamps of a planned scene."""
    passes = planned.plan.paths is not None and bool(_STRAIGHT & set(planned.plan.paths.effects))
    settings = planned.settings
    return LampTracer(planned.scene, planned.lamps.groups, settings.samples, settings.seed, passes)


def bounced_light(
    series: Bounces,
    albedo: NDArray,
    direct: NDArray[np.float32],
    channels: int,
    bounces: int | None,
    brought: NDArray[np.float32] | None = None,
) -> NDArray[np.float32]:
    """(n, V, 3) light of n lamps that comes by way of other surfaces.

    Parameters
    ----------
    series : Bounces
    albedo : (V, 3)
    direct : (n, V, 3)
        For unit albedo.
    channels : 1 (the mean of the albedo stands for all) or 3
    bounces : int or None
        None until the rest of each lamp's light is less than a thousandth.
    brought : (n, V, 3), optional
        What paths brought by way of mirrors, glass and the like, which is part of the result.
    """
    bounced = np.zeros(direct.shape, dtype=np.float32)
    if brought is not None:
        bounced += brought
        direct = direct + brought
    if bounces is None:
        bounces = max((series.count(albedo, light.max(axis=1)) for light in direct), default=0)
    for channel in range(3):
        light, collected = (np.ascontiguousarray(values[:, :, channel].T) for values in (direct, bounced))
        reflectance = reflectance_of(albedo, channels, channel)
        bounced[:, :, channel] = series.follow(reflectance, light, collected, bounces, channel).T
    return bounced


def _check(path: str, names: Sequence[str], direct: NDArray[np.float32]) -> None:
    for name, light in zip(names, direct, strict=True):
        if not np.isfinite(light).all():
            raise UserError(f"{path}: the light of lamp '{name}' is not finite somewhere; scale it down or repair it")
        if light.min(initial=0.0) < 0.0:
            raise UserError(f"{path}: the light of lamp '{name}' is negative somewhere; repair its texture")


def _remark(path: str, name: str, reached: float, light: NDArray[np.float32], noise: float) -> None:
    """What is worth knowing of a lamp: that it lights nothing, and why; that its light is noisy."""
    if not light.any():
        reason = "it is inside a closed shape, or hidden" if reached > 0.0 else "it shines past all of them"
        log.info("%s: lamp '%s' lights no vertex: %s", path, name, reason)
    elif noise > _NOISY:
        log.info(
            "%s: the light of lamp '%s' has a noise of %.0f %%; more `samples` lessen it", path, name, 100.0 * noise
        )
