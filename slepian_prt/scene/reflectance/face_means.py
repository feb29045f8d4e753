"""Textures as vertices hold them: averaged around each, and what interpolation between them then loses."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class FaceMeans(NamedTuple):
    """A texture v on faces, by means over each: enough to average it around vertices, and to say what that loses.

    Attributes
    ----------
    faces : (F, 3)
    area : (F,)
    moments : (F, 3, 3)
        Of λ_k v, by corner k and channel.
    squares : (F, 3)
        Of v².
    shared : (3, 3)
        Of λ_k λ_l.
    """

    faces: NDArray
    area: NDArray[np.float64]
    moments: NDArray[np.float64]
    squares: NDArray[np.float64]
    shared: NDArray[np.float64]

    def around_vertices(self, count: int) -> NDArray[np.float64]:
        """(count, 3) means over the faces around each vertex, weighted by λ_k; 0 where there are none."""
        weights, total = np.zeros(count), np.zeros((count, 3))
        for k in range(3):
            corner = self.faces[:, k]
            weights += np.bincount(corner, self.area / 3.0, minlength=count)
            for channel in range(3):
                total[:, channel] += np.bincount(corner, self.area * self.moments[:, k, channel], minlength=count)
        return np.asarray(total / np.maximum(weights, 1e-300)[:, None])

    def lost(self, albedo: NDArray) -> float:
        """Relative RMS of v - Σ a_k λ_k for values a at the vertices."""
        held, area = albedo[self.faces], self.area
        missed = self.squares - 2.0 * np.einsum("fkc,fkc->fc", held, self.moments)
        missed += np.einsum("fkc,kl,flc->fc", held, self.shared, held)
        whole = float(area @ self.squares.sum(axis=1))
        return math.sqrt(max(0.0, float(area @ missed.sum(axis=1))) / max(whole, 1e-300))
