"""The shapes of a Mitsuba scene by what light does with them: what receives it, and what only casts shadows."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError
from slepian_prt.renderer.shape_names import shape_name
from slepian_prt.scene.mitsuba.edge_lengths import EdgeLengths, Things, boxes_of, lengths_alone
from slepian_prt.scene.mitsuba.effects import ShapeOutcome
from slepian_prt.scene.mitsuba.instances import (
    MOST_COPIES,
    MOST_VERTICES,
    Instance,
    InstancedGroup,
    casting_shadows,
    copy_name,
    instanced_groups,
    placed,
)
from slepian_prt.scene.mitsuba.parametric import PARAMETRIC, fewest_cuts, surface_of
from slepian_prt.scene.mitsuba.shapes import ReceivingShape, receiving_shape, shape_triangles
from slepian_prt.scene.mitsuba.subdivision import Surface, cut_long_edges
from slepian_prt.scene.mitsuba.triangles import Triangles
from slepian_prt.scene.normals import face_areas, leaning_normals
from slepian_prt.scene.reflectance import materials

# Faces of meshes may be so large a part of the scene's diagonal, and all may get so many vertices to be no larger.
_LARGEST_FACE = 1.0 / 48.0
_MOST_NEW_VERTICES = 100_000

_SHADOWS_ONLY = "it casts shadows only"


class SortedShapes(NamedTuple):
    """The shapes of a scene by what light does with them.

    Attributes
    ----------
    receiving : list of ReceivingShape
    occluders : list of Mitsuba shapes
        Those that only cast shadows.
    groups : list of Mitsuba groups
        What instances among the occluders stand for.
    outcomes : list of ShapeOutcome
        What became of each shape of the scene; those of a group are told of once.
    of_outcome : list of int
        Which of the outcomes each of ``receiving`` belongs to.
    coarseness : float
    boundaries : list of Mitsuba shapes
        See `Scene`.
    """

    receiving: list[ReceivingShape]
    occluders: list[Any]
    groups: list[Any]
    outcomes: list[ShapeOutcome]
    of_outcome: list[int]
    coarseness: float
    boundaries: list[Any]

    def outcomes_with(self, lost_behind: Sequence[float | None], two_sided: NDArray[np.bool_]) -> list[ShapeOutcome]:
        """The outcomes, after it is known which receiving shapes are lit on both sides.

        Parameters
        ----------
        lost_behind : sequence of float or None
            What the vertices of each receiving shape lose of textures on its back; None where that is not lit.
        two_sided : bool array
            Whether its material reflects there.
        """
        result, told = list(self.outcomes), [False] * len(self.outcomes)
        for number, lost, both in zip(self.of_outcome, lost_behind, two_sided, strict=True):
            if told[number]:  # instances of one shape may differ: one that is lit on both sides counts
                continue
            outcome, told[number] = self.outcomes[number], lost is not None
            if lost is not None:
                over_both = math.hypot(outcome.texture_lost, lost) / math.sqrt(2.0)
                result[number] = outcome._replace(sides=2, texture_lost=over_both)
            else:
                reason = "it is closed: nobody sees its back" if both else ""
                result[number] = outcome._replace(sides=1, reason=reason)
        return result


class _Candidate(NamedTuple):
    """A shape that may receive light.

    Attributes
    ----------
    shape : Mitsuba shape
    name : str
    triangles : Triangles
    instances : list of Instance or None
        Where it is, for a shape of a group.
    stretch : float
        By how much the largest of them is larger.
    outcome : int
        Which of the outcomes is its.
    """

    shape: Any
    name: str
    triangles: Triangles
    instances: list[Instance] | None
    stretch: float
    outcome: int

    @property
    def copies(self) -> int:
        return 1 if self.instances is None else len(self.instances)


def sort_shapes(mi: Any, loaded: Any, path: str, *, toward_view: bool) -> SortedShapes:
    """Give vertices to all that light can be computed on.

    Parameters
    ----------
    mi : Mitsuba
    loaded : Mitsuba scene
    path : str
        For messages.
    toward_view : bool
        Whether glossy surfaces count.

    Raises
    ------
    UserError
        A shape or a material that cannot be used.
    """
    box = loaded.bbox()
    with np.errstate(invalid="ignore"):  # without a finite size
        diagonal = float(np.linalg.norm(np.array(box.max) - np.array(box.min)))
    if loaded.shapes() and not np.isfinite(diagonal):
        raise UserError(f"{path}: its shapes have no finite size; correct their transforms")
    return _Sorter(mi, loaded, path, diagonal, toward_view).sort()


class _Sorter:
    """Goes through the shapes of a scene; see `SortedShapes` for what it gathers."""

    def __init__(self, mi: Any, loaded: Any, path: str, diagonal: float, toward_view: bool) -> None:
        self._mi, self._loaded, self._path, self._diagonal = mi, loaded, path, diagonal
        self._reflects = materials.reflects_toward_a_view if toward_view else materials.reflects_diffusely
        self._instanced = instanced_groups(mi, loaded, path)
        copies = sum(len(group.shapes) * len(group.instances) for group in self._instanced)
        self._fewest = fewest_cuts(len(loaded.shapes()) + copies)
        self._candidates: list[_Candidate] = []
        self._result = SortedShapes([], [], [], [], [], 1.0, [])

    def sort(self) -> SortedShapes:
        for index, shape in enumerate(self._loaded.shapes()):
            if shape.class_name() != "Instance":
                self._take_alone(shape, shape_name(shape, index))
        left = MOST_VERTICES, MOST_COPIES
        for group in sorted(self._instanced, key=lambda group: sum(_size(shape) for shape in group.shapes)):
            left = self._take_group(group, *left)
        pieces, coarseness = self._cut()
        for candidate, triangles in zip(self._candidates, pieces, strict=True):
            self._receive(candidate, triangles)
        return self._result._replace(coarseness=coarseness)

    def _cut(self) -> tuple[list[Triangles], float]:
        """The candidates' triangles cut finer: first all alike, then where something small is near; what is left."""
        copies = [candidate.copies for candidate in self._candidates]
        most = [_LARGEST_FACE * self._diagonal / candidate.stretch for candidate in self._candidates]
        pieces = [candidate.triangles for candidate in self._candidates]
        alike = cut_long_edges(pieces, [EdgeLengths(length) for length in most], copies, _MOST_NEW_VERTICES)
        things = Things(boxes_of(self._loaded.shapes()))
        wanted = [
            things.lengths(piece.positions, length)
            if candidate.instances is None
            else lengths_alone(piece.positions, length)
            for candidate, piece, length in zip(self._candidates, alike.pieces, most, strict=True)
        ]
        surfaces = [self._surface(candidate) for candidate in self._candidates]
        finer = cut_long_edges(alike.pieces, wanted, copies, alike.most, surfaces)
        return finer.pieces, max(alike.left, finer.left)

    def _surface(self, candidate: _Candidate) -> Surface | None:
        kind = candidate.shape.class_name()
        return surface_of(self._mi, candidate.shape, kind, self._path) if kind in PARAMETRIC else None

    def _take_alone(self, shape: Any, name: str) -> None:
        triangles, reason = self._triangles(shape, name, 1.0)
        if triangles is not None:
            self._candidates.append(_Candidate(shape, name, triangles, None, 1.0, len(self._result.outcomes)))
        elif reason.endswith(_SHADOWS_ONLY):
            self._result.occluders.append(shape)
        elif any(medium is not None for medium in (shape.interior_medium(), shape.exterior_medium())):
            self._result.boundaries.append(shape)
        self._result.outcomes.append(ShapeOutcome(shape, name, _area(shape), 0, reason))

    def _take_group(self, group: InstancedGroup, vertices: int, copies: int) -> tuple[int, int]:
        """Take the shapes of a group; returns how many vertices and copies others may have."""
        stretch = max(instance.stretch for instance in group.instances)
        names = group.names()
        found = [self._triangles(shape, name, stretch) for shape, name in zip(group.shapes, names, strict=True)]
        times = len(group.instances)
        # Backs have vertices of their own, where they are open: that is not known yet.
        each = sum(
            (2 if materials.reflects_on_both_sides(self._mi, shape.bsdf()) else 1) * len(triangles.positions)
            for shape, (triangles, _) in zip(group.shapes, found, strict=True)
            if triangles is not None
        )
        wanted = times * each, times * sum(triangles is not None for triangles, _ in found)
        fits = wanted[0] <= vertices and wanted[1] <= copies
        casting = []
        for shape, name, (triangles, why) in zip(group.shapes, names, found, strict=True):
            reason = why
            if triangles is not None and fits:
                outcome = len(self._result.outcomes)
                self._candidates.append(_Candidate(shape, name, triangles, group.instances, stretch, outcome))
            elif triangles is not None:
                reason = f"{times} instances of {each} vertices are more than light is computed on; {_SHADOWS_ONLY}"
            if reason.endswith(_SHADOWS_ONLY):
                casting.append(shape)
            area = _area(shape) * sum(instance.enlargement for instance in group.instances)
            self._result.outcomes.append(ShapeOutcome(shape, name, area, 0, reason))
        if casting:
            made, instances = casting_shadows(self._mi, casting, group.instances)
            self._result.groups.append(made)
            self._result.occluders.extend(instances)
        return (vertices - wanted[0], copies - wanted[1]) if fits else (vertices, copies)

    def _triangles(self, shape: Any, name: str, stretch: float) -> tuple[Triangles | None, str]:
        """Those of a shape that can receive light, or why it cannot."""
        mi, bsdf = self._mi, shape.bsdf()
        if bsdf is not None and materials.lets_all_light_through(mi, bsdf):
            return None, "all light passes it, and it casts no shadow"
        if not self._reflects(mi, bsdf):
            return None, f"its material has no diffuse part; {_SHADOWS_ONLY}"
        origin = f"{self._path}: shape '{name}'"
        triangles = shape_triangles(mi, shape, origin, self._diagonal / stretch, self._fewest)
        return triangles, "" if triangles is not None else f"it has no vertices; {_SHADOWS_ONLY}"

    def _receive(self, candidate: _Candidate, triangles: Triangles) -> None:
        mi, result, name = self._mi, self._result, candidate.name
        receiving = receiving_shape(mi, candidate.shape, name, f"{self._path}: shape '{name}'", triangles)
        made = [receiving]
        if candidate.instances is not None:
            made = [placed(mi, receiving, instance, copy_name(name, instance)) for instance in candidate.instances]
        area = sum(float(face_areas(shape.mesh.positions, shape.mesh.faces).sum()) for shape in made)
        result.outcomes[candidate.outcome] = result.outcomes[candidate.outcome]._replace(
            area=area,
            sides=1,
            texture_lost=receiving.texture_lost,
            leaning=leaning_normals(receiving.mesh.positions, receiving.mesh.faces, receiving.mesh.normals),
        )
        result.receiving.extend(made)
        result.of_outcome.extend([candidate.outcome] * len(made))


def _size(shape: Any) -> int:
    return int(shape.primitive_count())


def _area(shape: Any) -> float:
    """Of the surface of a shape; zero where Mitsuba does not know it, as for curves."""
    if not shape.is_mesh() and shape.class_name() not in PARAMETRIC:
        return 0.0
    return float(np.array(shape.surface_area()).ravel()[0])
