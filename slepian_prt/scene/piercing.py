"""Vertices behind a surface that an edge of theirs goes through.

Where a foot is sunk a little into a floor, its lowest vertices are under the floor. In a closed slab they are dark;
under a sheet they see the sky from below, and the triangles that reach up through the floor would show it above. Nobody
sees the vertices themselves: they take what their neighbours on the other side of the floor receive.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from slepian_prt.scene.segments import are_blocked, met_faces

if TYPE_CHECKING:
    from slepian_prt.scene.scene import Scene


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
    pairs = []
    for k in range(3):
        ends, above = scene.mesh.faces[:, [k, (k + 1) % 3]], np.stack([corners[k], corners[(k + 1) % 3]], axis=1)
        blocked = np.flatnonzero(are_blocked(scene, above[:, 0], above[:, 1]))
        ends, above = ends[blocked], above[blocked]
        for pair, (begin, end) in ((ends, (0, 1)), (ends[:, ::-1], (1, 0))):
            way = above[:, end] - above[:, begin]
            met = met_faces(scene, above[:, begin], above[:, end])
            pairs.append(pair[_shows_its_back(scene, met, way) & ~_is_at(scene, met, pair[:, 0])])
    found = np.unique(np.concatenate(pairs), axis=0)
    return found[~np.isin(found[:, 1], found[:, 0])]


def _shows_its_back(scene: Scene, met: NDArray, way: NDArray) -> NDArray[np.bool_]:
    """(n,) whether a face is met from behind on the way (n, 3)."""
    met_corners = scene.faces[np.maximum(met, 0)]
    positions = scene.traced_positions[met_corners]
    normal = np.cross(positions[:, 1] - positions[:, 0], positions[:, 2] - positions[:, 0])
    front = np.einsum("ij,ij->i", normal, scene.receivers.normals[met_corners].sum(axis=1))
    return np.asarray((met >= 0) & (front * np.einsum("ij,ij->i", normal, way) > 0.0))


def _is_at(scene: Scene, met: NDArray, vertices: NDArray) -> NDArray[np.bool_]:
    """(n,) whether a vertex is a corner of the face."""
    return np.asarray((scene.faces[np.maximum(met, 0)] == vertices[:, None]).any(axis=1))
