"""Mitsuba sensors: the camera of a scene, or one that sees all of it."""

from __future__ import annotations

from typing import Any

import numpy as np

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
        return _of_view(scene, scene.view, width, samples)
    if scene.sensor is not None:
        return scene.sensor
    receivers = scene.receivers
    framing = aimed_view(Aim(), None, receivers.positions[receivers.active], width or DEFAULT_WIDTH)
    return _of_view(scene, framing, width, samples)


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
