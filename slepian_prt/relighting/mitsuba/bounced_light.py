"""Light of a scene's lamps by way of other surfaces, as a file holds it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.lighting.fixed_lights import FixedLights
from slepian_prt.lighting.lamps import emitted_light, lamp_kind

# Lamps without a name are the same if they are of one kind and this near in brightness.
_SAME = 1e-3


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
        lamps = [emitter for emitter in scene.emitters() if not emitter.is_environment()]
        self._lamps: list[tuple[Any, NDArray[np.float64], Any]] = []
        self.unknown = tuple(_names(lamp)[0] for lamp in lamps)
        if fixed is None:
            return
        found = _same_lamps(mi, fixed, lamps)
        self.unknown = tuple(_names(lamp)[0] for i, lamp in enumerate(lamps) if i not in found.values())
        for number, name in enumerate(fixed.names):
            # Many lamps are one in the file, which cannot follow them.
            joined = bool(self.unknown) and number not in found and name.endswith("other lights")
            if joined:
                self.unknown = ()
            if (number in found or joined) and fixed.bounced[number].any():
                bounced = np.ascontiguousarray(fixed.bounced[number], dtype=np.float32)
                lamp = None if joined else lamps[found[number]]
                self._lamps.append((lamp, fixed.emitted[number], mi.Float(bounced.ravel())))

    def now(self) -> Any:
        """(3 V,) flat Float of radiance for unit albedo; None where there is none."""
        import drjit as dr

        mi, total = self._mi, None
        for lamp, then, bounced in self._lamps:
            factor = np.full(3, self._factor) if lamp is None else self._factor * brightened(mi, lamp, then)
            vertex = dr.arange(mi.UInt32, dr.width(bounced))
            some = bounced * dr.gather(mi.Float, mi.Float(factor.astype(np.float32)), vertex % 3)
            total = some if total is None else total + some
        return total


def brightened(mi: Any, lamp: Any, then: NDArray[np.float64]) -> NDArray[np.float64]:
    """(3,) how many times brighter a lamp is than it was; 1 where a spectrum does not tell."""
    now = np.full(3, np.nan) if mi.is_spectral else emitted_light(mi, lamp)
    known = np.isfinite(now) & (np.asarray(then) > 0.0)
    return np.divide(now, then, out=np.ones(3), where=known)


def _same_lamps(mi: Any, fixed: FixedLights, lamps: list[Any]) -> dict[int, int]:
    """Places of lamps of a scene by numbers of those of a file: by name, else by kind and brightness."""
    found: dict[int, int] = {}
    for i, lamp in enumerate(lamps):
        number = next((n for n, name in enumerate(fixed.names) if name in _names(lamp) and n not in found), None)
        if number is not None:
            found[number] = i
    for i, lamp in enumerate(lamps):
        if i in found.values() or mi.is_spectral:
            continue
        now = emitted_light(mi, lamp)
        for number, (kind, then) in enumerate(zip(fixed.kinds, fixed.emitted, strict=True)):
            if number not in found and kind == lamp_kind(lamp) and np.allclose(now, then, rtol=_SAME):
                found[number] = i
                break
    return found


def _names(emitter: Any) -> tuple[str, ...]:
    """By which files may know a lamp: the id of the shape that emits, its own, and what it is."""
    shape = emitter.get_shape()
    names = (shape.id() if shape is not None else "", emitter.id(), lamp_kind(emitter))
    return tuple(str(name) for name in names if name)
