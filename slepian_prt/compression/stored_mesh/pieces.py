"""The parts of a mesh, one after the other, as arrays of a file; what is on both sides of a surface is coded once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.stored_mesh import connectivity
from slepian_prt.compression.stored_mesh.connectivity import Coded
from slepian_prt.compression.stored_mesh.lattice import Lattice, find_lattices
from slepian_prt.compression.stored_mesh.planes import from_planes, to_planes
from slepian_prt.errors import UserError
from slepian_prt.scene.mesh import Mesh
from slepian_prt.scene.scene import Part


@dataclass(frozen=True, eq=False)
class Piece:
    """The vertices of a part.

    Attributes
    ----------
    first, count, sides : int
        As of `Part`.
    lattice : Lattice
    places : (count, 3) int64
        Of those on the front, on the lattice.
    faces : (F, 3) int64
        Of the front, of vertices as the whole mesh numbers them.
    """

    first: int
    count: int
    sides: int
    lattice: Lattice
    places: NDArray[np.int64]
    faces: NDArray[np.int64]

    @property
    def blocks(self) -> list[slice]:
        """The vertices of its front, and of its back."""
        begins = [self.first + side * self.count for side in range(self.sides)]
        return [slice(begin, begin + self.count) for begin in begins]

    @property
    def all_faces(self) -> NDArray[np.int64]:
        """Those of the front, then those of the back in the same order."""
        if self.sides == 1:
            return self.faces
        return np.concatenate([self.faces, self.faces[:, ::-1] + self.count])


def cut(mesh: Mesh, parts: Sequence[Part]) -> list[Piece]:
    """The pieces of a mesh.

    Raises
    ------
    UserError
        Parts that are not all of the mesh, one after the other; faces between two parts; a back that is not the front
        turned round.
    """
    ends = [0, *(part.end for part in parts)]
    if [part.first for part in parts] != ends[:-1] or ends[-1] != len(mesh.positions):
        raise UserError(
            "the parts of a mesh must follow each other and hold all its vertices; precompute the transfer again"
        )
    faces = mesh.faces.astype(np.int64)
    owner = np.searchsorted(ends, faces, side="right") - 1
    if np.any(owner != owner[:, :1]):
        raise UserError("no face may join two parts of a mesh; precompute the transfer again")
    order = np.argsort(owner[:, 0], kind="stable")
    split = np.split(faces[order], np.cumsum(np.bincount(owner[:, 0], minlength=len(parts)))[:-1])
    fronts = [_front(mesh, part, own) for part, own in zip(parts, split, strict=True)]
    lattices = find_lattices(mesh.positions, fronts)
    return [
        Piece(
            part.first,
            part.count,
            part.sides,
            lattice,
            lattice.places(mesh.positions[part.first : part.first + part.count]),
            own,
        )
        for part, own, lattice in zip(parts, fronts, lattices, strict=True)
    ]


def write_pieces(pieces: Sequence[Piece]) -> tuple[dict[str, Any], dict[str, NDArray], NDArray[np.int64]]:
    """The entry of the manifest, arrays, and which vertex each one of the file is."""
    coded = [connectivity.encode(piece.places, piece.faces - piece.first) for piece in pieces]
    about = [
        {
            "vertices": piece.count,
            "faces": len(piece.faces),
            "sides": piece.sides,
            "shift": piece.lattice.shift,
            "first": piece.lattice.first.tolist(),
            "draco": len(one.draco),
            "loose": len(one.loose),
            "loose_faces": len(one.loose_faces),
            "landmarks": find_landmarks(piece.places, one.order),
        }
        for piece, one in zip(pieces, coded, strict=True)
    ]
    order = [one.order + rows.start for piece, one in zip(pieces, coded, strict=True) for rows in piece.blocks]
    lattice = pieces[0].lattice
    entry = {"low": lattice.low.tolist(), "step": lattice.step, "pieces": about}
    arrays = {"mesh/draco": np.frombuffer(b"".join(one.draco for one in coded), dtype=np.uint8)}
    loose = np.concatenate([one.loose for one in coded])
    if loose.size:
        arrays["mesh/loose"] = to_planes(np.diff(loose, axis=0, prepend=0))
    faces = np.concatenate([one.loose_faces for one in coded])
    if faces.size:
        along = np.diff(faces[:, 0], prepend=0)
        arrays["mesh/loose_faces"] = to_planes(np.stack([along, *(faces[:, 1:] - faces[:, :1]).T], axis=1))
    return entry, arrays, np.concatenate(order)


def read_pieces(entry: dict[str, Any], arrays: dict[str, NDArray]) -> list[Piece]:
    """What `write_pieces` wrote, as the file numbers the vertices.

    Parameters
    ----------
    entry, arrays
        As the schema of files has them.

    Raises
    ------
    ValueError
        The pieces do not have so many vertices and faces.
    """
    about = entry["pieces"]
    counts = np.array([[one[name] for name in _COUNTS] for one in about], dtype=np.int64)
    data = _pieces(arrays["mesh/draco"], counts[:, 3])
    loose = _pieces(_loose(arrays), counts[:, 4])
    loose_faces = _pieces(_loose_faces(arrays), counts[:, 5])
    plain = Lattice(np.array(entry["low"], dtype=np.float64), entry["step"])
    pieces, first = [], 0
    for one, (count, faces, sides, *_), octets, *lists in zip(
        about, counts.tolist(), data, loose, loose_faces, strict=True
    ):
        places, sides_of = connectivity.decode(Coded(_NO_ORDER, octets.tobytes(), *lists), count)
        if len(sides_of) != faces:
            raise ValueError("number of faces")
        lattice = plain._replace(shift=one["shift"], first=np.array(one["first"], dtype=np.int64))
        pieces.append(Piece(first, count, sides, lattice, places, sides_of + first))
        first += sides * count
    return pieces


# What a piece counts: vertices and faces of its front, sides, and what it has of the arrays.
_COUNTS = ("vertices", "faces", "sides", "draco", "loose", "loose_faces")

# How many vertices of a number and of an eighth of that are known by number.
_LANDMARKS, _FEWER = 6, 8

_NO_ORDER = np.zeros(0, dtype=np.int64)


def find_landmarks(places: NDArray[np.int64], order: NDArray[np.int64]) -> list[list[int]]:
    """Vertices by which a mesh of the same vertices in their old order is known wherever it was moved.

    Of all vertices, of the first eighth of them, of the first eighth of these, … a few that are far from each other:
    a mesh may since have been cut finer, its old vertices first.

    Parameters
    ----------
    places : (n, 3)
    order : (n,)
        The vertex that each one of the file is.

    Returns
    -------
    Their numbers in the file, and before.
    """
    chosen: set[int] = set()
    count = len(places)
    while count >= 3:
        some = places[:count].astype(np.float64)
        away = np.linalg.norm(some - some.mean(axis=0), axis=1)
        for _ in range(_LANDMARKS):
            farthest = int(np.argmax(away))
            chosen.add(farthest)
            away = np.minimum(away, np.linalg.norm(some - some[farthest], axis=1))
        count //= _FEWER
    before = sorted(chosen)
    return [np.argsort(order)[before].tolist(), before]


def _front(mesh: Mesh, part: Part, faces: NDArray[np.int64]) -> NDArray[np.int64]:
    """Those faces of a part that are on its front."""
    if part.sides == 1:
        return faces
    middle = part.first + part.count
    behind = faces[:, 0] >= middle
    front, back = faces[~behind], faces[behind]
    turned = (back - part.count)[:, ::-1]
    same = len(front) == len(back) and np.all((faces >= middle) == behind[:, None])
    if not (same and np.all(_sorted(front) == _sorted(turned))):
        raise UserError("the faces of a back must be those of the front turned round; precompute the transfer again")
    if not np.all(mesh.positions[part.first : middle] == mesh.positions[middle : part.end]):
        raise UserError(
            "the vertices of a back must be at the places of those of the front; precompute the transfer again"
        )
    return front


def _sorted(faces: NDArray[np.int64]) -> NDArray[np.int64]:
    turned = connectivity.turned(faces)
    return turned[np.lexsort(turned.T)]


def _pieces(array: NDArray, counts: NDArray[np.int64]) -> list[NDArray]:
    return np.split(array, np.cumsum(counts)[:-1])


def _loose(arrays: dict[str, NDArray]) -> NDArray[np.int64]:
    if "mesh/loose" not in arrays:
        return np.zeros((0, 3), dtype=np.int64)
    return np.cumsum(from_planes(arrays["mesh/loose"], 3), axis=0)


def _loose_faces(arrays: dict[str, NDArray]) -> NDArray[np.int64]:
    if "mesh/loose_faces" not in arrays:
        return np.zeros((0, 3), dtype=np.int64)
    faces = from_planes(arrays["mesh/loose_faces"], 3)
    first = np.cumsum(faces[:, :1], axis=0)
    return np.concatenate([first, faces[:, 1:] + first], axis=1)
