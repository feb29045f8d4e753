"""Compressed transfer with its vertices in another order: that of its file, or that of its source."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.compression.stored_mesh.stored import StoredMesh
from slepian_prt.scene.mesh import Mesh
from slepian_prt.scene.scene import Part


def in_file_order(packed: CompressedTransfer) -> CompressedTransfer:
    """The same transfer, its vertices as the file numbers them."""
    stored = packed.stored
    if stored is None or np.all(stored.order == np.arange(len(stored.order))):
        return packed
    return _reordered(packed, stored.order, np.arange(len(stored.order)))


def in_source_order(packed: CompressedTransfer, order: NDArray[np.int64]) -> CompressedTransfer:
    """Transfer in the order of its file, its vertices as the source numbers them.

    Parameters
    ----------
    packed : CompressedTransfer
    order : (V,)
        Which vertex of the source each one of the file is.

    Raises
    ------
    ValueError
        That is no permutation.
    """
    count = len(packed.mesh.positions)
    if order.shape != (count,) or not np.all(np.sort(order) == np.arange(count)):
        raise ValueError("order of the vertices")
    return _reordered(packed, np.argsort(order), order)


def rounding_of(packed: CompressedTransfer, part: Part) -> float:
    """How far from its place in the source a vertex of a part is at most."""
    assert packed.stored is not None
    piece, entry = packed.stored.entry["pieces"][packed.parts.index(part)], packed.stored.entry
    return 0.0 if entry["exact"] else math.sqrt(0.75) * float(entry["step"]) * 2.0 ** -piece["shift"]


def landmarks(packed: CompressedTransfer, part: Part) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Vertices of a part that are known by number: as they are numbered here, and by the shape it was made from."""
    assert packed.stored is not None
    of_file, before = packed.stored.entry["pieces"][packed.parts.index(part)]["landmarks"]
    return packed.stored.order[np.array(of_file, dtype=np.int64) + part.first], np.array(before, dtype=np.int64)


def _reordered(packed: CompressedTransfer, chosen: NDArray, order: NDArray) -> CompressedTransfer:
    """Vertex i becomes what ``chosen[i]`` was; ``order`` is that of the file then."""
    assert packed.stored is not None
    mesh, clusters, fixed = _reordered_mesh(packed.mesh, chosen, order), packed.clusters, packed.fixed
    clusters = replace(clusters, index=clusters.index[chosen])
    coefficients = tuple(
        values[np.searchsorted(before, chosen[after])]
        for values, before, after in zip(packed.coefficients, packed.clusters.members, clusters.members, strict=False)
    )
    if fixed is not None:
        fixed = replace(fixed, direct=fixed.direct[:, chosen], bounced=fixed.bounced[:, chosen])
    stored = StoredMesh(mesh, order, packed.stored.entry, packed.stored.arrays)
    return replace(packed, mesh=mesh, stored=stored, clusters=clusters, coefficients=coefficients, fixed=fixed)


def _reordered_mesh(mesh: Mesh, chosen: NDArray, order: NDArray) -> Mesh:
    number = np.empty(len(chosen), dtype=np.int32)
    number[chosen] = np.arange(len(chosen), dtype=np.int32)
    moved = replace(
        mesh,
        positions=mesh.positions[chosen],
        normals=mesh.normals[chosen],
        faces=number[mesh.faces],
        albedo=mesh.albedo[chosen],
        source=None if mesh.source is None else np.stack([mesh.source[:, 0], number[mesh.source[:, 1]]], axis=1),
    )
    vars(moved)["receivers"] = replace(moved.receivers, order=order)
    return moved
