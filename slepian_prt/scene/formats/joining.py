"""Vertices of the same position made one."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slepian_prt.scene.pieces import connected_pieces

# Vertices about each, itself counted, up to which those that are near may be copies, if all are fewer pairs than so
# many; how many are left otherwise; and vertices that are looked at for that.
_MOST_NEAR, _MOST_PAIRS = 32, 10_000_000
_FEW_NEAR = 2.0
_SAMPLE = 256


def join_equal(*columns: NDArray) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Find rows that are equal bit for bit, 0 and -0 taken as equal.

    `np.unique` with an axis does the same; sorting one hash of 64 bits is five times as fast.

    Parameters
    ----------
    *columns : (N, k) arrays
        Side by side.

    Returns
    -------
    first : (U,) int64
        Where each distinct row comes first, ascending: the order of the rows is kept.
    joined : (N,) int64
        The number of each row among those.
    """
    rows = np.concatenate(columns, axis=1, dtype=np.float64) + 0.0
    bits = rows.view(np.uint64)
    keys = np.zeros(len(rows), dtype=np.uint64)
    for column in bits.T:
        keys = (keys ^ column) * np.uint64(0x9E3779B97F4A7C15)
        keys ^= keys >> np.uint64(29)
    first, joined = group(keys)
    same = first[joined]
    if not all(
        np.all(column[same] == column) for column in bits.T
    ):  # two rows of one hash: one in 10^8 meshes of a million vertices
        first, joined = group(np.unique(bits, axis=0, return_inverse=True)[1].ravel())
    return first, joined


def group(keys: NDArray) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Where each distinct key (N,) comes first, and the number of each key among those, as in `join_equal`."""
    order = np.argsort(keys)
    ordered = keys[order]
    begins = np.concatenate([np.ones(min(len(keys), 1), dtype=bool), ordered[1:] != ordered[:-1]])
    first = np.minimum.reduceat(order, np.flatnonzero(begins)) if len(keys) else order
    rank = np.empty(len(first), dtype=np.int64)
    sequence = np.argsort(first)
    rank[sequence] = np.arange(len(first))
    joined = np.empty(len(keys), dtype=np.int64)
    joined[order] = rank[np.cumsum(begins) - 1]
    return first[sequence], joined


def join_near(
    positions: NDArray[np.float64], faces: NDArray[np.int64], tolerance: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Find vertices that differ by no more than rounding.

    No chain of near vertices grows beyond the tolerance, and corners of one triangle stay apart, however thin it is.

    Parameters
    ----------
    positions : (V, 3)
        Finite.
    faces : (F, 3)
    tolerance : float
        Largest distance of two vertices that are one; less where very many are as near.

    Returns
    -------
    first, joined : as `join_equal`
    """
    from scipy.spatial import cKDTree  # only here, so that relighting starts without SciPy

    count = len(positions)
    tree = cKDTree(positions)
    # Rounding leaves a few copies of each vertex; where very many are near, they are the surface itself, next to
    # something far away, and their pairs would not fit into memory.
    some = positions[:: max(1, count // _SAMPLE)]

    def mean_near() -> float:
        return float(np.mean(tree.query_ball_point(some, tolerance, return_length=True))) if count else 0.0

    if mean_near() * count > max(_MOST_PAIRS, _MOST_NEAR * count):
        while mean_near() > _FEW_NEAR:
            tolerance /= 4
    pairs = tree.query_pairs(tolerance, output_type="ndarray").astype(np.int64)
    if not len(pairs):
        return np.arange(count), np.arange(count)
    label = connected_pieces(pairs, count).astype(np.int64)
    low, high = np.full((label.max() + 1, 3), np.inf), np.full((label.max() + 1, 3), -np.inf)
    near = np.zeros(count, dtype=bool)
    near[pairs] = True
    np.minimum.at(low, label[near], positions[near])
    np.maximum.at(high, label[near], positions[near])
    doubtful = np.linalg.norm(high - low, axis=1) > tolerance
    sides = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    sides = sides[(label[sides[:, 0]] == label[sides[:, 1]]) & (sides[:, 0] != sides[:, 1])]
    doubtful[label[sides]] = True
    first, joined = group(label)
    representative = first[joined]
    unsure = doubtful[label]
    representative[unsure] = np.flatnonzero(unsure)
    _join_greedily(representative, pairs[unsure[pairs[:, 0]]], {(int(a), int(b)) for a, b in sides})
    return group(representative)


def _join_greedily(representative: NDArray[np.int64], pairs: NDArray[np.int64], sides: set[tuple[int, int]]) -> None:
    """Let each vertex join the first one before it that is near, if no triangle has a side between the joined."""
    members: dict[int, list[int]] = {}
    joined: set[int] = set()
    for a, b in sorted((min(a, b), max(a, b)) for a, b in pairs.tolist()):
        if a in joined or b in joined:
            continue
        group = members.setdefault(a, [a])
        if b in members or any((b, m) in sides or (m, b) in sides for m in group):
            continue
        group.append(b)
        joined.add(b)
        representative[b] = a
