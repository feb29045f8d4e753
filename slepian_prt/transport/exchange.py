"""Light that receivers get from each other: what surfaces reflect, and what paths by way of others bring.

T = T₀ + E + (R + S) diag(ρ) T, by its Neumann series: R of `interreflection`, E and S of `path_light`.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slepian_prt.lighting.fixed_lights import FixedLights
from slepian_prt.transport.fixed_lights import bounced_light
from slepian_prt.transport.glossy import merge_equal_channels
from slepian_prt.transport.interior import InteriorVertices
from slepian_prt.transport.interreflection import (
    Bounces,
    BouncesHere,
    Gather,
    gather_operator,
    gathering_nodes,
)
from slepian_prt.transport.lamp_paths import trace_lamp_paths
from slepian_prt.transport.path_light import PathLight, trace_paths
from slepian_prt.transport.planned import PlannedScene
from slepian_prt.transport.smoothing import across_seams, relative_noise, smooth, surface_guides, variance_of_halves
from slepian_prt.transport.view_paths import bounces_toward, trace_view_paths

log = logging.getLogger(__name__)

_WHITE = math.sqrt(4.0 * math.pi)

# So many times the light that comes in is worth a remark, at the brightest receivers but for these that noise makes so.
_TOO_BRIGHT, _NEARLY_ALL = 2.0, 0.99


@dataclass(frozen=True, eq=False)
class Together:
    """R + S.

    Attributes
    ----------
    gather : Gather or None
    paths : PathLight
    """

    gather: Gather | None
    paths: PathLight

    def reflected(self, albedo: NDArray, values: NDArray, channel: int = 0) -> NDArray[np.float32]:
        """(V, k) light received from surfaces of one channel's ``albedo`` (V,) that shine by ``values`` (V, k)."""
        brought = self.paths.reflected(albedo, values, channel)
        return brought if self.gather is None else self.gather.reflected(albedo, values) + brought


class Known(NamedTuple):
    """What was traced of an exchange of light.

    Attributes
    ----------
    all : Bounces
        Of R + S.
    surfaces : Bounces or None
        Of R alone, if there is any.
    paths : PathLight or None
    rays : int
    """

    all: Bounces
    surfaces: Bounces | None
    paths: PathLight | None
    rays: int


class Exchanged(NamedTuple):
    """What receivers get from each other, added to what they get directly.

    Attributes
    ----------
    vectors : (V, channels, (L+1)²) float32
    fixed : FixedLights or None
    bounces : int
    rays : int
    noise : float or None
        Relative RMS noise of ``vectors``; None where nothing is random.
    """

    vectors: NDArray[np.float32]
    fixed: FixedLights | None
    bounces: int
    rays: int
    noise: float | None


def exchange_light(
    planned: PlannedScene,
    vectors: NDArray[np.float32],
    fixed: FixedLights | None,
    blocked: NDArray[np.float32],
    interior: InteriorVertices,
    report: Callable[[int], None],
) -> Exchanged:
    """Add what receivers get from each other.

    Parameters
    ----------
    planned : PlannedScene
    vectors : (V, 1, (L+1)²) float32
        Direct transfer; its memory may become the result's.
    fixed : FixedLights or None
        Direct light of lamps.
    blocked : (V,)
        Part of each hemisphere that shows no sky.
    interior : InteriorVertices
    report : callable
        Given the number of vertices finished since its last call.
    """
    plan = planned.plan
    seeing = plan.shadowed[~planned.within_media[plan.shadowed]] if plan.interreflection else plan.shadowed[:0]
    if planned.remote is None:
        trace = _trace_here
    else:
        from slepian_prt.transport.by_workers.exchange import trace_exchange as trace
    return _Solver(planned, trace(planned, seeing, blocked, report), blocked, interior).solve(vectors, fixed)


