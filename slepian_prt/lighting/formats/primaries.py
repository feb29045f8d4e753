"""Colours of other primaries in those of sRGB."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

# x and y of red, green, blue and white (ITU-R BT.709-6, Sec. 1).
SRGB = np.array([[0.64, 0.33], [0.30, 0.60], [0.15, 0.06], [0.3127, 0.3290]])


def to_srgb(chromaticities: ArrayLike) -> NDArray[np.float64] | None:
    """(3, 3) from linear colours of the given primaries to linear sRGB; None if they are the same.

    The colours stay what a colorimeter measures: white is not adapted, as Mitsuba does not adapt it either.

    Parameters
    ----------
    chromaticities : (4, 2)
        x and y of red, green, blue and white.

    Raises
    ------
    ValueError
        Numbers that are no primaries.
    """
    given = np.asarray(chromaticities, dtype=np.float64).reshape(4, 2)
    if not np.isfinite(given).all() or given[:, 1].min() <= 0.0:
        raise ValueError("its chromaticities are no primaries")
    if np.abs(given - SRGB).max() < 1e-3:
        return None
    try:
        matrix = np.linalg.solve(_to_xyz(SRGB), _to_xyz(given))
    except np.linalg.LinAlgError:
        raise ValueError("its chromaticities are no primaries") from None
    return np.asarray(matrix)


def xyz_to_srgb() -> NDArray[np.float64]:
    """(3, 3) from CIE XYZ to linear sRGB, whose white has Y = 1."""
    return np.asarray(np.linalg.inv(_to_xyz(SRGB)))


def _to_xyz(xy: NDArray) -> NDArray[np.float64]:
    xyz = np.column_stack([xy, 1.0 - xy.sum(axis=1)]).T / xy[:, 1]
    return np.asarray(xyz[:, :3] * np.linalg.solve(xyz[:, :3], xyz[:, 3]))
