"""A scene as transport sees it: receivers of light, and everything that casts shadows."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from slepian_prt.lighting.environment import Environment
from slepian_prt.scene.mesh import Mesh, border_vertices
from slepian_prt.scene.receivers import Receivers
from slepian_prt.scene.view import View

# Where rays start above the surface, relative to the diagonal of the bounding box. From the vertex itself 41 % of the
# rays of a convex icosphere are falsely blocked; from here none.
RAY_OFFSET = 1e-4


@dataclass(frozen=True)
class Part:
    """One receiving shape: vertices ``first : first + count`` of the scene's mesh."""

    name: str
    first: int
    count: int


@dataclass(frozen=True)
class Scene:
    """A loaded scene; usable inside the with-block of `open_scene` that made it.

    Attributes
    ----------
    mi : module
        Mitsuba, in the variant that the scene was loaded in.
    path : str
    mesh : Mesh
        What draws the receivers, which are its vertices: all receiving shapes as one, in world space.
    parts : tuple of Part
    origin : (3,), scale : float
        Mitsuba's geometry is ``(world - origin) / scale``: a mesh file is traced in a box of unit diagonal, because
        Mitsuba's own ray offsets are absolute and float32 loses what lies far from the origin.
    shapes : tuple
        Mitsuba shapes in the order of ``parts``, then the occluders.
    faces : (F', 3) int32
        Vertices of all faces as Mitsuba numbers them, one receiver after the other; a degenerate face is among them.
    first_faces : tuple of int
        Where the faces of each receiver begin.
    two_sided : tuple of bool
        Whether the back of each receiver reflects light.
    has_materials : bool
        Whether the albedo is known; a mesh file says nothing about it.
    view : View or None
        The scene's camera, if it is a plain perspective one.
    sensor : Mitsuba sensor or None
        The scene's camera if it is of another kind.
    environment : Environment or None
        The scene's own distant light.
    not_simulated : tuple of str
        What the scene has and transport here leaves out.
    """

    mi: Any
    path: str
    mesh: Mesh
    parts: tuple[Part, ...]
    origin: NDArray[np.float64]
    scale: float
    shapes: tuple[Any, ...]
    faces: NDArray[np.int32]
    first_faces: tuple[int, ...]
    two_sided: tuple[bool, ...]
    has_materials: bool
    view: View | None
    sensor: Any
    environment: Environment | None
    not_simulated: tuple[str, ...] = ()

    @property
    def receivers(self) -> Receivers:
        """Where light is wanted: the vertices of the mesh."""
        return self.mesh.receivers

    @cached_property
    def geometry(self) -> Any:
        """A Mitsuba scene of the shapes alone."""
        return mitsuba_scene(self)

    @property
    def traced_positions(self) -> NDArray[np.float64]:
        """(V, 3) positions of the receivers in the space that Mitsuba traces in."""
        return (self.receivers.positions - self.origin) / self.scale

    @property
    def occluders(self) -> tuple[Any, ...]:
        """Mitsuba shapes that cast shadows but receive no light."""
        return self.shapes[len(self.parts) :]

    @cached_property
    def ray_offsets(self) -> NDArray[np.float64]:
        """(V,) how far above each receiver its rays start, in the space that Mitsuba traces in.

        Relative to the connected piece of surface that it belongs to, so that a small model beside a large
        floor keeps its shadows, but no less than a few units in the last place of its position in float32.
        """
        positions = self.traced_positions
        first, second = self.receivers.neighbours.T
        links = coo_array((np.ones(first.size, dtype=np.int8), (first, second)), shape=(len(positions), len(positions)))
        count, piece = connected_components(links, directed=False)
        low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
        np.minimum.at(low, piece, positions)
        np.maximum.at(high, piece, positions)
        diagonals = np.linalg.norm(high - low, axis=1)[piece]
        rounding = np.spacing(np.abs(positions).max(axis=1, initial=0.0).astype(np.float32))
        return np.maximum(RAY_OFFSET * diagonals, 32.0 * rounding)

    @cached_property
    def ray_origins(self) -> NDArray[np.float64]:
        """(V, 3) where the rays of each receiver start, in the space that Mitsuba traces in.

        Above the surface; and at the border of a surface also a little inward, because the border of a wall often
        lies in the plane of the next one, which its rays would start in and never meet.
        """
        normals, positions = self.receivers.normals, self.traced_positions
        inward = _inward(positions, self.mesh.faces)
        inward -= np.einsum("ij,ij->i", inward, normals)[:, None] * normals
        length = np.linalg.norm(inward, axis=1, keepdims=True)
        inward = np.divide(inward, length, out=np.zeros_like(inward), where=length > 0.0)
        return positions + self.ray_offsets[:, None] * (normals + inward)

    @property
    def traced_bounds(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Corners of the box of all shapes, occluders too, in the space that Mitsuba traces in."""
        boxes = [shape.bbox() for shape in self.shapes]
        low = np.min([np.array(box.min) for box in boxes], axis=0).astype(np.float64)
        high = np.max([np.array(box.max) for box in boxes], axis=0).astype(np.float64)
        return low, high


def _inward(positions: NDArray, faces: NDArray) -> NDArray[np.float64]:
    """(V, 3) from vertices on the border of the surface towards the middle of their faces; zero elsewhere."""
    border = border_vertices(faces, len(positions))
    centers = positions[faces].mean(axis=1)
    inward = np.zeros_like(positions)
    for corner in range(3):
        vertex = faces[:, corner]
        chosen = border[vertex]
        np.add.at(inward, vertex[chosen], centers[chosen] - positions[vertex[chosen]])
    return inward


def mitsuba_scene(scene: Scene, **others: Any) -> Any:
    """A Mitsuba scene of the same shapes with other things (emitter, sensor) as given.

    Embree's robust mode costs about a fifth of the speed. Without it rays slip between triangles, one in a million on a
    scan, and one in four where a model is 1e-8 of the size of the floor under it.
    """
    mi = scene.mi
    if mi.variant().startswith("llvm_"):
        others = {"embree_use_robust_intersections": True, **others}
    shapes = {f"shape_{i}": shape for i, shape in enumerate(scene.shapes)}
    return mi.load_dict({"type": "scene", **shapes, **others})
