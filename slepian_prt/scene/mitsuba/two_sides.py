"""Which surfaces are seen from behind: where both sides reflect, light is computed on the backs of these too.

Blender and others call every material two-sided, also those of closed models, whose backs nobody sees. So the room
behind each surface is explored by rays that go on from what they meet, on the side that they meet it: the back counts
if they find a way to the sky, to a lamp or to what is not held (mirrors, glass), or if a camera or a small lamp is in
that room. Inside a closed solid they find nothing, also where others are sunk in it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slepian_prt.scene.face_table import FaceTable
from slepian_prt.scene.mesh import Mesh
from slepian_prt.scene.mitsuba.shapes import ReceivingShape
from slepian_prt.scene.normals import face_areas

# Ways from each shape and from all together, and the rays of each.
_WAYS, _MOST_WAYS = 1024, 1 << 16
_RAYS = 4

# Where no larger part of the ways leads out, as through the holes of a scan, the surface counts as closed.
_OPEN = 0.03

# A ray goes on from this part of its length before what it met.
_SHORT = 1e-4

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
        Where cameras and small lamps are.
    """
    result = np.zeros(len(shapes), dtype=bool)
    chosen = np.flatnonzero(asked).tolist()
    if not chosen:
        return result
    count = int(np.clip(_MOST_WAYS // len(chosen), 16, _WAYS))
    rng = np.random.default_rng(_SEED)
    begins = [_points_behind(shapes[number], count, rng) for number in chosen]
    points = _Points(*(np.concatenate(values) for values in zip(*begins, strict=True)))
    held = _faces_of(mi, [shape for shape in shapes if not shape.shines])
    is_open = _lead_out(mi, geometry, points, held, rng).reshape(len(chosen), -1).mean(axis=1) > _OPEN
    for eye in eyes:
        is_open |= _are_seen(mi, geometry, points, eye).reshape(len(chosen), -1).mean(axis=1) > _OPEN
    result[chosen] = is_open
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


def eyes_of(mi: Any, loaded: Any) -> NDArray[np.float64]:
    """(k, 3) where the cameras and lamps of a Mitsuba scene are, as far as they are in one place."""
    eyes = []
    lamps = [lamp for lamp in loaded.emitters() if mi.has_flag(lamp.flags(), mi.EmitterFlags.DeltaPosition)]
    for placed in (*loaded.sensors(), *lamps):
        parameters = mi.traverse(placed)
        if "to_world" in parameters:
            eyes.append(np.array(parameters["to_world"].matrix, dtype=np.float64).reshape(4, 4)[:3, 3])
        elif "position" in parameters:
            eyes.append(np.array(parameters["position"], dtype=np.float64).ravel())
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


def _faces_of(mi: Any, shapes: Sequence[ReceivingShape]) -> FaceTable:
    counts = [len(shape.triangles.faces) for shape in shapes]
    corners = [shape.mesh.positions[shape.triangles.faces] for shape in shapes]
    first = np.cumsum([0, *counts])[:-1].tolist()
    return FaceTable(mi, [shape.shape for shape in shapes], first, np.concatenate([np.zeros((0, 3, 3)), *corners]))


def _lead_out(mi: Any, geometry: Any, points: _Points, held: FaceTable, rng: np.random.Generator) -> NDArray[np.bool_]:
    """(n,) whether a way of a few rays meets anything but faces that are ``held``."""
    import drjit as dr

    out = np.zeros(len(points.places), dtype=bool)
    inside = np.arange(len(out))
    places, outward = points
    for _ in range(_RAYS):
        way = rng.standard_normal((len(inside), 3))
        way /= np.linalg.norm(way, axis=1, keepdims=True)
        way += outward  # by Lambert's law
        way /= np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-300)
        ray = mi.Ray3f(mi.Point3f(places.T.astype(np.float32)), mi.Vector3f(way.T.astype(np.float32)))
        hit = geometry.ray_intersect_preliminary(ray)
        face = held.met(hit)
        normals, distance = held.normals(face), mi.Float(hit.t)
        dr.eval(face, normals, distance)
        goes_on = np.array(face) >= 0
        out[inside[~goes_on]] = True
        inside, way = inside[goes_on], way[goes_on]
        if inside.size == 0:
            break
        length = np.array(distance, dtype=np.float64)[goes_on]
        normal = np.array(normals, dtype=np.float64).T[goes_on]
        outward = normal * np.where(np.einsum("ij,ij->i", normal, way) > 0.0, -1.0, 1.0)[:, None]
        places = places[goes_on] + (1.0 - _SHORT) * length[:, None] * way
        # Rays that graze a wall would start in it, within what rounding moves them.
        places += _UNITS * np.spacing(np.abs(places).max(axis=1).astype(np.float32))[:, None] * outward
    return out


def _are_seen(mi: Any, geometry: Any, points: _Points, eye: NDArray) -> NDArray[np.bool_]:
    """(n,) whether the points are seen from a place."""
    way = eye - points.places
    length = np.linalg.norm(way, axis=1)
    behind = np.einsum("ij,ij->i", way, points.outward) > 0.0
    way /= np.maximum(length, 1e-300)[:, None]
    ray = mi.Ray3f(mi.Point3f(points.places.T.astype(np.float32)), mi.Vector3f(way.T.astype(np.float32)))
    ray.maxt = mi.Float(length.astype(np.float32))
    return np.asarray(behind & ~np.array(geometry.ray_test(ray)))
