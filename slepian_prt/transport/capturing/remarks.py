"""What is worth knowing of a capture beside its picture: lamps that light nothing, light that cannot be right."""

from __future__ import annotations

import logging
import math
from typing import Any

import numpy as np

from slepian_prt.errors import UserError
from slepian_prt.renderer.shape_names import shape_name
from slepian_prt.scene.film import Film
from slepian_prt.transport.capturing.camera import CameraRays
from slepian_prt.transport.capturing.denoising import Pixels
from slepian_prt.transport.capturing.lamp_pictures import LampPictures
from slepian_prt.transport.capturing.pixel_means import BlockMeans
from slepian_prt.transport.smoothing import variance_of_paths

log = logging.getLogger(__name__)

_WHITE = math.sqrt(4.0 * math.pi)

# More than so much under a sky of 1 is worth a remark, in so many pixels, if it is so many standard deviations more.
_TOO_BRIGHT, _SOME, _SURE = 1.1, 0.01, 3.0

# What squares of fit into float32, thousands of them.
_LARGEST = 1e16

# Rays into a medium, and the part of them that may slip through the cracks of its boundary.
_RAYS, _CRACKS = 1024, 0.02


def check_means(name: str, means: BlockMeans) -> None:
    """Refuse pixels that hold no numbers, or such that their squares are none.

    Raises
    ------
    UserError
        There are some.
    """
    tables = (means.vectors, means.background[:, None], means.moments[:, None])
    broken = np.any([~(np.abs(table) < _LARGEST).all(axis=(1, 2)) for table in tables], axis=0)
    if broken.any():
        raise UserError(
            f"{name}: the light of {int(broken.sum())} of {broken.size} pixels is not finite: a material sends more "
            "than it gets, or holds no numbers; correct it"
        )


def remark_on_light(name: str, film: Film, pixels: Pixels, pictures: LampPictures | None, samples: int) -> None:
    """Tell of a picture that is all background, or all dark; of light that grows; of lamps that light nothing."""
    sees_sky, sees_lamps = bool(pixels.vectors.any()), pictures is not None and bool(pictures.radiance.any())
    if not film.coverage.any() and not sees_lamps:
        log.info("%s: camera '%s' sees nothing of the scene; the picture is its background", name, film.name)
    elif not sees_sky and not sees_lamps and not film.background.any():
        log.info(
            "%s: no path from camera '%s' gets out to distant light, and no lamp lights what it sees: the picture is "
            "dark; open the scene, or add a lamp inside",
            name,
            film.name,
        )
    _remark_on_energy(name, pixels, samples)
    if pictures is not None:
        for lamp, radiance in zip(pictures.lamps, pictures.radiance, strict=True):
            if not radiance.any():
                log.info(
                    "%s: lamp '%s' lights nothing that camera '%s' sees: it is inside a closed shape (of glass, too), "
                    "hidden, or shines past all of it",
                    name,
                    lamp.name,
                    film.name,
                )


def _remark_on_energy(name: str, pixels: Pixels, samples: int) -> None:
    """Say so if there is more light than comes in: as much as under a sky of 1 is all that materials can send."""
    under_one = pixels.vectors[:, :, 0] * _WHITE
    # A few passes, or paths, hardly tell the noise of a pixel: it is no less than both say, and than that of others.
    foreseen = variance_of_paths(pixels.moments, pixels.vectors, samples)[:, :, 0]
    variance = np.maximum(foreseen, pixels.variance[:, :, 0])
    variance = np.maximum(variance, np.median(variance, axis=0))
    surely = (under_one - _SURE * _WHITE * np.sqrt(variance)).max(axis=1)
    bright = surely > _TOO_BRIGHT
    if bright.sum() > _SOME * bright.size:
        log.info(
            "%s: under a sky of 1 pixels show up to %.2g: a material sends more than it gets (correct it), or the "
            "camera is inside glass",
            name,
            float(under_one[bright].max()),
        )


def remark_on_media(mi: Any, scene: Any, name: str, rays: CameraRays) -> None:
    """Tell of media without an end, where paths that get into them stay.

    Where rays that start in a medium, at the camera or on a boundary, meet nothing, it is not closed.
    """
    import drjit as dr

    sampler = mi.load_dict({"type": "independent", "seed": 0})
    sampler.seed(0, _RAYS)
    if rays.medium is not None:
        pixels = mi.UInt32(sampler.next_1d() * (rays.width * rays.height))
        _remark_on_end(scene, name, "around the camera", rays.middles(pixels))
    for index, shape in enumerate(scene.shapes()):
        sides = ((shape.interior_medium(), "within", -1.0), (shape.exterior_medium(), "around", 1.0))
        for medium, where, side in sides:
            if medium is None:
                continue
            try:
                place = mi.SurfaceInteraction3f(shape.sample_position(0.0, sampler.next_2d()), dr.zeros(mi.Color0f))
            except RuntimeError:  # some shapes have no points to choose from
                continue
            away = mi.Frame3f(place.n * side).to_world(mi.warp.square_to_cosine_hemisphere(sampler.next_2d()))
            _remark_on_end(scene, name, f"{where} '{shape_name(shape, index)}'", place.spawn_ray(away))


def _remark_on_end(scene: Any, name: str, where: str, rays: Any) -> None:
    """Say so if rays into a medium meet nothing."""
    lost = 1.0 - float(np.mean(np.array(scene.ray_test(rays))))
    if lost > _CRACKS:
        log.info(
            "%s: the medium %s has no end: %.0f %% of the rays into it meet no boundary; put it within a closed shape",
            name,
            where,
            100.0 * lost,
        )
