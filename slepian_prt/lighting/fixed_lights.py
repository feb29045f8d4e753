"""Light that is not distant: what the lamps of a scene send to its receivers, whatever map shines."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


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
    """

    names: tuple[str, ...]
    kinds: tuple[str, ...]
    emitted: NDArray[np.float64]
    direct: NDArray[np.float32]
    bounced: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.names)
