"""Mitsuba sensors: the camera of a scene, or one that frames everything."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from slepian_prt.scene.scene import Scene
from slepian_prt.scene.view import View

# Of a picture, in pixels, where the scene has no camera.
DEFAULT_WIDTH = 400


def sensor(scene: Scene, width: int | None = None, samples: int = 16) -> Any:
    """The scene's camera, or one that frames everything from the front, a little right and above.

    ``width`` is that of the picture in pixels, by default that of the scene's film or 400; the height follows the
    shape of the film or of what is framed.
    """
    if scene.view is not None:
        return _of_view(scene, scene.view, width, samples)
    if scene.sensor is not None:
        return scene.sensor
    return _framing(scene, width or DEFAULT_WIDTH, samples)


def _of_view(scene: Scene, view: View, width: int | None, samples: int) -> Any:
    """A camera in the space that the scene is traced in, its film scaled to ``width`` pixels."""
    matrix = np.array(view.to_world)
    matrix[:3, 3] = (matrix[:3, 3] - scene.origin) / scene.scale
    columns = view.width if width is None else width
    return _perspective(
        scene.mi,
        matrix,
        {"fov": view.fov, "fov_axis": "x"},
        (columns, max(1, round(columns * view.height / view.width))),
        (view.near / scene.scale, view.far / scene.scale),
        samples,
    )


def _framing(scene: Scene, width: int, samples: int) -> Any:
    """A camera in front of the receivers, a little right of them and above, that sees them all."""
    low, high = scene.traced_bounds
    center, radius = 0.5 * (low + high), 0.5 * float(np.linalg.norm(high - low))
    radius = max(radius, 1e-6)
    fov = 28.0
    view = np.array([0.42, 0.22, 1.0])
    view /= np.linalg.norm(view)
    right = np.cross([0.0, 1.0, 0.0], view)
    right /= np.linalg.norm(right)
    up = np.cross(view, right)
    framed = scene.traced_positions[scene.receivers.active]
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
    to_world = scene.mi.ScalarTransform4f().look_at(
        origin=(target + distance * view).tolist(), target=target.tolist(), up=[0, 1, 0]
    )
    return _perspective(
        scene.mi,
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
