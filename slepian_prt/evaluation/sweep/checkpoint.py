"""Finished settings of a sweep on disk, so that one that was stopped goes on."""

from __future__ import annotations

import hashlib
import json
import logging
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta, Struct

from slepian_prt.compression.encoder import WarmStart
from slepian_prt.compression.fingerprint import instanced_shapes, shape_arrays
from slepian_prt.errors import UserError
from slepian_prt.evaluation.provenance import machine, versions
from slepian_prt.evaluation.sweep.axes import Setting
from slepian_prt.evaluation.sweep.results import Point
from slepian_prt.evaluation.sweep.starts import start_as_json, start_from_json
from slepian_prt.files import add_line, is_own_file
from slepian_prt.lighting.environment import Environment
from slepian_prt.transport.planned import PlannedScene

log = logging.getLogger(__name__)

# Lines are far shorter, and a file of all settings that anybody waits for is.
_LONGEST_LINE, _LARGEST_FILE = 1 << 18, 1 << 28

_Count = Annotated[int, Meta(ge=0, le=1 << 40)]
_Amount = Annotated[float, Meta(ge=0.0, le=1e30)]


class _Line(Struct):
    """What a line holds: the fields of `Setting` and `Point`, the key of the job, and what the coding started from."""

    key: str
    samples: _Count
    bandlimit: _Count
    clusters: _Count
    basis: str
    tolerance: _Amount
    bounces: _Count | None
    error: dict[str, _Amount]
    full_error: dict[str, _Amount]
    bytes_per_vertex: _Amount
    transport_seconds: _Amount
    transport_spread: _Amount
    compress_seconds: _Amount
    prepare_seconds: _Amount
    relight_seconds: _Amount
    start: dict[str, Any] | None

    def point(self, names: set[str]) -> Point:
        """The point under environments of such names; ValueError if it is of others."""
        if set(self.error) != names or set(self.full_error) != names:
            raise ValueError("other environments")
        fields = msgspec.to_builtins(self)
        return Point.from_dict({name: fields[name] for name in fields if name != "start"})


_decoder = msgspec.json.Decoder(_Line)


class SweepCheckpoint:
    """A file of finished settings for one scene, maps, noise and machine; without a path, none.

    Parameters
    ----------
    path : path or None
        Settings of anything else in that file are passed over.
    planned : PlannedScene
    environments : sequence of Environment
    noise : float
    by_workers : bool
        Whether workers measure, whose seconds are others than those of one process.

    Attributes
    ----------
    points : dict of Setting to Point
        Those in the file when it was opened.
    starts : dict of Setting to WarmStart or None
        What each of them was coded from, or is a start for.
    """

    def __init__(
        self,
        path: Path | None,
        planned: PlannedScene,
        environments: Sequence[Environment],
        noise: float,
        by_workers: bool = False,
    ) -> None:
        self._path = path
        self._key = _fingerprint(planned, environments, noise, by_workers)
        self.points: dict[Setting, Point] = {}
        self.starts: dict[Setting, WarmStart | None] = {}
        if path is None or not is_own_file(path):
            return
        names, lost = {environment.name for environment in environments}, 0
        for line in _lines(path):
            try:
                entry = _decoder.decode(line)
                if entry.key == self._key:
                    start, point = start_from_json(entry.start), entry.point(names)
                    self.starts[point.setting] = start
                    self.points[point.setting] = point
            except (msgspec.MsgspecError, RecursionError, ValueError, KeyError, TypeError, OverflowError):
                lost += 1
        if lost > 1:  # one is the line that was being written when it was killed
            log.warning("%s: %d lines are no results of a sweep; these settings are measured again", path, lost)

    def add(self, point: Point, start: WarmStart | None = None) -> None:
        """Keep a point with the start of its coding, on the disk when this returns."""
        if self._path is None:
            return
        self._path.parent.mkdir(parents=True, exist_ok=True)
        add_line(self._path, json.dumps({"key": self._key, **point.as_dict(), "start": start_as_json(start)}))

    def remove(self) -> None:
        """Delete the file, when all is done."""
        if self._path is not None:
            self._path.unlink(missing_ok=True)


def _fingerprint(planned: PlannedScene, environments: Sequence[Environment], noise: float, by_workers: bool) -> str:
    """A digest of everything but the axes that a point depends on."""
    digest = hashlib.sha256()
    settings = replace(planned.settings, samples=1, bandlimit=0, bounces=None)
    digest.update(repr((versions(), machine(), settings, noise, by_workers)).encode())
    mesh = planned.scene.mesh
    arrays = [mesh.positions, mesh.normals, mesh.faces, mesh.albedo]
    for shape in (*planned.scene.occluders, *instanced_shapes(planned.scene)):
        arrays += shape_arrays(planned.scene.mi, shape)
    for array in arrays:
        digest.update(np.ascontiguousarray(array).tobytes())
    for environment in environments:
        digest.update(repr((environment.name, environment.to_world.tolist())).encode())
        digest.update(environment.texels.tobytes())
    return digest.hexdigest()[:32]


def _lines(path: Path) -> list[bytes]:
    """Those of a file that are no longer than ours.

    Raises
    ------
    UserError
        The file cannot be read, or is none of ours.
    """
    try:
        if path.stat().st_size > _LARGEST_FILE:
            raise UserError(f"{path}: is too large for results of a sweep that was stopped; remove it")
        return [line for line in path.read_bytes().splitlines() if len(line) <= _LONGEST_LINE]
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror or error}); remove it") from None
