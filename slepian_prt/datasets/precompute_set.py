"""Transfer of many scenes: `precompute_set`."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from slepian_prt.compression.from_scene import settings_of_both
from slepian_prt.datasets.by_workers import mapped_by
from slepian_prt.datasets.fingerprint import settings_digest
from slepian_prt.datasets.jobs import FORMATS, ScanJob, ScanResult, ScanSettings
from slepian_prt.datasets.naming import name_scans
from slepian_prt.datasets.records import open_records
from slepian_prt.datasets.scan import mark_of, precompute_scan
from slepian_prt.datasets.training_files import pifu_folder
from slepian_prt.distributed.given import given_crew
from slepian_prt.errors import UserError
from slepian_prt.files import check_folder

Mapped = Callable[[Callable[[ScanJob], ScanResult], Sequence[ScanJob]], Iterable[ScanResult]]


def precompute_set(
    scenes: Iterable[str | Path],
    folder: str | Path,
    *,
    formats: str | Sequence[str] = "prt",
    on_result: Callable[[ScanResult], None] = lambda _: None,
    client: Any = None,
    **settings: Any,
) -> list[ScanResult]:
    """Transfer of many scenes, each written into a folder; what is there already is not done again.

    A scene that fails does not stop the others: its result says why. ``results.jsonl`` in the folder has a line for
    each scene. Work that is killed goes on, when it is started again, with the scenes that are not there whole, or were
    made of other files, with other settings or by another version of the package.

    Parameters
    ----------
    scenes : paths
        Of mesh files and Mitsuba scenes.
    folder : path
        Made if it is not there.
    formats : some of ``prt``, ``pifu`` and ``icon``
        ``NAME.prt``; what PIFu's or ICON's training reads, of OBJ files: direct transfer of order 2 with all faces in
        the order of the file.
    on_result : callable
        Given each result when it is there.
    client : distributed.Client, or what `open_crew` takes as one, optional
        Dask workers that do a scene each; they must see the same folders.
    **settings
        As of `precompute` and `compress`: ``bandlimit``, ``tolerance``, …. Where ``samples`` is given it counts for all
        formats; ``bandlimit``, ``effects`` and compression count for ``prt``.

    Returns
    -------
    list of ScanResult
        In the order of the scenes; a scene that is given twice has one.

    Raises
    ------
    UserError
        No scene, an unknown format or setting, two scenes whose outputs would have the same name, or a folder that
        cannot be written to or has outputs of that name that are of another scene.
    """
    transport, compression = settings_of_both(settings)
    asked = ScanSettings(
        formats=(formats,) if isinstance(formats, str) else tuple(formats),
        transport=transport,
        compression=compression,
        samples=settings.get("samples"),
    )
    with given_crew(client) as crew:
        return run_set(list(scenes), folder, asked, on_result, map if crew is None else mapped_by(crew))


def run_set(
    scenes: Sequence[str | Path],
    folder: str | Path,
    settings: ScanSettings,
    on_result: Callable[[ScanResult], None] = lambda _: None,
    mapped: Mapped = map,
) -> list[ScanResult]:
    """As `precompute_set`.

    ``mapped`` calls a function for each of some jobs, and gives the results in any order, as ``map`` does.
    """
    _check(scenes, settings)
    check_folder(folder)
    names, asked = name_scans(scenes), settings_digest(settings)
    if "pifu" in settings.formats:
        _check_folders(names)
    with open_records(Path(folder)) as records:
        jobs = [ScanJob(path, name, str(folder), settings, asked, records[name]) for path, name in names.items()]
        for job in jobs:
            _check_owner(job)
        jobs.sort(key=lambda job: mark_of(job).exists())  # what a process died of would kill this one before the rest
        done: dict[str, ScanResult] = {}
        for result in mapped(precompute_scan, jobs):
            if not result.kept:
                records.add(result)
            done[result.name] = result
            on_result(result)
        records.tidy(names.values())
    return [done[name] for name in names.values()]


def _check(scenes: Sequence[str | Path], settings: ScanSettings) -> None:
    if not scenes:
        raise UserError("no scene is given; name some")
    if not settings.formats or set(settings.formats) - set(FORMATS):
        wrong = next(iter(set(settings.formats) - set(FORMATS)), "none")
        raise UserError(f"`formats` must be some of {', '.join(FORMATS)}, not {wrong!r}")
    settings.compression.check(settings.transport.bandlimit)
    if settings.goal is not None:
        settings.goal.check()
        if "prt" not in settings.formats:
            raise UserError("`max_error` and `max_seconds` are about prt; leave them out, or add `formats=prt`")


def _check_folders(names: Mapping[str, str]) -> None:
    """Raise UserError if PIFu has one folder for two scans."""
    owners: dict[str, str] = {}
    for path, name in names.items():
        folder = pifu_folder(name)
        other = owners.setdefault(folder.casefold(), path)
        if other != path:
            raise UserError(f"{other} and {path} would both be in the folder {folder} of PIFu; rename one of the two")


def _check_owner(job: ScanJob) -> None:
    """Raise UserError if the outputs of a scan would take the place of those of another."""
    if job.before is None or job.before.failure is not None:
        return
    other, own = Path(job.before.source), Path(job.source)
    if other.is_file() and not (own.is_file() and own.samefile(other)):
        raise UserError(f"{job.folder}: {job.name} there is of {other}; choose another folder for {own}")
