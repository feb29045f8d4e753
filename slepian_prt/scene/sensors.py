"""Cameras: that of a scene, kept with the transfer, or one that frames everything."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from slepian_prt.scene.scene import Scene


# Of a picture, in pixels, where the scene has no camera.
DEFAULT_WIDTH = 400


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

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)

    def sensor(self, scene: Scene, width: int | None = None, samples: int = 16) -> Any:
        """A Mitsuba sensor in the space that the scene is traced in, scaled to ``width`` pixels."""
        mi = scene.mi
        matrix = np.array(self.to_world)
        matrix[:3, 3] = (matrix[:3, 3] - scene.origin) / scene.scale
        columns = self.width if width is None else width
        return _perspective(
            mi,
            matrix,
            {"fov": self.fov, "fov_axis": "x"},
            (columns, max(1, round(columns * self.height / self.width))),
            (self.near / scene.scale, self.far / scene.scale),
            samples,
        )


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


def sensor(scene: Scene, width: int | None = None, samples: int = 16) -> Any:
    """The scene's camera, or one that frames everything from the front, a little right and above.

    ``width`` is that of the picture in pixels, by default that of the scene's film or 400; the height follows the
    shape of the film or of what is framed.
    """
    mi = scene.mi
    if scene.view is not None:
        return scene.view.sensor(scene, width, samples)
    if scene.sensor is not None:
        return scene.sensor
    width = width or DEFAULT_WIDTH
    low, high = scene.traced_bounds
    center, radius = 0.5 * (low + high), 0.5 * float(np.linalg.norm(high - low))
    radius = max(radius, 1e-6)
    fov = 28.0
    view = np.array([0.42, 0.22, 1.0])
    view /= np.linalg.norm(view)
    right = np.cross([0.0, 1.0, 0.0], view)
    right /= np.linalg.norm(right)
    up = np.cross(view, right)
    framed = scene.traced_positions[scene.mesh.receivers.active]
    x, y = framed @ right, framed @ up
    target = 0.5 * (right * (x.min() + x.max()) + up * (y.min() + y.max())) + view * (view @ center)
    offsets = framed - target
    tangent = math.tan(math.radians(fov / 2))
    depth = offsets @ view
    aspect = float(np.clip(np.ptp(x) / max(np.ptp(y), 1e-9), 0.6, 1.8))
    distance = 1.05 * max(
        float(np.max(np.abs(offsets @ up) / tangent + depth)),
        float(np.max(np.abs(offsets @ right) / (tangent * aspect) + depth)),
        1.2 * radius,
    )
    to_world = mi.ScalarTransform4f().look_at(
        origin=(target + distance * view).tolist(), target=target.tolist(), up=[0, 1, 0]
    )
    return _perspective(
        mi,
        np.array(to_world.matrix),
        {"fov": fov, "fov_axis": "y"},
        (width, max(1, round(width / aspect))),
        (0.01 * radius, 100.0 * radius + 10.0 * distance),
        samples,
    )


def _perspective(
    mi: Any,
    to_world: Any,
    fov: dict[str, Any],
    size: tuple[int, int],
    clip: tuple[float, float],
    samples: int,
) -> Any:
    return mi.load_dict(
        {
            "type": "perspective",
            **fov,
            "near_clip": clip[0],
            "far_clip": clip[1],
            "to_world": mi.ScalarTransform4f(np.asarray(to_world).tolist()),
            "film": {
                "type": "hdrfilm",
                "width": size[0],
                "height": size[1],
                "pixel_format": "rgba",
                "rfilter": {"type": "box"},
            },
            "sampler": {"type": "multijitter", "sample_count": samples},
        }
    )
