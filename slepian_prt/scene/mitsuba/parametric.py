"""Mitsuba's shapes that have a formula instead of vertices, cut into triangles; and its cube, cut finer."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError
from slepian_prt.scene.mitsuba.triangles import Triangles
from slepian_prt.scene.normals import face_areas

# Shapes that have a formula instead of vertices are cut into faces of about this part of the scene's diagonal.
_FACE_SIZE = 1.0 / 96.0
_FEWEST_CUTS, _MOST_CUTS = 48, 128
_MANY_SHAPES = 20

# Cuts that round shapes have at least, and flat ones.
_ROUND, _FLAT = 12, 6


def fewest_cuts(shapes: int) -> int:
    """Cuts along a shape that is not a mesh, at least: fewer where a scene has very many."""
    return max(_FLAT, min(_FEWEST_CUTS, round(_FEWEST_CUTS * math.sqrt(_MANY_SHAPES / max(shapes, 1)))))


def _on_sphere(u: NDArray, v: NDArray) -> tuple[NDArray, NDArray]:
    theta, phi = np.pi * v, 2.0 * np.pi * u
    p = np.column_stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])
    return p, p


def _on_rectangle(u: NDArray, v: NDArray) -> tuple[NDArray, NDArray]:
    return np.column_stack([2.0 * u - 1.0, 2.0 * v - 1.0, 0.0 * u]), np.column_stack([0.0 * u, 0.0 * u, 1.0 + 0.0 * u])


def _on_disk(u: NDArray, v: NDArray) -> tuple[NDArray, NDArray]:
    phi = 2.0 * np.pi * v
    return np.column_stack([u * np.cos(phi), u * np.sin(phi), 0.0 * u]), np.column_stack(
        [0.0 * u, 0.0 * u, 1.0 + 0.0 * u]
    )


def _on_cylinder(u: NDArray, v: NDArray) -> tuple[NDArray, NDArray]:
    phi = 2.0 * np.pi * u
    return np.column_stack([np.cos(phi), np.sin(phi), v]), np.column_stack([np.cos(phi), np.sin(phi), 0.0 * u])


# Points and normals of Mitsuba's shapes in their own space, by the texture coordinates that Mitsuba gives them.
PARAMETRIC = {"Sphere": _on_sphere, "Rectangle": _on_rectangle, "Disk": _on_disk, "Cylinder": _on_cylinder}


def surface_of(mi: Any, shape: Any, kind: str, origin: str) -> Callable[[NDArray], tuple[NDArray, NDArray]]:
    """What gives positions and unit normals of the shape by its own parameters."""
    matrix = np.array(mi.traverse(shape)["to_world"].matrix, dtype=np.float64).reshape(4, 4)
    linear, offset = matrix[:3, :3], matrix[:3, 3]
    if not np.all(np.isfinite(matrix)) or abs(np.linalg.det(linear)) <= 1e-12 * np.abs(linear).max() ** 3:
        raise UserError(f"{origin}: its to_world flattens it to nothing; correct the transform")

    def evaluate(uv: NDArray) -> tuple[NDArray, NDArray]:
        positions, normals = PARAMETRIC[kind](uv[:, 0], uv[:, 1])
        if kind == "Sphere":  # Mitsuba's stays round under any transform, as large as that makes its x axis
            outward = positions @ linear.T
            outward /= np.linalg.norm(outward, axis=1, keepdims=True)
            return np.linalg.norm(linear[:, 0]) * outward + offset, outward
        normals = normals @ np.linalg.inv(linear)
        return positions @ linear.T + offset, normals / np.linalg.norm(normals, axis=1, keepdims=True)

    return evaluate


def parametric(mi: Any, shape: Any, kind: str, origin: str, diagonal: float, fewest: int) -> Triangles:
    """A grid over the shape's own parameters, so that textures stay where they are."""
    evaluate = surface_of(mi, shape, kind, origin)
    coarse = np.stack(np.meshgrid(np.linspace(0, 1, 9), np.linspace(0, 1, 9), indexing="ij"), axis=-1)
    grid = evaluate(coarse.reshape(-1, 2))[0].reshape(9, 9, 3)
    along = [np.linalg.norm(np.diff(grid, axis=axis), axis=2).sum(axis=axis).max() for axis in (0, 1)]
    least = fewest if kind == "Rectangle" else max(fewest, _ROUND)
    cuts = [_cuts(float(length), diagonal, least) for length in along]
    u, v = np.meshgrid(*(np.linspace(0.0, 1.0, n + 1) for n in cuts), indexing="ij")
    uv = np.column_stack([u.ravel(), v.ravel()])
    positions, normals = evaluate(uv)
    index = np.arange(uv.shape[0]).reshape(u.shape)
    a, b, c, d = (part.ravel() for part in (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]))
    faces = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    area = face_areas(positions, faces)
    faces = faces[area > 1e-4 * area.max()]  # at the poles triangles have no area but for rounding
    used, faces = np.unique(faces, return_inverse=True)  # a pole needs fewer vertices than the grid has there
    return Triangles(positions[used], normals[used], faces.reshape(-1, 3), uv[used], {}, are_own=False)


def _cuts(length: float, diagonal: float, fewest: int) -> int:
    return int(np.clip(math.ceil(min(length / max(_FACE_SIZE * diagonal, 1e-300), 1e6)), fewest, _MOST_CUTS))


def cut_cube(cube: Triangles, diagonal: float, fewest: int) -> Triangles:
    """Every triangle cut into n² by interpolation; corners that were apart (hard edges) stay apart."""
    positions, normals, faces, uv = cube[:4]
    if normals is None or uv is None:
        return cube
    corner = positions[faces]
    longest = float(np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=2).max())
    n = max(2, math.ceil(_cuts(longest, diagonal, fewest) / 2))
    i, j = np.array([(i, j) for i in range(n + 1) for j in range(n + 1 - i)]).T
    weights = np.column_stack([n - i - j, i, j]) / n
    number = np.full((n + 1, n + 1), -1)
    number[i, j] = np.arange(i.size)
    up = np.array([(number[a, b], number[a + 1, b], number[a, b + 1]) for a in range(n) for b in range(n - a)])
    down = np.array(
        [(number[a + 1, b], number[a + 1, b + 1], number[a, b + 1]) for a in range(n) for b in range(n - a - 1)]
    )
    pattern = np.concatenate([up, down.reshape(-1, 3)])
    parts = [
        np.einsum("pk,fkc->fpc", weights, values[faces].astype(np.float64)).reshape(-1, values.shape[1])
        for values in (positions, normals, uv)
    ]
    # The two triangles of a side share the points along their common edge: those that agree to rounding in everything.
    in_box = (parts[0] - positions.min(axis=0)) / max(longest, 1e-300)
    _, first, which = np.unique(
        np.round(np.concatenate([in_box, *parts[1:]], axis=1), 5), axis=0, return_index=True, return_inverse=True
    )
    cut = (np.arange(len(faces))[:, None, None] * i.size + pattern).reshape(-1, 3)
    return Triangles(parts[0][first], parts[1][first], which.ravel()[cut], parts[2][first], {}, are_own=False)
