"""Spherical polygons: which vertices make one, and which directions are inside.

Every sign is taken of differences to a vertex or to the middle of the polygon, which float64 forms without error where
they are small; so a polygon of 1e-8 rad is judged as well as one of a radian. Two parts of the boundary nearer to each
other than `RESOLUTION`, some fifty roundings of a unit vector, are refused: what lies between them is lost in these.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slepian_prt.arrays import real_numbers
from slepian_prt.errors import UserError
from slepian_prt.sphere.directions import check_directions
from slepian_prt.sphere.quadrature import spherical_fibonacci

RESOLUTION = 1e-14
LARGEST = 20_000
_CHUNK = 64
_PAIRS = 2_000_000


class Edges(NamedTuple):
    """The sides of a polygon, each field of shape (n, 3).

    ``normals`` are the unit axes about which an edge turns from ``starts`` to ``ends``; ``at_starts`` and ``at_ends``
    are its own directions there.
    """

    starts: NDArray[np.float64]
    ends: NDArray[np.float64]
    normals: NDArray[np.float64]
    at_starts: NDArray[np.float64]
    at_ends: NDArray[np.float64]


@dataclass(frozen=True)
class Polygon:
    """A simple spherical polygon, the inside to the left of its edges.

    Attributes
    ----------
    edges : Edges
    middle : (3,)
        Near which differences are taken.
    references : (2, 3)
        Directions on no edge's great circle, about at right angles; paths start from one of them.
    within : (2,) bool
        Whether they are inside.
    """

    edges: Edges
    middle: NDArray[np.float64]
    references: NDArray[np.float64]
    within: tuple[bool, bool]

    def contains(self, directions: NDArray) -> NDArray[np.bool_]:
        """(n,) bool for (n, 3) unit directions."""
        # A path is the shorter arc of a great circle, so it must not end opposite to where it starts.
        second = directions @ self.references[0] < -0.5
        inside = np.empty(len(directions), dtype=bool)
        step = max(1, _PAIRS // len(self.edges.starts))
        for which, reference in enumerate(self.references):
            chosen = np.flatnonzero(second == bool(which))
            for begin in range(0, chosen.size, step):
                part = chosen[begin : begin + step]
                crossed = _crossings(self.edges, self.middle, reference, directions[part]).sum(axis=1)
                inside[part] = (crossed % 2 == 1) ^ self.within[which]
        return inside


def make_polygon(vertices: ArrayLike) -> Polygon:
    """Check the vertices of a polygon, and find its inside.

    Parameters
    ----------
    vertices : (n, 3)

    Raises
    ------
    UserError
        Fewer than three vertices or more than 20,000, two successive ones equal or opposite, or edges that cross, touch
        or overlap.
    """
    vertices = real_numbers(vertices, "vertices")
    corners = check_directions(vertices, "vertices")
    # Unit vectors stay as they are: a second rounding of their length moves them by 1e-16, across a tiny polygon too.
    unit = np.abs(corners - vertices).max(axis=-1, keepdims=True, initial=0.0) <= 4e-16
    corners = np.where(unit, vertices, corners)
    if len(corners) > LARGEST:
        raise UserError(f"vertices must hold at most {LARGEST} directions, not {len(corners)}; leave some out")
    if len(corners) < 3:
        raise UserError(f"vertices must hold at least three directions, not {len(corners)}")
    repeated = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1) <= RESOLUTION
    if repeated.any():
        first = int(np.argmax(repeated))
        which = "the last vertex of a closed ring" if first == len(corners) - 1 else "one of them"
        raise UserError(f"vertices[{first}] and vertices[{(first + 1) % len(corners)}] are equal; leave out {which}")
    opposite = np.linalg.norm(np.roll(corners, -1, axis=0) + corners, axis=1) < 1e-9
    if opposite.any():
        first, following = ((int(np.argmax(opposite)) + step) % len(corners) for step in (0, 1))
        raise UserError(
            f"vertices[{first}] and vertices[{following}] must not be opposite: put one between them to say which way"
        )
    edges = _join(corners)
    middle = _middle(corners)
    _check_simple(edges, middle)
    return _orient(edges, middle)


def _join(corners: NDArray) -> Edges:
    ends = np.roll(corners, -1, axis=0)
    normals = np.cross(corners, ends - corners)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return Edges(corners, ends, normals, np.cross(normals, corners), np.cross(normals, ends))


def _middle(corners: NDArray) -> NDArray[np.float64]:
    """The mean direction; z where the vertices go round and leave none."""
    mean = corners.mean(axis=0)
    length = np.linalg.norm(mean)
    return mean / length if length > 0.05 else np.array([0.0, 0.0, 1.0])


def _check_simple(edges: Edges, middle: NDArray) -> None:
    """Compare each chunk of successive edges with those of the chunks whose bounding balls meet its own."""
    count = len(edges.starts)
    lengths = np.linalg.norm(edges.ends - edges.starts, axis=1)
    chunks = [np.arange(begin, min(begin + _CHUNK, count)) for begin in range(0, count, _CHUNK)]
    centers = np.array([edges.starts[chunk].mean(axis=0) for chunk in chunks])
    # No point of an arc of a great circle is farther from its nearer end than the chord is long.
    radii = np.array(
        [
            (np.linalg.norm(edges.starts[chunk] - center, axis=1) + lengths[chunk]).max()
            for chunk, center in zip(chunks, centers, strict=True)
        ]
    )
    for i, chunk in enumerate(chunks):
        near = np.linalg.norm(centers[i:] - centers[i], axis=1) <= radii[i:] + radii[i] + RESOLUTION
        others = np.concatenate([chunks[i + int(j)] for j in np.flatnonzero(near)])
        _check_pairs(edges, middle, chunk, others)


def _check_pairs(edges: Edges, middle: NDArray, some: NDArray, others: NDArray) -> None:
    count = len(edges.starts)
    pairs = ((some, others), (others, some))
    for these, those in pairs:
        touching = _touches(edges, middle, these, those)
        if touching.any():
            edge, vertex = (int(x[0]) for x in np.nonzero(touching))
            edge, vertex = int(these[edge]), int(those[vertex])
            # Either edge of the vertex touches; after a spike one of them is the next to this edge's neighbour.
            other = (vertex - 1) % count if (edge + 2) % count == vertex else vertex
            first, second = sorted((int(edge), int(other)))
            raise UserError(
                f"the edges from vertices[{first}] and vertices[{second}] touch or overlap (within 1e-14 rad): cut the "
                "polygon up there and combine the parts with | or -"
            )
    first_sides, second_sides = (_sides(edges, middle, these, those) for these, those in pairs)
    crossing = _cross(*first_sides, *(side.T for side in second_sides))
    if crossing.any():
        edge, other = (int(x[0]) for x in np.nonzero(crossing))
        first, second = sorted((int(some[edge]), int(others[other])))
        raise UserError(
            f"the edges from vertices[{first}] and vertices[{second}] cross: list the vertices in the order in which "
            "they follow each other round the polygon"
        )


def _touches(edges: Edges, middle: NDArray, these: NDArray, those: NDArray) -> NDArray[np.bool_]:
    """Whether each of these edges (rows) comes within the resolution of the start of each of those (columns)."""
    starts, ends = edges.starts[these], edges.ends[these]
    vertices = edges.starts[those] - middle
    beyond_start = edges.at_starts[these] @ vertices.T - _dots(edges.at_starts[these], starts - middle)[:, None]
    beyond_end = edges.at_ends[these] @ vertices.T - _dots(edges.at_ends[these], ends - middle)[:, None]
    aside = edges.normals[these] @ vertices.T - _dots(edges.normals[these], starts - middle)[:, None]
    own = (these[:, None] == those) | ((these[:, None] + 1) % len(edges.starts) == those)
    return (beyond_start > -RESOLUTION) & (beyond_end < RESOLUTION) & (np.abs(aside) < RESOLUTION) & ~own


def _sides(edges: Edges, middle: NDArray, these: NDArray, those: NDArray) -> tuple[NDArray, NDArray]:
    """On which side of these edges (rows) those (columns) start and end: 1 left, -1 right, 0 on the great circle."""
    offsets = _dots(edges.normals[these], edges.starts[these] - middle)[:, None]
    found = []
    for points in (edges.starts[those], edges.ends[those]):
        aside = edges.normals[these] @ (points - middle).T - offsets
        found.append(np.where(np.abs(aside) < RESOLUTION, 0, np.sign(aside)))
    return found[0], found[1]


def _cross(starts: NDArray, ends: NDArray, starts_back: NDArray, ends_back: NDArray) -> NDArray[np.bool_]:
    """Whether two edges cross, from the sides on which the second starts and ends, and the first as seen from it.

    Where no vertex touches an edge, a crossing has all four well away from the other's great circle. That the edges
    meet in one point, not in two opposite ones, is the last condition.
    """
    return (starts * ends < 0) & (starts_back * ends_back < 0) & (starts * ends_back > 0)


def _orient(edges: Edges, middle: NDArray) -> Polygon:
    """Find whether the references are inside.

    A path from a reference to the middle of an edge gets there from the left of the edge, which is inside, or from the
    right; each edge that it crosses before changes sides.
    """
    candidates = spherical_fibonacci(61)
    clearance = np.abs(candidates @ edges.normals.T).min(axis=1)
    first = candidates[int(np.argmax(clearance))]
    second = candidates[int(np.argmax(np.where(np.abs(candidates @ first) < 0.3, clearance, -1.0)))]
    longest = int(np.argmax(np.linalg.norm(edges.ends - edges.starts, axis=1)))
    target = edges.starts[longest] + edges.ends[longest]
    target /= np.linalg.norm(target)
    # The path must not be half a turn, so it starts from the nearer of them; another joins the two.
    near, far = (first, second) if first @ target > second @ target else (second, first)
    crossed = _crossings(edges, middle, near, target[None])[0]
    crossed[longest] = False
    near_inside = bool(edges.normals[longest] @ near > 0.0) ^ (int(crossed.sum()) % 2 == 1)
    far_inside = near_inside ^ (int(_crossings(edges, middle, near, far[None]).sum()) % 2 == 1)
    return Polygon(edges, middle, np.array([near, far]), (near_inside, far_inside))


def _crossings(edges: Edges, middle: NDArray, reference: NDArray, directions: NDArray) -> NDArray[np.bool_]:
    """Whether the arc from the reference to each direction (rows) crosses each edge (columns).

    Vertices on the path's great circle count as left of it, for both of their edges, so that a path through a vertex
    crosses one of them if it changes sides and both or none if not.
    """
    offsets = directions - middle
    paths = np.cross(reference, directions - reference)
    left = paths @ (edges.starts - middle).T >= _dots(paths, offsets)[:, None]
    left_end = np.roll(left, -1, axis=1)
    base = _dots(edges.normals, edges.starts - middle)
    from_left = edges.normals @ (reference - middle) > base
    to_left = offsets @ edges.normals.T >= base
    # As in `_cross`, the last condition leaves out arcs that meet each other's continuation on the far side.
    return (left != left_end) & (to_left != from_left) & (left_end == from_left)


def _dots(a: NDArray, b: NDArray) -> NDArray[np.float64]:
    return np.einsum("ij,ij->i", a, b)
