"""Light of a scene's lamps by way of other surfaces, as a file holds it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.lighting.fixed_lights import FixedLights, joined_count
from slepian_prt.lighting.lamps import UNSEEN, emitted_light, lamp_kind

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
    named : mapping of str to Mitsuba emitter, optional
        The lamps of the scene by the names that the file has for them. By default they are found by their ids, and
        those without by their kind and brightness.

    Attributes
    ----------
    unknown : tuple of str
        Lamps of the scene that the file knows nothing of.
    """

    def __init__(
        self,
        mi: Any,
        fixed: FixedLights | None,
        scene: Any,
        factor: float,
        named: Mapping[str, Any] | None = None,
    ) -> None:
        self._mi, self._factor = mi, factor
        if named is None:
            lamps = [emitter for emitter in scene.emitters() if not emitter.is_environment()]
            names = [_names(lamp)[0] for lamp in lamps]
        else:
            names, lamps = list(named), list(named.values())
        self._lamps: list[tuple[Sequence[Any], NDArray[np.float64], Any]] = []
        self.unknown = tuple(names)
        if fixed is None:
            return
        if named is None:
            found = _same_lamps(mi, fixed, lamps)
        else:
            found = {number: names.index(name) for number, name in enumerate(fixed.names) if name in named}
        others = [i for i, lamp in enumerate(lamps) if i not in found.values() and _shines(mi, lamp)]
        self.unknown = tuple(names[i] for i in others)
        for number, name in enumerate(fixed.names):
            same, then = [lamps[found[number]]] if number in found else [], fixed.emitted[number]
            if not same and (count := joined_count(name)):
                same = [lamps[i] for i in others if lamp_kind(lamps[i]) not in UNSEEN]
                then = count * then
                self.unknown = self.unknown if len(same) > count else ()
            if same and fixed.bounced[number].any():
                bounced = np.ascontiguousarray(fixed.bounced[number], dtype=np.float32)
                self._lamps.append((same, then, mi.Float(bounced.ravel())))

    def now(self) -> Any:
        """(3 V,) flat Float of radiance for unit albedo; None where there is none."""
        import drjit as dr

        mi, total = self._mi, None
        for lamps, then, bounced in self._lamps:
            factor = self._factor * brightened(mi, lamps, then)
            vertex = dr.arange(mi.UInt32, dr.width(bounced))
            some = bounced * dr.gather(mi.Float, mi.Float(factor.astype(np.float32)), vertex % 3)
            total = some if total is None else total + some
        return total


def brightened(mi: Any, lamps: Sequence[Any], then: NDArray[np.float64]) -> NDArray[np.float64]:
    """(3,) how many times brighter lamps are, together, than they were; 1 where a spectrum does not tell."""
    now = np.full(3, np.nan) if mi.is_spectral else np.sum([emitted_light(mi, lamp) for lamp in lamps], axis=0)
    known = np.isfinite(now) & (np.asarray(then) > 0.0)
    return np.divide(now, then, out=np.ones(3), where=known)


def _shines(mi: Any, lamp: Any) -> bool:
    """Whether a lamp is not set to zero, as far as that can be told."""
    return bool(mi.is_spectral or emitted_light(mi, lamp).any())


def _same_lamps(mi: Any, fixed: FixedLights, lamps: Sequence[Any]) -> dict[int, int]:
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
            alone = number not in found and not joined_count(fixed.names[number])
            if alone and kind == lamp_kind(lamp) and np.allclose(now, then, rtol=_SAME):
                found[number] = i
                break
    return found


def _names(emitter: Any) -> tuple[str, ...]:
    """By which files may know a lamp: the id of the shape that emits, its own, and what it is."""
    shape = emitter.get_shape()
    names = (shape.id() if shape is not None else "", emitter.id(), lamp_kind(emitter))
    return tuple(str(name) for name in names if name)
