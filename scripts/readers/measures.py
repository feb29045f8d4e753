"""What is compared of a mesh: how many triangles, how large, and where."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

# Height over longest side below which a triangle has no area that float32 coordinates tell.
_THIN = 1e-5

# Readers keep coordinates in float32; sums over nodes may round a few times.
_ROUNDINGS = 4.0


@dataclass(frozen=True)
class Measures:
    """Of the triangles of a mesh that have an area.

    Attributes
    ----------
    fewest, most : int
        How many there are, without and with those of which rounding decides whether they have an area.
    area : float
    perimeter : float
        Of all of them together: how much the area changes with the coordinates.
    low, high : (3,) of float
        The box about them.
    """

    fewest: int
    most: int
    area: float
    perimeter: float
    low: tuple[float, ...]
    high: tuple[float, ...]

    def as_json(self) -> dict[str, Any]:
        return asdict(self)


def measure(triangles: NDArray) -> Measures:
    """Measures of triangles (T, 3, 3)."""
    corners = np.asarray(triangles, dtype=np.float64)
    corners = corners[np.isfinite(corners).all(axis=(1, 2))]
    sides = np.roll(corners, -1, axis=1) - corners
    lengths = np.linalg.norm(sides, axis=2)
    areas = 0.5 * np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    longest = lengths.max(axis=1, initial=0.0)
    rounding = np.spacing(np.abs(corners).max(axis=(1, 2), initial=0.0).astype(np.float32)).astype(np.float64)
    limit = 0.5 * longest * np.maximum(_THIN * longest, _ROUNDINGS * rounding)
    surely, perhaps = areas > 10.0 * limit, areas > 0.0
    counted = corners[areas > limit].reshape(-1, 3)
    if not len(counted):
        counted = np.zeros((1, 3))
    return Measures(
        fewest=int(np.count_nonzero(surely)),
        most=int(np.count_nonzero(perhaps)),
        area=float(areas.sum()),
        perimeter=float(lengths.sum()),
        low=tuple(counted.min(axis=0).tolist()),
        high=tuple(counted.max(axis=0).tolist()),
    )


def differences(ours: Measures, theirs: Measures) -> str:
    """In what two meshes differ by more than rounding; empty if in nothing."""
    box = np.array([ours.low, ours.high, theirs.low, theirs.high])
    step = _ROUNDINGS * float(np.spacing(np.abs(box).max().astype(np.float32)))
    found = []
    if ours.fewest > theirs.most or theirs.fewest > ours.most:
        found.append(f"{ours.most} triangles, not {theirs.most}")
    if abs(ours.area - theirs.area) > step * ours.perimeter + 1e-6 * ours.area:
        found.append(f"area {ours.area:.6g}, not {theirs.area:.6g}")
    thin = _THIN * float(np.linalg.norm(box[1] - box[0]))
    if np.abs(box[:2] - box[2:]).max() > step + thin:
        sizes = (" x ".join(f"{extent:.4g}" for extent in high - low) for low, high in (box[:2], box[2:]))
        found.append("box {}, not {}".format(*sizes))
        if found[-1].split(", not ")[0][4:] == found[-1].split(", not ")[1]:
            found[-1] = f"box from {box[0].tolist()}, not from {box[2].tolist()}"
    return "; ".join(found)
