"""Normals at the vertices of a mesh: those that a file gives, and computed ones where it gives none."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components


def face_normals(positions: NDArray, faces: NDArray) -> NDArray[np.float64]:
    """(F, 3) unit normals; zero for faces without area."""
    corners = positions[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(cross, axis=1, keepdims=True)
    return np.divide(cross, length, out=np.zeros_like(cross), where=length > 0.0)


def corner_angles(positions: NDArray, faces: NDArray, corner: int) -> NDArray[np.float64]:
    """(F,) angles of the faces at one of their corners."""
    a, b, c = (positions[faces[:, (corner + k) % 3]] for k in range(3))
    u, v = b - a, c - a
    return np.asarray(np.arctan2(np.linalg.norm(np.cross(u, v), axis=1), np.einsum("ij,ij->i", u, v)))


def angle_weighted_normals(positions: NDArray, faces: NDArray, groups: NDArray | None = None) -> NDArray[np.float64]:
    """(n, 3) face normals weighted by the angle at the vertex, which no retriangulation changes.

    Zero where faces cancel or there are none (Thürmer & Wüthrich 1998).

    Parameters
    ----------
    positions : (V, 3)
    faces : (F, 3)
    groups : (V,), optional
        Vertices of the same group share a normal; n is their number. Without them every vertex is its own.
    """
    groups = np.arange(len(positions)) if groups is None else groups
    normals = face_normals(positions, faces)
    total = np.zeros((int(groups.max(initial=-1)) + 1, 3))
    for corner in range(3):
        angle, group = corner_angles(positions, faces, corner), groups[faces[:, corner]]
        for axis in range(3):
            total[:, axis] += np.bincount(group, angle * normals[:, axis], minlength=len(total))
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return np.where(length > 1e-9, total / np.maximum(length, 1e-300), 0.0)


def complete_normals(
    positions: NDArray, faces: NDArray, given: ArrayLike | None, groups: NDArray | None, notes: list[str]
) -> NDArray[np.float64]:
    """(V, 3) unit normals: the ``given`` ones where they are finite and not zero, else computed.

    Zero at vertices that no face uses. ``groups`` is as in `angle_weighted_normals`; what was done is added to
    ``notes``.
    """
    unit = angle_weighted_normals(positions, faces, groups)
    if groups is not None:
        unit = unit[groups]
    used = np.zeros(len(positions), dtype=bool)
    used[faces] = True
    if not used.all():
        notes.append(f"{int((~used).sum())} vertices that no face uses receive no light")
    if given is not None:
        candidate = np.array(given, dtype=np.float64)
        if candidate.shape == positions.shape:
            length = np.linalg.norm(candidate, axis=1)
            good = np.isfinite(length) & (length > 1e-12)
            if not good[used].all():
                notes.append(f"{int((used & ~good).sum())} missing or zero normals computed from the faces")
            unit[good] = candidate[good] / length[good, None]
        else:
            notes.append(f"normals of shape {candidate.shape} do not fit the vertices; computed from the faces")
    unit[~used] = 0.0
    lost = used & ~unit.any(axis=1)
    if lost.any():
        # Faces that meet back to back cancel: any of their normals will do better than none.
        face_of = np.zeros(len(positions), dtype=np.int64)
        face_of[faces] = np.arange(len(faces))[:, None]
        unit[lost] = face_normals(positions, faces[face_of[lost]])
        notes.append(f"{int(lost.sum())} vertices whose faces cancel take the normal of one of them")
    return unit


def split_at_creases(
    positions: NDArray, faces: NDArray, groups: NDArray, degrees: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Part the faces at edges that are sharper than an angle.

    Parameters
    ----------
    positions : (V, 3)
    faces : (F, 3)
    groups : (V,)
        Vertices at the same place, whose faces are neighbours.
    degrees : float
        Angle between the normals of two faces up to which their edge is smooth.

    Returns
    -------
    vertices : (W,)
        The vertex that each new one is a copy of.
    faces : (F, 3)
        Of new vertices; no two faces share one across a sharp edge.
    """
    corner_of = np.arange(3 * len(faces)).reshape(-1, 3)
    places = groups[faces]
    normals = face_normals(positions, faces)
    # Edges of the same two places, next to each other.
    begin, end = (np.concatenate([places[:, (k + s) % 3] for k in range(3)]) for s in (0, 1))
    first, second = (np.concatenate([corner_of[:, (k + s) % 3] for k in range(3)]) for s in (0, 1))
    along = begin < end  # the corner at the lower place first, whichever way the face runs
    low, high = np.where(along, begin, end), np.where(along, end, begin)
    at_low, at_high = np.where(along, first, second), np.where(along, second, first)
    order = np.lexsort([high, low])
    same = (low[order][1:] == low[order][:-1]) & (high[order][1:] == high[order][:-1])
    one, other = order[:-1][same], order[1:][same]
    cosine = np.einsum("ij,ij->i", normals[at_low[one] // 3], normals[at_low[other] // 3])
    smooth = cosine >= np.cos(np.radians(degrees)) - 1e-12
    one, other = one[smooth], other[smooth]
    begin = np.concatenate([at_low[one], at_high[one]])
    end = np.concatenate([at_low[other], at_high[other]])
    links = coo_array((np.ones(begin.size, dtype=np.int8), (begin, end)), shape=(corner_of.size, corner_of.size))
    _, fan = connected_components(links, directed=False)
    # Corners of one fan become one vertex, unless the file itself keeps them apart.
    keys, first_corner, which = np.unique(
        fan.astype(np.int64) * (len(positions) + 1) + faces.ravel(), return_index=True, return_inverse=True
    )
    rank = np.argsort(faces.ravel()[first_corner], kind="stable")  # in the order of the file
    place = np.empty(keys.size, dtype=np.int64)
    place[rank] = np.arange(keys.size)
    return faces.ravel()[first_corner][rank], place[which.ravel()].reshape(-1, 3)
