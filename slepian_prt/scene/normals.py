"""Normals at the vertices of a mesh: those that a file gives, and computed ones where it gives none."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slepian_prt.scene.pieces import connected_pieces

# Faces in one plane differ by the rounding of their normals.
_ROUNDING = 1e-12

# Faces at one edge that are compared, each with the next ones of the file.
_MOST_FACES = 16

# Vertices around that tell which side of faces back to back is the outer one.
_AROUND = 8

# Points at which normals are compared with faces.
_LEANING_POINTS = 1024


def face_normals(positions: NDArray, faces: NDArray) -> NDArray[np.float64]:
    """(F, 3) unit normals; zero for faces without area."""
    corners = positions[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(cross, axis=1, keepdims=True)
    return np.divide(cross, length, out=np.zeros_like(cross), where=length > 0.0)


def face_areas(positions: NDArray, faces: NDArray) -> NDArray[np.float64]:
    """(F,) areas."""
    corners = positions[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.asarray(0.5 * np.linalg.norm(cross, axis=1))


def run_against(positions: NDArray, faces: NDArray, normals: NDArray) -> NDArray[np.bool_]:
    """(F,) whether faces turn the other way round than the normals (V, 3) at their corners."""
    corner = positions[faces]
    turned = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    return np.asarray(np.einsum("ij,ij->i", turned, normals[faces].sum(axis=1)) < 0.0)


def leaning_normals(positions: NDArray, faces: NDArray, normals: NDArray) -> float:
    """How much of the light that normals ask for comes from behind the faces, at some points of the surface.

    Of a hemisphere weighted by the cosine with a normal, that is (1 - cos θ) / 2 where the normal leans by θ. Which
    side the faces are turned to does not matter.
    """
    rng = np.random.default_rng(0)
    area = face_areas(positions, faces)
    total = float(area.sum())
    if total <= 0.0:
        return 0.0
    chosen = faces[rng.choice(len(faces), _LEANING_POINTS, p=area / total)]
    there = np.einsum("pk,pkc->pc", rng.dirichlet(np.ones(3), _LEANING_POINTS), normals[chosen])
    there /= np.maximum(np.linalg.norm(there, axis=1, keepdims=True), 1e-300)
    cosine = np.abs(np.einsum("ij,ij->i", there, face_normals(positions, chosen)))
    return float(0.5 - 0.5 * cosine.mean())


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
    angles = np.zeros(len(total))
    for corner in range(3):
        angle, group = corner_angles(positions, faces, corner), groups[faces[:, corner]]
        angles += np.bincount(group, angle, minlength=len(total))
        for axis in range(3):
            total[:, axis] += np.bincount(group, angle * normals[:, axis], minlength=len(total))
    length = np.linalg.norm(total, axis=1)
    return np.where((length > 1e-9 * angles)[:, None], total / np.maximum(length, 1e-300)[:, None], 0.0)


def are_normals(vectors: NDArray) -> NDArray[np.bool_]:
    """(V,) whether vectors (V, 3) are finite and long enough to have a direction."""
    longest = np.abs(vectors).max(axis=1)
    return np.asarray(np.isfinite(longest) & (longest > 1e-12))


def complete_normals(
    positions: NDArray, faces: NDArray, given: NDArray | None, groups: NDArray | None, notes: list[str]
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
        good = are_normals(given)
        if not good[used].all():
            notes.append(f"{int((used & ~good).sum())} missing or zero normals computed from the faces")
        unit[good] = given[good] / np.abs(given[good]).max(axis=1, keepdims=True)  # squares must not overflow
        unit[good] /= np.linalg.norm(unit[good], axis=1, keepdims=True)
    unit[~used] = 0.0
    lost = used & ~unit.any(axis=1)
    if lost.any():
        # Faces that meet back to back cancel: of their two sides that which the surface around is turned to.
        face_of = np.zeros(len(positions), dtype=np.int64)
        face_of[faces] = np.arange(len(faces))[:, None]
        either, around = face_normals(positions, faces[face_of[lost]]), np.flatnonzero(used & ~lost)
        if around.size:
            from scipy.spatial import cKDTree  # only for such faces, so that relighting starts without SciPy

            nearest = cKDTree(positions[around]).query(positions[lost], k=min(_AROUND, around.size))[1]
            toward = unit[around[nearest.reshape(len(either), -1)]].sum(axis=1)
            either *= np.where(np.einsum("ij,ij->i", either, toward) < 0.0, -1.0, 1.0)[:, None]
        unit[lost] = either
        notes.append(f"{int(lost.sum())} vertices whose faces cancel take the normal of one of them")
    return unit


class SplitFaces(NamedTuple):
    """Faces of vertices that no two of them share across a sharp edge.

    Attributes
    ----------
    vertices : (W,)
        The vertex that each new one is a copy of, ascending; vertices that no face uses are among them.
    faces : (F, 3)
        Of new vertices.
    groups : (W,)
        New vertices that share a computed normal: copies of vertices at one place that smooth edges connect.
    """

    vertices: NDArray[np.int64]
    faces: NDArray[np.int64]
    groups: NDArray[np.int64]


def split_at_creases(
    positions: NDArray, faces: NDArray, groups: NDArray, degrees: float, whole: NDArray | None = None
) -> SplitFaces:
    """Part the faces at edges that are sharper than an angle.

    Where more than two faces share an edge, any two of them may be smooth.

    Parameters
    ----------
    positions : (V, 3)
    faces : (F, 3)
    groups : (V,)
        Vertices at the same place, whose faces are neighbours.
    degrees : float
        Angle between the normals of two faces up to which their edge is smooth.
    whole : (V,) bool, optional
        Vertices that stay one whatever their faces.
    """
    corners, first_faces, other_faces = _shared_edges(groups[faces])
    normals = face_normals(positions, faces)
    cosine = np.einsum("ij,ij->i", normals[first_faces], normals[other_faces])
    smooth = cosine >= math.cos(math.radians(degrees)) - _ROUNDING
    count, vertices = faces.size, len(positions)
    fan = connected_pieces(corners[..., smooth].reshape(2, -1).T, count).astype(np.int64)
    # Vertices that no face uses, and those that stay whole, are fans of their own.
    alone = np.ones(vertices, dtype=bool)
    alone[faces] = False
    vertex = np.concatenate([faces.ravel(), np.flatnonzero(alone)]).astype(np.int64)
    if whole is not None:
        alone |= whole
    fan = np.where(alone[vertex], count + vertex, np.append(fan, np.zeros(vertex.size - count, dtype=fan.dtype)))
    # Corners of one fan become one vertex, unless the file itself keeps them apart.
    _, first, which = np.unique(vertex * (count + vertices) + fan, return_index=True, return_inverse=True)
    return SplitFaces(vertex[first], which[:count].reshape(-1, 3), fan[first])


def _shared_edges(places: NDArray) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Pairs of faces with an edge in common; ``places`` (F, 3) are those of their corners.

    Returns
    -------
    corners : (2, 2, n)
        Numbers 3 f + k of corners: of the one face and the other, at the two ends of the edge.
    first, other : (n,)
        The faces.
    """
    corner = np.arange(places.size).reshape(-1, 3)
    begin, end = (np.concatenate([places[:, (k + s) % 3] for k in range(3)]) for s in (0, 1))
    from_corner, to_corner = (np.concatenate([corner[:, (k + s) % 3] for k in range(3)]) for s in (0, 1))
    along = begin < end  # the corner at the lower place first, whichever way the face runs
    low, high = np.where(along, begin, end), np.where(along, end, begin)
    ends = np.stack([np.where(along, from_corner, to_corner), np.where(along, to_corner, from_corner)])
    order = np.lexsort([high, low])
    low, high = low[order], high[order]
    # Edges of the same two places stand next to each other: each with the next one, the one after that, ….
    pairs, begin = [], np.arange(order.size)
    for step in range(1, _MOST_FACES):
        begin = begin[begin + step < order.size]
        begin = begin[(low[begin] == low[begin + step]) & (high[begin] == high[begin + step])]
        pairs.append(np.stack([order[begin], order[begin + step]]))
    one, other = np.concatenate(pairs, axis=1)
    return np.stack([ends[:, one], ends[:, other]]), ends[0, one] // 3, ends[0, other] // 3
