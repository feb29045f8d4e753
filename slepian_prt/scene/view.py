"""A perspective camera as plain data, kept with the transfer that was made in its scene."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike


@dataclass(frozen=True)
class View:
    """A perspective camera in world space.

    Attributes
    ----------
    name : str
    to_world : nested lists, (4, 4)
    fov : float
        Across the width, in degrees.
    width, height : int
        Of the film, in pixels.
    near, far : float
        Clipping distances.
    """

    name: str
    to_world: list[list[float]]
    fov: float
    width: int
    height: int
    near: float
    far: float

    def moved(self, by: ArrayLike) -> View:
        """The same camera, its position moved by (3,)."""
        matrix = np.array(self.to_world)
        matrix[:3, 3] += by
        return replace(self, to_world=matrix.tolist())

    def as_dict(self) -> dict[str, Any]:
        """The attributes by name, for files."""
        return asdict(self)


def view_of(mi: Any, sensor: Any) -> View | None:
    """A scene's own camera, or None if it is not a plain perspective one."""
    if sensor is None or sensor.class_name() != "PerspectiveCamera":
        return None
    parameters = mi.traverse(sensor)
    columns, rows = (int(n) for n in sensor.film().size())
    shifted = [float(np.ravel(parameters[f"principal_point_offset_{axis}"])[0]) for axis in "xy"]
    if any(shifted) or [int(n) for n in sensor.film().crop_size()] != [columns, rows]:
        return None  # cropped, or with a shifted lens
    matrix = np.array(parameters["to_world"].matrix, dtype=np.float64).reshape(4, 4)
    return View(
        sensor.id(),
        matrix.tolist(),
        float(np.ravel(parameters["x_fov"])[0]),
        columns,
        rows,
        float(parameters["near_clip"]),
        float(parameters["far_clip"]),
    )