def _trace_here(
    planned: PlannedScene, seeing: NDArray[np.int64], blocked: NDArray[np.float32], report: Callable[[int], None]
) -> Known:
    """What is exchanged; ``seeing`` are the receivers that surfaces are gathered at."""
    scene, plan, settings = planned.scene, planned.plan, planned.settings
    gather = paths = None
    if seeing.size:
        gather = gather_operator(scene, gathering_nodes(settings.samples), seeing, blocked, settings.seed + 1, report)
    if plan.interreflection:
        planned.clock.stop("interreflection")
    if plan.paths is not None:
        wanted = plan.paths
        paths = trace_paths(
            scene, wanted.receivers, wanted.samples, wanted.effects, settings.bandlimit, plan.channels, settings.seed,
            report,
        )  # fmt: skip
        planned.clock.stop("paths")
    exchange = gather if paths is None else Together(gather, paths)
    assert exchange is not None
    rays = sum(part.rays for part in (gather, paths) if part is not None)
    return Known(BouncesHere(exchange), None if gather is None else BouncesHere(gather), paths, rays)


def add_indirect(planned: PlannedScene, vectors: NDArray[np.float32], report: Callable[[int], None]) -> Exchanged:
    """Transfer toward a camera with what comes by way of other surfaces, whatever these are made of."""
    if planned.remote is None:
        trace = trace_view_paths
    else:
        from slepian_prt.transport.by_workers.paths import view_paths_by_workers as trace
    paths, bounces = trace(planned, report), bounces_toward(planned.settings)
    planned.clock.stop("paths")
    if vectors.shape[1] == 1:
        vectors = np.repeat(vectors, 3, axis=1)
    brought, error = np.zeros_like(vectors), np.zeros_like(vectors)
    brought[paths.rows], error[paths.rows] = paths.escaped, paths.escaped_error
    change, variance = _noise_in(planned, paths.rows, brought, error)
    vectors = vectors + brought + change
    planned.clock.stop("smoothing")
    return Exchanged(merge_equal_channels(vectors), None, bounces, paths.rays, relative_noise(variance, vectors))


