"""The settings of a sweep by workers: transport of each number of rays first, then all settings, beside each other.

What is measured is the same as in one process; seconds are those of the workers, each with its own threads.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import TYPE_CHECKING, Any

from slepian_prt.distributed.held import value_of
from slepian_prt.evaluation.sweep.axes import Setting
from slepian_prt.evaluation.sweep.measure import CompressionTimes, SettingMeasurer, TransportShare, rays_aside
from slepian_prt.evaluation.sweep.results import Point
from slepian_prt.evaluation.vertex_error import MapMetric
from slepian_prt.transport.transfer import Transfer

if TYPE_CHECKING:
    from distributed import Future

    from slepian_prt.distributed.crew import Crew, Shared


@dataclass(frozen=True, eq=False)
class Level:
    """Settings that have their rays and bounces in common.

    Attributes
    ----------
    settings : tuple of Setting
    transfer : Transfer
        Of the highest bandlimit.
    shares : dict of int to TransportShare
        For each bandlimit.
    """

    settings: tuple[Setting, ...]
    transfer: Transfer
    shares: dict[int, TransportShare]


Found = list[tuple[Point, CompressionTimes]]


def _measure(_nothing: Any, item: tuple[Shared, Shared, list[Setting], list[Found]]) -> Found:
    """Settings that follow each other; ``before`` are those with more rays, which they may start from."""
    of_level, of_all, settings, before = item
    level: Level = value_of(of_level)
    measurer = SettingMeasurer(value_of(of_all))
    for point, times in chain.from_iterable(before):
        measurer.know(point.setting, times)
    found = []
    for setting in settings:
        point = measurer.measure(setting, level.transfer, level.shares[setting.bandlimit])
        found.append((point, measurer.times_of(setting)))
    return found


def measure_by_workers(
    crew: Crew, levels: Sequence[Level], metrics: dict[int, MapMetric], known: Found
) -> Iterator[tuple[Point, CompressionTimes]]:
    """Points of all settings as they come in, each with what others may start from.

    Parameters
    ----------
    crew : Crew
    levels : sequence of Level
        Those with most rays first.
    metrics : dict of int to MapMetric
        For each bandlimit.
    known : list of (Point, CompressionTimes)
        Of settings that were measured before.
    """
    handles = [crew.share(metrics)]
    first: dict[Setting, Future | Found] = {rays_aside(point.setting): [(point, times)] for point, times in known}
    futures: list[Future] = []
    try:
        for level in levels:
            handles.append(crew.share(level))
            for settings in _follow_each_other(level.settings, set(first)):
                before = [first[rays_aside(s)] for s in settings if rays_aside(s) in first]
                item = (handles[-1], handles[0], settings, before)
                # The longest ones first, so that all workers end about together.
                (future,) = crew.submit(_measure, [item], priority=settings[0].bandlimit)
                first.update({rays_aside(s): future for s in settings if rays_aside(s) not in first})
                futures.append(future)
        for _, found in crew.results(futures):
            yield from found
    finally:
        for handle in handles:
            crew.release(handle)


def _follow_each_other(settings: Sequence[Setting], known: set[Setting]) -> list[list[Setting]]:
    """Settings that are measured by themselves, and those that share what they differ from others by tolerance only."""
    groups: dict[Setting, list[Setting]] = {}
    for setting in settings:
        alone = rays_aside(setting) not in known
        groups.setdefault(setting if alone else replace(setting, tolerance=0.0), []).append(setting)
    return list(groups.values())
