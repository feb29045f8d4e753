"""Triangle meshes: checked, and repaired where that is safe."""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slepian_prt.arrays import real_numbers, whole_numbers
from slepian_prt.errors import UserError
from slepian_prt.scene.left_out import LeftOut
from slepian_prt.scene.normals import are_normals, complete_normals, split_at_creases
from slepian_prt.scene.orientation import parts_inside_out
from slepian_prt.scene.receivers import Receivers
from slepian_prt.summary import Summarised

log = logging.getLogger(__name__)

# Faces no wider than so many units in the last place of their coordinates have no usable normal.
_DEGENERATE = 2.0

# Part of the faces from which on flipped neighbours are worth a remark; real scans have a few non-manifold edges.
_TWISTED = 0.01

# Coordinates whose products of four are still finite.
LARGEST_COORDINATE = 1e60

# Coordinates that float32 holds, and sums of a few of them.
_LARGEST_FLOAT32 = 1e37


@dataclass(frozen=True, repr=False)
class Mesh(Summarised):
    """A triangle mesh with a normal and an albedo at each vertex.

    Attributes
    ----------
    name : str
    positions : (V, 3) float64
    normals : (V, 3) float64
        Unit vectors; zero at vertices that no face uses, which receive no light.
    faces : (F, 3) int32
    albedo : (V, 3) float32
        Diffuse reflectance per colour channel.
    notes : tuple of str
        What was repaired, with counts.
    known_albedo : bool
        Whether the albedo is that of materials or colours, not a mere default.
    not_simulated : tuple of LeftOut
        What the materials have and transport here leaves out.
    source : (n, 2) int64 or None
        Pairs of a vertex of the file that the mesh was read from and one of the mesh at its place: some are split at
        hard edges or seams, some joined. None: the mesh numbers them as the file does, or the file numbers none.
    """

    name: str
    positions: NDArray[np.float64]
    normals: NDArray[np.float64]
    faces: NDArray[np.int32]
    albedo: NDArray[np.float32]
    notes: tuple[str, ...] = ()
    known_albedo: bool = False
    not_simulated: tuple[LeftOut, ...] = ()
    source: NDArray[np.int64] | None = None

    @cached_property
    def receivers(self) -> Receivers:
        """The vertices; those that no face uses receive no light."""
        return Receivers(self.positions, self.normals, self.albedo, edges(self.faces))

    def _summary(self) -> dict[str, object]:
        low, high = self.albedo.min(axis=0), self.albedo.max(axis=0)
        shown = low[:1] if np.all(low == low[0]) else low
        return {
            "name": self.name,
            "vertices": len(self.positions),
            "faces": len(self.faces),
            "size": " x ".join(f"{extent:.3g}" for extent in np.ptp(self.positions, axis=0)),
            "albedo": "varies" if np.any(low != high) else ", ".join(f"{value:.3g}" for value in shown),
            "notes": "; ".join(self.notes) or None,
        }


def make_mesh(
    positions: ArrayLike,
    faces: ArrayLike,
    *,
    normals: ArrayLike | None = None,
    albedo: ArrayLike = 1.0,
    name: str = "mesh",
    origin: str = "mesh",
) -> Mesh:
    """Check arrays and complete them to a `Mesh`.

    Parameters
    ----------
    positions : (V, 3)
    faces : (F, 3) vertex indices
    normals : (V, 3), optional
        Kept where they are finite and not zero; the others are computed, weighted by the angles of the faces.
    albedo : broadcastable to (V, 3)
    name, origin : str
        For logs and messages.

    Raises
    ------
    UserError
    """
    return complete_mesh(positions, faces, normals, albedo, MeshDetails(name, origin))


class MeshDetails(NamedTuple):
    """What `complete_mesh` is told beside arrays.

    Attributes
    ----------
    name, origin : str
        For logs and messages.
    groups : (V,) or None
        Vertices of the same number are one point of the surface and share a computed normal.
    known_albedo : bool or None
        Whether the albedo is known; None: if another than 1 is given.
    not_simulated : tuple of LeftOut
        As of `Mesh`.
    crease_angle : float
        In degrees: edges sharper than this are hard where no normals are given.
    source : (n, 2) or None
        As of `Mesh`.
    """

    name: str
    origin: str
    groups: NDArray | None = None
    known_albedo: bool | None = None
    not_simulated: tuple[LeftOut, ...] = ()
    crease_angle: float = 180.0
    source: NDArray[np.int64] | None = None


