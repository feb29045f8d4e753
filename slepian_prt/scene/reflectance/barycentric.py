"""Points spread evenly over the faces of a mesh, in barycentric coordinates."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

# Along each side of a face, points that are looked at: more where there are few faces.
_FEWEST_POINTS, _MOST_POINTS = 4, 32


@lru_cache(maxsize=32)
def barycentric_grid(n: int) -> NDArray[np.float64]:
    """(n², 3) centres of the n² equal triangles that a triangle is cut into."""
    up = [(3 * i + 1, 3 * j + 1) for i in range(n) for j in range(n - i)]
    down = [(3 * i + 2, 3 * j + 2) for i in range(n) for j in range(n - i - 1)]
    first = np.array(up + down) / (3.0 * n)
    return np.column_stack([1.0 - first.sum(axis=1), first])


def points_on(faces: int, lookups: float) -> NDArray[np.float64]:
    """(n², 3) where each of so many faces is looked at, for about so many lookups in all."""
    n = math.sqrt(lookups / max(faces, 1))
    return barycentric_grid(int(min(max(n, _FEWEST_POINTS), _MOST_POINTS)))
