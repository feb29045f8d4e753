"""Relit meshes as binary glTF 2.0 (``.glb``): light as colours of the vertices, textures as they are, drawn unlit."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.relighting.files.coloured_mesh import fits_float32
from slepian_prt.relighting.files.gltf_document import GltfDocument
from slepian_prt.relighting.files.painted_mesh import PaintedMesh, Piece
from slepian_prt.scene.mesh import Mesh, check_float32


def write_glb(path: str | Path, painted: PaintedMesh, up: str = "y") -> None:
    """Write a painted mesh, complete or not at all.

    Each part is a node, each texture of it a primitive: ``COLOR_0`` is linear, and is multiplied by the texture.
    Materials are unlit, so that viewers show just that, and single-sided, as light is.

    Parameters
    ----------
    path : path
    painted : PaintedMesh
    up : "y" or "z"
        What is up in the mesh; it is put upright for viewers.

    Raises
    ------
    UserError
        More than the 4 GiB that the format holds; a folder that cannot be written to.

    References
    ----------
    Khronos Group, glTF 2.0 specification, 3 and 4; KHR_materials_unlit.
    """
    document, center = GltfDocument(), mesh_center(painted.mesh)
    by_part: defaultdict[str, list[Piece]] = defaultdict(list)
    for piece in painted.pieces:
        by_part[piece.name].append(piece)
    roots = []
    for name, pieces in by_part.items():
        primitives = [_primitive(document, painted.mesh, center, piece) for piece in pieces]
        roots.append(add_node(document, name, primitives, center))
    document.write(path, roots, up)


def mesh_center(mesh: Mesh) -> NDArray[np.float64]:
    """(3,) about what positions are written: the origin, or the middle of a model whose coordinates float32 rounds.

    Raises
    ------
    UserError
        The mesh is too large for float32.
    """
    check_float32(mesh)
    if fits_float32(mesh):
        return np.zeros(3)
    used = mesh.positions[mesh.receivers.active]
    return np.asarray(0.5 * (used.min(axis=0) + used.max(axis=0)))


def add_node(document: GltfDocument, name: str, primitives: list[dict[str, Any]], center: NDArray, **more: Any) -> int:
    """A node with a mesh of some primitives about ``center``; ``more`` properties of the mesh."""
    mesh = document.add("meshes", {"name": name, "primitives": primitives, **more})
    moved = {"translation": center.tolist()} if center.any() else {}
    return document.add("nodes", {"name": name, "mesh": mesh, **moved})


def add_geometry(document: GltfDocument, mesh: Mesh, center: NDArray, vertices: NDArray[np.int64]) -> dict[str, int]:
    """Attributes of some vertices of a mesh: where they are about ``center``, and their normals."""
    return {
        "POSITION": document.add_attribute((mesh.positions[vertices] - center).astype(np.float32)),
        "NORMAL": document.add_attribute(mesh.normals[vertices].astype(np.float32)),
    }


def _primitive(document: GltfDocument, mesh: Mesh, center: NDArray, piece: Piece) -> dict[str, Any]:
    attributes = add_geometry(document, mesh, center, piece.vertices)
    attributes["COLOR_0"] = document.add_attribute(piece.colors.astype(np.float32))
    if piece.uv is not None:
        attributes["TEXCOORD_0"] = document.add_attribute(piece.uv)
    indices = document.add_indices(piece.faces)
    return {"attributes": attributes, "indices": indices, "material": document.add_material(piece.texture)}