def complete_mesh(
    positions: ArrayLike, faces: ArrayLike, normals: ArrayLike | None, albedo: ArrayLike, details: MeshDetails
) -> Mesh:
    """As `make_mesh`."""
    origin = details.origin
    p = _of_three(real_numbers(positions, f"{origin}: positions", copy=True), f"{origin}: positions", "(V, 3)")
    f = _of_three(whole_numbers(faces, f"{origin}: faces"), f"{origin}: faces", "(F, 3), of triangles")
    check_geometry(p, f, origin)
    notes: list[str] = []
    f = _without_degenerate(p, f, notes)
    if f.size == 0:
        raise UserError(f"{origin}: every face has zero area; export the mesh again")
    _remark_on_winding(f, notes)
    given, groups, source = _fitting(normals, p, notes), details.groups, details.source
    colour = _of_vertices(albedo, len(p), origin)
    if details.crease_angle < 180.0:
        known = None if given is None else are_normals(given)
        places = np.arange(len(p)) if groups is None else groups
        vertices, f, groups = split_at_creases(p, f, places, details.crease_angle, known)
        source = _source_of_copies(source, vertices, len(p))
        p, colour, given = p[vertices], colour[vertices], None if given is None else given[vertices]
    unit = complete_normals(p, f, given, groups, notes)
    _remark_on_parts(p, unit, f, notes)
    for note in notes:
        log.info("%s: %s", origin, note)
    colour = np.ascontiguousarray(colour)
    known_albedo = bool(np.any(colour != 1.0)) if details.known_albedo is None else details.known_albedo
    more = (tuple(notes), known_albedo, details.not_simulated, source)
    return Mesh(details.name, p, unit, f.astype(np.int32), colour, *more)


def _of_three(values: NDArray, name: str, wanted: str) -> NDArray:
    """An array of rows of three; one row may be given alone, and an empty array has them."""
    rows = values.reshape(-1, 3) if values.size == 0 else np.atleast_2d(values)
    if rows.ndim != 2 or rows.shape[1] != 3:
        raise UserError(f"{name} have the shape {values.shape}; give an array of shape {wanted}")
    return rows


def _of_vertices(albedo: ArrayLike, count: int, origin: str) -> NDArray[np.float32]:
    """(V, 3) of what can be broadcast to it."""
    given = real_numbers(albedo, f"{origin}: albedo")
    try:
        colour = np.broadcast_to(given, (count, 3))
    except ValueError:
        raise UserError(
            f"{origin}: albedo has the shape {given.shape}, which does not fit {count} vertices; give one number, "
            "(3,), (V, 1) or (V, 3)"
        ) from None
    if not np.all((given >= 0.0) & (given <= np.finfo(np.float32).max)):
        raise UserError(f"{origin}: albedo is negative, NaN or infinite somewhere; give what is reflected, in [0, 1]")
    return colour.astype(np.float32)


def _source_of_copies(source: NDArray | None, vertices: NDArray[np.int64], count: int) -> NDArray[np.int64] | None:
    """As ``source`` of `Mesh`, of copies of ``count`` vertices: ``vertices`` (W,) are what they are of, ascending."""
    if len(vertices) == count:
        return source
    pairs = np.stack([np.arange(count)] * 2, axis=1) if source is None else source
    begin = np.searchsorted(vertices, pairs[:, 1])
    copies = np.searchsorted(vertices, pairs[:, 1], side="right") - begin
    number = np.arange(copies.sum()) - np.repeat(np.cumsum(copies) - copies, copies)
    return np.stack([np.repeat(pairs[:, 0], copies), np.repeat(begin, copies) + number], axis=1)


def check_geometry(positions: NDArray, faces: NDArray, origin: str) -> None:
    """Raise UserError for a mesh without vertices or faces, or with coordinates or indices that cannot be used."""
    if positions.size == 0:
        raise UserError(f"{origin}: the mesh has no vertices; export it again with its geometry")
    if faces.size == 0:
        raise UserError(f"{origin}: the mesh has no faces (a point cloud?); light needs surfaces, so mesh it first")
    if not np.all(np.isfinite(positions)):
        bad = np.flatnonzero(~np.isfinite(positions).all(axis=1))
        raise UserError(
            f"{origin}: {bad.size} vertices have NaN or infinite coordinates (the first is vertex {bad[0]}); "
            "remove them or export the mesh again"
        )
    if np.abs(positions).max() > LARGEST_COORDINATE:
        bad = np.flatnonzero((np.abs(positions) > LARGEST_COORDINATE).any(axis=1))
        raise UserError(
            f"{origin}: {bad.size} vertices have coordinates above {LARGEST_COORDINATE:g} "
            f"(the first is vertex {bad[0]}); remove them or export the mesh again"
        )
    check_faces(faces, len(positions), origin)


