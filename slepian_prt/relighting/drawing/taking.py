"""What is asked of pictures: the light, and how they are taken. Whoever only asks needs no renderer."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import check_integer
from slepian_prt.scene.view import Aim

if TYPE_CHECKING:
    from slepian_prt.lighting.environment import Environment


@dataclass(frozen=True, eq=False)
class Lit:
    """What a model is drawn under, B lights.

    Attributes
    ----------
    lighting : (B, 3, (L+1)²)
        Coefficients, in the world of the file.
    radiance : (B, V, 3) float32
        Of the vertices under them.
    fixed_lights : number, or mapping of names to numbers
        What the light of the scene's lamps is multiplied by.
    environments : callable
        Gives the maps that the lights are of, as they stand; called where they are to be seen. It gives nothing for
        light that is only coefficients.
    own_turns : sequence of (3, 3), or None
        Rotations, if the light is the scene's own.
    """

    lighting: NDArray[np.float64]
    radiance: NDArray[np.float32]
    fixed_lights: float | Mapping[str, float] = 1.0
    environments: Callable[[], Sequence[Environment]] = tuple
    own_turns: Sequence[NDArray[np.float64]] | None = None


@dataclass(frozen=True)
class Taking:
    """How pictures are taken.

    Attributes
    ----------
    width : int or None
        In pixels.
    aim : Aim
        Of the camera.
    scene : path or None
        The scene or mesh file that the transfer was made from, where it is not where it was.
    spp : int or None
        Samples of each pixel, where the scene is gathered; None for as many as the noise asks for.
    """

    width: int | None = None
    aim: Aim = field(default_factory=Aim)
    scene: str | Path | None = None
    spp: int | None = None

    def __post_init__(self) -> None:
        if self.spp is not None:
            object.__setattr__(self, "spp", check_integer(self.spp, "spp", 1, _MOST_SAMPLES))


_MOST_SAMPLES = 65536
