"""Parts of a mesh that are inside out among others that are not."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components


def parts_inside_out(positions: NDArray, normals: NDArray, faces: NDArray) -> list[NDArray[np.int64]]:
    """Closed parts whose normals point inward, as their vertices, if other closed parts are the right way round.

    A part inside another one may be the wall of a cavity and does not count; nor do models that are a single part, or
    altogether inside out: rooms are modelled so.

    Parameters
    ----------
    positions, normals : (V, 3)
    faces : (F, 3)
    """
    # Vertices at one place are one: parts are often split at hard edges or seams of a texture.
    _, place = np.unique(positions, axis=0, return_inverse=True)
    welded = place.ravel()[faces]
    sides = np.sort(np.concatenate([welded[:, [0, 1]], welded[:, [1, 2]], welded[:, [2, 0]]]), axis=1)
    count = int(welded.max()) + 1
    links = coo_array((np.ones(len(sides), dtype=np.int8), (sides[:, 0], sides[:, 1])), shape=(count, count))
    parts, part = connected_components(links, directed=False)
    of_face = part[welded[:, 0]]
    if np.unique(of_face).size < 2:
        return []
    keys, uses = np.unique(sides[:, 0].astype(np.int64) * count + sides[:, 1], return_counts=True)
    closed = np.ones(parts, dtype=bool)
    closed[part[keys[uses == 1] // count]] = False
    closed[np.setdiff1d(np.arange(parts), of_face)] = False
    low, high = np.full((parts, 3), np.inf), np.full((parts, 3), -np.inf)
    np.minimum.at(low, of_face, positions[faces].min(axis=1))
    np.maximum.at(high, of_face, positions[faces].max(axis=1))
    volume = _volumes(positions, normals, faces, of_face, 0.5 * (low + high))
    size = np.prod(np.maximum(high - low, 0.0), axis=1, where=np.isfinite(high - low), initial=1.0)
    outward, inward = closed & (volume > 1e-6 * size), closed & (volume < -1e-6 * size)
    if not outward.any():
        return []
    wrong = [
        number
        for number in np.flatnonzero(inward)
        if not np.any((low[outward] <= low[number]).all(axis=1) & (high[outward] >= high[number]).all(axis=1))
    ]
    return [np.unique(faces[of_face == number]) for number in wrong]


def _volumes(positions: NDArray, normals: NDArray, faces: NDArray, part: NDArray, center: NDArray) -> NDArray:
    """Of each part, positive where its normals point outward, whatever the winding of its faces."""
    corner = positions[faces] - center[part][:, None]
    area = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    along = np.sign(np.einsum("ij,ij->i", area, normals[faces].sum(axis=1)))
    return np.bincount(part, along * np.einsum("ij,ij->i", corner[:, 0], area) / 6.0, minlength=len(center))
