"""How far from the surfaces of a scene those of a file are that are found by place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError
from slepian_prt.scene.scene import Part

# Points at which a part is searched, and the fraction that must be found.
_PROBES = 512
_FOUND = 0.97

# How far the surface of a scene may be from that of the file where faces stand for a round shape, in mean lengths of
# an edge; and how much farther than at the probes it may be elsewhere.
_FARTHEST = 0.3
_MARGIN = 1.5

# Surfaces of other shapes that are looked behind for that of a part.
_LAYERS = 4

# What rounding moves a point by, in units of the last place of the largest coordinate.
_ROUNDING = 64.0


@dataclass(frozen=True, eq=False)
class PlacedPart:
    """A part that is found by where it is.

    Attributes
    ----------
    part : Part
    shape : Mitsuba shape or None
        That it was computed on, if that is known.
    flat : bool
        Whether its faces lie in those of the shape.
    moved : float
        How far the file has moved its vertices at most, in the scene.
    reach : float
        How far from the surface of the scene the part is at most.
    """

    part: Part
    shape: Any
    flat: bool
    moved: float = 0.0
    reach: float = 0.0


def find_reaches(
    mi: Any, scene: Any, placed: Sequence[PlacedPart], positions: NDArray[np.float64], faces: NDArray, file: str
) -> tuple[PlacedPart, ...]:
    """The same parts with their reaches, as measured in a scene from the middles of some of their faces.

    Parameters
    ----------
    mi : Mitsuba, in the variant of the scene
    scene : Mitsuba scene
    placed : sequence of PlacedPart
    positions : (V, 3)
        Vertices of the file in the scene.
    faces : (F, 3)
        Of the file.
    file : str
        Its name, for messages.

    Raises
    ------
    UserError
        A part that is not in the scene.
    """
    if not placed:
        return ()
    of_floats = _ROUNDING * float(np.spacing(np.float32(np.abs(positions).max(initial=0.0))))
    rounding = [of_floats + one.moved for one in placed]
    probes = [_probes(positions, part_faces(faces, one.part)) for one in placed]
    edges = [edge for _, _, edge in probes]
    farthest = [
        max(0.0 if one.flat else _FARTHEST * edge, least)
        for one, edge, least in zip(placed, edges, rounding, strict=True)
    ]
    counts = [len(middles) for middles, _, _ in probes]
    own_shape = np.repeat([_number(mi, one.shape) for one in placed], counts)
    middles, normals = (np.concatenate([arrays[i] for arrays in probes]) for i in (0, 1))
    any_surface, own_surface = _distances(
        mi, scene, middles, normals, np.repeat(farthest, counts), own_shape, np.repeat(rounding, counts)
    )  # fmt: skip
    reached = []
    ends = np.cumsum(counts)[:-1]
    found = zip(placed, rounding, np.split(any_surface, ends), np.split(own_surface, ends), strict=True)
    for one, least, some, own in found:
        # Where two shapes touch, either may be met.
        if some.size and np.mean(np.isfinite(some)) < _FOUND:
            raise UserError(_not_there(scene, one, file))
        reached.append(replace(one, reach=least + _MARGIN * float(own[np.isfinite(own)].max(initial=0.0))))
    return tuple(reached)


def part_faces(faces: NDArray, part: Part) -> NDArray:
    """(F', 3) of the faces of a file those of the front of a part."""
    return faces[(faces[:, 0] >= part.first) & (faces[:, 0] < part.first + part.count)]


def _probes(positions: NDArray[np.float64], faces: NDArray) -> tuple[NDArray, NDArray, float]:
    """Middles (n, 3) of some faces, their normals (n, 3), and the mean length of an edge."""
    corners = positions[np.random.default_rng(0).permutation(faces)[:_PROBES]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    return corners.mean(axis=1), normals, float(edges.mean()) if edges.size else 0.0


def _distances(
    mi: Any, scene: Any, middles: NDArray, normals: NDArray, farthest: NDArray, own: NDArray, rounding: NDArray
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """How far the scene's surface is from points along normals to either side, infinite beyond ``farthest``.

    Returns
    -------
    (n,), (n,)
        To any shape, and to that whose number in Mitsuba's registry is ``own`` (n,), which is any where it is 0.
    """
    import drjit as dr

    to_any, to_own = np.full(len(middles), np.inf), np.full(len(middles), np.inf)
    for side in (1.0, -1.0):
        along, begin = mi.Vector3f((side * normals).T.astype(np.float32)), -rounding
        for _ in range(_LAYERS):
            start = middles + side * begin[:, None] * normals
            ray = mi.Ray3f(mi.Point3f(start.T.astype(np.float32)), along)
            ray.maxt = mi.Float(np.maximum(farthest + rounding - begin, 0.0).astype(np.float32))
            hit = scene.ray_intersect_preliminary(ray, coherent=False)
            met = np.array(hit.is_valid())
            distance = np.where(met, np.abs(begin + np.array(hit.t, dtype=np.float64)), np.inf)
            is_own = (own == 0) | (np.array(dr.reinterpret_array(mi.UInt32, hit.shape)) == own)
            to_any, to_own = np.minimum(to_any, distance), np.minimum(to_own, np.where(is_own, distance, np.inf))
            if np.all(is_own | ~met):
                break
            begin = np.where(met & ~is_own, begin + np.array(hit.t, dtype=np.float64) + rounding, np.inf)
            begin = np.minimum(begin, farthest + rounding)
    return to_any, to_own


def _number(mi: Any, shape: Any) -> int:
    """Of a shape in Mitsuba's registry; 0 for none."""
    import drjit as dr

    return 0 if shape is None else int(mi.UInt32(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(shape)))[0])


def remeshed(shape: Any, part: Part, file: str) -> str:
    """What to say of a mesh of the scene that has other vertices than its part."""
    return (
        f"{file}: shape '{part.name}' has {part.count} vertices there and {shape.vertex_count()} in the scene; it was "
        "remeshed since, so precompute it again"
    )


def _not_there(scene: Any, placed: PlacedPart, file: str) -> str:
    part = placed.part
    if placed.shape is not None and placed.flat:
        return remeshed(placed.shape, part, file)
    shapes = ", ".join(f"'{shape.id()}'" for shape in scene.shapes()) or "none"
    return (
        f"{file}: its shape '{part.name}' ({part.count} vertices) is not in the scene, which has the shapes {shapes}; "
        "give the shape that id; it may be moved, turned and evenly scaled, but not changed"
    )
