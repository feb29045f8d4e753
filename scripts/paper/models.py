"""Transfer and light that figures measure on: the shipped knot, and scans where SLEPIAN_PRT_DATA names their folder."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import slepian_prt as sp


class Model(NamedTuple):
    """A model and the map that lights it.

    Attributes
    ----------
    name : str
    mesh, environment : Path
    """

    name: str
    mesh: Path
    environment: Path

    def lighting(self, bandlimit: int) -> NDArray[np.float64]:
        """(3, (L+1)²) spherical harmonics of the map."""
        return sp.project_environment(self.environment, bandlimit, clamp_negative=True)


def models(*scans: str) -> Iterator[Model]:
    """The knot under its sky, and those of the scans ``skull`` and ``nefertiti`` that are at hand, in a studio."""
    yield Model("knot, sky", sp.example("knot"), sp.example("sky"))
    folder = os.environ.get("SLEPIAN_PRT_DATA")
    for scan in scans if folder else ():
        mesh = Path(str(folder)) / "meshes" / f"{scan}.ply"
        if mesh.exists():
            yield Model(f"{scan}, studio", mesh, Path(str(folder)) / "environments" / "studio.exr")
