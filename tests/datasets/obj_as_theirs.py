"""OBJ files and transfer as the training code of PIFu and ICON reads them: written anew from what it does.

Positions are the lines ``v``, triangles the first three corners of each line ``f`` and, where it has more than three,
corners three, four and one. Transfer is a table and a list of faces, and the value of corner k of triangle f is
``table[faces[f, k]]``, drawn at position ``v[triangles[f, k]]``.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray


def read_triangles(path: Path) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """(V, 3) positions and (F, 3) their triangles, numbered from 0."""
    positions, triangles = [], []
    for line in path.read_text().splitlines():
        words = line.split()
        if words[:1] == ["v"]:
            positions.append([float(word) for word in words[1:4]])
        elif words[:1] == ["f"]:
            corners = [int(word.split("/")[0]) for word in words[1:]]
            triangles.append(corners[:3])
            if len(corners) > 3:
                triangles.append([corners[2], corners[3], corners[0]])
    return np.array(positions), np.array(triangles) - 1


def read_pifu(folder: Path) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """(V, 9) table and (F, 3) faces of a scan's folder."""
    return np.loadtxt(folder / "bounce" / "bounce0.txt"), np.load(folder / "bounce" / "face.npy")


def read_icon(folder: Path) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """The same of ICON."""
    return np.load(folder / "prt" / "bounce.npy"), np.load(folder / "prt" / "face.npy")


def their_harmonics(theta: NDArray, phi: NDArray) -> NDArray[np.float64]:
    """(n, 9) their real harmonics, in closed form; those of the direction (-sin θ cos φ, -sin θ sin φ, cos θ)."""
    s, c = np.sin(theta), np.cos(theta)
    legendre = {
        (0, 0): np.ones_like(c), (1, 0): c, (1, 1): -s,
        (2, 0): 1.5 * c * c - 0.5, (2, 1): -3.0 * c * s, (2, 2): 3.0 * s * s,
    }  # fmt: skip
    size = {(0, 0): 1.0, (1, 0): 3.0, (1, 1): 1.5, (2, 0): 5.0, (2, 1): 5.0 / 6.0, (2, 2): 5.0 / 24.0}
    columns = []
    for degree in range(3):
        for order in range(-degree, degree + 1):
            m = abs(order)
            turn = np.cos(m * phi) if order >= 0 else np.sin(m * phi)
            factor = np.sqrt(size[degree, m] / (4.0 * np.pi)) * (np.sqrt(2.0) if m else 1.0)
            columns.append(factor * turn * legendre[degree, m])
    return np.stack(columns, axis=1)
