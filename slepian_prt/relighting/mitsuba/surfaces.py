"""Where the surfaces of a transfer file are in a Mitsuba scene, and what its vertices weigh where a ray meets them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.errors import UserError
from slepian_prt.scene.scene import Part

# Vertices of a shape may be this far, in diagonals of it, from where transfer was computed.
_MOVED = 1e-4

# Points that a shape without the file's own vertices is looked for at, and the part that must be found.
_PROBES = 512
_FOUND = 0.97

# How far from the surface of a scene that of the file may be, in mean lengths of an edge.
_APART = 0.3

# Shapes whose vertices, if they have any, are not those that transfer is computed at.
_REPLACED = {"Sphere", "Rectangle", "Disk", "Cylinder", "Cube"}


@dataclass(frozen=True)
class Placement:
    """Where the file's world is in that of a scene: ``scale`` R x + ``offset``.

    Distant light is the same everywhere, so what was precomputed holds for a moved, turned and scaled model too.
    """

    rotation: NDArray[np.float64]
    scale: float
    offset: NDArray[np.float64]

    def __call__(self, positions: NDArray) -> NDArray[np.float64]:
        return self.scale * positions @ self.rotation.T + self.offset


@dataclass(frozen=True)
class SurfaceHit:
    """What rays met of the surfaces of a file, on Mitsuba's arrays.

    Attributes
    ----------
    held : Bool
        Whether it is the front of such a surface.
    vertices : three UInt32, weights : three Float
    """

    held: Any
    vertices: tuple[Any, Any, Any]
    weights: tuple[Any, Any, Any]


class Surfaces:
    """The surfaces of a file in one Mitsuba scene.

    Shapes are found by id; a mesh must have the file's vertices. Shapes that the file has finer vertices of (spheres,
    rectangles, …) and meshes that Mitsuba has merged are found by where they are.

    Parameters
    ----------
    mi : Mitsuba, in the variant of the scene
    scene : Mitsuba scene
    packed : CompressedTransfer
    file : str
        Its name, for messages.

    Raises
    ------
    UserError
        A shape of the file that is not in the scene, or has other vertices.
    """

    def __init__(self, mi: Any, scene: Any, packed: CompressedTransfer, file: str) -> None:
        self._mi = mi
        shapes = list(scene.shapes())
        self.meshes: list[tuple[Any, Part]] = []
        elsewhere: list[Part] = []
        for part in packed.parts:
            shape = _shape_of(mi, shapes, part, packed, file)
            if shape is None:
                elsewhere.append(part)
            else:
                self.meshes.append((shape, part))
        self._seen = self._vertices()
        self.placement = _placement(mi, self.meshes, packed, file)
        dr = _drjit()
        # Identity in the registry of shapes: 0 is no shape.
        numbers = [int(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(shape))[0]) for shape, _ in self.meshes]
        table = np.full(max(numbers, default=0) + 1, -1, dtype=np.int32)
        faces = []
        first = 0
        for number, (shape, part) in zip(numbers, self.meshes, strict=True):
            own = self.faces_of(shape) + part.first
            table[number] = first
            first += len(own)
            faces.append(own)
        self._first_face = mi.Int32(table)
        self._stand_in: Any = None
        if elsewhere:
            own = _faces_of(elsewhere, packed).astype(np.int64)
            self._first_own = first
            faces.append(own)
            positions = self.placement(packed.mesh.positions)
            edges = positions[own] - positions[np.roll(own, 1, axis=1)]
            self._apart = _APART * float(np.linalg.norm(edges, axis=2).mean())
            self._stand_in = _stand_in(mi, positions, own)
            self._check_places(scene, elsewhere, packed, file)
        corners = np.concatenate(faces).astype(np.uint32)
        self._corners = tuple(mi.UInt32(np.ascontiguousarray(corners[:, i])) for i in range(3))

    def faces_of(self, shape: Any) -> NDArray[np.int64]:
        """(F, 3) of a mesh, as Mitsuba numbers them."""
        faces = shape.face_indices(_drjit().arange(self._mi.UInt32, shape.face_count()))
        return np.array(faces, dtype=np.int64).T

    def changed(self) -> bool:
        """Whether vertices were moved since."""
        return any(a.index != b.index for a, b in zip(self._seen, self._vertices(), strict=True))

    def _vertices(self) -> list[Any]:
        """Copies of the handles: held, so that no other array gets the same index."""
        return [self._mi.Float(self._mi.traverse(shape)["vertex_positions"]) for shape, _ in self.meshes]

    def meet(self, ray: Any, hit: Any, si: Any, active: Any) -> SurfaceHit:
        """What rays meet of the surfaces.

        Parameters
        ----------
        ray : Ray3f
        hit : PreliminaryIntersection3f of them with the scene
        si : SurfaceInteraction3f, minimal, of the same
        active : Bool
        """
        dr, mi = _drjit(), self._mi
        active = active & hit.is_valid()
        number = dr.reinterpret_array(mi.UInt32, hit.shape)
        first = dr.gather(mi.Int32, self._first_face, number, active & (number < dr.width(self._first_face)))
        first = dr.select(active & (number < dr.width(self._first_face)), first, -1)
        facing = dr.dot(si.n, ray.d)
        held = active & (first >= 0) & (facing < 0.0)
        face = mi.UInt32(first) + hit.prim_index
        u, v = mi.Float(hit.prim_uv.x), mi.Float(hit.prim_uv.y)
        if self._stand_in is not None:
            # From a little above what was met, back along the normal on the side that is seen.
            seen = active & (first < 0)
            normal = dr.mulsign(si.n, -facing)
            probe = mi.Ray3f(si.p + self._apart * normal, -normal)
            probe.maxt = 2.0 * self._apart
            own = self._stand_in.ray_intersect_preliminary(probe, active=seen)
            found = own.compute_surface_interaction(probe, mi.RayFlags.Minimal, seen & own.is_valid())
            # The front of the same surface, and not that of another one close by.
            here = seen & own.is_valid() & (dr.dot(found.n, normal) > 0.7) & (dr.dot(found.n, ray.d) < 0.0)
            face = dr.select(here, mi.UInt32(self._first_own) + own.prim_index, face)
            u, v = dr.select(here, own.prim_uv.x, u), dr.select(here, own.prim_uv.y, v)
            held |= here
        vertices = tuple(dr.gather(mi.UInt32, corner, face, held) for corner in self._corners)
        return SurfaceHit(held, vertices, (1.0 - u - v, u, v))

    def _check_places(self, scene: Any, parts: list[Part], packed: CompressedTransfer, file: str) -> None:
        """Raise UserError unless the scene has a surface where each part is."""
        mi = self._mi
        rng = np.random.default_rng(0)
        for part in parts:
            faces = _faces_of([part], packed)
            corners = self.placement(packed.mesh.positions)[rng.permutation(faces)[:_PROBES]]
            normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
            start = corners.mean(axis=1) + self._apart * normals
            ray = mi.Ray3f(mi.Point3f(start.T.astype(np.float32)), mi.Vector3f(-normals.T.astype(np.float32)))
            ray.maxt = 2.0 * self._apart
            if np.mean(np.array(scene.ray_test(ray))) < _FOUND:
                there = ", ".join(f"'{shape.id()}'" for shape in scene.shapes()) or "none"
                raise UserError(
                    f"{file}: its shape '{part.name}' ({part.count} vertices) is not in the scene, which has the "
                    f"shapes {there}; give the shape that id; it may be moved, turned and evenly scaled, but "
                    "not changed"
                )


def _drjit() -> Any:
    """Loaded only once Mitsuba is."""
    import drjit

    return drjit


def _faces_of(parts: list[Part], packed: CompressedTransfer) -> NDArray[np.int32]:
    first = packed.mesh.faces[:, 0]
    chosen = np.zeros(len(first), dtype=bool)
    for part in parts:
        chosen |= (first >= part.first) & (first < part.first + part.count)
    return packed.mesh.faces[chosen]


def _stand_in(mi: Any, positions: NDArray, faces: NDArray) -> Any:
    mesh = mi.Mesh("transfer", len(positions), len(faces))
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = mi.Float(positions.astype(np.float32).ravel())
    parameters["faces"] = mi.UInt32(faces.astype(np.uint32).ravel())
    parameters.update()
    return mi.load_dict({"type": "scene", "mesh": mesh})


# --- Which shape is which --------------------------------------------------------------------------------------------


def _shape_of(mi: Any, shapes: list[Any], part: Part, packed: CompressedTransfer, file: str) -> Any:
    """The mesh of the scene that has the part's vertices; None if it must be looked for by its place.

    Raises
    ------
    UserError
        A mesh of that id with other vertices.
    """
    named = [shape for shape in shapes if shape.id() == part.name]
    if named:
        shape = named[0]
        if shape.class_name() in _REPLACED or not shape.is_mesh():
            return None
        if shape.vertex_count() != part.count:
            raise UserError(
                f"{file}: shape '{part.name}' has {part.count} vertices there and {shape.vertex_count()} in the scene; "
                "it was remeshed since, so precompute it again"
            )
        return shape
    # A mesh file has no ids: the only mesh without another name that has the same vertices.
    alike = [
        shape
        for shape in shapes
        if shape.is_mesh()
        and shape.vertex_count() == part.count
        and shape.class_name() not in _REPLACED
        and _fit(_positions(mi, shape), _own_positions(part, packed))[1] <= _MOVED
    ]
    return alike[0] if len(alike) == 1 and len(packed.parts) == 1 else None


def _placement(mi: Any, meshes: list[tuple[Any, Part]], packed: CompressedTransfer, file: str) -> Placement:
    """Where the file's world is, from the vertices that both have.

    Raises
    ------
    UserError
        Shapes whose vertices are not those of the file, in the same order, moved as one.
    """
    still = Placement(np.eye(3), 1.0, np.zeros(3))
    if not meshes:
        return still
    there = [_positions(mi, shape) for shape, _ in meshes]
    own = [_own_positions(part, packed) for _, part in meshes]

    def apart(placement: Placement) -> list[float]:
        return [_misfit(placement, a, b) for a, b in zip(there, own, strict=True)]

    placement = still
    if max(apart(still)) > _MOVED:
        placement = _fit(np.concatenate(there), np.concatenate(own))[0]
    misfits = apart(placement)
    worst = int(np.argmax(misfits))
    if misfits[worst] > _MOVED or not np.isfinite(misfits[worst]):
        name = meshes[worst][1].name
        raise UserError(
            f"{file}: shape '{name}' of the scene has the {meshes[worst][1].count} vertices of '{name}' there, but in "
            "another order or at other places; it was changed since, so precompute it again"
        )
    return placement


def _positions(mi: Any, shape: Any) -> NDArray[np.float64]:
    dr = _drjit()
    return np.array(shape.vertex_position(dr.arange(mi.UInt32, shape.vertex_count())), dtype=np.float64).T


def _own_positions(part: Part, packed: CompressedTransfer) -> NDArray[np.float64]:
    return packed.mesh.positions[part.first : part.first + part.count]


def _misfit(placement: Placement, there: NDArray, own: NDArray) -> float:
    """Largest distance of a vertex from where it should be, in diagonals, beyond what rounding to float32 moves it."""
    diagonal = float(np.linalg.norm(np.ptp(there, axis=0)))
    distance = float(np.abs(placement(own) - there).max())
    rounding = 4.0 * float(np.spacing(np.float32(np.abs(there).max())))
    return max(distance - rounding, 0.0) / max(diagonal, 1e-300)


def _fit(there: NDArray, own: NDArray) -> tuple[Placement, float]:
    """The similarity that takes ``own`` to ``there`` (Umeyama 1991), and its misfit."""
    middle, own_middle = there.mean(axis=0), own.mean(axis=0)
    a, b = there - middle, own - own_middle
    u, singular, vt = np.linalg.svd(a.T @ b)
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    rotation = (u * sign) @ vt
    scale = float(np.sum(singular * sign) / max(float(np.sum(b * b)), 1e-300))
    placement = Placement(rotation, scale, middle - scale * rotation @ own_middle)
    return placement, _misfit(placement, there, own)
