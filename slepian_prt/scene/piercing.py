"""Vertices behind a surface that an edge of theirs goes through.

Where a foot is sunk a little into a floor, its lowest vertices are under the floor. In a closed slab they are dark;
under a sheet they see the sky from below, and the triangles that reach up through the floor would show it above. Nobody
sees the vertices themselves: they take what their neighbours on the other side of the floor receive.

Not so where a surface goes on to the other side around what divides it, as a wall does around an awning, nor where
sheets cross, as those of a plant do, nor where light comes through what divides it: both sides of these are seen.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from slepian_prt.scene.formats.joining import join_equal
from slepian_prt.scene.pieces import connected_pieces
from slepian_prt.scene.segments import are_blocked, met_faces

if TYPE_CHECKING:
    from slepian_prt.scene.scene import Scene

# A sheet is no thicker than this part of its length.
_FLAT = 1e-3

# In heights of rays.
_TOUCHING = 2.0


def find_pierced(scene: Scene) -> NDArray[np.integer]:
    """(n, 2) vertices behind the back of a surface, and their neighbours through it that are not behind any.

    Edges are followed just above the faces that they belong to, everywhere as high, so that what is as near to a face
    all along is not gone through. Which side of a surface is its back, its vertex normals tell; shapes that only cast
    shadows have none.
    """
    lowest = scene.ray_heights[scene.mesh.faces].min(axis=1)
    corners = []
    for _, (vertices, feet, points) in scene.surroundings.beside():
        height = np.maximum(scene.ray_heights[vertices], 1e-300)
        corners.append(feet + (lowest / height)[:, None] * (points - feet))
    pairs, touching = [], []
    for k in range(3):
        ends, above = scene.mesh.faces[:, [k, (k + 1) % 3]], np.stack([corners[k], corners[(k + 1) % 3]], axis=1)
        blocked = np.flatnonzero(are_blocked(scene, above[:, 0], above[:, 1]))
        ends, above = ends[blocked], above[blocked]
        for begin, end in ((0, 1), (1, 0)):
            met = met_faces(scene, above[:, begin], above[:, end])
            known = (met >= 0) & ~scene.passes_light[np.maximum(met, 0)]
            met, pair = met[known], ends[known][:, [begin, end]]
            way = (above[:, end] - above[:, begin])[known]
            starts_behind, near = _place_behind(scene, met, pair[:, 0])
            shows_back = np.einsum("ij,ij->i", _outward(scene, met), way) > 0.0
            is_other = (scene.faces[met] != scene.fronts[pair[:, :1]]).all(axis=1)
            through = shows_back & starts_behind & is_other
            pairs.append(pair[through])
            touching.append(near[through])
    found, row = np.unique(np.concatenate(pairs), axis=0, return_inverse=True)
    if len(found) == 0:
        return found
    touches = np.bincount(row.ravel(), np.concatenate(touching)) > 0.0
    hidden = found[touches | _are_cut_off(scene, found)]
    return hidden[~np.isin(hidden[:, 1], hidden[:, 0])]


def _outward(scene: Scene, met: NDArray) -> NDArray[np.float64]:
    """(n, 3) unit normals of faces, on the side that their vertex normals tell."""
    corners = scene.faces[met]
    positions = scene.traced_positions[corners]
    normal = np.cross(positions[:, 1] - positions[:, 0], positions[:, 2] - positions[:, 0])
    toward = np.einsum("ij,ij->i", normal, scene.receivers.normals[corners].sum(axis=1))
    length = np.maximum(np.linalg.norm(normal, axis=1), 1e-300)
    return np.asarray((np.sign(toward) / length)[:, None] * normal)


def _place_behind(scene: Scene, met: NDArray, vertices: NDArray) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """(n,) whether the rays of vertices start behind the planes of faces; and whether the vertices lie in these."""
    outward, foot = _outward(scene, met), scene.traced_positions[scene.faces[met, 0]]
    start = np.einsum("ij,ij->i", outward, scene.ray_origins.front[vertices] - foot)
    distance = np.einsum("ij,ij->i", outward, scene.traced_positions[vertices] - foot)
    return start < 0.0, np.abs(distance) <= _TOUCHING * scene.ray_heights[vertices]


def _are_cut_off(scene: Scene, pairs: NDArray) -> NDArray[np.bool_]:
    """(n,) whether vertices are on the smaller piece of what falls apart where it is gone through, and not of a sheet.

    The smaller one, as floors may have their normals down: then all that stands on them is behind their backs.
    """
    positions = scene.traced_positions
    first, place = join_equal(positions)  # parts are often split at hard edges
    edges = place[scene.receivers.neighbours]
    whole = connected_pieces(edges, len(first))
    cut = np.isin(_keys(edges, len(first)), _keys(place[pairs], len(first)))
    piece = connected_pieces(edges[~cut], len(first))
    # A sheet lies in a plane: the least moment of its vertices is none, but for rounding.
    count = np.bincount(whole)[:, None]
    mean = np.stack([np.bincount(whole, values) for values in positions[first].T], axis=1) / count
    offset = positions[first] - mean[whole]
    moments = np.empty((len(count), 3, 3))
    for i in range(3):
        for j in range(3):
            moments[:, i, j] = np.bincount(whole, offset[:, i] * offset[:, j])
    least, _, largest = np.linalg.eigvalsh(moments).T
    flat = least <= _FLAT**2 * largest
    near, far = place[pairs].T
    size = np.bincount(piece)[piece]
    return np.asarray((piece[near] != piece[far]) & (size[near] <= size[far]) & ~flat[whole[near]])


def _keys(edges: NDArray, count: int) -> NDArray[np.int64]:
    """(E,) one number for each edge, whichever end comes first."""
    low, high = np.sort(edges, axis=1).T
    return np.asarray(low.astype(np.int64) * count + high)
