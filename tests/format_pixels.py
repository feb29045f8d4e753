"""The pixels of captured films, read from docs/file-format.md alone, as format_reader.py does."""

from __future__ import annotations

import math

import numpy as np


def mesh_of_pixels(film: dict, arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The mesh that a film stands for."""
    width, height = film["width"], film["height"]
    positions = [[column, row, 0.0] for row in range(height) for column in range(width)]
    faces = []
    for half in (0, 1):
        for row in range(height - 1):
            for column in range(width - 1):
                a = row * width + column
                faces.append([[a, a + 1, a + width], [a + 1, a + width + 1, a + width]][half])
    normals = np.zeros((width * height, 3))
    for i, (a, b) in enumerate(running_sums(arrays["film/axes"]).T.tolist()):
        if a or b:
            u, v = (a - 128) / 127, (b - 128) / 127
            z = 1.0 - abs(u) - abs(v)
            t = max(-z, 0.0)
            x, y = u - math.copysign(t, u), v - math.copysign(t, v)
            normals[i] = np.array([x, y, z]) / math.sqrt(x * x + y * y + z * z)
    return {
        "mesh/positions": np.array(positions),
        "mesh/normals": normals.astype(np.float32),
        "mesh/faces": np.array(faces, dtype=np.int32).reshape(-1, 3),
        "mesh/albedo": np.ones((width * height, 3), dtype=np.float32),
    }


def running_sums(rows: np.ndarray) -> np.ndarray:
    """Numbers from their differences, modulo 2⁸ or 2¹⁶."""
    return np.cumsum(rows.astype(np.int64), axis=1) % (1 << (8 * rows.itemsize))


def film_background(arrays: dict[str, np.ndarray]) -> np.ndarray:
    """(V, 3)."""
    parts = running_sums(arrays["film/background"]) / 65535.0
    return np.broadcast_to(parts, (3, parts.shape[1])).T


def film_noise(arrays: dict[str, np.ndarray]) -> np.ndarray:
    """(V,)."""
    codes = running_sums(arrays["film/noise"])[0]
    return np.where(codes > 0, 2.0 ** (codes / 8.0 - 24.0), 0.0)
