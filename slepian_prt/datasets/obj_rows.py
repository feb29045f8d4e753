"""A scan as PIFu and ICON number it: all faces of an OBJ file in its order, whatever becomes of them here.

Their renderers take the triangles of the file itself, one corner after the other, and pair them with those of the
transfer. So none may be missing, moved or turned: faces without area stay, and polygons of four corners are cut as
their loaders cut them.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError
from slepian_prt.files import check_readable
from slepian_prt.scene.formats.joining import join_equal
from slepian_prt.scene.formats.obj import split_at_normals
from slepian_prt.scene.formats.obj_tables import Statements, read_statements
from slepian_prt.scene.mesh import Mesh, MeshDetails, complete_mesh, degenerate_faces

# Corners of the two triangles of a polygon of four.
_HALVES = np.array([[0, 1, 2], [2, 3, 0]])


class ObjRows(NamedTuple):
    """A mesh, and the faces of the file that it was read from.

    Attributes
    ----------
    mesh : Mesh
        Its vertices are the rows of the transfer: the positions of the file in their order, then copies of those that
        have several normals.
    faces : (F, 3) int64
        Vertices of the mesh, of all triangles of the file in its order; those without area, too.
    """

    mesh: Mesh
    faces: NDArray[np.int64]


def read_rows(path: str | Path, crease_angle: float = 180.0) -> ObjRows:
    """Read an OBJ file.

    Where it has no normals they are computed, those of positions that are equal together.

    Parameters
    ----------
    path : path
    crease_angle : float
        As of `read_mesh`.

    Raises
    ------
    UserError
        What `read_mesh` refuses; another format; a face of more than four corners, of which the loaders of PIFu and
        ICON read four, or of fewer than three.
    """
    path = Path(path)
    check_readable(path, "an OBJ file")
    if path.suffix.lower() != ".obj":
        raise UserError(f"{path}: PIFu and ICON read OBJ files only; convert it, or choose `formats=prt`")
    if path.stat().st_size == 0:
        raise UserError(f"{path}: the file is empty; export the mesh again")
    said = read_statements(path)
    _check_polygons(path, said)
    if np.any(said.corners[:, 2] >= 0):
        vertices, corners = split_at_normals(said)
        positions, normals, groups = vertices.positions, vertices.normals, None
    else:
        positions, normals, corners = said.positions, None, said.corners[:, 0]
        groups = join_equal(positions)[1] if len(positions) else None
    faces = _cut(said.sizes, corners)
    mesh = complete_mesh(
        positions, faces, normals, 1.0, MeshDetails(path.stem, str(path), groups, crease_angle=crease_angle)
    )
    return ObjRows(mesh, _in_mesh(mesh, positions, faces))


def _check_polygons(path: Path, said: Statements) -> None:
    if not len(said.positions) or not len(said.sizes):
        raise UserError(f"{path}: has no faces; light needs surfaces, so mesh it first")
    bad = np.flatnonzero((said.sizes < 3) | (said.sizes > 4))
    if bad.size:
        raise UserError(
            f"{path}: line {said.lines[bad[0]] + 1}: a face of {said.sizes[bad[0]]} corners, and the loaders of PIFu "
            "and ICON read three or four; triangulate the mesh"
        )


def _cut(sizes: NDArray[np.int64], corners: NDArray[np.int64]) -> NDArray[np.int64]:
    """(F, 3) triangles, those of a polygon of four side by side."""
    if np.all(sizes == 3):
        return corners.reshape(-1, 3)
    begin = np.cumsum(sizes) - sizes
    halves = corners[np.minimum(begin[:, None, None] + _HALVES, len(corners) - 1)]
    halves[sizes == 3, 0] = corners[begin[sizes == 3, None] + np.arange(3)]
    there = np.stack([np.ones(len(sizes), dtype=bool), sizes == 4], axis=1)
    return np.asarray(halves[there])


def _in_mesh(mesh: Mesh, positions: NDArray[np.float64], faces: NDArray[np.int64]) -> NDArray[np.int64]:
    """All faces (F, 3) of vertices of the file as those of the mesh, which has not those without area.

    Where hard edges made copies of a vertex, a face without area takes the first of them.
    """
    first = np.arange(len(positions))
    if mesh.source is not None:
        vertex, begin = np.unique(mesh.source[:, 0], return_index=True)
        first[vertex] = mesh.source[begin, 1]
    held = first[faces]
    has_area = slice(None) if len(mesh.faces) == len(faces) else ~degenerate_faces(positions, faces)
    held[has_area] = mesh.faces
    return held
