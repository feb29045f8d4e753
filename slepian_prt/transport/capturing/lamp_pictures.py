"""Pictures of a scene under each of its lamps, by Mitsuba's own integrators, with all other light turned off."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slepian_prt.lighting.fixed_lights import FixedLights
from slepian_prt.lighting.lamps import Lamp
from slepian_prt.scene.mitsuba.files import silent
from slepian_prt.transport.capturing.camera import CameraRays
from slepian_prt.transport.capturing.denoising import pooled
from slepian_prt.transport.capturing.pixel_paths import LANES, pixels_of_lanes, stratified_sampler
from slepian_prt.transport.smoothing import smooth

# What emitters call their brightness: factors, colours and texels.
_BRIGHTNESS = ("scale", "sun_scale", "sky_scale", "radiance", "intensity", "irradiance")


class LampPictures(NamedTuple):
    """What the pixels of a camera show of n lamps, bounces and all.

    Attributes
    ----------
    lamps : list of Lamp
    radiance : (n, V, 3) float32
    variance : (n, V, 3) float32
        Of that, as passes tell it.
    """

    lamps: list[Lamp]
    radiance: NDArray[np.float32]
    variance: NDArray[np.float32]

    def smoothed(self, neighbours: NDArray[np.integer], guides: NDArray) -> LampPictures:
        """The same with less noise; ``guides`` as of `smooth`."""
        smoothed = [
            smooth(picture[:, :, None], pooled(variance[:, :, None], neighbours), neighbours, guides).vectors[:, :, 0]
            for picture, variance in zip(self.radiance, self.variance, strict=True)
        ]
        return self._replace(radiance=np.stack(smoothed))

    def fixed_lights(self) -> FixedLights:
        """As transfer holds them: all of the light as direct."""
        return FixedLights(
            tuple(lamp.name for lamp in self.lamps),
            tuple(lamp.kind for lamp in self.lamps),
            np.stack([lamp.emitted for lamp in self.lamps]),
            self.radiance,
            np.zeros_like(self.radiance),
            np.stack([lamp.direction for lamp in self.lamps]),
        )


def picture_lamp(
    mi: Any, loaded: Any, rays: CameraRays, lamp: Lamp, samples: int, seeds: tuple[int, ...]
) -> NDArray[np.float32]:
    """(V, 3) mean radiance of the pixels under a lamp alone.

    Parameters
    ----------
    mi : Mitsuba
    loaded : Mitsuba scene
        As before afterwards.
    rays : CameraRays
    lamp : Lamp
    samples : int
        Of each pixel.
    seeds : tuple of int
        That tell the picture from others.
    """
    has_media = any(shape.is_medium_transition() for shape in loaded.shapes())
    integrator = mi.load_dict({"type": "volpath" if has_media else "path", "max_depth": -1})
    with silent(mi), _alone(mi, loaded, lamp.place):
        return _picture(mi, loaded, integrator, rays, samples, seeds)


def mean_pictures(
    lamps: list[Lamp], pixels: int, passes: int, pictures: Iterator[NDArray[np.float32]]
) -> LampPictures | None:
    """Pictures under each lamp alone, the means over two passes or more, which come in order; None without lamps."""
    if not lamps:
        return None
    sums, squares = (np.zeros((len(lamps), pixels, 3)) for _ in range(2))
    for place, picture in enumerate(pictures):
        sums[place // passes] += picture
        squares[place // passes] += np.square(picture, dtype=np.float64)
    means = sums / passes
    variance = np.maximum(squares / passes - means**2, 0.0) / max(passes - 1, 1)
    return LampPictures(lamps, means.astype(np.float32), variance.astype(np.float32))


@contextmanager
def _alone(mi: Any, loaded: Any, place: int) -> Iterator[None]:
    """All emitters of a scene but one turned off, for the length of a with-block."""
    changed = []
    try:
        for number, emitter in enumerate(loaded.emitters()):
            parameters = mi.traverse(emitter)
            names = [name for name in parameters.keys() if _is_brightness(name)]  # noqa: SIM118
            if number != place and names:
                changed.append((parameters, {name: _copy(parameters[name]) for name in names}))
                for name in names:
                    parameters[name] = parameters[name] * 0
                parameters.update()
        yield
    finally:
        for parameters, before in changed:
            for name, value in before.items():
                parameters[name] = value
            parameters.update()


def _is_brightness(name: str) -> bool:
    parts = name.split(".")
    return parts[0] in _BRIGHTNESS and (len(parts) == 1 or parts[-1] in ("value", "data", "scale"))


def _copy(value: Any) -> Any:
    return value if isinstance(value, float | int) else type(value)(value)


def _picture(
    mi: Any, loaded: Any, integrator: Any, rays: CameraRays, samples: int, seeds: tuple[int, ...]
) -> NDArray[np.float32]:
    """(V, 3) mean radiance of the pixels."""
    import drjit as dr

    count = rays.width * rays.height
    per_block = max(1, LANES // samples)
    picture = np.empty((count, 3), dtype=np.float32)
    for begin in range(0, count, per_block):
        pixels = np.arange(begin, min(begin + per_block, count))
        sampler = stratified_sampler(mi, samples, pixels, *seeds)
        ray, weight = rays.sample(sampler, pixels_of_lanes(mi, pixels, samples))
        radiance, _, _ = integrator.sample(loaded, sampler, mi.RayDifferential3f(ray), rays.medium, mi.Bool(True))
        shown = mi.Color3f(mi.unpolarized_spectrum(radiance)) * weight
        dr.eval(shown)
        picture[pixels] = np.stack([np.array(dr.block_sum(one, samples)) for one in shown], axis=1) / samples
    return picture
