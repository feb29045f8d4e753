"""Whether the arrays of a mesh fit its entry in the manifest; nothing is decoded for it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

# What a piece counts: vertices and faces of its front, sides, and what it has of the arrays.
COUNTS = ("vertices", "faces", "sides", "draco", "loose", "loose_faces")

_WAYS = 4


def check_mesh(entry: dict[str, Any], arrays: dict[str, NDArray]) -> None:
    """Raise ValueError, KeyError or TypeError for arrays of other shapes than the entry has them."""
    counts = count_pieces(entry)
    vertices = int(counts[:, 0] @ counts[:, 2])
    draco, loose, loose_faces = counts[:, 3:].sum(axis=0).tolist()
    if arrays["mesh/draco"].dtype != np.uint8 or arrays["mesh/draco"].shape != (draco,):
        raise ValueError("bytes of Draco")
    _check_planes(arrays, "mesh/loose", 3, loose)
    _check_planes(arrays, "mesh/loose_faces", 3, loose_faces)
    if entry["exact"]:
        _check_planes(arrays, "mesh/positions", 3, vertices)
        if "mesh/normals" in arrays:
            _check_planes(arrays, "mesh/normals", 3, vertices)
    else:
        ways = arrays.get("mesh/normal_ways", np.zeros(vertices, dtype=np.uint8))
        if ways.dtype != np.uint8 or ways.shape != (vertices,) or ways.max() >= _WAYS:
            raise ValueError("ways of normals")
        _check_planes(arrays, "mesh/normals", 2, int(np.count_nonzero(ways == _WAYS - 2)))
    _check_albedo(entry["albedo"], arrays, vertices)
    if "mesh/order" in arrays:
        _check_planes(arrays, "mesh/order", 1, vertices)
    if "mesh/source" in arrays:
        _check_planes(arrays, "mesh/source", 2, arrays["mesh/source"].shape[-1])


def count_pieces(entry: dict[str, Any]) -> NDArray[np.int64]:
    """(P, 6) `COUNTS` of the pieces.

    Raises
    ------
    ValueError, KeyError, TypeError
    """
    about = entry["pieces"]
    counts = np.array([[one[name] for name in COUNTS] for one in about], dtype=np.int64).reshape(len(about), -1)
    if not len(about) or counts.min() < 0 or counts[:, 0].min() < 1 or not np.all(np.isin(counts[:, 2], (1, 2))):
        raise ValueError("pieces of the mesh")
    for one in about:
        landmarks = np.array(one["landmarks"], dtype=np.int64)
        if landmarks.ndim != 2 or len(landmarks) != 2 or not np.all((landmarks >= 0) & (landmarks < one["vertices"])):
            raise ValueError("landmarks of the mesh")
    return counts


def _check_planes(arrays: dict[str, NDArray], name: str, columns: int, rows: int) -> None:
    """That numbers (rows, columns) are there as `planes.to_planes` gives them; nothing need be if there are none."""
    if rows == 0 and name not in arrays:
        return
    planes = arrays[name]
    if planes.dtype != np.uint8 or planes.ndim != 3 or planes.shape[::2] != (columns, rows) or planes.shape[1] > 8:
        raise ValueError(f"shape of {name}")


def _check_albedo(entry: dict[str, Any], arrays: dict[str, NDArray], vertices: int) -> None:
    if entry["kind"] == "constant":
        return
    packed = arrays["mesh/albedo"]
    fits = packed.dtype == np.uint8 and len(packed) in (1, 3) and packed.shape[-1] == vertices
    if not fits or packed.ndim != (2 if entry["kind"] == "table" else 3):
        raise ValueError("shape of mesh/albedo")
