"""A scene as transport sees it: receivers of light, and everything that casts shadows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.scene.face_table import FaceTable, interactions
from slepian_prt.scene.left_out import LeftOut
from slepian_prt.scene.mesh import Mesh
from slepian_prt.scene.mitsuba.ids import load_keeping_ids
from slepian_prt.scene.piercing import find_pierced
from slepian_prt.scene.ray_origins import RayOrigins, find_ray_origins
from slepian_prt.scene.receivers import Receivers
from slepian_prt.scene.reflectance.path_effects import passes_light
from slepian_prt.scene.slipping import find_slipping, too_many_slip
from slepian_prt.scene.surroundings import Surroundings, ray_heights
from slepian_prt.scene.view import View

if TYPE_CHECKING:  # parts of a scene are read with every transfer file, whose light may be of none
    from slepian_prt.lighting.environment import Environment


@dataclass(frozen=True)
class Part:
    """One receiving shape: vertices ``first : end`` of the scene's mesh.

    Attributes
    ----------
    name : str
    first : int
    count : int
        Of the vertices of the shape.
    sides : 1 or 2
        With 2, vertices ``first + count : end`` are the backs of those before them, in the same order: at the same
        places, with normals the other way; so are the faces of the mesh between them.
    """

    name: str
    first: int
    count: int
    sides: int = 1

    @property
    def end(self) -> int:
        """The first vertex behind those of the part."""
        return self.first + self.sides * self.count


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
        Whether the back of each receiver reflects light; which backs are receivers too, ``parts`` tell.
    has_materials : bool
        Whether the albedo is known; a mesh file without materials and colours says nothing about it.
    view : View or None
        The scene's camera, if it is a plain perspective one.
    sensor : Mitsuba sensor or None
        The scene's camera if it is of another kind.
    environment : Environment or None
        The scene's own distant light.
    not_simulated : tuple of LeftOut
        What the scene has and transport here leaves out.
    loaded : Mitsuba scene or None
        As its author has it, where it is one: its lamps, and the shapes before they were cut into vertices.
    groups : tuple
        Mitsuba's groups of the shapes that instances among ``shapes`` stand for.
    coarseness : float
        How many times longer than wanted the longest edge is that could not be cut, or 1.
    boundaries : tuple of Mitsuba shapes
        That all light passes, around participating media; not among ``shapes``.
    robust : bool or None
        Whether rays are traced in Embree's robust mode; by default where it is worth its price, see `is_robust`.
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
    not_simulated: tuple[LeftOut, ...] = ()
    loaded: Any = None
    groups: tuple[Any, ...] = ()
    coarseness: float = 1.0
    boundaries: tuple[Any, ...] = ()
    robust: bool | None = None

    @property
    def receivers(self) -> Receivers:
        """Where light is wanted: the vertices of the mesh."""
        return self.mesh.receivers

    @cached_property
    def geometry(self) -> Any:
        """A Mitsuba scene of the shapes alone."""
        return mitsuba_scene(self)

    @cached_property
    def is_robust(self) -> bool:
        """Whether no ray slips between triangles: on a mesh that is not too fine for its size a few may.

        Walls of scenes meet in all ways, and rays to their lamps run through the middle of edges: never there.
        """
        if self.robust is not None:
            return self.robust
        on_gpu = not self.mi.variant().startswith("llvm_")  # OptiX has no other mode
        return on_gpu or self.loaded is not None or too_many_slip(self.slipping)

    @cached_property
    def slipping(self) -> NDArray[np.float64]:
        """(V,) bound on the part of the rays that slip between triangles where they may."""
        return find_slipping(self)

    @cached_property
    def traced_positions(self) -> NDArray[np.float64]:
        """(V, 3) positions of the receivers in the space that Mitsuba traces in; zero where no face is."""
        return np.where(self.receivers.active[:, None], (self.receivers.positions - self.origin) / self.scale, 0.0)

    @cached_property
    def face_table(self) -> FaceTable:
        """Which of ``faces`` rays meet, and their normals in the space that Mitsuba traces in."""
        receiving = self.shapes[: len(self.parts)]
        return FaceTable(self.mi, receiving, self.first_faces, self.traced_positions[self.faces])

    @cached_property
    def faces_behind(self) -> NDArray[np.int32]:
        """(F', 3) as ``faces``, of the vertices that receive light behind; -1 where light is computed in front only."""
        none = np.broadcast_to(np.int32(-1), self.faces.shape)
        if all(part.sides == 1 for part in self.parts):
            return none
        behind = none.copy()
        ends = (*self.first_faces[1:], len(self.faces))
        for part, first, end in zip(self.parts, self.first_faces, ends, strict=True):
            if part.sides == 2:
                behind[first:end] = self.faces[first:end] + part.count
        return behind

    @cached_property
    def fronts(self) -> NDArray[np.int64]:
        """(V,) for each vertex the one on the front of the surface at its place: itself, unless it is one of a back."""
        fronts = np.arange(len(self.mesh.positions))
        for part in self.parts:
            if part.sides == 2:
                fronts[part.first + part.count : part.end] -= part.count
        return fronts

    def hit_faces(self, hit: Any) -> Any:
        """Rows of ``faces`` that rays met (a preliminary intersection); negative for occluders and the sky."""
        return self.face_table.met(hit)

    @cached_property
    def passes_light(self) -> NDArray[np.bool_]:
        """(F',) whether light comes through the material of each of ``faces``, as of leaves and of holes in masks."""
        sizes = np.diff([*self.first_faces, len(self.faces)])
        receiving = self.shapes[: len(self.parts)]
        return np.repeat([passes_light(self.mi, shape.bsdf()) for shape in receiving], sizes)

    def meets_dark_back(self, ray: Any, hit: Any) -> Any:
        """Whether rays met the back of a surface (a preliminary intersection) that is dark: none comes through it.

        Nor is light computed on it.
        """
        import drjit as dr

        face = self.hit_faces(hit)
        back = dr.dot(self.face_table.normals(face), ray.d) > 0.0
        if any(part.sides == 2 for part in self.parts):
            holds_light = self.mi.Bool(self.faces_behind[:, 0] >= 0)
            back &= ~dr.gather(self.mi.Bool, holds_light, face, face >= 0)
        if self.passes_light.any():
            back &= ~dr.gather(self.mi.Bool, self.mi.Bool(self.passes_light), face, face >= 0)
        # Instances are not asked: each would have all shapes traced.
        others = [
            shape
            for shape in self.occluders
            if shape.class_name() != "Instance" and not passes_light(self.mi, shape.bsdf())
        ]
        return back | (dr.dot(interactions(self.mi, others, ray, hit, self.mi.RayFlags.Minimal).n, ray.d) > 0.0)

    @property
    def occluders(self) -> tuple[Any, ...]:
        """Mitsuba shapes that cast shadows but receive no light."""
        return self.shapes[len(self.parts) :]

    @cached_property
    def ray_heights(self) -> NDArray[np.float64]:
        """(V,) how far above its faces the rays of each receiver start, in the space that Mitsuba traces in."""
        return ray_heights(self.traced_positions, self.mesh.faces)

    @cached_property
    def surroundings(self) -> Surroundings:
        """The faces around each receiver."""
        return Surroundings(self)

    @cached_property
    def ray_origins(self) -> RayOrigins:
        """Where the rays of each receiver start."""
        return find_ray_origins(self)

    @cached_property
    def pierced(self) -> NDArray[np.integer]:
        """(n, 2) vertices behind a surface that an edge of theirs goes through, and their neighbours before it."""
        return find_pierced(self)

    @cached_property
    def is_hidden(self) -> NDArray[np.bool_]:
        """(V,) True at the vertices behind a surface among ``pierced``."""
        hidden = np.zeros(len(self.receivers), dtype=bool)
        hidden[self.pierced[:, 0]] = True
        return hidden

    @cached_property
    def with_media(self) -> Scene:
        """The scene with the boundaries of media as occluders: what light does within them is traced then.

        Where receivers are, and their rays start, does not change.
        """
        if not self.boundaries:
            return self
        return self._keeping_origins(replace(self, shapes=(*self.shapes, *self.boundaries), boundaries=()))

    @property
    def in_robust_mode(self) -> Scene:
        """The scene with rays that never slip between triangles."""
        return self if self.is_robust else self._keeping_origins(replace(self, robust=True))

    def _keeping_origins(self, scene: Scene) -> Scene:
        """Where receivers are, and their rays start, is known already."""
        for name in ("surroundings", "ray_origins", "pierced"):
            vars(scene)[name] = getattr(self, name)
        return scene

    @property
    def traced_bounds(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Corners of the box of all shapes, occluders too, in the space that Mitsuba traces in."""
        boxes = [shape.bbox() for shape in self.shapes]
        low = np.min([np.array(box.min) for box in boxes], axis=0).astype(np.float64)
        high = np.max([np.array(box.max) for box in boxes], axis=0).astype(np.float64)
        return low, high


def mitsuba_scene(scene: Scene, **others: Any) -> Any:
    """A Mitsuba scene of the same shapes with other things (emitter, sensor) as given."""
    return traced_scene(scene.mi, scene.shapes, scene.groups, robust=scene.is_robust, **others)


def traced_scene(mi: Any, shapes: Sequence[Any], groups: Sequence[Any], *, robust: bool = True, **others: Any) -> Any:
    """As `mitsuba_scene`, of shapes and the groups that instances among them stand for.

    Embree's ``robust`` mode costs about a fifth of the speed. Without it rays slip between triangles, fewer than one in
    a million on a scan, and one in four where a model is 1e-8 of the size of the floor under it.
    """
    if robust and mi.variant().startswith("llvm_"):
        others = {"embree_use_robust_intersections": True, **others}
    objects = {f"group_{i}": group for i, group in enumerate(groups)}
    objects |= {f"shape_{i}": shape for i, shape in enumerate(shapes)}
    return load_keeping_ids(mi, {"type": "scene", **objects, **others})
