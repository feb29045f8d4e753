"""Relit results as files: numbers per vertex, a coloured mesh."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

from slepian_prt.compression.archive import atomic_output
from slepian_prt.relighting.picture import Picture, exposure, to_srgb
from slepian_prt.scene.meshes import Mesh

SUFFIXES = (".npz", ".ply", ".png", ".exr")


def write_radiance(path: str | Path, mesh: Mesh, radiance: NDArray) -> None:
    """``.npz`` with ``radiance`` (V, 3) float32, linear RGB, and ``positions`` (V, 3) in the order of the mesh."""
    with atomic_output(path) as file:
        np.savez(file, radiance=radiance.astype(np.float32), positions=mesh.positions)


def write_coloured_mesh(path: str | Path, mesh: Mesh, radiance: NDArray) -> float:
    """``.ply`` with tone-mapped sRGB colours per vertex; returns the exposure that they were scaled with."""
    strip = Picture(radiance[None].astype(np.float32), mesh.receivers[None].astype(np.float32))
    scale = exposure(strip)
    coloured = trimesh.Trimesh(
        mesh.positions, mesh.faces, vertex_normals=mesh.normals, vertex_colors=to_srgb(strip, scale)[0], process=False
    )
    with atomic_output(path) as file:
        file.write(coloured.export(file_type="ply"))
    return scale