class _Solver:
    """The series, for what is known to be exchanged."""

    def __init__(
        self,
        planned: PlannedScene,
        known: Known,
        blocked: NDArray[np.float32],
        interior: InteriorVertices,
    ) -> None:
        self._planned, self._known, self._paths = planned, known, known.paths
        self._blocked, self._interior = blocked, interior
        self._albedo = planned.scene.receivers.albedo
        self._channels = planned.plan.channels

    def solve(self, vectors: NDArray[np.float32], fixed: FixedLights | None) -> Exchanged:
        settings, interior, paths = self._planned.settings, self._interior, self._paths
        bounces = self._likely_bounces() if settings.bounces is None else settings.bounces
        source = None if paths is None else self._source
        vectors = self._known.all.add(self._albedo, vectors[:, 0], self._channels, bounces, source)
        interior.fill(vectors)
        noise = None
        if paths is not None:
            _remark_on_energy(self._planned, paths, vectors)
            self._planned.clock.stop("bounces")
            noise = self._take_out_noise(paths, vectors, bounces)
            self._planned.clock.stop("smoothing")
        rays = self._known.rays
        if fixed is not None:
            brought, lamp_rays = self._light_of_lamps()
            rays += lamp_rays
            bounced = bounced_light(
                self._known.all, self._albedo, fixed.direct, self._channels, settings.bounces, brought
            )
            for light in bounced:
                interior.fill(light)
            fixed = replace(fixed, bounced=bounced)
        if paths is None:
            self._planned.clock.stop("interreflection")
        return Exchanged(vectors, fixed, bounces, rays, noise)

    def _take_out_noise(self, paths: PathLight, vectors: NDArray[np.float32], bounces: int) -> float:
        """Smooth what paths brought along the surface, in place; returns the relative noise that is left.

        What surfaces reflect of the difference follows: (1 - R diag(ρ))⁻¹ of it is added.
        """
        brought, error = np.zeros_like(vectors), np.zeros_like(vectors)
        for channel in range(self._channels):
            light, albedo = vectors[:, channel], self._albedo_of(channel)
            brought[:, channel] = self._source(channel, slice(None))
            error[paths.rows, channel] = paths.escaped_error[:, channel]
            if bounces > 0:
                brought[:, channel] += paths.reflected(albedo, light, channel)
                error[paths.rows, channel] += paths.error(albedo, light, channel)
        self._interior.fill(brought)
        change, variance = _noise_in(self._planned, paths.rows, brought, error)
        if change.any():
            vectors += self._spread(change, bounces)
            self._interior.fill(vectors)
        return relative_noise(variance, vectors)

    def _light_of_lamps(self) -> tuple[NDArray[np.float32] | None, int]:
        """(lamps, V, 3) what comes from lamps by way of mirrors, glass and the like; and the rays that it took."""
        planned, wanted = self._planned, self._planned.plan.paths
        if wanted is None:
            return None, 0
        if planned.remote is None:
            trace = trace_lamp_paths
        else:
            from slepian_prt.transport.by_workers.lamps import lamp_paths_by_workers as trace
        found, groups, count = trace(planned, wanted), planned.lamps.groups, len(planned.scene.receivers)
        brought = np.zeros((len(groups), count, 3), dtype=np.float32)
        for light, radiance, half in zip(brought, found.radiance, found.error, strict=True):
            light[found.rows] = radiance
            self._interior.fill(light)
            error = np.zeros_like(light)
            error[found.rows] = half
            light += _noise_in(planned, found.rows, light[:, :, None], error[:, :, None])[0][:, :, 0]
        planned.clock.stop("paths to lamps")
        return brought, found.rays

    def _spread(self, light: NDArray[np.float32], bounces: int) -> NDArray[np.float32]:
        """(V, channels, M) light, and what surfaces reflect of it onto each other."""
        if self._known.surfaces is None:
            return light
        none = np.zeros((len(light), light.shape[2]), dtype=np.float32)

        def source(channel: int, columns: slice) -> NDArray[np.float32]:
            return light[:, channel, columns]

        return self._known.surfaces.add(self._albedo, none, self._channels, bounces, source)

    def _albedo_of(self, channel: int) -> NDArray[np.float32]:
        albedo = self._albedo.mean(axis=1) if self._channels == 1 else self._albedo[:, channel]
        return albedo.astype(np.float32)

    def _source(self, channel: int, columns: slice) -> NDArray[np.float32]:
        """What paths bring from the sky; vertices inside other geometry get what those before it get."""
        assert self._paths is not None
        light = self._paths.source(len(self._albedo), channel, columns)
        self._interior.fill(light)
        return light

    def _likely_bounces(self) -> int:
        active = self._planned.scene.receivers.active
        ambient = np.where(active, 1.0 - self._blocked, 0.0)
        if self._paths is None:
            return self._known.all.count(self._albedo, ambient)
        channels = range(self._channels)
        columns = [self._albedo.mean(axis=1, keepdims=True)] if self._channels == 1 else self._albedo.T[:, :, None]
        counts = []
        for channel in channels:
            first = self._source(channel, slice(0, 1))[:, 0] * _WHITE
            counts.append(self._known.all.count(columns[channel], ambient + first, channel))
        return max(counts)


def _noise_in(
    planned: PlannedScene, rows: NDArray[np.int64], brought: NDArray[np.float32], error: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """What to add to light that paths brought, to take noise out of it along the surface; the variance that is left.

    Parameters
    ----------
    planned : PlannedScene
    rows : indices of receivers
        That paths start from; at others nothing changes.
    brought, error : (V, channels, (L+1)²)
        The light, and half the difference of its halves.

    Returns
    -------
    (V, channels, (L+1)²), (V, channels, L+1)
    """
    receivers, change = planned.scene.receivers, np.zeros_like(brought)
    variance = variance_of_halves(error, receivers.neighbours)
    if planned.settings.smooth:
        pairs = across_seams(receivers.neighbours, receivers.positions, receivers.normals)
        smoothed = smooth(brought, variance, pairs, surface_guides(receivers.normals))
        change[rows], variance = smoothed.vectors[rows] - brought[rows], smoothed.variance
    return change, variance


def _remark_on_energy(planned: PlannedScene, paths: PathLight, vectors: NDArray[np.float32]) -> None:
    """Say so if there is more light than comes in, as by materials that reflect more than they get."""
    under_one = vectors[paths.rows, :, 0].max(axis=1) * _WHITE
    most = float(np.quantile(under_one, _NEARLY_ALL, method="lower"))
    if most > _TOO_BRIGHT * paths.brightest and planned.plan.paths is not None:
        log.info(
            "%s: under a sky of 1 surfaces get up to %.2g by way of %s: a material sends more than it gets; correct it",
            planned.scene.path,
            most,
            ", ".join(planned.plan.paths.effects),
        )
