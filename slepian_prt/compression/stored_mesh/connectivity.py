"""Faces and whole-numbered places of vertices in few bytes: by Draco, which reorders them, and what that leaves out.

Draco joins vertices at one place, splits vertices where a surface is not a manifold, drops faces of no area and
vertices without faces. So vertices at one place are told apart by a second attribute, their number among those;
vertices that come back with the same place and number are one; and what is missing after a trial of decoding is listed.
"""

from __future__ import annotations

import importlib
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slepian_prt.scene.formats.draco_header import draco_counts
from slepian_prt.scene.formats.joining import group, join_equal
from slepian_prt.scene.receivers import morton

# DracoPy passes whole numbers through float32.
LARGEST_PLACE = (1 << 24) - 1

# Draco's own; 10 is the smallest and slowest, of about 1.7 million vertices per second.
_LEVEL = 10

# Three numbers of vertices of so many bits are one number.
_BITS = 21


class Coded(NamedTuple):
    """Vertices and faces as a file has them.

    Attributes
    ----------
    order : (n,)
        Which vertex each one of the file is: those of Draco first, then the loose ones.
    draco : bytes
        Empty if all is loose.
    loose : (k, 3) int64
        Places of the vertices that Draco has not.
    loose_faces : (m, 3) int64
        Faces that Draco has not, of vertices as the file numbers them.
    """

    order: NDArray[np.int64]
    draco: bytes
    loose: NDArray[np.int64]
    loose_faces: NDArray[np.int64]


def encode(places: NDArray[np.int64], faces: NDArray[np.integer]) -> Coded:
    """Code a triangle mesh; what `decode` gives was checked to be the very same but for the order.

    Parameters
    ----------
    places : (n, 3)
        Those of vertices that faces use in [0, `LARGEST_PLACE`], else they are listed without Draco.
    faces : (f, 3)
    """
    faces = faces.astype(np.int64)
    joined = join_equal(places)[1]
    corners = joined[faces]
    solid = np.all(corners != np.roll(corners, 1, axis=1), axis=1)
    used = np.zeros(len(places), dtype=bool)
    used[faces[solid]] = True
    chosen = np.flatnonzero(used)
    fits = places[chosen].min(initial=0) >= 0 and places[chosen].max(initial=0) <= LARGEST_PLACE
    found = _by_draco(places, faces, chosen, joined, solid) if chosen.size and fits else None
    return found or _as_lists(places, faces)


