"""Affine transforms of glTF nodes, joints and instances, and what they do to positions, normals and winding."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray


def compose(
    translation: ArrayLike = (0.0, 0.0, 0.0),
    rotation: ArrayLike = (0.0, 0.0, 0.0, 1.0),
    scale: ArrayLike = (1.0, 1.0, 1.0),
) -> NDArray[np.float64]:
    """(…, 4, 4) translation after rotation after scale.

    Parameters
    ----------
    translation, scale : (…, 3)
    rotation : (…, 4)
        Quaternions x, y, z, w; their length does not matter unless it is zero (which gives NaN).
    """
    t, q, s = (np.asarray(values, dtype=np.float64) for values in (translation, rotation, scale))
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    x, y, z, w = (q[..., k] for k in range(4))
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    turn = np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
    out = np.zeros((*np.broadcast_shapes(t.shape[:-1], q.shape[:-1], s.shape[:-1]), 4, 4))
    out[..., :3, :3] = turn * s[..., None, :]
    out[..., :3, 3] = t
    out[..., 3, 3] = 1.0
    return out


def transform_points(matrices: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """(V, 3) points under one matrix (4, 4), or each under its own (V, 3 or 4, 4)."""
    linear, offset = matrices[..., :3, :3], matrices[..., :3, 3]
    if matrices.ndim == 2:
        return points @ linear.T + offset
    return np.einsum("vij,vj->vi", linear, points) + offset


def transform_normals(matrices: NDArray[np.float64], normals: NDArray[np.float64]) -> NDArray[np.float64]:
    """(V, 3) unit normals under the inverse transpose of one matrix, or each of its own; zero where there is none.

    Cofactors in place of the inverse: they also serve a matrix that flattens.
    """
    a = _to_unit_size(matrices[..., :3, :3])
    cofactors = np.stack([np.cross(a[..., (k + 1) % 3, :], a[..., (k + 2) % 3, :]) for k in range(3)], axis=-2)
    signed = cofactors * np.where(is_mirrored(matrices), -1.0, 1.0)[..., None, None]
    turned = normals @ signed.T if signed.ndim == 2 else np.einsum("vij,vj->vi", signed, normals)
    length = np.linalg.norm(turned, axis=1, keepdims=True)
    return np.divide(turned, length, out=np.zeros_like(turned), where=length != 0.0)


def is_mirrored(matrices: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether each matrix (…, 3 or 4, 4) turns the winding of faces around."""
    return np.linalg.det(_to_unit_size(matrices[..., :3, :3])) < 0.0


def _to_unit_size(linear: NDArray[np.float64]) -> NDArray[np.float64]:
    """Divided by the largest element: determinants of tiny scales would otherwise vanish."""
    size = np.abs(linear).max(axis=(-2, -1), keepdims=True)
    return linear / np.where(size > 0.0, size, 1.0)
