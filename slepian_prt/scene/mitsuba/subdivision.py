"""Large faces cut finer, since light is computed at vertices: walls of two triangles, floors of a few.

Edges that are too long are halved, each in the same way for all faces that have it, also where these have vertices of
their own at its ends: no gaps open. The new faces lie in the planes of the old ones, so that the shape stays the same;
those of spheres and the like come nearer to their surface.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from slepian_prt.scene.mitsuba.edge_lengths import EdgeLengths
from slepian_prt.scene.mitsuba.triangles import Triangles
from slepian_prt.scene.normals import complete_normals

# Positions (n, 3) and unit normals (n, 3) by texture coordinates (n, 2).
Surface: TypeAlias = Callable[[NDArray], tuple[NDArray, NDArray]]

# A mesh is coarse if edges are longer than so many times what is wanted; others keep the vertices that they came with.
_COARSE = 3.0

# Rounding must not decide about edges that are just as long as they may be.
_TOLERANCE = 1.0 + 1e-6


class Subdivision(NamedTuple):
    """What came of cutting long edges.

    Attributes
    ----------
    pieces : list of Triangles
        In the order given.
    left : float
        How many times too long the longest edge still is; 1 if none is too long.
    most : int
        New vertices that others may have.
    """

    pieces: list[Triangles]
    left: float
    most: int


def cut_long_edges(
    pieces: Sequence[Triangles],
    wanted: Sequence[EdgeLengths],
    copies: Sequence[int],
    most: int,
    surfaces: Sequence[Surface | None] = (),
) -> Subdivision:
    """Halve edges of coarse meshes, the longest first, until none is longer than wanted or the vertices are too many.

    Parameters
    ----------
    pieces : sequence of Triangles
    wanted : sequence of EdgeLengths
        How long edges of each piece may be.
    copies : sequence of int
        How often each piece is there.
    most : int
        New vertices that all copies together may get.
    surfaces : sequence of Surface or None, optional
        What new vertices of each piece are put on; its faces without one.
    """
    nets, excess = {}, {}
    for number, (piece, lengths) in enumerate(zip(pieces, wanted, strict=True)):
        sides = _excess(piece.positions, piece.faces, lengths)
        if sides.max(initial=0.0) > _COARSE:
            nets[number], excess[number] = _Net.of(piece), sides
    ratio = _worst(excess)
    while ratio > 1.0:
        step = max(1.0, 0.5 * ratio)
        long = {number: net.edges(excess[number] > step) for number, net in nets.items()}
        new = sum(copies[number] * len(edges.ends) for number, edges in long.items())
        if new > most:
            break
        most -= new
        nets = {n: net.halved(long[n], surfaces[n] if surfaces else None) for n, net in nets.items()}
        excess = {n: _excess(net.values[:, :3], net.faces, wanted[n]) for n, net in nets.items()}
        ratio = _worst(excess)
    result = list(pieces)
    for number, net in nets.items():
        result[number] = net.triangles(pieces[number])
    return Subdivision(result, max(ratio, 1.0), most)


def side_lengths(positions: NDArray, faces: NDArray) -> NDArray[np.float64]:
    """(F, 3) lengths of the sides of faces: from corner 0 to 1, 1 to 2, 2 to 0."""
    corner = positions[faces]
    return np.asarray(np.linalg.norm(np.roll(corner, -1, axis=1) - corner, axis=2))


class _LongEdges(NamedTuple):
    """Edges to halve.

    Attributes
    ----------
    ends : (n, 2)
    side : (F, 3)
        Which edge each side of the faces is, or -1.
    """

    ends: NDArray[np.int64]
    side: NDArray[np.int64]


class _Net(NamedTuple):
    """Triangles on their way: all values of vertices side by side, places first.

    Attributes
    ----------
    values : (V, k)
    faces : (F, 3)
    parent : (F,)
        Which of the faces given each is a part of.
    """

    values: NDArray[np.float64]
    faces: NDArray[np.int64]
    parent: NDArray[np.int64]

    @classmethod
    def of(cls, piece: Triangles) -> _Net:
        columns = [piece.positions, _normals(piece)]
        columns += [] if piece.uv is None else [piece.uv]
        columns += [values for name, values in piece.attributes.items() if name.startswith("vertex_")]
        values = np.concatenate([np.asarray(column, dtype=np.float64) for column in columns], axis=1)
        return cls(values, piece.faces.astype(np.int64), np.arange(len(piece.faces)))

    def edges(self, long: NDArray[np.bool_]) -> _LongEdges:
        """The edges that some sides (F, 3) of the faces are."""
        low, high = np.sort(np.stack([self.faces[long], np.roll(self.faces, -1, axis=1)[long]]), axis=0)
        keys, number = np.unique(low * len(self.values) + high, return_inverse=True)
        side = np.full(self.faces.shape, -1)
        side[long] = number.ravel()
        return _LongEdges(np.stack(np.divmod(keys, len(self.values)), axis=1), side)

    def halved(self, edges: _LongEdges, surface: Surface | None) -> _Net:
        """With a vertex in the middle of each of the edges, and the faces cut there."""
        new = 0.5 * self.values[edges.ends].sum(axis=1)
        if surface is not None:
            new[:, :3], outward = surface(new[:, 6:8])
            new[:, 3:6] = outward * np.sign(np.einsum("ij,ij->i", outward, new[:, 3:6]))[:, None]
        values = np.concatenate([self.values, new])
        middle = np.where(edges.side >= 0, len(self.values) + edges.side, -1)
        cut = (middle >= 0).sum(axis=1)
        # Faces turned so that their first sides are those that are cut.
        turn = np.zeros(len(cut), dtype=np.int64)
        one, two = cut == 1, cut == 2
        turn[one] = np.argmax(middle[one] >= 0, axis=1)
        turn[two] = (np.argmax(middle[two] < 0, axis=1) + 1) % 3
        order = (turn[:, None] + np.arange(3)) % 3
        corner, middle = np.take_along_axis(self.faces, order, 1), np.take_along_axis(middle, order, 1)
        parts, parent = [self.faces[cut == 0]], [self.parent[cut == 0]]
        for count, cutter in ((1, _in_two), (2, _in_three), (3, _in_four)):
            rows = np.flatnonzero(cut == count)
            new = cutter(corner[rows].T, middle[rows].T, values[:, :3])
            parts.append(np.concatenate([np.stack(face, axis=1) for face in new]))
            parent.append(np.tile(self.parent[rows], len(new)))
        return _Net(values, np.concatenate(parts), np.concatenate(parent))

    def triangles(self, piece: Triangles) -> Triangles:
        """What has become of a piece; itself where nothing was cut."""
        normals = self.values[:, 3:6] / np.maximum(np.linalg.norm(self.values[:, 3:6], axis=1, keepdims=True), 1e-300)
        first, uv, attributes = 6, None, {}
        if piece.uv is not None:
            uv, first = self.values[:, 6:8], 8
        for name, values in piece.attributes.items():
            if name.startswith("vertex_"):
                attributes[name] = self.values[:, first : first + values.shape[1]]
                first += values.shape[1]
            else:
                attributes[name] = values[self.parent]
        return Triangles(self.values[:, :3], normals, self.faces, uv, attributes, are_own=False)


def _excess(positions: NDArray, faces: NDArray, wanted: EdgeLengths) -> NDArray[np.float64]:
    """(F, 3) how many times too long the sides of faces are; of those that are not, no more than that is known."""
    sides = side_lengths(positions, faces)
    excess = np.asarray(sides / (_TOLERANCE * wanted.least))
    if wanted.near:
        face, side = np.nonzero(excess > 1.0)
        middle = 0.5 * (positions[faces[face, side]] + positions[faces[face, (side + 1) % 3]])
        excess[face, side] = sides[face, side] / (_TOLERANCE * wanted.at(middle))
    return excess


def _worst(excess: dict[int, NDArray]) -> float:
    return max((float(sides.max(initial=0.0)) for sides in excess.values()), default=1.0)


def _normals(piece: Triangles) -> NDArray[np.float64]:
    notes: list[str] = []  # what is missing is remarked on when the mesh is made
    return complete_normals(piece.positions, piece.faces, piece.normals, None, notes)


def _in_two(corner: NDArray, middle: NDArray, _: NDArray) -> list[tuple[NDArray, ...]]:
    a, b, c = corner
    return [(a, middle[0], c), (middle[0], b, c)]


def _in_three(corner: NDArray, middle: NDArray, positions: NDArray) -> list[tuple[NDArray, ...]]:
    """The tip, and what is left of the face along its shorter diagonal."""
    (a, b, c), (m, n, _) = corner, middle
    across = np.linalg.norm(positions[a] - positions[n], axis=1) <= np.linalg.norm(positions[m] - positions[c], axis=1)
    return [(m, b, n), (a, m, np.where(across, n, c)), (np.where(across, a, m), n, c)]


def _in_four(corner: NDArray, middle: NDArray, _: NDArray) -> list[tuple[NDArray, ...]]:
    (a, b, c), (m, n, o) = corner, middle
    return [(a, m, o), (m, b, n), (o, n, c), (m, n, o)]
