"""What is known where rays meet a scene: surfaces whose diffuse reflection is held at vertices."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slepian_prt.paths.lobes import LAMBERTIAN, PLAIN, material_kind
from slepian_prt.scene.scene import Scene

# Materials that do nothing but reflect diffusely.
_DIFFUSE_ONLY = (PLAIN, LAMBERTIAN)


class Corners(NamedTuple):
    """Vertices of the faces that n rays met, on the side that they met.

    Attributes
    ----------
    vertices : (n, 3) int32
    weights : (n, 3) float32
        Barycentric.
    """

    vertices: NDArray[np.int32]
    weights: NDArray[np.float32]


class HeldFaces:
    """The faces of the receivers of a scene, and what vertices know of the light that they reflect.

    `slepian_prt.paths.tracer.PathTracer` ends paths on them.
    """

    def __init__(self, scene: Scene) -> None:
        mi = scene.mi
        self._mi, self._scene = mi, scene
        sizes = np.diff([*scene.first_faces, len(scene.faces)])
        shapes = scene.shapes[: len(scene.parts)]
        simple = np.array([material_kind(mi, shape.bsdf()) in _DIFFUSE_ONLY for shape in shapes])
        self._simple = mi.Bool(np.repeat(simple, sizes))
        self._black_behind = mi.Bool(np.repeat(~np.array(scene.two_sided), sizes))
        self._holds_back = mi.Bool(scene.faces_behind[:, 0] >= 0)
        self._corners, self._corners_behind = (
            [mi.UInt32(np.maximum(corners[:, i], 0).astype(np.uint32)) for i in range(3)]
            for corners in (scene.faces, scene.faces_behind)
        )
        self._albedo = mi.Color3f(np.ascontiguousarray(scene.receivers.albedo.T, dtype=np.float32))

    def at(self, ray: Any, hit: Any, _si: Any, active: Any) -> tuple[Any, Any]:
        """Whether rays met a side of a face that vertices hold (Bool), and the albedo there (Color3f).

        Parameters
        ----------
        ray : Ray3f
        hit : PreliminaryIntersection3f
        active : Bool
        """
        import drjit as dr

        mi = self._mi
        face, front = self._side(ray, hit)
        valid = active & (face >= 0)
        valid &= front | dr.gather(mi.Bool, self._holds_back, face, valid)
        u, v = mi.Float(hit.prim_uv.x), mi.Float(hit.prim_uv.y)
        albedo = mi.Color3f(0.0)
        for ahead, behind, weight in zip(
            self._corners, self._corners_behind, (1.0 - u - v, u, v), strict=True
        ):
            vertex = dr.gather(mi.UInt32, ahead, face, valid & front)
            vertex = dr.select(front, vertex, dr.gather(mi.UInt32, behind, face, valid & ~front))
            albedo += weight * dr.gather(mi.Color3f, self._albedo, vertex, valid)
        return valid, dr.select(valid, albedo, 0.0)

    def goes_on(self, ray: Any, hit: Any) -> Any:
        """Bool, whether more comes back along rays than the sky, or what vertices hold of what they met."""
        import drjit as dr

        mi = self._mi
        face, front = self._side(ray, hit)
        known = face >= 0
        enough = front | dr.gather(mi.Bool, self._holds_back, face, known)
        enough |= dr.gather(mi.Bool, self._black_behind, face, known)
        return hit.is_valid() & ~(known & enough & dr.gather(mi.Bool, self._simple, face, known))

    def corners(self, ray: Any, hit: Any, lanes: NDArray[np.int64]) -> Corners:
        """Where the rays of some ``lanes``, that ended on held faces, met them."""
        face, front = (np.array(value)[lanes] for value in self._side(ray, hit))
        u, v = (np.array(value, dtype=np.float32)[lanes] for value in (hit.prim_uv.x, hit.prim_uv.y))
        scene = self._scene
        vertices = np.where(front[:, None], scene.faces[face], scene.faces_behind[face])
        return Corners(vertices, np.stack([1.0 - u - v, u, v], axis=1))

    def _side(self, ray: Any, hit: Any) -> tuple[Any, Any]:
        """Rows of faces that rays met (negative for others), and whether from the front."""
        import drjit as dr

        table = self._scene.face_table
        face = table.met(hit)
        return face, dr.dot(table.normals(face), ray.d) < 0.0
