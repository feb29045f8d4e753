"""One scan of a data set, in whatever process; what is wrong with it is its result."""

from __future__ import annotations

import logging
import os
import time
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from slepian_prt.accuracy.goal import Light
from slepian_prt.accuracy.run import precompute_within
from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.compression.stream import compress_scene
from slepian_prt.datasets.fingerprint import digest_of, fingerprint
from slepian_prt.datasets.jobs import ScanJob, ScanResult
from slepian_prt.datasets.obj_rows import read_rows
from slepian_prt.datasets.order_two import trace_order_two
from slepian_prt.datasets.training_files import icon_files, pifu_files
from slepian_prt.errors import UserError
from slepian_prt.files import atomic_output
from slepian_prt.transport.planned import Clock

# Processes that may die of a scan, before it has failed.
_MOST_STARTS = 3

_TRAINING = {"pifu": pifu_files, "icon": icon_files}


def precompute_scan(job: ScanJob) -> ScanResult:
    """Do a scan; nothing that is wrong with it is raised.

    Parameters
    ----------
    job : ScanJob

    Raises
    ------
    KeyboardInterrupt
    """
    started = time.perf_counter()
    known = ScanResult(job.source, job.name)
    with _collected(job.source) as notes:
        try:
            known = replace(known, fingerprint=fingerprint(job.source, job.asked))
            if _is_there(job, known.fingerprint):
                assert job.before is not None
                return replace(job.before, source=job.source, kept=True)
            with _begun(job):
                if _TRAINING.keys() & set(job.settings.formats):  # first, as they refuse more, and sooner
                    known = _write_training(job, known)
                if "prt" in job.settings.formats:
                    known = _write_prt(job, known)
                known = _measured(job, known)
        except UserError as error:
            known = replace(known, failure=str(error))
        except Exception as error:  # a fault of ours must not cost the scans that come after it
            if os.environ.get("SLEPIAN_PRT_DEBUG"):
                traceback.print_exc()
            reason = " ".join(str(error).split())
            known = replace(known, failure=f"internal error, {type(error).__name__}: {reason} (please report it)")
    seconds = {**known.seconds, "all": time.perf_counter() - started}
    rounded = {stage: round(taken, 4) for stage, taken in seconds.items()}
    return replace(known, seconds=rounded, notes=tuple(dict.fromkeys((*notes, *known.notes))))


def mark_of(job: ScanJob) -> Path:
    """A file that is there while a scan is done, and stays where the process died of it."""
    return Path(job.folder) / f".{job.name}.begun"


@contextmanager
def _begun(job: ScanJob) -> Iterator[None]:
    mark = mark_of(job)
    starts = int(mark.read_text() or 1) if mark.is_file() else 0
    if starts >= _MOST_STARTS:
        mark.unlink()
        raise UserError(
            f"{job.source}: each of {starts} processes that did it was killed; it may need more memory than there is"
        )
    mark.write_text(str(starts + 1))
    try:
        yield
    finally:
        mark.unlink(missing_ok=True)


def _is_there(job: ScanJob, wanted: str) -> bool:
    """Whether the outputs of last time are those that are asked for now, and are whole."""
    before = job.before
    if before is None or before.failure is not None or before.fingerprint != wanted or not before.outputs:
        return False
    paths = {output: Path(job.folder) / output for output in before.outputs}
    return all(path.is_file() and digest_of(path) == before.digests.get(output) for output, path in paths.items())


def _write_prt(job: ScanJob, known: ScanResult) -> ScanResult:
    """The compressed transfer, of which the result tells then."""
    settings, output = job.settings, f"{job.name}.prt"
    packed = _compressed(job)
    clock = Clock(packed.seconds)
    packed.save(Path(job.folder) / output, keep_order=packed.vertex_count <= settings.kept_order)
    clock.stop("write")
    error = max(packed.verified.values()) if packed.verified else settings.compression.expected_error(packed.expected)
    return replace(
        known,
        outputs=(output, *known.outputs),
        seconds=_added(known.seconds, clock.seconds),
        error=float(f"{error:.4g}"),
        vertices=packed.vertex_count,
        rays=known.rays + packed.rays_traced,
    )


def _compressed(job: ScanJob) -> CompressedTransfer:
    settings = job.settings
    if settings.goal is None:
        return compress_scene(job.source, settings.compression, settings.transport)
    light = settings.light or Light()
    return precompute_within(job.source, settings.goal, light, settings.compression, settings.transport).packed


def _write_training(job: ScanJob, known: ScanResult) -> ScanResult:
    """Files of the formats of order 2, which share their rays."""
    settings, clock = job.settings, Clock()
    crease = settings.transport.crease_angle
    mesh, faces = read_rows(job.source, 180.0 if crease is None else crease)
    traced = trace_order_two(mesh, settings.samples, settings.transport.seed, clock.stop)
    files: dict[str, bytes] = {}
    for name, made in _TRAINING.items():
        files |= made(job.name, traced.vectors, faces) if name in settings.formats else {}
    for path, content in files.items():
        _write(Path(job.folder) / path, content)
    clock.stop("write")
    return replace(
        known,
        outputs=tuple(files),
        seconds=clock.seconds,
        error=float(f"{traced.error:.4g}"),
        vertices=len(mesh.positions),
        rays=traced.rays,
    )


def _write(path: Path, content: bytes) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"{path.parent}: cannot be made ({error.strerror or error}); rename what is there") from None
    with atomic_output(path) as file:
        file.write(content)


def _added(seconds: dict[str, float], more: dict[str, float]) -> dict[str, float]:
    """Stage by stage."""
    return {stage: seconds.get(stage, 0.0) + more.get(stage, 0.0) for stage in dict.fromkeys((*seconds, *more))}


def _measured(job: ScanJob, known: ScanResult) -> ScanResult:
    """With the size and the digest of each output."""
    paths = {output: Path(job.folder) / output for output in known.outputs}
    size = sum(path.stat().st_size for path in paths.values())
    return replace(known, bytes=size, digests={output: digest_of(path) for output, path in paths.items()})


@contextmanager
def _collected(source: str) -> Iterator[list[str]]:
    """What the library remarks meanwhile, without the name of the scan before it."""
    notes: list[str] = []
    log, handler = logging.getLogger("slepian_prt"), _Collector(notes, f"{source}: ")
    level = log.level
    log.setLevel(logging.INFO)
    log.addHandler(handler)
    try:
        yield notes
    finally:
        log.removeHandler(handler)
        log.setLevel(level)


class _Collector(logging.Handler):
    def __init__(self, notes: list[str], subject: str) -> None:
        super().__init__()
        self._notes, self._subject = notes, subject

    def emit(self, record: logging.LogRecord) -> None:
        self._notes.append(record.getMessage().removeprefix(self._subject))
