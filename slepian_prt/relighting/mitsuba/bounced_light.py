"""Light of a scene's lamps by way of other surfaces, as a file holds it."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.lighting.fixed_lights import FixedLights


class BouncedLight:
    """What lamps send to the vertices of a file by way of other surfaces, as bright as they are now.

    Parameters
    ----------
    mi : Mitsuba, in the variant of the scene
    fixed : FixedLights or None
        Of the file.
    scene : Mitsuba scene
        With these lamps, or some of them.
    factor : float
        Of all lamps.

    Attributes
    ----------
    unknown : tuple of str
        Lamps of the scene that the file knows nothing of.
    """

    def __init__(self, mi: Any, fixed: FixedLights | None, scene: Any, factor: float) -> None:
        self._mi, self._factor = mi, factor
        names = fixed.names if fixed is not None else ()
        unknown, self._lamps = [], []
        for emitter in scene.emitters():
            if emitter.is_environment():
                continue
            own = lamp_names(emitter)
            number = next((i for i, name in enumerate(names) if name in own), None)
            if number is None or fixed is None:
                unknown.append(own[0])
            elif fixed.bounced[number].any():
                bounced = np.ascontiguousarray(fixed.bounced[number], dtype=np.float32)
                self._lamps.append((emitter, fixed.emitted[number], mi.Float(bounced.ravel())))
        self.unknown = tuple(unknown)

    def now(self) -> Any:
        """(3 V,) flat Float of radiance for unit albedo; None where there is none."""
        import drjit as dr

        mi, total = self._mi, None
        for lamp, then, bounced in self._lamps:
            factor = self._factor * brightened(then, emitted(mi, lamp))
            vertex = dr.arange(mi.UInt32, dr.width(bounced))
            some = bounced * dr.gather(mi.Float, mi.Float(factor.astype(np.float32)), vertex % 3)
            total = some if total is None else total + some
        return total


def lamp_names(emitter: Any) -> tuple[str, ...]:
    """By which files may know a lamp: the id of the shape that emits, its own, and what it is."""
    shape = emitter.get_shape()
    names = (shape.id() if shape is not None else "", emitter.id(), emitter.class_name())
    return tuple(str(name) for name in names if name)


def emitted(mi: Any, emitter: Any) -> NDArray[np.float64] | None:
    """(3,) mean radiance, intensity or irradiance that a lamp is set to, linear sRGB; None if that cannot be told."""
    parameters = mi.traverse(emitter)
    for name, value in parameters.items():
        if re.match(r"(radiance|intensity|irradiance)\b.*(value|data)$", name):
            values = np.array(value, dtype=np.float64)
            values = values.reshape(-1, values.shape[-1] if values.ndim == 3 else max(values.size, 1))
            scale = np.ravel(np.array(parameters["scale"]))[0] if "scale" in parameters else 1.0
            mean = values.mean(axis=0) * scale
            return np.broadcast_to(mean[:3], 3).copy() if mean.size in (1, 3, 4) else None
    return None


def brightened(then: NDArray[np.float64], now: NDArray[np.float64] | None) -> NDArray[np.float64]:
    """(3,) how many times brighter a lamp is than it was; 1 where that cannot be told."""
    if now is None:
        return np.ones(3)
    return np.divide(now, then, out=np.ones(3), where=np.asarray(then) > 0.0)
