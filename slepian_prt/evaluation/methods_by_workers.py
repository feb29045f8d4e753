"""Methods of a comparison by workers: parts of methods that do not depend on each other are tasks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from slepian_prt.distributed.held import value_of
from slepian_prt.evaluation.comparison import MethodResult, View
from slepian_prt.evaluation.measuring import Measured, measure_methods
from slepian_prt.evaluation.methods import METHODS, MethodRun, Part, Workload, parts_of
from slepian_prt.relighting.drawing.camera import Camera
from slepian_prt.relighting.drawing.pictures import Picture

if TYPE_CHECKING:
    from slepian_prt.distributed.crew import Crew, Shared


@dataclass(frozen=True, eq=False)
class _Job:
    """What all tasks share; see `measure_methods`."""

    first: str
    work: Workload
    views: list[View]
    camera: Camera
    pictured_terms: int


Found = tuple[tuple[MethodResult, ...], dict[str, MethodRun], list[dict[str, Picture]]]


def _silent(_: str) -> None:
    """Reports to nobody."""


def _measure(_nothing: Any, item: tuple[Shared, Part]) -> Found:
    """Results, runs for the ladder, and pictures of each view."""
    handle, part = item
    job: _Job = value_of(handle)
    runs = part.run(job.work)
    found = measure_methods(runs, job.first, job.work.transfer, job.views, job.camera, job.pictured_terms)
    return found.results, found.lossy, [view.compressed for view in found.views]


def measure_by_workers(
    crew: Crew, methods: Sequence[str], work: Workload, views: list[View], camera: Camera, pictured_terms: int
) -> Measured:
    """As `measure_methods` of `run_methods`; seconds are those of the workers."""
    parts = parts_of(methods, work.terms)
    handle = crew.share(_Job(methods[0], replace(work, report=_silent), views, camera, pictured_terms))
    order = sorted(range(len(parts)), key=lambda number: -_cost(parts[number]))  # so that all end about together
    found: list[Found] = [((), {}, [])] * len(parts)
    try:
        for place, result in crew.results(crew.submit(_measure, [(handle, parts[number]) for number in order])):
            part = parts[order[place]]
            work.report(f"{part.method}{', coded' if part.tolerances else ''} is measured")
            found[order[place]] = result
    finally:
        crew.release(handle)
    results = tuple(result for own, _, _ in found for result in own)
    lossy = {coding: run for _, own, _ in found for coding, run in own.items()}
    for _, _, pictures in found:
        views = [
            replace(view, compressed={**view.compressed, **own}) for view, own in zip(views, pictures, strict=True)
        ]
    return Measured(results, lossy, views)


def _cost(part: Part) -> float:
    """About how long it takes: tighter tolerances take longer."""
    if part.method not in METHODS:
        return 0.0
    return METHODS[part.method].cost / min(part.tolerances, default=1.0)
