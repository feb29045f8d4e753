"""Finished settings of a sweep on disk, so that one that was stopped goes on."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from slepian_prt.compression.encoder import WarmStart
from slepian_prt.compression.fingerprint import instanced_shapes, shape_arrays
from slepian_prt.evaluation.provenance import machine, versions
from slepian_prt.evaluation.sweep.axes import Setting
from slepian_prt.evaluation.sweep.results import Point
from slepian_prt.evaluation.sweep.starts import start_as_json, start_from_json
from slepian_prt.files import add_line, is_own_file
from slepian_prt.lighting.environment import Environment
from slepian_prt.transport.planned import PlannedScene


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
        for line in path.read_text().splitlines():
            try:
                entry = json.loads(line)
                if entry.pop("key") == self._key:
                    start, point = start_from_json(entry.pop("start")), Point.from_dict(entry)
                    self.starts[point.setting] = start
                    self.points[point.setting] = point
            except (ValueError, KeyError, TypeError, AttributeError):
                continue  # the line that was being written when it was killed

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
