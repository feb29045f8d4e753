"""Paths from receivers, traced by workers in blocks."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.sphere.harmonics import num_coefficients
from slepian_prt.transport.by_workers.bounces import Rows
from slepian_prt.transport.by_workers.scene import Asked, OpenScene
from slepian_prt.transport.path_light import Ends, LightSums, PathLight, PathRays, join_light
from slepian_prt.transport.planned import PlannedScene
from slepian_prt.transport.view_paths import ViewPaths

if TYPE_CHECKING:
    from distributed import Future


# --- On workers ------------------------------------------------------------------------------------------------------


def _path_rays(planned: PlannedScene) -> PathRays:
    wanted, settings = planned.plan.paths, planned.settings
    assert wanted is not None
    return PathRays(planned.scene, wanted.samples, wanted.effects, settings.seed)


def _path_light(scene: OpenScene, item: tuple[Asked | None, NDArray[np.int64]]) -> PathLight:
    asked, receivers = item
    rays, planned = scene.tool(asked, _path_rays), scene.planned(asked)
    return _sum(planned, rays.trace(receivers), planned.plan.channels, rays.brightest)


def _view_paths(planned: PlannedScene) -> ViewPaths:
    return ViewPaths.planned(planned)


def _view_light(scene: OpenScene, item: tuple[Asked | None, tuple[int, NDArray[np.int64]]]) -> PathLight:
    asked, (number, receivers) = item
    rays, planned = scene.tool(asked, _view_paths), scene.planned(asked)
    return _sum(planned, rays.trace(number, receivers), 3, 1.0)


def _sum(planned: PlannedScene, ends: Ends, channels: int, brightest: float) -> PathLight:
    bandlimit, count = planned.settings.bandlimit, len(planned.scene.receivers)
    sums = LightSums(ends.receivers, count, channels, num_coefficients(bandlimit), brightest)
    sums.add(ends, bandlimit)
    return sums.finished()


def _rows_of(_scene: Any, light: PathLight) -> Rows:
    return Rows(light.rows, light.met)


# --- On the client ---------------------------------------------------------------------------------------------------


def path_light_by_workers(planned: PlannedScene, report: Callable[[int], None]) -> tuple[list[Future], PathLight]:
    """As `trace_paths`, of a planned scene; also S in rows, that stay with workers."""
    remote, wanted = planned.remote, planned.plan.paths
    assert remote is not None
    assert wanted is not None
    lights = remote.submit(_path_light, _path_rays(planned).blocks(wanted.receivers))
    rows = remote.crew.submit(_rows_of, lights)
    return rows, _join(planned, lights, report)


def view_paths_by_workers(planned: PlannedScene, report: Callable[[int], None]) -> PathLight:
    """As `trace_view_paths`, of a planned scene."""
    assert planned.remote is not None
    lights = planned.remote.submit(_view_light, ViewPaths.planned(planned).blocks())
    return _join(planned, lights, report)


def _join(planned: PlannedScene, lights: list[Future], report: Callable[[int], None]) -> PathLight:
    assert planned.remote is not None
    parts = []
    for part in planned.remote.in_order(lights):
        parts.append(part)
        report(part.rows.size)
    return join_light(parts)
