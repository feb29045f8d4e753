"""Meshes with a colour at each vertex, as binary ``.ply``."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slepian_prt.files import atomic_output
from slepian_prt.scene.mesh import Mesh

# Rounding of a position, relative to the size of the model, from which on float32 does not hold it: that of a model
# beside the origin is a twentieth of it, that of a georeferenced one thousands of times as large.
_MOVED = 1e-6

_NAMES = {"f4": "float", "f8": "double", "u1": "uchar", "i4": "int"}


def write_ply(path: str | Path, mesh: Mesh, colours: NDArray[np.uint8]) -> None:
    """Write a mesh with normals and sRGB colours (V, 3), complete or not at all.

    Positions are float, or double where float would move them by more than a millionth of the model's size.
    """
    real = "f4" if _fits_float32(mesh) else "f8"
    kinds = {
        **dict.fromkeys(("x", "y", "z"), real),
        **dict.fromkeys(("nx", "ny", "nz"), "f4"),
        **dict.fromkeys(("red", "green", "blue", "alpha"), "u1"),
    }
    vertices = np.empty(len(mesh.positions), dtype=[(name, f"<{kind}") for name, kind in kinds.items()])
    columns = np.hstack([mesh.positions, mesh.normals, colours, np.full((len(colours), 1), 255)])
    for name, values in zip(kinds, columns.T, strict=True):
        vertices[name] = values
    faces = np.empty(len(mesh.faces), dtype=[("corners", "u1"), ("indices", "<i4", 3)])
    faces["corners"], faces["indices"] = 3, mesh.faces
    header = [
        "ply",
        "format binary_little_endian 1.0",
        "comment slepian_prt",
        f"element vertex {len(vertices)}",
        *(f"property {_NAMES[kind]} {name}" for name, kind in kinds.items()),
        f"element face {len(faces)}",
        "property list uchar int vertex_indices",
        "end_header",
    ]
    with atomic_output(path) as file:
        file.write(("\n".join(header) + "\n").encode())
        file.write(vertices.tobytes())
        file.write(faces.tobytes())


def _fits_float32(mesh: Mesh) -> bool:
    """Whether float32 holds the positions, at the size of what faces use: a stray vertex elsewhere does not count."""
    positions = mesh.positions[np.any(mesh.normals != 0.0, axis=1)]
    if len(positions) == 0:
        return True
    size = float(np.linalg.norm(np.ptp(positions, axis=0)))
    with np.errstate(over="ignore"):
        moved = np.abs(positions.astype(np.float32) - positions).max()
    return bool(moved <= _MOVED * size)