def decode(coded: Coded, vertices: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Places (n, 3) and faces (f, 3) of so many vertices, as the file has them; ``order`` is not looked at.

    Raises
    ------
    ValueError
    """
    places, faces = np.zeros((0, 3), dtype=np.int64), np.zeros((0, 3), dtype=np.int64)
    if coded.draco:
        places, copies, faces = _decode_draco(coded.draco)
        if len(places) + len(coded.loose) != vertices:
            places, faces = _joined(places, copies, faces)[::2]
    if len(places) + len(coded.loose) != vertices:
        raise ValueError("number of vertices")
    for listed in (faces, coded.loose_faces):
        if listed.size and not 0 <= listed.min() <= listed.max() < vertices:
            raise ValueError("vertices of faces")
    return np.concatenate([places, coded.loose]), np.concatenate([faces, coded.loose_faces])


def check_draco_header(data: bytes, faces: int) -> None:
    """Raise ValueError for a stream that is no mesh of so many faces: Draco takes memory for as many as it tells."""
    told, vertices = draco_counts(data)
    if told != faces or vertices > 3 * faces:
        raise ValueError(f"a mesh of Draco of {told} faces and {vertices} vertices where {faces} faces are told of")


def _by_draco(
    places: NDArray, faces: NDArray, chosen: NDArray, joined: NDArray, solid: NDArray[np.bool_]
) -> Coded | None:
    """As `encode`, the ``chosen`` vertices and ``solid`` faces by Draco; None where that fails."""
    copies = _numbers_among_equals(joined[chosen])
    number = np.empty(len(places), dtype=np.int64)
    number[chosen] = np.arange(chosen.size)
    data = _encode_draco(places[chosen], copies, number[faces[solid]])
    if data is None:
        return None
    found, numbers, sides = _joined(*_decode_draco(data))
    # Each vertex of ours has its own place and number, so that it comes first among its equals.
    which = join_equal(
        np.concatenate([places[chosen], found]), np.concatenate([copies, numbers])[:, None]
    )[1][chosen.size :]  # fmt: skip
    if which.size and which.max() >= chosen.size:
        return None
    missing = _missing_faces(number[faces[solid]], which[sides])
    if missing is None:
        return None
    back = np.ones(len(places), dtype=bool)
    back[chosen[which]] = False
    left = np.flatnonzero(back)
    left = left[np.argsort(morton(places[left]), kind="stable")]
    order = np.concatenate([chosen[which], left])
    others = np.concatenate([faces[solid][missing], faces[~solid]])
    return Coded(order, data, places[left], _listed(others, order))


def _as_lists(places: NDArray, faces: NDArray) -> Coded:
    order = np.argsort(morton(places), kind="stable")
    return Coded(order, b"", places[order], _listed(faces, order))


def _listed(faces: NDArray, order: NDArray) -> NDArray[np.int64]:
    """Faces of vertices as the file numbers them, neighbours beside each other."""
    number = np.empty(len(order), dtype=np.int64)
    number[order] = np.arange(len(order))
    listed = number[faces].reshape(-1, 3)
    return listed[np.lexsort(listed.T[::-1])]


def _numbers_among_equals(labels: NDArray) -> NDArray[np.int64]:
    """0, 1, 2, … for entries (n,) of the same label."""
    order = np.argsort(labels, kind="stable")
    ordered = labels[order]
    numbers = np.empty(labels.size, dtype=np.int64)
    numbers[order] = np.arange(labels.size) - np.searchsorted(ordered, ordered)
    return numbers


def _missing_faces(faces: NDArray, found: NDArray) -> NDArray[np.int64] | None:
    """Which ``faces`` are not among those ``found``, as often as they are there; None if others were found."""
    kinds = _kinds_of(turned(np.concatenate([faces, found])))
    own, other = kinds[: len(faces)], kinds[len(faces) :]
    wanted = np.bincount(own, minlength=int(kinds.max(initial=0)) + 1)
    there = np.bincount(other, minlength=wanted.size)
    if np.any(there > wanted):
        return None
    return np.flatnonzero(_numbers_among_equals(own) >= there[own])


def _kinds_of(faces: NDArray[np.int64]) -> NDArray[np.int64]:
    """A number for each distinct face (f, 3)."""
    if faces.max(initial=0) >> _BITS:
        return join_equal(faces)[1]
    return group((faces[:, 0] << 2 * _BITS) | (faces[:, 1] << _BITS) | faces[:, 2])[1]


def turned(faces: NDArray) -> NDArray[np.int64]:
    """Faces with their smallest vertex first, turned the same way round."""
    first, result = np.argmin(faces, axis=1), faces.copy()
    for corner in (1, 2):
        rows = first == corner
        result[rows] = np.roll(faces[rows], -corner, axis=1)
    return result


def _joined(places: NDArray, copies: NDArray, faces: NDArray) -> tuple[NDArray, NDArray, NDArray]:
    """Vertices of the same place and number made one, in the order in which they come first."""
    first, joined = join_equal(places, copies[:, None])
    return places[first], copies[first], joined[faces]


def _encode_draco(places: NDArray, copies: NDArray, faces: NDArray) -> bytes | None:
    package = importlib.import_module("DracoPy")
    attributes = {0: copies.astype(np.uint32)[:, None]} if copies.any() else None
    try:
        data = package.encode(
            places.astype(np.uint32), faces.astype(np.uint32), compression_level=_LEVEL, generic_attributes=attributes
        )
    except Exception:  # DracoPy raises Exception itself
        return None
    return bytes(data)


def _decode_draco(data: bytes) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Places, numbers among equals, and faces.

    Raises
    ------
    ValueError
    """
    package = importlib.import_module("DracoPy")
    try:
        mesh = package.decode(data)
        attributes = {int(a["attribute_type"]): np.asarray(a["data"]) for a in mesh.attributes}
        places, faces = attributes[_POSITION], np.asarray(mesh.faces, dtype=np.int64)
    except Exception as error:  # as above
        raise ValueError(f"mesh of Draco ({error})") from None
    copies = attributes[_GENERIC][:, 0] if _GENERIC in attributes else np.zeros(len(places))
    if places.dtype != np.uint32 or places.shape != (len(copies), 3):
        raise ValueError("vertices of Draco")
    return places.astype(np.int64), copies.astype(np.int64), faces


# Types of Draco's attributes.
_POSITION, _GENERIC = 0, 4
