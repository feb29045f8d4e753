"""Ours and other readers of meshes: from a file to its triangles."""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray


def read_ours(path: Path) -> NDArray:
    """(T, 3, 3) triangles by `read_mesh`."""
    from slepian_prt.scene.mesh_files import read_mesh

    mesh = read_mesh(path)
    return mesh.positions[mesh.faces]


def read_fans(path: Path) -> NDArray:
    """(T, 3, 3) ours, but polygons cut as most readers cut them, concave or not: around their first corner."""
    from slepian_prt.scene.formats import assembly

    def cut(positions: NDArray, sizes: NDArray, corners: NDArray) -> tuple[NDArray, NDArray]:
        counts = np.maximum(sizes - 2, 0)
        owners = np.repeat(np.arange(len(sizes)), counts)
        starts = (np.cumsum(sizes) - sizes)[owners]
        second = starts + 1 + np.arange(len(owners)) - (np.cumsum(counts) - counts)[owners]
        return np.stack([starts, second, second + 1], axis=1), owners

    kept = assembly.triangulate
    assembly.triangulate = cut
    try:
        return read_ours(path)
    finally:
        assembly.triangulate = kept


def read_trimesh(path: Path) -> NDArray:
    """(T, 3, 3) triangles by trimesh."""
    import trimesh

    loaded = trimesh.load_scene(path, process=False, skip_materials=True)
    meshes = [mesh for mesh in loaded.dump() if isinstance(mesh, trimesh.Trimesh)]
    return np.concatenate([np.empty((0, 3, 3)), *(mesh.vertices[mesh.faces] for mesh in meshes)])


def read_assimp(path: Path) -> NDArray:
    """(T, 3, 3) triangles by assimp."""
    assimp = importlib.import_module("assimp_py")
    flags = assimp.Process_Triangulate | assimp.Process_PreTransformVertices | assimp.Process_SortByPType
    scene = assimp.import_file(str(path), flags)
    found = [np.empty((0, 3, 3))]
    for mesh in scene.meshes:
        if mesh.num_faces and mesh.num_indices == 3 * mesh.num_faces:
            vertices = np.asarray(mesh.vertices, dtype=np.float64).reshape(-1, 3)
            found.append(vertices[np.asarray(mesh.indices).reshape(-1, 3)])
    return np.concatenate(found)


PYTHON_READERS: dict[str, Callable[[Path], NDArray]] = {
    "ours": read_ours,
    "fans": read_fans,
    "trimesh": read_trimesh,
    "assimp": read_assimp,
}

_MODULES = {"trimesh": "trimesh", "assimp": "assimp_py"}


def installed() -> list[str]:
    """Names of the other readers in Python that are installed."""
    return [name for name, module in _MODULES.items() if importlib.util.find_spec(module)]
