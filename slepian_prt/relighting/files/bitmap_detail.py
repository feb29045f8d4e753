"""The textures of a Mitsuba scene on the faces of a transfer file, for meshes that are written with them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.relighting.files.baked_textures import BakedTexture, bake_texture
from slepian_prt.relighting.mitsuba.shape_matching import mesh_faces
from slepian_prt.relighting.source import locate_source
from slepian_prt.renderer.shape_names import shape_name
from slepian_prt.scene.face_matching import ROUNDED, match_faces
from slepian_prt.scene.formats.parts import Texture
from slepian_prt.scene.mesh import Mesh
from slepian_prt.scene.mitsuba.ids import load_keeping_ids
from slepian_prt.scene.mitsuba.instances import copy_name, instanced_groups
from slepian_prt.scene.reflectance.bsdf_parts import is_textured
from slepian_prt.scene.reflectance.surface_detail import SurfaceDetail
from slepian_prt.scene.scene import Part

# How far within a face its corners are looked up, so that texture coordinates are those of its side of a seam; and how
# far from the face its surface may be, in lengths of its longest side.
_INSIDE, _REACH = 0.125, 0.3


class _Source(NamedTuple):
    """What a part was made from: a Mitsuba shape, and the (4, 4) transform that a copy of it is placed by."""

    shape: Any
    matrix: NDArray[np.float64]


class _Baker:
    """Bakes each side of each material once."""

    def __init__(self, mi: Any) -> None:
        self._mi = mi
        self._made: dict[tuple[int, int], tuple[Any, BakedTexture | None]] = {}

    def bake(self, bsdf: Any, name: str, side: int) -> BakedTexture | None:
        """As `bake_texture`."""
        key = id(bsdf), side
        if key not in self._made:
            made = bake_texture(self._mi, bsdf, name, side=side)
            front = self.bake(bsdf, name, 1) if side < 0 and made is not None else None
            if front is not None and made is not None and front.is_same(made):
                made = front
            self._made[key] = bsdf, made  # with the BSDF, so that no other one gets its address
        return self._made[key][1]


def source_detail(
    mi: Any,
    packed: CompressedTransfer,
    scene: str | Path | None,
    file: str | Path | None,
    report: Callable[[str], None],
) -> SurfaceDetail | None:
    """The textures of what a transfer file was made from, where that can be found; None without any.

    Parameters
    ----------
    mi : Mitsuba, in an RGB variant
    packed : CompressedTransfer
    scene : path, optional
        What it was made from, if that is not where it was.
    file : path, optional
        Of the transfer: its source is looked for beside it.
    report : callable
        Given a line about each thing worth knowing.

    Raises
    ------
    UserError
        The scene is named and cannot be used.
    """
    source = locate_source(mi, packed, scene, file, report)
    if source.scene is None or source.origin is None:
        return source.detail
    return bitmap_detail(mi, source.scene, source.origin, packed.mesh, packed.parts, report)


def bitmap_detail(
    mi: Any,
    loaded: Any,
    origin: NDArray[np.float64],
    mesh: Mesh,
    parts: tuple[Part, ...],
    report: Callable[[str], None] = lambda _: None,
) -> SurfaceDetail | None:
    """What textured materials of a scene reflect diffusely, as images on the faces of the mesh that was made from it.

    Parameters
    ----------
    mi : Mitsuba, in an RGB variant
    loaded : Mitsuba scene
    origin : (3,)
        The point of the world that is the origin of the scene.
    mesh : Mesh
    parts : tuple of Part
    report : callable
        Given a line about the textures that stay with the vertices.

    Returns
    -------
    None without any such image. Reflectance of faces without one is left at 1.
    """
    sources, baker = _sources(mi, loaded), _Baker(mi)
    choice = np.full(len(mesh.faces), -1, dtype=np.int32)
    uv = np.zeros((len(mesh.faces), 3, 2), dtype=np.float32)
    textures: dict[tuple[object, ...], Texture] = {}  # by their content: materials of their own may read one file
    left: list[str] = []
    for part in parts:
        source = sources.get(part.name)
        bsdf = None if source is None else source.shape.bsdf()
        if source is None or bsdf is None or not is_textured(mi, bsdf):
            continue
        for number in range(part.sides):
            baked = baker.bake(bsdf, part.name, 1 if number == 0 else -1)
            if baked is None:
                left += [] if part.name in left else [part.name]
                continue
            first = part.first + number * part.count
            faces = np.flatnonzero((mesh.faces[:, 0] >= first) & (mesh.faces[:, 0] < first + part.count))
            placed, found = _coordinates(mi, source, mesh, part, faces, origin)
            uv[faces] = baked.coordinates(placed)
            content = (baked.texture.source, baked.texture.wrap)
            textures.setdefault(content, baked.texture)
            choice[faces[found]] = list(textures).index(content)
    if left:
        names = ", ".join(f"'{name}'" for name in left[:3]) + (", …" if len(left) > 3 else "")
        report(f"textures of {names} are no single image; they are written as colours of vertices")
    if not textures:
        return None
    none = np.full(len(mesh.faces), -1, dtype=np.int32)
    white = np.ones((len(mesh.faces), 3, 3), dtype=np.float32)
    return SurfaceDetail(
        tuple(textures.values()), choice, uv, white, np.zeros(len(choice), dtype=np.float32), none, np.zeros_like(uv)
    )


def _sources(mi: Any, loaded: Any) -> dict[str, _Source]:
    """The shapes of a scene, and of its instances, by the names of parts."""
    sources = {shape_name(shape, index): _Source(shape, np.eye(4)) for index, shape in enumerate(loaded.shapes())}
    for group in instanced_groups(mi, loaded, "the scene"):
        for name, shape in zip(group.names(), group.shapes, strict=True):
            sources |= {copy_name(name, each): _Source(shape, each.matrix) for each in group.instances}
    return sources


def _coordinates(
    mi: Any, source: _Source, mesh: Mesh, part: Part, faces: NDArray[np.int64], origin: NDArray
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """(F', 3, 2) texture coordinates of the corners of some faces, and (F',) where they were found."""
    import drjit as dr

    shape, inverse = source.shape, np.linalg.inv(source.matrix)

    def in_shape(positions: NDArray) -> NDArray[np.float64]:
        return np.asarray((positions - origin) @ inverse[:3, :3].T + inverse[:3, 3])

    if shape.is_mesh() and shape.vertex_count() == part.count and shape.has_vertex_texcoords():
        places = np.array(shape.vertex_position(dr.arange(mi.UInt32, part.count)), dtype=np.float64).T
        own = in_shape(mesh.positions[part.first : part.first + part.count])
        tolerance = 2.0 * ROUNDED * max(float(np.ptp(own, axis=0).max()), 1e-300)
        given = np.array(shape.vertex_texcoord(dr.arange(mi.UInt32, part.count)), dtype=np.float64).T
        if np.abs(places - own).max() <= tolerance:
            return given[(mesh.faces[faces] - part.first) % part.count], np.ones(len(faces), dtype=bool)
        own_faces = mesh_faces(mi, shape)
        matched = match_faces(in_shape(mesh.positions[mesh.faces[faces]]), places[own_faces], tolerance)
        if np.all(matched.faces >= 0):
            return matched.of_corners(given[own_faces]), np.ones(len(faces), dtype=bool)
    if shape.is_mesh() and not shape.has_vertex_texcoords():
        return np.zeros((len(faces), 3, 2)), np.zeros(len(faces), dtype=bool)
    corners = in_shape(mesh.positions[mesh.faces[faces]])
    inside = corners + _INSIDE * (corners.mean(axis=1, keepdims=True) - corners)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    reach = _REACH * np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    down = np.repeat(-normals, 3, axis=0)
    start = inside.reshape(-1, 3) - np.repeat(reach, 3)[:, None] * down
    ray = mi.Ray3f(mi.Point3f(start.T.astype(np.float32)), mi.Vector3f(down.T.astype(np.float32)))
    ray.maxt = mi.Float(2.0 * np.repeat(reach, 3).astype(np.float32))
    hit = load_keeping_ids(mi, {"type": "scene", "shape": shape}).ray_intersect(ray)
    uv = np.array(hit.uv, dtype=np.float64).T.reshape(-1, 3, 2)
    # A closed shape goes on from 1 at 0.
    if not shape.is_mesh():
        uv = uv + ((np.ptp(uv, axis=1, keepdims=True) > 0.5) & (uv < 0.5))
    middle = uv.mean(axis=1, keepdims=True)
    found = np.array(hit.is_valid()).reshape(-1, 3).all(axis=1)
    return np.asarray(middle + (uv - middle) / (1.0 - _INSIDE)), np.asarray(found)
