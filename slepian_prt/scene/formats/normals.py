"""Normals of vertices from the faces around them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def smooth_normals(positions: NDArray[np.float64], faces: NDArray[np.int64]) -> NDArray[np.float64]:
    """Face normals weighted by the angle at the vertex (Thürmer & Wüthrich 1998).

    Parameters
    ----------
    positions : (V, 3)
    faces : (F, 3)

    Returns
    -------
    (V, 3)
        Unit vectors; zero where no face is, or where those that are cancel or have no area.
    """
    # What is not finite or has no area is refused or left out later: here it must only not warn.
    with np.errstate(all="ignore"):
        corners = positions[faces]
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        face_normals = np.nan_to_num(cross / np.linalg.norm(cross, axis=1, keepdims=True))
        total = np.zeros_like(positions)
        for corner in range(3):
            a, b, c = (corners[:, (corner + k) % 3] for k in range(3))
            u, v = b - a, c - a
            angle = np.nan_to_num(np.arctan2(np.linalg.norm(np.cross(u, v), axis=1), np.einsum("ij,ij->i", u, v)))
            for axis in range(3):
                weights = angle * face_normals[:, axis]
                total[:, axis] += np.bincount(faces[:, corner], weights, minlength=len(positions))
        length = np.linalg.norm(total, axis=1, keepdims=True)
        return np.where(length > 1e-9, total / np.maximum(length, 1e-300), 0.0)
