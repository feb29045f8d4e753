"""Transfer as GAMES202's program writes it, ``transport.txt``: nine numbers for each corner of each triangle.

The first line is the number of vertices; then come three lines for each triangle of the .obj file, of its corners.
The numbers are ∫ V (n·ω)₊ y_lm dω, π times ours. Its WebGL viewer takes them by their places.

References
----------
GAMES202, homework 2 (Lingqi Yan, 2021): prt/src/prt.cpp, which writes; src/engine.js, which reads.
"""

from __future__ import annotations

import codecs
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError
from slepian_prt.files import check_readable
from slepian_prt.machine.file_content import read_content
from slepian_prt.scene.mesh import Mesh
from slepian_prt.scene.mesh_files import read_mesh
from slepian_prt.scene.scene import Part
from slepian_prt.sphere.conventions.convert import convert_sh
from slepian_prt.transport.effects import UNKNOWN, Effect
from slepian_prt.transport.transfer import Transfer

SUFFIX = ".txt"

# Of bandlimit 2.
_SIZE = 9

# Numbers of surfaces that send back no more than they receive are below π; squares of these stay within float32.
_LARGEST = 1e6

_UNKNOWN = Effect("all effects", UNKNOWN, None, None, 0, "GAMES202's transport.txt does not say what was simulated")

# Corners of a vertex may differ by so much of the largest number: six digits are written, and a digit is lost in sums.
_ROUNDING = 1e-4


def read_transport(path: str | Path, mesh: str | Path | Mesh) -> Transfer:
    """Transfer of bandlimit 2 on the mesh that it was made of; `sp.load_transfer` calls it.

    Parameters
    ----------
    path : path of a transport.txt
    mesh : path of its .obj file, or Mesh
        Its triangles in the same order.

    Raises
    ------
    UserError
        Missing, no such text, or of another mesh: with another number of corners, or numbers that differ between the
        corners of one vertex.
    """
    path = Path(path)
    rows = _read_rows(path)
    if not isinstance(mesh, Mesh):
        mesh = read_mesh(mesh)
    corners = mesh.faces.ravel()
    if len(rows) != corners.size:
        raise UserError(
            f"{path}: is of {len(rows) / 3:g} triangles, and {mesh.name} has {len(mesh.faces)}; name the mesh that it "
            "was made of, of triangles alone and none without area"
        )
    vectors = np.zeros((len(mesh.positions), _SIZE))
    vectors[corners] = rows
    if np.abs(vectors[corners] - rows).max() > _ROUNDING * np.abs(rows).max():
        raise UserError(
            f"{path}: its numbers differ between the corners of one vertex of {mesh.name}: it is another mesh"
        )
    ours = convert_sh(vectors, source="games202", quantity="transfer")
    return Transfer(
        vectors=ours[:, None].astype(np.float32), axes=mesh.normals, mesh=mesh,
        parts=(Part(mesh.name, 0, len(mesh.positions), 1),), bandlimit=2, samples=0, seed=0, effects=(_UNKNOWN,),
        bounces=0, rays_traced=0, source=str(path),
    )  # fmt: skip


def is_transport_text(path: str | Path) -> bool:
    """Whether a .txt file begins as such a file does: with a number that stands alone in its line."""
    path = Path(path)
    if path.suffix.lower() != SUFFIX or not path.is_file():
        return False
    with path.open("rb") as file:
        first = file.readline(100).removeprefix(codecs.BOM_UTF8)
        return first.strip().isdigit() and bool(file.read(1))


def _read_rows(path: Path) -> NDArray[np.float64]:
    """(corners, 9)."""
    check_readable(path, "a transport.txt")
    try:
        content = read_content(path).removeprefix(codecs.BOM_UTF8)  # which Windows puts before text
        if b"_" in content:  # Python takes 1_0 for 10
            raise ValueError
        words = content.split()
        count, numbers = int(words[0]), np.array(words[1:], dtype=np.float64)
    except UserError:
        raise
    except (ValueError, IndexError):
        raise UserError(
            f"{path}: cannot be read as transport: a number of vertices and nine numbers per corner"
        ) from None
    if count < 1 or not numbers.size or numbers.size % (3 * _SIZE):
        raise UserError(
            f"{path}: holds {numbers.size} numbers after that of the vertices, and each triangle has {3 * _SIZE}; it "
            "may be cut short"
        )
    if not np.isfinite(numbers).all():
        raise UserError(f"{path}: holds numbers that are not finite; compute it again")
    if np.abs(numbers).max() > _LARGEST:
        raise UserError(
            f"{path}: holds numbers beyond {_LARGEST:g}, and those of transfer are about 1; compute it again"
        )
    return numbers.reshape(-1, _SIZE)


def transport_text(vectors: NDArray, faces: NDArray) -> bytes:
    """The content of transport.txt of vectors (V, 9) of ours and faces (F, 3), with all digits that float32 has."""
    theirs = convert_sh(np.asarray(vectors, dtype=np.float64), target="games202", quantity="transfer")
    rows = [" ".join(f"{number:.9g}" for number in row) + " \n" for row in theirs.tolist()]
    return f"{len(rows)}\n".encode() + "".join([rows[v] for v in faces.ravel().tolist()]).encode()
