"""Where the rays of a receiver start: beside its vertex, on the side of the surface that light reaches.

A ray must not start on the surface, where rounding decides whether it is blocked, nor behind a surface that the vertex
touches: the rim of a drum lies in the floor that the drum stands on, and from below the floor it would see the sky.

What a vertex stands for are the faces around it. So rays start above those faces, as near as float32 allows, from a
point that *reaches* them: the straight way from it to a point just above each face is free. Where other geometry
divides the faces of a vertex (a contact), rays start on the side that is darker, but not inside other geometry. Light
that leaks in under what stands on a floor is seen at once; the side that is given up is one that nobody looks at.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from slepian_prt.scene.segments import are_blocked, met_faces
from slepian_prt.scene.surroundings import PointsAbove, Surroundings, join_points
from slepian_prt.sphere.quadrature import hemisphere_fibonacci
from slepian_prt.sphere.rotation import rotation_to

if TYPE_CHECKING:
    from slepian_prt.scene.scene import Scene

# Directions that decide between the sides of a contact, and rays at a time.
_DIRECTIONS = 64
# What is nearer than so many heights closes a side in if it fills more than this part of its hemisphere, as in the gap
# under a foot that stands almost on the floor, but not in the wedge under a wall that leans over it.
_NEAR, _CLOSED = 160.0, 0.9
_RAYS_PER_BLOCK = 1 << 20


@dataclass(frozen=True, eq=False)
class RayOrigins:
    """Where rays start, in the space that Mitsuba traces in.

    Attributes
    ----------
    front : (V, 3) float64
    feet : (V, 3) float64
        The points of the surface below them.
    sheets : (V,) bool
        Where the surface is a plane sheet and the normal lies in it, as on leaves whose normals point up: a normal that
        says nothing of a side. A ray starts on the side that it goes to, since a plane cannot shade itself.
    back : (V, 3) float64
        Where rays start that go behind a sheet; as ``front`` elsewhere.
    axes : (V, 3) float64
        Normals of the sheets; zero elsewhere.
    """

    front: NDArray[np.float64]
    feet: NDArray[np.float64]
    sheets: NDArray[np.bool_]
    back: NDArray[np.float64]
    axes: NDArray[np.float64]

    @classmethod
    def above(cls, points: NDArray) -> RayOrigins:
        """Points (n, 3) that are above the surface already."""
        return cls(points, points, np.zeros(len(points), dtype=bool), points, np.zeros_like(points))


def find_ray_origins(scene: Scene) -> RayOrigins:
    """Choose the origins for all receivers of a scene; traces about six short rays a vertex."""
    surroundings = scene.surroundings
    above, feet = surroundings.above()
    reached, in_the_way = _reach(surroundings, above)
    contact = np.zeros(len(above), dtype=bool)
    contact[in_the_way] = True
    contact &= ~surroundings.sheets
    lost = (reached < 0.5 * surroundings.angle) & ~contact & ~surroundings.sheets
    if lost.any():
        # Faces that hide each other: from above the widest of them.
        beside = surroundings.beside_widest(np.flatnonzero(lost))
        feet[lost], above[lost] = beside.feet, beside.points
    if contact.any():
        chosen = _choose_sides(surroundings, np.flatnonzero(contact))
        feet[chosen.vertices], above[chosen.vertices] = chosen.feet, chosen.points
    sheets = surroundings.sheets
    back, axes = above, np.zeros_like(above)
    if sheets.any():
        back = above.copy()
        back[sheets] = 2.0 * feet[sheets] - above[sheets]
        axes[sheets] = surroundings.up[sheets]
    return RayOrigins(above, feet, sheets, back, axes)


def _reach(surroundings: Surroundings, origins: NDArray) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """How much of the angle about each vertex its origin reaches, and vertices with other geometry in the way."""
    reached = np.zeros(len(origins))
    contacts = []
    for angle, (vertex, _, points) in surroundings.beside():
        free = ~are_blocked(surroundings.scene, origins[vertex], points)
        reached += np.bincount(vertex[free], angle[free], minlength=len(origins))
        closed = np.flatnonzero(~free)
        foreign = ~_is_own(surroundings.scene, vertex[closed], origins[vertex[closed]], points[closed])
        contacts.append(vertex[closed[foreign]])
    return reached, np.unique(np.concatenate(contacts))


def _is_own(scene: Scene, vertices: NDArray, begin: NDArray, end: NDArray) -> NDArray[np.bool_]:
    """(n,) whether what lies between points is a face at the vertex itself."""
    if len(vertices) == 0:
        return np.zeros(0, dtype=bool)
    hit = met_faces(scene, begin, end)
    return np.asarray((hit >= 0) & (scene.faces[np.maximum(hit, 0)] == scene.fronts[vertices][:, None]).any(axis=1))


def _choose_sides(surroundings: Surroundings, vertices: NDArray) -> PointsAbove:
    """Origins of vertices whose faces other geometry divides: in the middle of the darkest open side."""
    wanted = np.zeros(len(surroundings.positions), dtype=bool)
    wanted[vertices] = True
    angles, parts = zip(*surroundings.beside(wanted), strict=True)
    angle, (vertex, feet, points) = np.concatenate(angles), join_points(parts)
    scene, upward = surroundings.scene, points - feet
    sky, _ = _look_around(scene, points, surroundings.normals[vertex], np.zeros(len(points)))
    _, closed = _look_around(scene, points, upward, _NEAR * np.linalg.norm(upward, axis=1))
    # Sides that are closed in come last, then by darkness; of equal ones the widest.
    order = np.lexsort([-angle, np.round(sky * _DIRECTIONS / 2.0), closed > _CLOSED, vertex])
    first = order[np.append(True, np.diff(vertex[order]) > 0)]
    best = np.empty(len(wanted), dtype=np.int64)
    best[vertex[first]] = first
    # The middle of all faces on that side, if it reaches the chosen one.
    with_best = ~are_blocked(scene, points[best[vertex]], points)
    with_best[first] = True
    weight = np.where(with_best, angle, 0.0)
    total = np.maximum(np.bincount(vertex, weight, minlength=len(wanted))[vertices], 1e-300)
    middle = [
        np.stack(
            [np.bincount(vertex, weight * values[:, axis], minlength=len(wanted))[vertices] for axis in range(3)], 1
        )
        / total[:, None]
        for values in (feet, points)
    ]
    reaches = ~are_blocked(scene, middle[1], points[best[vertices]])
    chosen_feet, chosen_points = (
        np.where(reaches[:, None], mean, values[best[vertices]])
        for mean, values in zip(middle, (feet, points), strict=True)
    )
    return PointsAbove(vertices, chosen_feet, chosen_points)


def _look_around(scene: Scene, origins: NDArray, axes: NDArray, near: NDArray) -> tuple[NDArray, NDArray]:
    """(n,) parts of the hemispheres about axes that show the sky; and that show backs of surfaces, or what is near."""
    mi = scene.mi
    local = hemisphere_fibonacci(_DIRECTIONS)
    sky, closed = np.zeros(len(axes)), np.zeros(len(axes))
    size = _RAYS_PER_BLOCK // _DIRECTIONS
    for begin in range(0, len(axes), size):
        block = slice(begin, begin + size)
        world = np.einsum("nij,kj->nki", rotation_to(axes[block]), local).reshape(-1, 3)
        origin, nearest = (np.repeat(values[block], _DIRECTIONS, axis=0) for values in (origins, near))
        ray = mi.Ray3f(mi.Point3f(origin.T.astype(np.float32)), mi.Vector3f(world.T.astype(np.float32)))
        hit = scene.geometry.ray_intersect_preliminary(ray)
        valid = hit.is_valid()
        shut = scene.meets_dark_back(ray, hit) | (valid & (hit.t < mi.Float(nearest.astype(np.float32))))
        sky[block] = 1.0 - np.array(valid).reshape(-1, _DIRECTIONS).mean(axis=1)
        closed[block] = np.array(shut).reshape(-1, _DIRECTIONS).mean(axis=1)
    return sky, closed
