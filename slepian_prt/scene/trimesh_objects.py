"""Meshes and scenes of the library trimesh, as they are in memory; trimesh itself is not imported."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.arrays import real_numbers, whole_numbers
from slepian_prt.errors import UserError
from slepian_prt.scene.mesh import Mesh, make_mesh

log = logging.getLogger(__name__)


def is_of_trimesh(thing: Any) -> bool:
    """Whether it is an object of trimesh, or of a class derived from one there."""
    return any(kind.__module__.partition(".")[0] == "trimesh" for kind in type(thing).__mro__)


def mesh_from_trimesh(thing: Any) -> Mesh:
    """A ``trimesh.Trimesh``, or all of a ``trimesh.Scene`` in the place where its graph has it, as one mesh.

    Normals are those that the object holds; where it holds none, they are computed as for a file without any. Colours,
    materials and textures are left out, with a remark.

    Raises
    ------
    UserError
        Another object of trimesh, or one without faces.
    """
    name = _name(thing)
    if hasattr(thing, "graph"):
        with np.errstate(all="ignore"):  # what is not finite is told of when all is one mesh
            placed = [thing.graph[node] for node in thing.graph.nodes_geometry]
        parts = [(np.asarray(matrix, dtype=np.float64), thing.geometry[geometry]) for matrix, geometry in placed]
    else:
        parts = [(np.eye(4), thing)]
    surfaces = [(matrix, part) for matrix, part in parts if hasattr(part, "faces")]
    if not surfaces:
        kind = f"trimesh {type(thing).__name__}"
        raise UserError(f"{name}: a {kind} without a triangle mesh; light needs surfaces, so give a trimesh.Trimesh")
    if len(surfaces) < len(parts):
        log.info("%s: %d of %d parts have no faces and are left out", name, len(parts) - len(surfaces), len(parts))
    if any(part.visual.defined for _, part in surfaces):
        log.info("%s: its colours and materials are left out; give an `albedo`, or the path of its file", name)
    with np.errstate(all="ignore"):
        positions, normals, faces = zip(*(_placed(matrix, part, name) for matrix, part in surfaces), strict=True)
    starts = np.cumsum([0, *map(len, positions)])
    unknown = all(part is None for part in normals)
    filled = [np.full(p.shape, np.nan) if n is None else n for p, n in zip(positions, normals, strict=True)]
    return make_mesh(
        np.concatenate(positions),
        np.concatenate([part + start for part, start in zip(faces, starts, strict=False)]),
        normals=None if unknown else np.concatenate(filled),
        name=name,
        origin=name,
    )


def _placed(matrix: NDArray[np.float64], part: Any, name: str) -> tuple[NDArray, NDArray | None, NDArray]:
    """Positions, normals if it holds them, and faces of a ``trimesh.Trimesh``, moved by a matrix."""
    linear = matrix[:3, :3]
    vertices, faces = real_numbers(part.vertices, f"{name}: vertices"), whole_numbers(part.faces, f"{name}: faces")
    for what, rows in (("vertices", vertices), ("faces", faces)):
        if rows.size and (rows.ndim != 2 or rows.shape[1] != 3):
            raise UserError(f"{name}: {what} have the shape {rows.shape}, not (n, 3); load or build the mesh again")
    vertices, faces = vertices.reshape(-1, 3), faces.reshape(-1, 3)
    positions = vertices @ linear.T + matrix[:3, 3]
    mirrored = np.linalg.det(linear) < 0.0
    normals = None
    # `part.vertex_normals` would compute what the object does not hold.
    if "vertex_normals" in part._cache:
        # The cofactors of the matrix: normals of surfaces, also where it flattens them.
        cofactors = np.cross(linear[[1, 2, 0]], linear[[2, 0, 1]])
        held = real_numbers(part.vertex_normals, f"{name}: vertex_normals")
        if held.shape == vertices.shape:
            normals = held @ (-cofactors if mirrored else cofactors).T
    return positions, normals, faces[:, ::-1] if mirrored else faces


def _name(thing: Any) -> str:
    """What it is called, or its file, as one knows it."""
    metadata = getattr(thing, "metadata", None)
    metadata = metadata if isinstance(metadata, dict) else {}
    path = getattr(getattr(thing, "source", None), "file_path", None) or metadata.get("file_name")
    return str(metadata.get("name") or (Path(str(path)).stem if path else "mesh"))
