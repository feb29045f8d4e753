"""Normals that a decoder computes from places and faces, and those that it cannot.

Only sums, products, quotients and square roots in a fixed order are used, which IEEE 754 rounds alike everywhere; the
last bits of library functions (arctan2, norms by BLAS) depend on the machine.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.stored_mesh.planes import from_ordered, from_planes, to_ordered, to_planes
from slepian_prt.scene.formats.joining import join_equal

# A normal that is not computed this near is stored.
LARGEST_TURN = math.radians(0.25)

# Between the ends of both, less what rounding to float32 may add.
_LARGEST_CHORD = 2.0 * math.sin(0.5 * LARGEST_TURN) - 1e-6

# Stored normals are points of an octahedron's faces in whole numbers: 12 bits each, within 0.06 degrees.
_OCTAHEDRON = 2047

# How a vertex has its normal: from its own faces, from those of all vertices at its place, stored, or none.
_OWN, _SHARED, STORED, _NONE = range(4)
WAYS = 4

# acos x = √(1 - x) Σ a_k x^k for x in [0, 1] within 2·10⁻⁸ (Abramowitz & Stegun 1964, 4.4.46).
_ACOS = (
    1.5707963050,
    -0.2145988016,
    0.0889789874,
    -0.0501743046,
    0.0308918810,
    -0.0170881256,
    0.0066700901,
    -0.0012624911,
)

# Faces at a time, so that what is computed on the way stays in the cache.
_BLOCK = 1 << 14

# Sums of normals by angle that are no longer than this cancel.
_CANCELLED = 1e-9


@dataclass(frozen=True, eq=False)
class Surface:
    """What normals are computed from.

    Attributes
    ----------
    places : (V, 3) float64
        In any unit, which may differ from block to block.
    faces : (F, 3)
    blocks : (V,)
        Vertices of different ones have nothing in common: shapes, and their backs.
    """

    places: NDArray[np.float64]
    faces: NDArray[np.integer]
    blocks: NDArray[np.int64]

    @cached_property
    def own_normals(self) -> NDArray[np.float64]:
        """(V, 3) `computed_normals` of each vertex."""
        return computed_normals(self.places, self.faces)

    @cached_property
    def shared_normals(self) -> NDArray[np.float64]:
        """(V, 3) `computed_normals` of all vertices at a place."""
        return computed_normals(self.places, self.faces, join_equal(self.places, self.blocks[:, None])[1])


def pack_normals(normals: NDArray[np.float64], surface: Surface, exact: bool) -> dict[str, NDArray]:
    """Arrays from which `unpack_normals` makes normals (V, 3).

    They turn by no more than `LARGEST_TURN`, and are those of float32 if ``exact``. Zero stays zero.
    """
    own = surface.own_normals
    if exact:
        away = to_ordered(normals.astype(np.float32)) - to_ordered(own.astype(np.float32))
        return {"mesh/normals": to_planes(away)} if away.any() else {}
    ways = np.full(len(normals), _OWN, dtype=np.uint8)
    ways[_turns(own, normals)] = STORED
    if np.any(ways == STORED):
        shared = surface.shared_normals
        ways[(ways == STORED) & ~_turns(shared, normals)] = _SHARED
    ways[(ways != _OWN) & ~normals.any(axis=1)] = _NONE
    stored = ways == STORED
    arrays = {"mesh/normal_ways": ways} if ways.any() else {}
    if stored.any():
        arrays["mesh/normals"] = to_planes(_to_octahedron(normals[stored]) - _to_octahedron(own[stored]))
    return arrays


def unpack_normals(arrays: dict[str, NDArray], surface: Surface, exact: bool) -> NDArray[np.float64]:
    """(V, 3) what `pack_normals` packed, numbers of float32.

    ``arrays`` are those that `array_schema` finds to fit.

    Raises
    ------
    ValueError
    """
    own = surface.own_normals
    single = own.astype(np.float32)
    if exact and "mesh/normals" in arrays:
        away = from_planes(arrays["mesh/normals"], 3)
        return from_ordered(to_ordered(single) + away, single.dtype).astype(np.float64)
    ways = arrays.get("mesh/normal_ways", np.zeros(0, dtype=np.uint8))
    if exact or not ways.size:
        return single.astype(np.float64)
    normals = single.astype(np.float64)
    shared, stored = ways == _SHARED, ways == STORED
    if shared.any():
        normals[shared] = surface.shared_normals[shared].astype(np.float32)
    if stored.any():
        away = from_planes(arrays["mesh/normals"], 2)
        if np.abs(away).max() > 2 * _OCTAHEDRON:
            raise ValueError("corrections of normals")
        normals[stored] = _from_octahedron(_to_octahedron(own[stored]) + away).astype(np.float32)
    normals[ways == _NONE] = 0.0
    return normals


def computed_normals(
    places: NDArray[np.float64], faces: NDArray, groups: NDArray[np.int64] | None = None
) -> NDArray[np.float64]:
    """(V, 3) normals of faces, weighted by their angles at the vertex and added up face after face, corners 0 first.

    Zero where there are none, or they cancel. ``groups`` (V,): vertices of the same one share a normal.
    """
    count = len(places)
    columns = [np.ascontiguousarray(column) for column in places.T]
    weighted = np.empty((3, 3, len(faces)))  # corner, axis
    for begin in range(0, len(faces), _BLOCK):
        rows = slice(begin, begin + _BLOCK)
        _weight_by_angle(columns, faces[rows], weighted[:, :, rows])
    total = np.zeros((3, count))
    for corner in range(3):
        vertex = faces[:, corner] if groups is None else groups[faces[:, corner]]
        for axis in range(3):
            total[axis] += np.bincount(vertex, weighted[corner, axis], minlength=count)
    length = _length(total)
    cancelled = length <= _CANCELLED
    length[cancelled] = 1.0
    total /= length
    total[:, cancelled] = 0.0
    return np.ascontiguousarray((total if groups is None else total[:, groups]).T)


def _weight_by_angle(columns: list[NDArray], faces: NDArray, weighted: NDArray) -> None:
    """Unit normals of faces (n, 3) times their angles, to ``weighted`` (3 corners, 3 axes, n)."""
    a, b, c = (np.stack([column[faces[:, corner]] for column in columns]) for corner in range(3))
    sides = (b - a, c - b, a - c)
    lengths = [_length(side) for side in sides]
    (ux, uy, uz), (vx, vy, vz) = sides[0], sides[1]
    normal = np.stack([uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx])
    area = _length(normal)
    normal /= np.where(area > 0.0, area, 1.0)
    for corner in range(3):
        coming, going = sides[corner - 1], sides[corner]
        product = lengths[corner - 1] * lengths[corner]
        cosine = -_dot(coming, going) / np.where(product > 0.0, product, 1.0)
        np.multiply(normal, _acos(cosine), out=weighted[corner])


def _acos(x: NDArray[np.float64]) -> NDArray[np.float64]:
    size = np.minimum(np.abs(x), 1.0)
    series = np.full_like(size, _ACOS[-1])
    for coefficient in _ACOS[-2::-1]:
        series *= size
        series += coefficient
    series *= np.sqrt(1.0 - size)
    return np.where(x < 0.0, math.pi - series, series)


def _dot(a: NDArray, b: NDArray) -> NDArray[np.float64]:
    """Of vectors (3, n), added up in this order."""
    return np.asarray(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


def _length(a: NDArray) -> NDArray[np.float64]:
    return np.sqrt(_dot(a, a))


def _turns(computed: NDArray, normals: NDArray) -> NDArray[np.bool_]:
    """(n,) whether a normal is further off than `LARGEST_TURN`, or zero where the other is not."""
    apart = np.sqrt(np.sum((computed - normals) ** 2, axis=1))
    return np.asarray((apart > _LARGEST_CHORD) | (computed.any(axis=1) != normals.any(axis=1)))


def _to_octahedron(normals: NDArray[np.float64]) -> NDArray[np.int64]:
    """(n, 2) the point of |x| + |y| + |z| = 1 in each direction, the half below folded over that above."""
    x, y, z = normals.T
    size = np.abs(x) + np.abs(y) + np.abs(z)
    size = np.where(size > 0.0, size, 1.0)
    u, v = x / size, y / size
    below = z < 0.0
    folded = (1.0 - np.abs(v)) * np.where(u < 0.0, -1.0, 1.0), (1.0 - np.abs(u)) * np.where(v < 0.0, -1.0, 1.0)
    both = np.stack([np.where(below, folded[0], u), np.where(below, folded[1], v)], axis=1)
    return np.rint(both * _OCTAHEDRON).astype(np.int64)


def _from_octahedron(points: NDArray[np.int64]) -> NDArray[np.float64]:
    """(n, 3) unit vectors."""
    u, v = points.T.astype(np.float64)
    z = _OCTAHEDRON - np.abs(u) - np.abs(v)
    below = z < 0.0
    x = np.where(below, (_OCTAHEDRON - np.abs(v)) * np.where(u < 0.0, -1.0, 1.0), u)
    y = np.where(below, (_OCTAHEDRON - np.abs(u)) * np.where(v < 0.0, -1.0, 1.0), v)
    vector = np.stack([x, y, z])
    return np.ascontiguousarray((vector / _length(vector)).T)
