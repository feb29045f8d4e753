"""Mitsuba sensors: the camera of a scene, or one that sees all of it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from slepian_prt.scene.scene import Scene
from slepian_prt.scene.view import Aim, View, aimed_view

# Of a picture, in pixels, where the scene has no camera.
DEFAULT_WIDTH = 400


def sensor(scene: Scene, width: int | None = None, samples: int = 16) -> Any:
    """The scene's camera, or one that sees all receivers from the front, a little above.

    ``width`` is that of the picture in pixels, by default that of the scene's film or 400; the height follows the
    shape of the film or of what is framed.
    """
    if scene.view is not None:
        return view_sensor(scene.mi, scene.view, width, samples, origin=scene.origin, scale=scene.scale)
    if scene.sensor is not None:
        return scene.sensor
    receivers = scene.receivers
    framing = aimed_view(Aim(), None, receivers.positions[receivers.active], width or DEFAULT_WIDTH)
    return view_sensor(scene.mi, framing, width, samples, origin=scene.origin, scale=scene.scale)


def view_sensor(
    mi: Any, view: View, width: int | None = None, samples: int = 16, *, origin: ArrayLike = 0.0, scale: float = 1.0
) -> Any:
    """A camera of Mitsuba, in a space of which ``origin`` is a point of the world and ``scale`` the unit.

    ``width`` is that of the picture in pixels, by default that of the view.
    """
    matrix = np.array(view.to_world)
    matrix[:3, 3] = (matrix[:3, 3] - np.asarray(origin)) / scale
    columns = view.width if width is None else width
    return _perspective(
        mi,
        matrix,
        {"fov": view.fov, "fov_axis": "x"},
        (columns, max(1, round(columns * view.height / view.width))),
        (view.near / scale, view.far / scale),
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
