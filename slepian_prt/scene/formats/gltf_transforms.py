"""Affine transforms of glTF nodes, joints and instances, and what they do to positions, normals and winding."""

from __future__ import annotations

from dataclasses import dataclass

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


@dataclass(frozen=True, eq=False)
class Transforms:
    """One transform, or many.

    Attributes
    ----------
    matrices : (…, 3 or 4, 4)
    normals : (…, 3, 3)
        What they do to normals, but for the length: their inverse transposes. Those are made of cofactors, which a
        matrix that flattens has, too.
    mirrored : (…,) bool
        Whether they turn the winding of faces around.
    """

    matrices: NDArray[np.float64]
    normals: NDArray[np.float64]
    mirrored: NDArray[np.bool_]

    def __getitem__(self, index: int) -> Transforms:
        return Transforms(self.matrices[index], self.normals[index], self.mirrored[index])


def make_transforms(matrices: NDArray[np.float64]) -> Transforms:
    """Those of affine ``matrices`` (…, 3 or 4, 4)."""
    linear = matrices[..., :3, :3]
    # Of unit size: determinants of tiny scales would vanish.
    size = np.abs(linear).max(axis=(-2, -1), keepdims=True)
    linear = linear / np.where(size > 0.0, size, 1.0)
    cofactors = np.cross(linear[..., [1, 2, 0], :], linear[..., [2, 0, 1], :])
    mirrored = np.einsum("...i,...i->...", linear[..., 0, :], cofactors[..., 0, :]) < 0.0
    return Transforms(matrices, np.where(mirrored[..., None, None], -cofactors, cofactors), mirrored)


def transform_points(transforms: Transforms, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """(V, 3) points under one transform, or each under its own."""
    linear, offset = transforms.matrices[..., :3, :3], transforms.matrices[..., :3, 3]
    if linear.ndim == 2:
        return points @ linear.T + offset
    return np.einsum("vij,vj->vi", linear, points) + offset


def transform_normals(transforms: Transforms, normals: NDArray[np.float64]) -> NDArray[np.float64]:
    """(V, 3) unit normals under one transform, or each under its own; zero where there is none."""
    if transforms.normals.ndim == 2:
        turned = normals @ transforms.normals.T
    else:
        turned = np.einsum("vij,vj->vi", transforms.normals, normals)
    length = np.sqrt(np.einsum("vi,vi->v", turned, turned))[:, None]
    return turned / np.where(length == 0.0, 1.0, length)
