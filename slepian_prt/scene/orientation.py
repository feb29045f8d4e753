"""Parts of a mesh that are inside out among others that are not."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slepian_prt.scene.formats.joining import join_equal
from slepian_prt.scene.pieces import connected_pieces

# Of the volume of its box, the least that a part encloses; less is flat but for rounding.
_FLAT = 1e-6


def parts_inside_out(positions: NDArray, normals: NDArray, faces: NDArray) -> list[NDArray[np.integer]]:
    """Closed parts whose normals point inward, as their vertices, if other closed parts are the right way round.

    A part inside another one may be the wall of a cavity, and one around others a room: by their boxes, such parts do
    not count. Nor do models that are a single part, or altogether inside out.

    Parameters
    ----------
    positions, normals : (V, 3)
    faces : (F, 3)
    """
    # Vertices at one place are one: parts are often split at hard edges or seams of a texture.
    first, place = join_equal(positions)
    welded = place[faces]
    sides = np.sort(np.concatenate([welded[:, [0, 1]], welded[:, [1, 2]], welded[:, [2, 0]]]), axis=1)
    part_of_place = connected_pieces(sides, len(first))
    _, part = np.unique(part_of_place[welded[:, 0]], return_inverse=True)
    parts = int(part.max()) + 1
    if parts < 2:
        return []
    order = np.argsort(part, kind="stable")
    begins = np.searchsorted(part[order], np.arange(parts + 1))
    closed = _are_closed(sides, part, parts, len(first))
    corner = positions[faces[order]]
    low = np.minimum.reduceat(corner.min(axis=1), begins[:-1])
    high = np.maximum.reduceat(corner.max(axis=1), begins[:-1])
    volume = _volumes(corner - low[part[order]][:, None], normals[faces[order]], begins)
    flat = _FLAT * np.prod(high - low, axis=1)
    outward, inward = closed & (volume > flat), closed & (volume < -flat)
    if not outward.any():
        return []
    around = low[outward], high[outward]
    return [
        np.unique(faces[order[begins[number] : begins[number + 1]]])
        for number in np.flatnonzero(inward)
        if not _any_holds(*around, low[number], high[number]) and not _any_holds(low[number], high[number], *around)
    ]


def _are_closed(sides: NDArray, part: NDArray, parts: int, places: int) -> NDArray[np.bool_]:
    """(parts,) False where an edge has a single face; ``sides`` are those of all faces, one column after the other."""
    _, edge, uses = np.unique(sides[:, 0] * places + sides[:, 1], return_inverse=True, return_counts=True)
    closed = np.ones(parts, dtype=bool)
    closed[np.tile(part, 3)[uses[edge] == 1]] = False
    return closed


def _volumes(corner: NDArray, normals: NDArray, begins: NDArray) -> NDArray[np.float64]:
    """Of each part, positive where its normals point outward, whatever the winding of its faces, (F, 3 corners, 3)."""
    area = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    along = np.sign(np.einsum("ij,ij->i", area, normals.sum(axis=1)))
    return np.add.reduceat(along * np.einsum("ij,ij->i", corner[:, 0], area) / 6.0, begins[:-1])


def _any_holds(low: NDArray, high: NDArray, inner_low: NDArray, inner_high: NDArray) -> bool:
    """Whether one of some boxes lies in one of others; either may be a single box."""
    return bool(np.any((low <= inner_low).all(axis=-1) & (high >= inner_high).all(axis=-1)))
