"""Scans of a data set, each by one of the workers of a crew, which see the same folders as we do."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from slepian_prt.datasets.jobs import ScanJob, ScanResult
from slepian_prt.renderer.variants import chosen_variant, usable_variant

if TYPE_CHECKING:
    from slepian_prt.distributed.crew import Crew

Scan = Callable[[ScanJob], ScanResult]


def mapped_by(crew: Crew) -> Callable[[Scan, Sequence[ScanJob]], Iterator[ScanResult]]:
    """What calls a function for each job there, and gives results as they come."""

    def mapped(scan: Scan, jobs: Sequence[ScanJob]) -> Iterator[ScanResult]:
        # Workers may have been started in another folder.
        there = [replace(job, source=_absolute(job.source), folder=_absolute(job.folder)) for job in jobs]
        variant = usable_variant()
        for number, result in crew.results(crew.submit(_scan, [(scan, job, variant) for job in there], key="scan")):
            yield replace(result, source=jobs[number].source)

    return mapped


def _absolute(path: str) -> str:
    return str(Path(path).absolute())


def _scan(_nothing: None, item: tuple[Scan, ScanJob, str]) -> ScanResult:
    scan, job, variant = item
    with chosen_variant(variant):
        return scan(job)
