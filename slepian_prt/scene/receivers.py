"""Where light is wanted: all that transport, compression and relighting know of a surface.

The vertices of a mesh are one kind of receivers; whoever adds another kind gives the same arrays.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Receivers:
    """Points of surfaces that receive light on the side of their normals.

    Attributes
    ----------
    positions : (V, 3) float64
        World space.
    normals : (V, 3) float64
        Unit vectors; zero where no light is received.
    albedo : (V, 3) float32
        Diffuse reflectance per colour channel.
    neighbours : (E, 2) int64
        Pairs of receivers side by side on the surface, each pair once.
    order : (V,) int64 or None
        The receivers as a file numbers them, which tells those at one place apart; None: as they are here.
    """

    positions: NDArray[np.float64]
    normals: NDArray[np.float64]
    albedo: NDArray[np.float32]
    neighbours: NDArray[np.int64]
    order: NDArray[np.int64] | None = None

    def __len__(self) -> int:
        return len(self.positions)

    @cached_property
    def active(self) -> NDArray[np.bool_]:
        """(V,) True where light is received."""
        return np.any(self.normals != 0.0, axis=1)


def morton(points: NDArray) -> NDArray[np.uint64]:
    """Position of each point, (n, 2) or (n, 3), on a Z-order curve of 2²¹ cells a side."""
    if len(points) == 0:
        return np.zeros(0, dtype=np.uint64)
    low, extent = points.min(axis=0), np.ptp(points, axis=0).max()
    cells = ((points - low) / max(float(extent), 1e-300) * (2**21 - 1)).astype(np.uint64)
    for shift, mask in (
        (32, 0x1F00000000FFFF),
        (16, 0x1F0000FF0000FF),
        (8, 0x100F00F00F00F00F),
        (4, 0x10C30C30C30C30C3),
        (2, 0x1249249249249249),
    ):
        cells = (cells | (cells << np.uint64(shift))) & np.uint64(mask)
    key = np.zeros(len(points), dtype=np.uint64)
    for axis in range(points.shape[1]):
        key |= cells[:, axis] << np.uint64(axis)
    return key
