"""Rays that slip between two triangles, and whether Embree's robust mode is worth its price.

Embree tests each triangle about the origin of the ray. Along an edge that two triangles share rounding differs between
them, and a ray within some ε t of it, t how far it is, can miss both: that is a part ε t · (length of edges / area) of
the rays. Measured inside closed shapes, spheres of 320 to 327,680 faces and a cylinder of 2,000 needles, 0.5 to 4 in a
million slip, which is 0.003 to 0.016 of ε (2⁻²⁴) times the diagonal of everything times edges per area; on scans, where
most rays meet something near, none of 10⁷. Robust mode has no such rays, and takes a fifth more time.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from slepian_prt.scene.scene import Scene

_ROUNDING = 2.0**-24
_MEASURED = 0.02

# What may slip, as a part of the rays: of all, and of those that start at any one vertex. A ray that slips changes one
# of a vertex's thousand directions. One in 10⁵ does that at one vertex in a hundred, which is little beside the noise
# of the others; in an interior, where little light comes in, it would count for more.
_OF_ALL, _AT_A_VERTEX = 1e-5, 1e-4


def find_slipping(scene: Scene) -> NDArray[np.float64]:
    """(V,) bound on the part of the rays that slip between two triangles, where the surface is as about each vertex."""
    corners = scene.traced_positions[scene.faces]
    sides = corners - np.roll(corners, 1, axis=1)
    lengths = np.linalg.norm(sides, axis=2).sum(axis=1)
    areas = 0.5 * np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    vertices, count = scene.faces.ravel(), len(scene.receivers)
    length, area = (np.bincount(vertices, np.repeat(part, 3), minlength=count) for part in (lengths, areas))
    low, high = scene.traced_bounds
    density = np.divide(length, area, out=np.zeros(count), where=area > 0.0)  # without area there is nothing to hit
    return np.minimum(1.0, _MEASURED * _ROUNDING * float(np.linalg.norm(high - low)) * density)


def too_many_slip(parts: NDArray) -> bool:
    """Whether rays had better be traced in Embree's robust mode, by what `find_slipping` gave."""
    return bool(parts.mean() > _OF_ALL or parts.max() > _AT_A_VERTEX)