def check_float32(mesh: Mesh) -> None:
    """Raise UserError for a mesh of which float32, that pictures, pages and models hold, would not hold the faces."""
    largest = float(np.abs(mesh.positions[mesh.receivers.active]).max(initial=0.0))
    if largest > _LARGEST_FLOAT32:
        raise UserError(
            f"{mesh.name}: has coordinates up to {largest:.3g}, more than {_LARGEST_FLOAT32:g}, which is too large to "
            "draw or to write as a model; scale the mesh down"
        )


def check_faces(faces: NDArray, count: int, origin: str) -> None:
    """Raise UserError for faces (F, 3) that name vertices outside of [0, count)."""
    bad = np.flatnonzero((faces < 0).any(axis=1) | (faces >= count).any(axis=1))
    if bad.size:
        raise UserError(
            f"{origin}: {bad.size} faces name vertices that do not exist (face {bad[0]} has {faces[bad[0]].tolist()}, "
            f"the mesh has {count} vertices); export the mesh again"
        )


def _fitting(normals: ArrayLike | None, positions: NDArray, notes: list[str]) -> NDArray[np.float64] | None:
    """The normals given, if there is one for each vertex."""
    if normals is None:
        return None
    given = real_numbers(normals, "normals", copy=True)
    if given.shape == positions.shape:
        return given
    notes.append(f"normals of shape {given.shape} do not fit the vertices; computed from the faces")
    return None


def _remark_on_winding(f: NDArray, notes: list[str]) -> None:
    twisted = _twice_in_one_direction(f)
    if twisted > _TWISTED * len(f):
        notes.append(f"{twisted} edges join faces of opposite orientation; make the winding consistent")


def _remark_on_parts(p: NDArray, unit: NDArray, f: NDArray, notes: list[str]) -> None:
    wrong = parts_inside_out(p, unit, f)
    if wrong:
        some = f"{len(wrong)} closed parts are" if len(wrong) > 1 else "a closed part is"
        part = p[wrong[0]]
        digits = 3 - math.floor(math.log10(float(np.ptp(part, axis=0).max())))  # of its own size, none of rounding
        middle = ", ".join(f"{round(x, digits) + 0.0:.3g}" for x in part.mean(axis=0).tolist())
        first, its = ("the first of ", "their") if len(wrong) > 1 else ("", "its")
        notes.append(
            f"{some} inside out among others that are not ({first}{len(part)} vertices about {middle}) and will be "
            f"dark; turn {its} faces round"
        )


def half_edges(faces: NDArray) -> NDArray[np.int64]:
    """(3 F, 2) sides of triangles (F, 3) along their winding: corners 0 to 1 of all of them, 1 to 2, 2 to 0."""
    return np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64)


def edges(faces: NDArray) -> NDArray[np.int64]:
    """(E, 2) pairs of vertices that share an edge of triangles (F, 3), each once, the smaller index first."""
    return _counted_edges(faces)[0]


def border_vertices(faces: NDArray, count: int) -> NDArray[np.bool_]:
    """(count,) True at vertices on the border of a surface: at the ends of an edge that only one face has."""
    pairs, uses = _counted_edges(faces)
    border = np.zeros(count, dtype=bool)
    border[pairs[uses == 1]] = True
    return border


def _counted_edges(faces: NDArray) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """`edges`, and how many faces have each."""
    sides = half_edges(faces)
    low, high = np.sort(sides[sides[:, 0] != sides[:, 1]], axis=1).T
    count = int(faces.max(initial=0)) + 1
    keys, uses = np.unique(low * count + high, return_counts=True)
    return np.stack(np.divmod(keys, count), axis=1), uses


def _twice_in_one_direction(f: NDArray) -> int:
    """Edges that two faces run along in the same direction, which neighbours of one orientation never do."""
    begin, end = half_edges(f).T
    keys = np.sort(begin * (f.max() + 1) + end)  # np.unique hashes: 34 s for 23 million keys, this 0.2
    return int(np.count_nonzero(keys[1:] == keys[:-1]))


def degenerate_faces(positions: NDArray, faces: NDArray) -> NDArray[np.bool_]:
    """(F,) which faces have no area but for rounding."""
    corners = positions[faces]
    sides = corners - np.roll(corners, 1, axis=1)
    area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    rounding = np.spacing(np.abs(corners).max(axis=(1, 2)))
    return np.asarray(area <= _DEGENERATE * rounding * np.linalg.norm(sides, axis=2).max(axis=1))


def _without_degenerate(p: NDArray, f: NDArray, notes: list[str]) -> NDArray:
    degenerate = degenerate_faces(p, f)
    if degenerate.any():
        notes.append(f"{int(degenerate.sum())} faces of zero area left out")
    return f[~degenerate]
