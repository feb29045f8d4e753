"""Meshes as ``.prt`` files have them: quantised, in an order of their own, and no larger than they need be."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.stored_mesh.pieces import Piece, cut, read_pieces, write_pieces
from slepian_prt.compression.stored_mesh.planes import from_ordered, from_planes, to_ordered, to_planes
from slepian_prt.compression.stored_mesh.reflectance import pack_albedo, unpack_albedo
from slepian_prt.compression.stored_mesh.surface_normals import Surface, pack_normals, unpack_normals
from slepian_prt.machine.kept import Kept
from slepian_prt.scene.mesh import LARGEST_COORDINATE, Mesh
from slepian_prt.scene.receivers import Receivers
from slepian_prt.scene.scene import Part

# Unit vectors, but for rounding to float32; and albedo that times radiance is still finite.
_LONGEST_NORMAL = 1.0 + 1e-5
_LARGEST_ALBEDO = 2.0**32


@dataclass(frozen=True, eq=False)
class StoredMesh:
    """A mesh, and what a file has of it.

    Attributes
    ----------
    mesh : Mesh
        In the order of its source; positions, normals and albedo are those that readers of the file get.
    order : (V,) int64
        Which vertex of ``mesh`` each vertex of the file is.
    entry : dict
        Of the manifest.
    arrays : dict of str to array
    """

    mesh: Mesh
    order: NDArray[np.int64]
    entry: dict[str, Any]
    arrays: dict[str, NDArray]


def store_mesh(mesh: Mesh, parts: Sequence[Part], *, exact: bool = False) -> StoredMesh:
    """What a file has of a mesh, and what is read from it again: the same vertices and faces in another order.

    Positions move by at most 1/131,070 of the largest side of the mesh along each axis, normals turn by at most a
    quarter of a degree, albedo changes by at most 2⁻¹¹, relatively, or 2⁻²⁵. Made once for each mesh.

    Parameters
    ----------
    mesh : Mesh
    parts : sequence of Part
        Whose vertices, one after the other, are all of the mesh; parts stay where they are.
    exact : bool
        Whether positions and albedo are kept to the bit, and normals in float32.

    Raises
    ------
    UserError
        The parts do not fit the mesh.
    """
    known = _stored.of(mesh.receivers, dict)
    wanted = (tuple(parts), exact)
    if wanted not in known:
        known[wanted] = _store(mesh, parts, exact)
    return known[wanted]


def read_mesh(entry: dict[str, Any], arrays: dict[str, NDArray], name: str, notes: tuple[str, ...]) -> Mesh:
    """The mesh of a file, in the file's order.

    Raises
    ------
    ValueError
        What does not fit together, or is not finite.
    """
    pieces = read_pieces(entry, arrays)
    positions, exact = _positions(pieces), entry["exact"]
    if exact:
        positions = _with_all_bits(positions, entry, arrays)
    _check_range("positions", positions, -LARGEST_COORDINATE, LARGEST_COORDINATE)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # of vertices without faces, far away
        surface = _surface(pieces, positions, exact)
        normals = unpack_normals(arrays, surface, exact)
    _check_range("normals", normals, -_LONGEST_NORMAL, _LONGEST_NORMAL)
    albedo = unpack_albedo(entry["albedo"], arrays, _blocks(pieces), len(positions))
    _check_range("albedo", albedo, 0.0, _LARGEST_ALBEDO)
    return Mesh(name, positions, normals, surface.faces.astype(np.int32), albedo, notes)


def _check_range(name: str, values: NDArray, low: float, high: float) -> None:
    if values.size and not low <= float(values.min()) <= float(values.max()) <= high:  # nor NaN
        raise ValueError(f"{name} outside of [{low:g}, {high:g}]")


def read_stored(entry: dict[str, Any], arrays: dict[str, NDArray], name: str, notes: tuple[str, ...]) -> StoredMesh:
    """As `read_mesh`, with what is needed to write the same file again."""
    mesh = read_mesh(entry, arrays, name, notes)
    own = {key: values for key, values in arrays.items() if key.startswith("mesh/") and key not in _OF_SOURCE}
    if "mesh/source" in arrays:
        mesh = replace(mesh, source=_unpack_source(arrays["mesh/source"], len(mesh.positions)))
    return StoredMesh(mesh, np.arange(len(mesh.positions)), entry, own)


def pack_order(order: NDArray[np.int64], mesh: Mesh) -> dict[str, NDArray[np.uint8]]:
    """What a file has of its source's numbers.

    Parameters
    ----------
    order : (V,)
        Which vertex of the mesh, as it was made from the source, each vertex of the file is.
    mesh : Mesh
        As the file numbers its vertices.
    """
    arrays = {"mesh/order": to_planes(np.diff(order, prepend=0)[:, None])}
    if mesh.source is not None:
        pairs = mesh.source[np.lexsort(mesh.source.T)]
        arrays["mesh/source"] = to_planes(np.diff(pairs, axis=0, prepend=0))
    return arrays


def unpack_order(planes: NDArray[np.uint8]) -> NDArray[np.int64]:
    """(V,) the order that `pack_order` packed; not checked."""
    return np.cumsum(from_planes(planes, 1)[:, 0])


def _unpack_source(planes: NDArray[np.uint8], count: int) -> NDArray[np.int64]:
    pairs = np.cumsum(from_planes(planes, 2), axis=0)
    numbers = np.unique(pairs[:, 1])
    if len(numbers) != count or numbers[0] != 0 or numbers[-1] != count - 1 or pairs[:, 0].min() < 0:
        raise ValueError("vertices of the source")
    return pairs


def _store(mesh: Mesh, parts: Sequence[Part], exact: bool) -> StoredMesh:
    pieces = cut(mesh, parts)
    # Vertices without faces may be too far away to be counted from the others.
    exact = exact or not all(piece.lattice.holds(mesh.positions[piece.blocks[0]]) for piece in pieces)
    entry, arrays, order = write_pieces(pieces)
    pieces = read_pieces(entry, arrays)
    positions = _positions(pieces)
    entry["exact"] = exact
    if exact:
        kind, arrays["mesh/positions"] = _missing_bits(positions, mesh.positions[order])
        entry["positions"] = kind
        positions = mesh.positions[order]
    entry["albedo"], colors = pack_albedo(mesh.albedo[order], _blocks(pieces), exact)
    surface = _surface(pieces, positions, exact)
    arrays |= colors | pack_normals(mesh.normals[order], surface, exact)
    # As readers get it, but for the order.
    normals = unpack_normals(arrays, surface, exact)
    albedo = unpack_albedo(entry["albedo"], arrays, _blocks(pieces), len(order))
    back = np.argsort(order)
    seen = replace(mesh, positions=positions[back], normals=normals[back], albedo=albedo[back])
    vars(seen)["receivers"] = replace(seen.receivers, order=order)
    return StoredMesh(seen, order, entry, arrays)


def _blocks(pieces: Sequence[Piece]) -> list[slice]:
    return [rows for piece in pieces for rows in piece.blocks]


def _positions(pieces: Sequence[Piece]) -> NDArray[np.float64]:
    return np.concatenate([piece.lattice.positions(piece.places) for piece in pieces for _ in piece.blocks])


def _surface(pieces: Sequence[Piece], positions: NDArray[np.float64], exact: bool) -> Surface:
    """In steps of the lattices, in which differences are exact."""
    rows = _blocks(pieces)
    lattices = [piece.lattice for piece in pieces for _ in piece.blocks]
    if exact:
        places = [lattice.coordinates(positions[own]) for own, lattice in zip(rows, lattices, strict=True)]
    else:
        places = [piece.places.astype(np.float64) for piece in pieces for _ in piece.blocks]
    faces = np.concatenate([piece.all_faces for piece in pieces])
    blocks = np.repeat(np.arange(len(rows)), [own.stop - own.start for own in rows])
    return Surface(np.concatenate(places), faces, blocks)


def _missing_bits(rounded: NDArray[np.float64], positions: NDArray[np.float64]) -> tuple[str, NDArray[np.uint8]]:
    """The type of floats that holds positions, and how many of its numbers they are away from those of the lattice."""
    with np.errstate(over="ignore"):
        dtype: np.dtype[Any] = np.dtype("f4" if np.all(positions.astype(np.float32) == positions) else "f8")
        away = to_ordered(positions.astype(dtype)) - to_ordered(rounded.astype(dtype))
    return dtype.name, to_planes(away)


def _with_all_bits(
    rounded: NDArray[np.float64], entry: dict[str, Any], arrays: dict[str, NDArray]
) -> NDArray[np.float64]:
    dtype: np.dtype[Any] = np.dtype({"float32": "f4", "float64": "f8"}[entry["positions"]])
    away = from_planes(arrays["mesh/positions"], 3)
    with np.errstate(over="ignore"):
        near: NDArray[np.floating] = rounded.astype(dtype)
    return from_ordered(to_ordered(near) + away, dtype).astype(np.float64)


# Arrays that are written on request.
_OF_SOURCE = ("mesh/order", "mesh/source")

_stored: Kept[Receivers, dict[tuple[tuple[Part, ...], bool], StoredMesh]] = Kept()
