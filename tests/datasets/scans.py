"""Small scans."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import ArrayLike


def write_obj(path: Path, positions: ArrayLike, faces: Sequence[Sequence[object]], more: str = "") -> Path:
    """An OBJ file; corners are numbers from 1 on, or words as the format has them."""
    path.parent.mkdir(parents=True, exist_ok=True)
    lines = ["v " + " ".join(f"{x:.9g}" for x in position) for position in np.asarray(positions)]
    lines += [more] if more else []
    lines += ["f " + " ".join(map(str, face)) for face in faces]
    path.write_text("\n".join(lines) + "\n")
    return path


def bent_ball(seed: int = 0, subdivisions: int = 2) -> trimesh.Trimesh:
    """A ball with dents that shadow each other."""
    ball = trimesh.creation.icosphere(subdivisions)
    middle = np.random.default_rng(seed).normal(size=(3, 3))
    middle /= np.linalg.norm(middle, axis=1, keepdims=True)
    ball.vertices *= 1.0 - 0.5 * np.exp(8.0 * (ball.vertices @ middle.T - 1.0)).sum(axis=1, keepdims=True)
    return ball


def write_ball(path: Path, seed: int = 0, subdivisions: int = 2) -> Path:
    ball = bent_ball(seed, subdivisions)
    return write_obj(path, ball.vertices, (ball.faces + 1).tolist())
