"""Light that is not distant: what the lamps of a scene send to its receivers, whatever map shines."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError
from slepian_prt.sphere.harmonics import real_sh

# In a mapping of scales, what lamps get that are not named.
OTHERS = "*"

# What many lamps are called that are one.
_JOINED = "other lights"


def joined_name(count: int) -> str:
    """What a file calls so many lamps that it holds as one."""
    return f"{count} {_JOINED}"


def joined_count(name: str) -> int:
    """How many lamps a file holds under this name as one; 0 of a lamp that it holds by its own."""
    found = re.fullmatch(rf"(\d+) {_JOINED}", name)
    return int(found[1]) if found else 0


@dataclass(frozen=True, eq=False)
class FixedLights:
    """Radiance that receivers of unit albedo send back under each of the lamps of a scene.

    Attributes
    ----------
    names : tuple of str, n
        Ids of the emitters, or of the shapes that emit.
    kinds : tuple of str, n
        Their plugins: ``area``, ``point``, ``spot``, ``projector``, ``directional``, …
    emitted : (n, 3) float64
        What each was set to when this was computed: mean radiance, intensity or irradiance in linear sRGB.
    direct : (n, V, 3) float32
        From the lamp itself.
    bounced : (n, V, 3) float32
        By way of other surfaces.
    directions : (n, 3) float64
        Unit vectors toward ``directional`` lamps; zero of all others, which is the default of all.
    """

    names: tuple[str, ...]
    kinds: tuple[str, ...]
    emitted: NDArray[np.float64]
    direct: NDArray[np.float32]
    bounced: NDArray[np.float32]
    directions: NDArray[np.float64] = field(default_factory=lambda: np.zeros((1, 3)))

    def __post_init__(self) -> None:
        object.__setattr__(self, "directions", np.array(np.broadcast_to(self.directions, (len(self), 3))))

    def __len__(self) -> int:
        return len(self.names)

    @property
    def can_turn(self) -> NDArray[np.bool_]:
        """(n,) True of lamps that shine from one direction: the only ones that can turn with a map."""
        return np.asarray(self.directions.any(axis=1))

    def radiance(self, scales: NDArray[np.float64]) -> NDArray[np.float32]:
        """(V, 3) radiance of unit albedo under all lamps, each times its scale (n,)."""
        total = np.zeros(self.direct.shape[1:], dtype=np.float32)
        for scale, direct, bounced in zip(scales, self.direct, self.bounced, strict=True):
            if scale:
                total += np.float32(scale) * (direct + bounced)
        return total

    def turned(self, scales: NDArray[np.float64], rotation: NDArray, bandlimit: int) -> NDArray[np.float64]:
        """(3, (L+1)²) coefficients of the directional lamps, turned: light of irradiance E from d is E y_lm(d)."""
        lighting = np.zeros((3, (bandlimit + 1) ** 2))
        for i in np.flatnonzero(self.can_turn):
            toward = (self.directions[i] @ np.asarray(rotation).T)[None]
            lighting += scales[i] * np.outer(self.emitted[i], real_sh(bandlimit, toward)[0])
        return lighting


def lamp_scales(fixed: FixedLights | None, fixed_lights: float | Mapping[str, float]) -> NDArray[np.float64]:
    """(n,) what each lamp is multiplied by.

    Parameters
    ----------
    fixed : FixedLights or None
    fixed_lights : number, or mapping of names to numbers
        Lamps that a mapping does not name keep 1, or what it has for ``*``.

    Raises
    ------
    UserError
        A name that no lamp has, or a scale that is negative or not finite.
    """
    if not isinstance(fixed_lights, Mapping):
        return np.full(0 if fixed is None else len(fixed), _checked(fixed_lights, ""))
    names = () if fixed is None else fixed.names
    scales = {name: _checked(scale, "" if name == OTHERS else f" of '{name}'") for name, scale in fixed_lights.items()}
    for name in scales:
        if name != OTHERS and name not in names:
            known = ", ".join(f"'{known}'" for known in names) or "none"
            raise UserError(f"`fixed_lights` names '{name}', which is no lamp of the transfer; it has: {known}")
    return np.array([scales.get(name, scales.get(OTHERS, 1.0)) for name in names], dtype=np.float64)


def _checked(scale: object, of: str) -> float:
    try:
        number = float(scale)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not 0.0 <= number < math.inf:
        raise UserError(f"`fixed_lights`{of} must be a finite number from 0 on, not {scale!r}")
    return number
