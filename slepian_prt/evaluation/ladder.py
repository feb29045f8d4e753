"""The error ladder: from the path-traced reference down to the compressed picture, what each step costs.

Every rung is held against the same reference, so that the errors of successive rungs show what each step adds; beside
it stands the noise of that comparison, below which no error is claimed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from slepian_prt.evaluation.metrics import Deviation, deviation, flip, picture_deviation, relative_mse
from slepian_prt.relighting.camera import Camera
from slepian_prt.relighting.pictures import Picture, exposure

IN_PICTURE = "path-traced picture"
AT_VERTICES = "radiance at the vertices"


@dataclass(frozen=True)
class Stage:
    """One way to radiance at the vertices.

    Attributes
    ----------
    name : str
    radiance : (V, 3)
    noise : float
        Relative RMS noise of its own.
    seconds : float
        That it took, apart from the stages before.
    bytes_per_vertex : float or None
        Where something is stored.
    """

    name: str
    radiance: NDArray[np.float32]
    noise: float
    seconds: float
    bytes_per_vertex: float | None


@dataclass(frozen=True)
class Rung:
    """One step; the fields of ``ladder`` in results.json.

    Attributes
    ----------
    environment, stage, against : str
    error : float
        Relative RMS.
    percentile_99, worst : float
        Of the differences of single vertices or pixels, relative to the RMS of the reference.
    worst_at : list of int
        The vertex, or column and row of the pixel, that is worst; empty for the reference itself.
    flip, relative_mse : float or None
        Of pictures: mean FLIP (Andersson et al. 2020) as they are shown, and mean squared error of the pixels relative
        to their brightness.
    noise : float
        Relative RMS noise of the comparison.
    seconds : float
    bytes_per_vertex : float or None
    """

    environment: str
    stage: str
    against: str
    error: float
    percentile_99: float
    worst: float
    worst_at: list[int]
    flip: float | None
    relative_mse: float | None
    noise: float
    seconds: float
    bytes_per_vertex: float | None


def ladder(
    environment: str,
    reference: Picture,
    reference_noise: float,
    reference_seconds: float,
    camera: Camera,
    stages: Sequence[Stage],
) -> list[Rung]:
    """The rungs of one environment.

    Parameters
    ----------
    environment : str
    reference : Picture
        Path-traced, reduced to what the camera's pictures show.
    reference_noise, reference_seconds : float
    camera : Camera
    stages : sequence of Stage
        The first is the reference at the vertices, without a bandlimit.
    """
    exact = stages[0]
    scale = exposure(reference)
    nothing = Deviation(0.0, 0.0, 0.0, [])
    first = Stage(IN_PICTURE, exact.radiance, 0.0, reference_seconds, None)
    rungs = [_rung(environment, first, IN_PICTURE, nothing, reference_noise, 0.0, 0.0)]
    for number, stage in enumerate(stages):
        picture = camera.picture(stage.radiance)
        shown = stage if number else replace(stage, name=f"{stage.name}, interpolated")
        found, noise = picture_deviation(picture, reference), float(np.hypot(reference_noise, stage.noise))
        seen, squared = flip(picture, reference, scale), relative_mse(picture, reference)
        rungs.append(_rung(environment, shown, IN_PICTURE, found, noise, seen, squared))
    for number, stage in enumerate(stages):
        found = deviation(stage.radiance, exact.radiance) if number else nothing
        rungs.append(_rung(environment, stage, AT_VERTICES, found, exact.noise, None, None))
    return rungs


def _rung(
    environment: str,
    stage: Stage,
    against: str,
    found: Deviation,
    noise: float,
    seen: float | None,
    squared: float | None,
) -> Rung:
    return Rung(
        environment,
        stage.name,
        against,
        found.error,
        found.percentile_99,
        found.worst,
        found.worst_at,
        seen,
        squared,
        noise,
        stage.seconds,
        stage.bytes_per_vertex,
    )
