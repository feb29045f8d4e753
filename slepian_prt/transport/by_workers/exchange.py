"""What receivers get from each other, traced by workers; rows of the exchange stay with them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slepian_prt.transport.by_workers.bounces import RemoteBounces, Rows
from slepian_prt.transport.by_workers.paths import path_light_by_workers
from slepian_prt.transport.by_workers.scene import Asked, OpenScene, RemoteScene
from slepian_prt.transport.exchange import Known
from slepian_prt.transport.interreflection import Gatherer, cut_gathering, gathering_nodes
from slepian_prt.transport.planned import PlannedScene

if TYPE_CHECKING:
    from distributed import Future

    from slepian_prt.distributed.crew import Crew

# Less than in one process, so that the last blocks of all workers end about together.
_RAYS_PER_BLOCK = 1 << 18

# Part of a worker's memory that all rows may take.
_PART_OF_MEMORY = 0.25


# --- On workers ------------------------------------------------------------------------------------------------------


class _Told(NamedTuple):
    """What the client hears of rows."""

    receivers: int
    rays: int
    nbytes: int


class _Gathered(NamedTuple):
    """Rows, and the rays that they took."""

    rows: Rows
    rays: int


def _gatherer(planned: PlannedScene) -> Gatherer:
    settings = planned.settings
    return Gatherer(planned.scene, gathering_nodes(settings.samples), settings.seed + 1)


def _gather(scene: OpenScene, item: tuple[Asked | None, tuple[NDArray[np.int64], NDArray[np.float32]]]) -> _Gathered:
    asked, (receivers, blocked) = item
    gatherer = scene.tool(asked, _gatherer)
    before = gatherer.rays
    weights = gatherer.gather(receivers, blocked).weights
    return _Gathered(Rows(receivers, (weights,)), gatherer.rays - before)


def _rows_of(_scene: Any, gathered: _Gathered) -> Rows:
    return gathered.rows


def _tell(_scene: Any, gathered: _Gathered) -> _Told:
    return _Told(gathered.rows.receivers.size, gathered.rays, gathered.rows.nbytes)


def _memory(dask_worker: Any = None) -> tuple[str, int, int]:
    """Machine of a worker, the bytes that it may take (0: no limit), and those of its machine."""
    import platform

    import psutil

    return platform.node(), int(dask_worker.memory_manager.memory_limit or 0), psutil.virtual_memory().total


# --- On the client ---------------------------------------------------------------------------------------------------


def trace_exchange(
    planned: PlannedScene, seeing: NDArray[np.int64], blocked: NDArray[np.float32], report: Callable[[int], None]
) -> Known:
    """What is exchanged; ``seeing`` are the receivers that surfaces are gathered at.

    Parameters
    ----------
    planned : PlannedScene
        With workers.
    seeing : (n,)
    blocked : (V,)
        Part of each hemisphere that shows no sky.
    report : callable
        Given the number of vertices finished since its last call.
    """
    remote = planned.remote
    assert remote is not None
    parts: list[list[Future]] = []
    rays = nbytes = 0
    if seeing.size:
        rows, told = _gather_rows(remote, planned, seeing, blocked, report)
        parts.append(rows)
        rays, nbytes = sum(t.rays for t in told), sum(t.nbytes for t in told)
    if planned.plan.interreflection:
        planned.clock.stop("interreflection")
    surfaces, paths = list(parts), None
    if planned.plan.paths is not None:
        rows, paths = path_light_by_workers(planned, report)
        parts.append(rows)
        rays += paths.rays
        nbytes += sum(met.data.nbytes + met.indices.nbytes for met in paths.met)
        planned.clock.stop("paths")
    whole = nbytes <= _PART_OF_MEMORY * _least_memory(remote.crew)
    between = RemoteBounces(remote.crew, surfaces, whole) if surfaces else None
    return Known(RemoteBounces(remote.crew, parts, whole), between, paths, rays)


def _gather_rows(
    remote: RemoteScene,
    planned: PlannedScene,
    seeing: NDArray[np.int64],
    blocked: NDArray[np.float32],
    report: Callable[[int], None],
) -> tuple[list[Future], list[_Told]]:
    nodes = gathering_nodes(planned.settings.samples)
    _, pieces = cut_gathering(planned.scene, nodes, seeing, _RAYS_PER_BLOCK)
    gathered = remote.submit(_gather, [(piece, blocked[piece]) for piece in pieces])
    told = []
    for _, fact in remote.crew.results(remote.crew.submit(_tell, gathered, priority=1)):
        told.append(fact)
        report(fact.receivers)
    return remote.crew.submit(_rows_of, gathered), told


def _least_memory(crew: Crew) -> int:
    """Bytes of the worker that has least; those without a limit share their machine's."""
    found = list(crew.client.run(_memory, on_error="ignore").values())
    sharing = Counter(machine for machine, _, _ in found)
    return min((limit or machine_has // sharing[machine] for machine, limit, machine_has in found), default=0)
