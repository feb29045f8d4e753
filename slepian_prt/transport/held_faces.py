"""What is known where rays meet a scene: surfaces whose diffuse reflection is held at vertices."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slepian_prt.paths.lobes import LAMBERTIAN, PLAIN, MaterialTable
from slepian_prt.scene.reflectance.path_effects import DIFFUSE, PATH_EFFECTS, path_effect
from slepian_prt.scene.scene import Scene

# Effects that paths may go on by, in the order of the numbers that they have here, from 1 on.
PATHS = (*PATH_EFFECTS, DIFFUSE)


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

    Parameters
    ----------
    scene : Scene
    geometry : Mitsuba scene, optional
        That is traced, if not that of the scene.

    Attributes
    ----------
    materials : list of Mitsuba BSDFs
        Of the scene.
    """

    def __init__(self, scene: Scene, geometry: Any = None) -> None:
        mi = scene.mi
        self._mi, self._scene = mi, scene
        self.materials = [
            node for node in mi.traverse(geometry or scene.geometry).hierarchy if isinstance(node, mi.BSDF)
        ]
        self._table = MaterialTable(mi, self.materials)
        effects = [path_effect(mi, material) for material in self.materials]
        numbers = [0 if effect is None else 1 + PATHS.index(effect) for effect in effects]
        self._effects = self._table.by_number(self.materials, numbers)
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
        for ahead, behind, weight in zip(self._corners, self._corners_behind, (1.0 - u - v, u, v), strict=True):
            vertex = dr.gather(mi.UInt32, ahead, face, valid & front)
            vertex = dr.select(front, vertex, dr.gather(mi.UInt32, behind, face, valid & ~front))
            albedo += weight * dr.gather(mi.Color3f, self._albedo, vertex, valid)
        return valid, dr.select(valid, albedo, 0.0)

    def first_met(self, ray: Any, hit: Any) -> Any:
        """UInt32, by which of `PATHS` (from 1 on) more comes back along rays than the sky and what vertices hold.

        0 where nothing more does. Of faces of receivers that only reflect diffusely nothing is followed, their backs,
        where these are not held, neither.
        """
        import drjit as dr

        face, _ = self._side(ray, hit)
        bsdf = hit.shape.bsdf()
        effect = self._table.look_up(self._effects, bsdf, hit.is_valid(), 0)
        kind = self._table.kind(bsdf, hit.is_valid())
        diffuse = (kind == PLAIN) | (kind == LAMBERTIAN) | (effect == 1 + PATHS.index(DIFFUSE))
        return dr.select((face >= 0) & diffuse, 0, effect)

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
