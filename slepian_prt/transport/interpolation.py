"""How far light between vertices is from what is interpolated from them, measured at some points of the surface."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slepian_prt.scene.normals import face_areas, face_normals
from slepian_prt.scene.scene import Scene
from slepian_prt.slepian.kernels import cosine_lobe, zonal_vectors
from slepian_prt.transport.directions import direction_set
from slepian_prt.transport.hemisphere import SurfacePoints
from slepian_prt.transport.occlusion import OcclusionTables
from slepian_prt.transport.visibility import VisibilityTracer

_POINTS = 256
_NODES = 128  # whose noise adds 0.2 % to what is remarked on from 5 % on
# Nearly all of the energy of irradiance is in these degrees (Ramamoorthi & Hanrahan 2001).
_BANDLIMIT = 2


def interpolation_error(scene: Scene, seed: int) -> float:
    """Relative RMS over the surface, of the transfer of degrees up to 2.

    Points are drawn evenly over the area; those next to a vertex that sees nothing at all are left out, since such
    vertices may be filled from their neighbours.
    """
    faces, positions, normals = scene.mesh.faces, scene.traced_positions, scene.receivers.normals
    rng = np.random.default_rng(seed)
    area = face_areas(positions, faces)
    chosen = rng.choice(len(faces), _POINTS, p=area / area.sum())
    weights = rng.dirichlet(np.ones(3), _POINTS)
    vertices, place = np.unique(faces[chosen], return_inverse=True)
    place = place.reshape(-1, 3)
    points = _points_between(scene, chosen, weights)
    at_vertices, _ = _transfer(scene, None, vertices, normals[vertices], seed)
    at_points, closed = _transfer(scene, points, np.arange(_POINTS), points.normals, seed + 1)
    interpolated = np.einsum("pk,pkm->pm", weights, at_vertices[place])
    dark: NDArray = ~np.any(at_vertices, axis=1)
    counted = ~(dark[place].any(axis=1) | closed)
    size = float(np.linalg.norm(at_points[counted]))
    return float(np.linalg.norm((interpolated - at_points)[counted])) / size if size > 0.0 else 0.0


def _points_between(scene: Scene, faces: NDArray, weights: NDArray) -> SurfacePoints:
    """Points on faces, with the normals that shading interpolates there."""
    corners = scene.mesh.faces[faces]
    normals = np.einsum("pk,pkc->pc", weights, scene.receivers.normals[corners])
    upward = face_normals(scene.traced_positions, corners)
    upward *= np.where(np.einsum("ij,ij->i", upward, normals) < 0.0, -1.0, 1.0)[:, None]
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.where(length > 1e-9, normals / np.maximum(length, 1e-300), upward)
    heights = scene.ray_heights[corners].max(axis=1)
    places = np.einsum("pk,pkc->pc", weights, scene.traced_positions[corners])
    return SurfacePoints(normals, places + heights[:, None] * upward)


def _transfer(
    scene: Scene, points: SurfacePoints | None, rows: NDArray, normals: NDArray, seed: int
) -> tuple[NDArray[np.float64], NDArray]:
    """(n, 9) transfer vectors at vertices or points, and where nothing but surfaces is seen."""
    directions = direction_set(_NODES)
    samples = VisibilityTracer(scene, directions, seed, points).trace(rows)
    blocked = OcclusionTables(directions, _BANDLIMIT).blocked(samples)
    closed: NDArray = np.asarray(np.all(samples.blocked, axis=0))
    vectors = zonal_vectors(cosine_lobe(_BANDLIMIT), normals).astype(np.float64) - blocked
    vectors[closed] = 0.0
    return vectors, closed
