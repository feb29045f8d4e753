"""Triangle meshes: read from files, checked, and repaired where that is safe."""

from __future__ import annotations

import importlib.util
import json
import logging
import struct
import warnings
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray

from slepian_prt.errors import UserError
from slepian_prt.scene.receivers import Receivers
from slepian_prt.summary import Summarised

log = logging.getLogger(__name__)

MESH_SUFFIXES = (".ply", ".obj", ".stl", ".off", ".glb")

# Faces thinner than this (area relative to the squared box diagonal) have no usable normal in float64.
_DEGENERATE = 1e-20

# Part of the faces from which on flipped neighbours are worth a remark; real scans have a few non-manifold edges.
_TWISTED = 0.01


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
    """

    name: str
    positions: NDArray[np.float64]
    normals: NDArray[np.float64]
    faces: NDArray[np.int32]
    albedo: NDArray[np.float32]
    notes: tuple[str, ...] = ()

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


def read_mesh(path: str | Path) -> Mesh:
    """Read a ply, obj, stl, off or glb file; all parts of a scene in it become one mesh.

    Raises
    ------
    UserError
        The file is missing, not a mesh, or holds nothing that can be lit: no face, coordinates that are not finite,
        faces that name vertices which do not exist, Draco compression that cannot be decoded here.
    """
    path = Path(path)
    if path.is_dir():
        raise UserError(f"{path}: is a folder; name a mesh file ({', '.join(MESH_SUFFIXES)}) or a Mitsuba .xml")
    if not path.is_file():
        raise UserError(f"{path}: no such file; check the path")
    if path.stat().st_size == 0:
        raise UserError(f"{path}: the file is empty; export the mesh again")
    if path.suffix.lower() not in MESH_SUFFIXES:
        raise UserError(f"{path}: unknown mesh format '{path.suffix}'; convert it to one of {', '.join(MESH_SUFFIXES)}")
    if path.suffix.lower() == ".glb":
        _refuse_undecodable_glb(path)
    loaded = _load(path)
    positions, faces = loaded.vertices, loaded.faces
    given = loaded.vertex_normals if "vertex_normals" in loaded._cache.cache else None
    if path.suffix.lower() == ".stl" or (path.suffix.lower() == ".obj" and given is None):
        # STL has no shared vertices, and OBJ splits them where texture coordinates differ: normals computed without
        # joining them again would be faceted, or show the seams of the texture.
        given = None
        before = len(positions)
        positions, joined = np.unique(np.asarray(positions), axis=0, return_inverse=True)
        faces = joined.ravel()[np.asarray(faces)]
        if len(positions) < before:
            log.info("%s: %d vertices joined to %d of different position", path, before, len(positions))
    return make_mesh(positions, faces, normals=given, name=path.stem, origin=str(path))


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
    p = np.array(positions, dtype=np.float64, ndmin=2)
    f = np.array(faces, dtype=np.int64, ndmin=2)
    if p.size == 0:
        raise UserError(f"{origin}: the mesh has no vertices; export it again with its geometry")
    if f.size == 0:
        raise UserError(f"{origin}: the mesh has no faces (a point cloud?); light needs surfaces, so mesh it first")
    if not np.all(np.isfinite(p)):
        bad = np.flatnonzero(~np.isfinite(p).all(axis=1))
        raise UserError(
            f"{origin}: {bad.size} vertices have NaN or infinite coordinates (the first is vertex {bad[0]}); "
            "remove them or export the mesh again"
        )
    if f.min() < 0 or f.max() >= len(p):
        bad = np.flatnonzero((f < 0).any(axis=1) | (f >= len(p)).any(axis=1))
        raise UserError(
            f"{origin}: {bad.size} faces name vertices that do not exist (face {bad[0]} has {f[bad[0]].tolist()}, "
            f"the mesh has {len(p)} vertices); export the mesh again"
        )
    notes: list[str] = []
    f = _without_degenerate(p, f, notes)
    if f.size == 0:
        raise UserError(f"{origin}: every face has zero area; export the mesh again")
    unit = _normals(p, f, normals, notes)
    twisted = _twice_in_one_direction(f)
    if twisted > _TWISTED * len(f):
        notes.append(f"{twisted} edges join faces of opposite orientation; make the winding consistent")
    colour = np.ascontiguousarray(np.broadcast_to(np.asarray(albedo, dtype=np.float32), (len(p), 3)))
    for note in notes:
        log.info("%s: %s", origin, note)
    return Mesh(name, p, unit, f.astype(np.int32), colour, tuple(notes))


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
    keys = begin * (f.max() + 1) + end
    return int(keys.size - np.unique(keys).size)


def _without_degenerate(p: NDArray, f: NDArray, notes: list[str]) -> NDArray:
    corners = p[f]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    extent = np.ptp(p[np.unique(f)], axis=0)
    degenerate = area <= _DEGENERATE * float(extent @ extent)
    if degenerate.any():
        notes.append(f"{int(degenerate.sum())} faces of zero area left out")
    return f[~degenerate]


def _normals(p: NDArray, f: NDArray, given: ArrayLike | None, notes: list[str]) -> NDArray[np.float64]:
    computed = _angle_weighted_normals(p, f)
    used = np.zeros(len(p), dtype=bool)
    used[f] = True
    if not used.all():
        notes.append(f"{int((~used).sum())} vertices that no face uses receive no light")
    unit = computed
    if given is not None:
        candidate = np.array(given, dtype=np.float64)
        if candidate.shape == p.shape:
            length = np.linalg.norm(candidate, axis=1)
            good = np.isfinite(length) & (length > 1e-12)
            if not good[used].all():
                notes.append(f"{int((used & ~good).sum())} missing or zero normals computed from the faces")
            unit = computed.copy()
            unit[good] = candidate[good] / length[good, None]
        else:
            notes.append(f"normals of shape {candidate.shape} do not fit the vertices; computed from the faces")
    unit[~used] = 0.0
    lost = used & ~unit.any(axis=1)
    if lost.any():
        # Faces that meet back to back cancel: any of their normals will do better than none.
        face_of = np.zeros(len(p), dtype=np.int64)
        face_of[f] = np.arange(len(f))[:, None]
        unit[lost] = _face_normals(p, f[face_of[lost]])
        notes.append(f"{int(lost.sum())} vertices whose faces cancel take the normal of one of them")
    return unit


def _face_normals(p: NDArray, f: NDArray) -> NDArray[np.float64]:
    corners = p[f]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return cross / np.linalg.norm(cross, axis=1, keepdims=True)


def _angle_weighted_normals(p: NDArray, f: NDArray) -> NDArray[np.float64]:
    """Face normals weighted by the angle at the vertex (Thürmer & Wüthrich 1998), which no retriangulation changes."""
    face_normals = _face_normals(p, f)
    total = np.zeros_like(p)
    for corner in range(3):
        a, b, c = (p[f[:, (corner + k) % 3]] for k in range(3))
        u, v = b - a, c - a
        angle = np.arctan2(np.linalg.norm(np.cross(u, v), axis=1), np.einsum("ij,ij->i", u, v))
        for axis in range(3):
            total[:, axis] += np.bincount(f[:, corner], angle * face_normals[:, axis], minlength=len(p))
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return np.where(length > 1e-9, total / np.maximum(length, 1e-300), 0.0)


def _load(path: Path) -> trimesh.Trimesh:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about colours and textures, which are not used
            # Not `maintain_order`: it would give each position of an OBJ file one of its several normals.
            loaded = trimesh.load(path, process=False)
    except Exception as error:  # the loaders raise whatever their parsers do
        reason = " ".join(str(error).split()) or type(error).__name__
        if isinstance(error, ImportError):
            reason = "its text cannot be decoded"
        raise UserError(f"{path}: cannot be read as a mesh ({reason}); export it again") from None
    if isinstance(loaded, trimesh.Scene):
        if not loaded.geometry:
            raise UserError(f"{path}: holds no mesh that can be read; check that it is a {path.suffix} file")
        coloured = any(_has_colours(part) for part in loaded.geometry.values())
        loaded = loaded.to_mesh()
    else:
        coloured = _has_colours(loaded)
    if coloured:
        log.info("%s: its colours and textures are not read; the albedo is 1 (a Mitsuba .xml can set it)", path)
    if isinstance(loaded, trimesh.PointCloud):
        raise UserError(f"{path}: the mesh has no faces (a point cloud?); light needs surfaces, so mesh it first")
    if not isinstance(loaded, trimesh.Trimesh):
        raise UserError(f"{path}: holds a {type(loaded).__name__}, not a triangle mesh; export triangles")
    return loaded


def _has_colours(mesh: Any) -> bool:
    """Whether a part carries vertex colours, a texture, or a material with a colour of its own."""
    visual = getattr(mesh, "visual", None)
    if visual is None or not getattr(visual, "defined", False):
        return False
    material = getattr(visual, "material", None)
    if material is None:
        return True
    base = getattr(material, "baseColorFactor", None)
    texture = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
    diffuse = getattr(material, "diffuse", None)
    tinted = [c for c in (base, diffuse) if c is not None and len(np.unique(np.asarray(c)[:3])) > 1]
    return texture is not None or bool(tinted)


def _refuse_undecodable_glb(path: Path) -> None:
    """trimesh turns a Draco-compressed part that it cannot decode into zeros or nothing, with a warning only."""
    with path.open("rb") as file:
        header = file.read(20)
        if len(header) < 20 or header[:4] != b"glTF":
            raise UserError(f"{path}: is not a binary glTF file; export it as .glb")
        length, kind = struct.unpack("<I4s", header[12:20])
        content = file.read(length) if kind == b"JSON" else b""
    try:
        used = json.loads(content).get("extensionsUsed", [])
    except (ValueError, AttributeError):
        raise UserError(f"{path}: its glTF header cannot be read; export it again") from None
    if "KHR_draco_mesh_compression" in used and importlib.util.find_spec("DracoPy") is None:
        raise UserError(
            f"{path}: is Draco-compressed and cannot be decoded here; export it without compression, or pip install "
            "DracoPy"
        )
