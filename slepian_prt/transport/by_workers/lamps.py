"""Light of lamps, sampled by workers in blocks of receivers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slepian_prt.transport.by_workers.scene import Asked, OpenScene
from slepian_prt.transport.effects import PathPlan
from slepian_prt.transport.fixed_lights import lamp_tracer
from slepian_prt.transport.lamp_light import DirectLight, LampTracer, cut_receivers, join_direct
from slepian_prt.transport.lamp_paths import BroughtLight, LampPaths, join_brought
from slepian_prt.transport.planned import PlannedScene


def _tracer(planned: PlannedScene) -> LampTracer:
    return lamp_tracer(planned)


def _direct(scene: OpenScene, item: tuple[Asked | None, tuple[NDArray[np.int64], bool]]) -> DirectLight:
    asked, (receivers, shadows) = item
    return scene.tool(asked, _tracer).trace_block(receivers, shadows)


def _lamp_paths(planned: PlannedScene) -> LampPaths:
    assert planned.plan.paths is not None
    return LampPaths.planned(planned, planned.plan.paths)


def _brought(scene: OpenScene, item: tuple[Asked | None, NDArray[np.int64]]) -> BroughtLight:
    asked, receivers = item
    return scene.tool(asked, _lamp_paths).trace(receivers)


@dataclass(frozen=True, eq=False)
class LampsByWorkers:
    """Samples the lamps of a planned scene, by workers."""

    planned: PlannedScene

    def trace(self, vertices: NDArray[np.int64], *, shadows: bool) -> DirectLight:
        """As of `LampTracer`."""
        remote = self.planned.remote
        assert remote is not None
        parts = remote.submit(_direct, [(block, shadows) for block in cut_receivers(vertices)])
        return join_direct(list(remote.in_order(parts)))


def lamp_paths_by_workers(planned: PlannedScene, wanted: PathPlan) -> BroughtLight:
    """As `trace_lamp_paths`, of a planned scene."""
    remote = planned.remote
    assert remote is not None
    blocks = LampPaths.planned(planned, wanted).blocks(wanted.receivers)
    return join_brought(list(remote.in_order(remote.submit(_brought, blocks))))
