"""The error ladder: from the path-traced reference down to the compressed picture, what each stage costs.

Every stage is held against the same reference, so that the errors of successive stages show what each adds; beside it
stands the noise of that comparison, below which no error is claimed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slepian_prt.evaluation.metrics import Deviation, deviation, flip, picture_deviation, relative_mse
from slepian_prt.relighting.drawing.camera import Camera
from slepian_prt.relighting.drawing.pictures import Picture, exposure

IN_PICTURE = "path-traced picture"
AT_VERTICES = "radiance at the vertices"
NO_BANDLIMIT = f"{AT_VERTICES}, no bandlimit"


@dataclass(frozen=True)
class Stage:
    """One way to radiance at the vertices.

    Attributes
    ----------
    name : str
    radiance : (V, 3)
    noise : float
        Its own relative RMS noise.
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
class StageError:
    """The error of one stage against one reference; the fields of ``ladder`` in results.json.

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
        Of pictures: mean FLIP (Andersson et al. 2020), and mean squared error of the pixels relative to their
        brightness.
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


def measure_stages(
    environment: str,
    reference: Picture,
    reference_noise: float,
    reference_seconds: float,
    camera: Camera,
    stages: Sequence[Stage],
) -> list[StageError]:
    """Errors of all stages under one environment, first in the picture and then at the vertices.

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

    def stage_error(
        stage: Stage, against: str, off: Deviation, noise: float, *of_pictures: float, name: str | None = None
    ) -> StageError:
        flipped, squared = of_pictures or (None, None)
        costs = (noise, stage.seconds, stage.bytes_per_vertex)
        return StageError(environment, name or stage.name, against, *off, flipped, squared, *costs)

    exact, scale, none = stages[0], exposure(reference), Deviation(0.0, 0.0, 0.0, [])
    path_traced = Stage(IN_PICTURE, exact.radiance, 0.0, reference_seconds, None)
    errors = [stage_error(path_traced, IN_PICTURE, none, reference_noise, 0.0, 0.0)]
    for stage in stages:
        picture = camera.picture(stage.radiance)
        noise = float(np.hypot(reference_noise, stage.noise))
        of_pictures = flip(picture, reference, scale), relative_mse(picture, reference)
        name = f"{stage.name}, interpolated" if stage is exact else stage.name
        off = picture_deviation(picture, reference)
        errors.append(stage_error(stage, IN_PICTURE, off, noise, *of_pictures, name=name))
    for stage in stages:
        off = none if stage is exact else deviation(stage.radiance, exact.radiance)
        errors.append(stage_error(stage, AT_VERTICES, off, exact.noise))
    return errors
