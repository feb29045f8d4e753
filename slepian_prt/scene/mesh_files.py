"""Mesh files of all formats: read, joined to one mesh, completed with normals and albedo."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError
from slepian_prt.files import check_readable
from slepian_prt.machine.memory import check_memory
from slepian_prt.scene.formats.gltf import read_gltf
from slepian_prt.scene.formats.obj import read_obj
from slepian_prt.scene.formats.off import read_off
from slepian_prt.scene.formats.parts import MeshFile, MeshPart, share_textures
from slepian_prt.scene.formats.ply import read_ply
from slepian_prt.scene.formats.stl import read_stl
from slepian_prt.scene.left_out import LeftOut
from slepian_prt.scene.mesh import Mesh, MeshDetails, check_faces, check_geometry, complete_mesh
from slepian_prt.scene.reflectance.albedo import decode_textures, effects_left_out, texture_lost, vertex_albedo

log = logging.getLogger(__name__)

_READERS: dict[str, Callable[[Path], MeshFile]] = {
    ".ply": read_ply,
    ".obj": read_obj,
    ".stl": read_stl,
    ".off": read_off,
    ".glb": read_gltf,
    ".gltf": read_gltf,
}
MESH_SUFFIXES = tuple(_READERS)

# Of memory for each byte of a file, at least: the file, and its numbers.
_BYTES = 4


def read_mesh(path: str | Path, *, crease_angle: float = 180.0) -> Mesh:
    """Read a ply, obj, stl, off, glb or gltf file; all parts of it become one mesh.

    The albedo is what its materials, textures and vertex colours reflect diffusely; 1 if the file says nothing of any.

    Parameters
    ----------
    path : path
    crease_angle : float
        In degrees, in [0, 180]: edges sharper than this are hard where the file gives no normals. By default none is.

    Raises
    ------
    UserError
        The file is missing, not a mesh, needs what cannot be read here, or holds nothing that can be lit: no face,
        coordinates that are not finite, faces that name vertices which do not exist.
    """
    path = Path(path)
    check_crease_angle(crease_angle)
    with np.errstate(all="ignore"):  # numbers that leave the range of floats are found where they come out
        file = read_parts(path)
        mesh = _join(file, path, crease_angle)
    for note in file.notes:  # of a file that is refused that line alone is told
        log.info("%s: %s", path, note)
    return mesh


def read_parts(path: Path) -> MeshFile:
    """The parts of a mesh file as its format has them, not checked yet.

    Raises
    ------
    UserError
        The file is missing, empty, of an unknown kind, or malformed.
    """
    check_readable(path, f"a mesh file ({', '.join(MESH_SUFFIXES)}) or a Mitsuba .xml")
    size = path.stat().st_size
    if size == 0:
        raise UserError(f"{path}: the file is empty; export the mesh again")
    suffix = path.suffix.lower()
    if suffix not in _READERS:
        raise UserError(f"{path}: unknown mesh format '{path.suffix}'; convert it to one of {', '.join(MESH_SUFFIXES)}")
    check_memory(_BYTES * size, f"{path}: to read it", "make it smaller, as by fewer triangles")
    return share_textures(_READERS[suffix](path))


def file_albedo(file: MeshFile) -> NDArray[np.float32]:
    """(V, 3) what the materials, textures and colours of all parts reflect at their vertices."""
    textures = decode_textures(file.parts)
    return np.concatenate([vertex_albedo(part, textures)[0] for part in file.parts])


def check_crease_angle(angle: Any) -> None:
    """Raise UserError unless it is a number of degrees in [0, 180]."""
    number = isinstance(angle, int | float | np.number) and not isinstance(angle, bool)
    if not (number and 0.0 <= angle <= 180.0):
        raise UserError(f"crease_angle must be a number of degrees in [0, 180], not {angle!r}")


def _join(file: MeshFile, path: Path, crease_angle: float) -> Mesh:
    parts, origin = file.parts, str(path)
    for part in parts:
        check_faces(part.faces, len(part.positions), origin)
    counts = np.array([len(part.positions) for part in parts], dtype=np.int64)
    starts = np.cumsum(counts) - counts
    empty = np.zeros((0, 3))
    positions = np.concatenate([empty, *(part.positions for part in parts)])
    faces = np.concatenate([empty.astype(np.int64), *(p.faces + start for p, start in zip(parts, starts, strict=True))])
    check_geometry(positions, faces, origin)
    normals = None
    if any(part.normals is not None for part in parts):
        missing = (np.full((n, 3), np.nan) for n in counts)
        normals = np.concatenate([m if p.normals is None else p.normals for p, m in zip(parts, missing, strict=True)])
    known = any(part.material is not None or part.colors is not None for part in parts)
    albedo: NDArray[np.float32] | float = 1.0
    left_out: tuple[LeftOut, ...] = ()
    if known:
        textures = decode_textures(parts)
        values, metallic = zip(*(vertex_albedo(part, textures) for part in parts), strict=True)
        lost = [texture_lost(part, textures, value) for part, value in zip(parts, values, strict=True)]
        albedo, left_out = np.concatenate(values), effects_left_out(parts, metallic, lost)
    if crease_angle < 180.0 and parts and all(part.normals is not None for part in parts):
        log.info("%s: all of it has normals in the file, so that `crease_angle` has no effect", path)
    details = MeshDetails(path.stem, origin, _points(parts), known, left_out, crease_angle, _source(parts, starts))
    return complete_mesh(positions, faces, normals, albedo, details)


def _source(parts: Sequence[MeshPart], starts: NDArray[np.int64]) -> NDArray[np.int64] | None:
    """(n, 2) as of `Mesh`."""
    pairs = [part.source + [0, start] for part, start in zip(parts, starts, strict=True) if part.source is not None]
    return np.concatenate(pairs) if pairs and len(pairs) == len(parts) else None


def _points(parts: Sequence[MeshPart]) -> NDArray[np.int64]:
    """(V,) which point of the surface each vertex of all parts is, from 0 on."""
    next_number = max((int(p.points.max(initial=-1)) + 1 for p in parts if p.points is not None), default=0)
    numbers = [np.zeros(0, dtype=np.int64)]
    for part in parts:
        count = len(part.positions)
        numbers.append(np.arange(next_number, next_number + count) if part.points is None else part.points)
        next_number += count if part.points is None else 0
    return np.unique(np.concatenate(numbers), return_inverse=True)[1].ravel()
