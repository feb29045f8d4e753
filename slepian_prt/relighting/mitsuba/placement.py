"""How the model of a file was moved, turned and scaled in a scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError

# Vertices of a shape may be this far, in diagonals of it, from where transfer was computed.
MOVED = 1e-4


@dataclass(frozen=True, eq=False)
class Placement:
    """Where the file's world is in that of a scene: ``scale`` R x + ``offset``.

    Distant light is the same everywhere, so what was precomputed holds for a moved, turned and scaled model too.
    """

    rotation: NDArray[np.float64]
    scale: float
    offset: NDArray[np.float64]

    def __call__(self, positions: NDArray) -> NDArray[np.float64]:
        return self.scale * positions @ self.rotation.T + self.offset


UNMOVED = Placement(np.eye(3), 1.0, np.zeros(3))


@dataclass(frozen=True, eq=False)
class Anchor:
    """The same vertices, (n, 3) each, in a scene and in a file, of the part ``name``."""

    name: str
    in_scene: NDArray[np.float64]
    in_file: NDArray[np.float64]


def find_placement(anchors: Sequence[Anchor], file: str) -> Placement:
    """Where the file's world is, from the vertices that both have.

    Raises
    ------
    UserError
        Shapes whose vertices are not those of the file, in the same order, moved as one.
    """
    placement = UNMOVED
    if not anchors:
        return placement
    if max(misfit(placement, one) for one in anchors) > MOVED:
        in_scene = np.concatenate([one.in_scene for one in anchors])
        in_file = np.concatenate([one.in_file for one in anchors])
        placement = fit_similarity(in_scene, in_file)
    remaining = [misfit(placement, one) for one in anchors]
    worst = int(np.argmax(remaining))
    if remaining[worst] > MOVED or not np.isfinite(remaining[worst]):
        raise UserError(changed(anchors[worst].name, file))
    return placement


def changed(name: str, file: str) -> str:
    """What to say of a shape whose vertices are not those of its part."""
    return (
        f"{file}: shape '{name}' of the scene has as many vertices as '{name}' there, but in another order or at other "
        "places; it was changed since, so precompute it again"
    )


def fit_similarity(in_scene: NDArray, in_file: NDArray) -> Placement:
    """The similarity that takes ``in_file`` to ``in_scene`` (Umeyama 1991)."""
    scene_mean, file_mean = in_scene.mean(axis=0), in_file.mean(axis=0)
    a, b = in_scene - scene_mean, in_file - file_mean
    u, singular, vt = np.linalg.svd(a.T @ b)
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    rotation = (u * sign) @ vt
    scale = float(np.sum(singular * sign) / max(float(np.sum(b * b)), 1e-300))
    return Placement(rotation, scale, scene_mean - scale * rotation @ file_mean)


def misfit(placement: Placement, anchor: Anchor) -> float:
    """Largest distance of a vertex from where it should be, in diagonals, beyond what rounding to float32 moves it."""
    diagonal = float(np.linalg.norm(np.ptp(anchor.in_scene, axis=0)))
    distance = float(np.abs(placement(anchor.in_file) - anchor.in_scene).max())
    rounding = 4.0 * float(np.spacing(np.float32(np.abs(anchor.in_scene).max())))
    return max(distance - rounding, 0.0) / max(diagonal, 1e-300)
