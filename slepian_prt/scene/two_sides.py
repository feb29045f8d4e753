"""Which surfaces are seen from behind: where both sides reflect, light is computed on the backs of these too.

Blender and others call every material two-sided, also those of closed models, whose backs nobody sees. So rays look
around behind each surface: the back counts if they meet the sky, a surface's front or another shape there, or if one of
the scene's cameras sees it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slepian_prt.scene.mesh import Mesh
from slepian_prt.scene.normals import face_areas
from slepian_prt.scene.shapes import ReceivingShape
from slepian_prt.sphere.quadrature import hemisphere_fibonacci
from slepian_prt.sphere.rotation import rotation_to

# Points on each shape, of all shapes together, and directions around each.
_POINTS, _MOST_POINTS = 256, 1 << 16
_DIRECTIONS = 16

# Where a part of the rays no larger than this leaves, as through the holes of a scan or where a leg is sunk in a floor,
# the surface counts as closed.
_OPEN = 0.02

# Rays start this part of the shortest side of a face behind it, but no less than so many units in the last place.
_PART_OF_EDGE, _UNITS = 1e-4, 32.0

_SEED = 5


def open_behind(
    mi: Any, geometry: Any, shapes: Sequence[ReceivingShape], asked: NDArray[np.bool_], eyes: NDArray
) -> NDArray[np.bool_]:
    """Which shapes have a back that can be seen.

    Parameters
    ----------
    mi : Mitsuba
    geometry : Mitsuba scene
        All that is traced.
    shapes : sequence of n ReceivingShape
    asked : (n,)
        Of which this is to be found out; False is told of the others.
    eyes : (k, 3)
        Where the cameras are.
    """
    result = np.zeros(len(shapes), dtype=bool)
    chosen = np.flatnonzero(asked).tolist()
    if not chosen:
        return result
    count = int(np.clip(_MOST_POINTS // len(chosen), 1, _POINTS))
    rng = np.random.default_rng(_SEED)
    spots = [_points_behind(shapes[number], count, rng) for number in chosen]
    points = _Points(*(np.concatenate(values) for values in zip(*spots, strict=True)))
    own = np.repeat([_number_of(mi, shapes[number].shape) for number in chosen], count).astype(np.uint32)
    leaves = _leaving(mi, geometry, points, own).reshape(len(chosen), -1).mean(axis=1)
    seen = np.zeros(len(chosen))
    for eye in eyes:
        seen = np.maximum(seen, _are_seen(mi, geometry, points, eye).reshape(len(chosen), -1).mean(axis=1))
    result[chosen] = np.maximum(leaves, seen) > _OPEN
    return result


def with_back(mesh: Mesh, albedo: NDArray[np.float32]) -> Mesh:
    """A mesh with its back: the same vertices and faces again, turned round, of the albedo given."""
    count = len(mesh.positions)
    return replace(
        mesh,
        positions=np.concatenate([mesh.positions, mesh.positions]),
        normals=np.concatenate([mesh.normals, -mesh.normals]),
        faces=np.concatenate([mesh.faces, mesh.faces[:, ::-1] + np.int32(count)]),
        albedo=np.concatenate([mesh.albedo, albedo]),
    )


def eyes_of(mi: Any, sensors: Sequence[Any]) -> NDArray[np.float64]:
    """(k, 3) where the cameras of a scene are, as far as they are anywhere."""
    eyes = []
    for sensor in sensors:
        parameters = mi.traverse(sensor)
        if "to_world" in parameters:
            eyes.append(np.array(parameters["to_world"].matrix, dtype=np.float64).reshape(4, 4)[:3, 3])
    return np.array(eyes).reshape(-1, 3)


class _Points(NamedTuple):
    """Points (n, 3) just behind a surface, and unit vectors away from it."""

    places: NDArray[np.float64]
    outward: NDArray[np.float64]


def _points_behind(shape: ReceivingShape, count: int, rng: np.random.Generator) -> _Points:
    positions, faces = shape.mesh.positions, shape.mesh.faces
    area = face_areas(positions, faces)
    corner = positions[faces[rng.choice(len(faces), count, p=area / area.sum())]]
    edges = np.roll(corner, -1, axis=1) - corner
    normal = np.cross(edges[:, 0], edges[:, 1])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    rounding = np.spacing(np.abs(corner).max(axis=(1, 2)).astype(np.float32))
    away = np.maximum(_PART_OF_EDGE * np.linalg.norm(edges, axis=2).min(axis=1), _UNITS * rounding)
    places = np.einsum("pk,pkc->pc", rng.dirichlet(np.ones(3), count), corner)
    return _Points(places - away[:, None] * normal, -normal)


def _number_of(mi: Any, shape: Any) -> int:
    """The number that Dr.Jit knows a shape by."""
    import drjit as dr

    return int(np.array(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(shape)))[0])


def _leaving(mi: Any, geometry: Any, points: _Points, own: NDArray) -> NDArray[np.bool_]:
    """(n, directions) whether rays meet anything but the back of the shape that they come from."""
    import drjit as dr

    local = hemisphere_fibonacci(_DIRECTIONS)
    world = np.einsum("nij,kj->nki", rotation_to(points.outward), local).reshape(-1, 3)
    origin = np.repeat(points.places, _DIRECTIONS, axis=0)
    ray = mi.Ray3f(mi.Point3f(origin.T.astype(np.float32)), mi.Vector3f(world.T.astype(np.float32)))
    hit = geometry.ray_intersect(ray, mi.RayFlags.Minimal, True)
    same = dr.reinterpret_array(mi.UInt32, hit.shape) == mi.UInt32(np.repeat(own, _DIRECTIONS))
    inside = hit.is_valid() & (dr.dot(hit.n, ray.d) > 0.0) & same
    return ~np.array(inside).reshape(-1, _DIRECTIONS)


def _are_seen(mi: Any, geometry: Any, points: _Points, eye: NDArray) -> NDArray[np.bool_]:
    """(n,) whether the points are seen from a place."""
    way = eye - points.places
    length = np.linalg.norm(way, axis=1)
    behind = np.einsum("ij,ij->i", way, points.outward) > 0.0
    way /= np.maximum(length, 1e-300)[:, None]
    ray = mi.Ray3f(mi.Point3f(points.places.T.astype(np.float32)), mi.Vector3f(way.T.astype(np.float32)))
    ray.maxt = mi.Float(length.astype(np.float32))
    return np.asarray(behind & ~np.array(geometry.ray_test(ray)))
