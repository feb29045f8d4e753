"""The bitmaps of a Mitsuba scene on the faces of a transfer file, for meshes that are written with their textures."""

from __future__ import annotations

import io
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.relighting.drawing.pictures import encode_srgb
from slepian_prt.renderer.shape_names import shape_name
from slepian_prt.scene.formats.parts import Texture, Wrap
from slepian_prt.scene.mesh import Mesh
from slepian_prt.scene.mitsuba.ids import load_keeping_ids
from slepian_prt.scene.mitsuba.instances import instanced_groups
from slepian_prt.scene.reflectance.surface_detail import SurfaceDetail
from slepian_prt.scene.scene import Part

# Where the reflectance of a diffuse BSDF is among its parameters, by its class.
_REFLECTANCE = {"SmoothDiffuse": "reflectance", "TwoSidedBRDF": "brdf_0.reflectance"}

# How far within a face its corners are looked up, so that texture coordinates are those of its side of a seam; and how
# far from the face its surface may be, in lengths of its longest side.
_INSIDE, _REACH = 0.125, 0.3

_WRAPS: tuple[Wrap, ...] = ("repeat", "mirror", "clamp")
_PROBES = 64

# Texels that are evaluated at once.
_TEXELS = 1 << 22


def bitmap_detail(
    mi: Any,
    loaded: Any,
    origin: NDArray[np.float64],
    mesh: Mesh,
    parts: tuple[Part, ...],
    report: Callable[[str], None] = lambda _: None,
) -> SurfaceDetail | None:
    """Bitmaps that diffuse materials of a scene reflect, on the faces of the mesh that was made from it.

    Parameters
    ----------
    mi : Mitsuba, in the variant of the scene
    loaded : Mitsuba scene
    origin : (3,)
        The point of the world that is the origin of the scene.
    mesh : Mesh
    parts : tuple of Part
    report : callable
        Given a line about the textures that stay with the vertices.

    Returns
    -------
    None without any such bitmap. Reflectance of faces without one is left at 1.
    """
    shapes = _shapes_of_parts(mi, loaded)
    bitmaps = _Bitmaps(mi)
    choice = np.full(len(mesh.faces), -1, dtype=np.int32)
    uv = np.zeros((len(mesh.faces), 3, 2), dtype=np.float32)
    left: list[str] = []
    for part in parts:
        shape, to_shape = shapes.get(part.name, (None, None))
        bsdf = None if shape is None else shape.bsdf()
        if bsdf is None or to_shape is None:
            continue
        number = bitmaps.number_of(bsdf, part.name)
        if number is None:
            left += [part.name] if _has_texture(mi, bsdf) else []
            continue
        faces = np.flatnonzero((mesh.faces[:, 0] >= part.first) & (mesh.faces[:, 0] < part.end))
        positions = (mesh.positions[part.first : part.end] - origin) @ to_shape[:3, :3].T + to_shape[:3, 3]
        placed, found = _coordinates(mi, shape, positions, part.count, mesh.faces[faces] - part.first)
        uv[faces] = _transformed(mi, bsdf, placed)
        choice[faces[found]] = number
    if left:
        names = ", ".join(f"'{name}'" for name in left[:3]) + (", …" if len(left) > 3 else "")
        report(f"textures of {names} are no bitmaps of a diffuse material; they are written as colours of vertices")
    if not bitmaps.textures:
        return None
    none = np.full(len(mesh.faces), -1, dtype=np.int32)
    white = np.ones((len(mesh.faces), 3, 3), dtype=np.float32)
    return SurfaceDetail(
        tuple(bitmaps.textures), choice, uv, white, np.zeros(len(choice), dtype=np.float32), none, np.zeros_like(uv)
    )


def _shapes_of_parts(mi: Any, loaded: Any) -> dict[str, tuple[Any, NDArray[np.float64]]]:
    """Shapes of a scene by the names of their parts, and (4, 4) from the space of the scene to that of the shape."""
    shapes: dict[str, tuple[Any, NDArray[np.float64]]] = {}
    for index, shape in enumerate(loaded.shapes()):
        shapes[shape_name(shape, index)] = shape, np.eye(4)
    for group in instanced_groups(mi, loaded, "the scene"):
        for index, shape in enumerate(group.shapes):
            member = group.member_name(index).rsplit("/", 1)[-1]
            for instance in group.instances:
                shapes[f"{instance.name}/{member}"] = shape, np.asarray(np.linalg.inv(instance.matrix))
    return shapes


class _Bitmaps:
    """The images that materials of a scene reflect, each once, whichever shapes and materials have it.

    Attributes
    ----------
    textures : list of Texture
    """

    def __init__(self, mi: Any) -> None:
        self._mi = mi
        self.textures: list[Texture] = []
        self._by_material: dict[int, int | None] = {}
        self._by_content: dict[tuple[bytes, tuple[Wrap, Wrap]], int] = {}

    def number_of(self, bsdf: Any, name: str) -> int | None:
        """Of the image that the material of a shape of this name reflects; None if that is no bitmap."""
        if bsdf.ptr not in self._by_material:
            texture = _bitmap_of(self._mi, bsdf, name)
            self._by_material[bsdf.ptr] = None if texture is None else self._number(texture)
        return self._by_material[bsdf.ptr]

    def _number(self, texture: Texture) -> int:
        assert isinstance(texture.source, bytes)
        number = self._by_content.setdefault((texture.source, texture.wrap), len(self.textures))
        if number == len(self.textures):
            self.textures.append(texture)
        return number


def _has_texture(mi: Any, bsdf: Any) -> bool:
    """Whether any of the BSDF's parameters varies over a surface."""
    return any(name.endswith((".to_uv", ".data")) for name, _ in mi.traverse(bsdf))


def _bitmap_of(mi: Any, bsdf: Any, name: str) -> Texture | None:
    """What the BSDF reflects, as an image; None if that is no bitmap."""
    slot, parameters = _REFLECTANCE.get(bsdf.class_name()), mi.traverse(bsdf)
    if slot is None or f"{slot}.data" not in parameters:
        return None
    from PIL import Image

    height, width = parameters[f"{slot}.data"].shape[:2]
    inverse = np.linalg.inv(_matrix(parameters[f"{slot}.to_uv"]))
    # Texels are stored in many ways: what the BSDF reflects at their middles is linear in each.
    columns, encoded = (np.arange(width) + 0.5) / width, np.empty((height, width, 3), dtype=np.uint8)
    each = max(_TEXELS // width, 1)
    for first in range(0, height, each):
        rows = (np.arange(first, min(first + each, height)) + 0.5) / height
        uv = np.stack(np.broadcast_arrays(columns, rows[:, None]), axis=-1).reshape(-1, 2)
        linear = np.clip(_reflectance(mi, bsdf, _affine(inverse, uv)), 0.0, 1.0)
        encoded[first : first + each] = (encode_srgb(linear) * 255.0 + 0.5).reshape(len(rows), width, 3)
    stream = io.BytesIO()
    Image.fromarray(encoded).save(stream, "PNG")
    wrap = _wrap_of(mi, bsdf, inverse)
    return Texture(f"of shape '{name}'", stream.getvalue(), (wrap, wrap))


def _wrap_of(mi: Any, bsdf: Any, inverse: NDArray) -> Wrap:
    """How a bitmap continues, which Mitsuba does not tell: as what it looks like beyond its border."""
    rng = np.random.default_rng(0)
    beyond = rng.random((_PROBES, 2)) + rng.integers(-2, 3, (_PROBES, 2))
    folded = np.abs((beyond + 1.0) % 2.0 - 1.0)
    candidates = (beyond % 1.0, folded, np.clip(beyond, 0.0, 1.0))
    seen, *expected = (_reflectance(mi, bsdf, _affine(inverse, uv)) for uv in (beyond, *candidates))
    return _WRAPS[int(np.argmin([np.median(np.abs(one - seen).max(axis=1)) for one in expected]))]


def _reflectance(mi: Any, bsdf: Any, uv: NDArray) -> NDArray[np.float32]:
    import drjit as dr

    si = dr.zeros(mi.SurfaceInteraction3f, len(uv))
    si.uv = mi.Point2f(uv.T.astype(np.float32))
    si.wi = mi.Vector3f(0.0, 0.0, 1.0)
    return np.array(bsdf.eval_diffuse_reflectance(si), dtype=np.float32).reshape(3, -1).T


def _matrix(to_uv: Any) -> NDArray[np.float64]:
    return np.array(to_uv.matrix, dtype=np.float64).reshape(3, 3)


def _affine(matrix: NDArray, uv: NDArray) -> NDArray[np.float64]:
    return np.asarray(uv @ matrix[:2, :2].T + matrix[:2, 2])


def _transformed(mi: Any, bsdf: Any, uv: NDArray) -> NDArray[np.float64]:
    to_uv = mi.traverse(bsdf)[f"{_REFLECTANCE[bsdf.class_name()]}.to_uv"]
    return _affine(_matrix(to_uv), uv)


def _coordinates(
    mi: Any, shape: Any, positions: NDArray[np.float64], count: int, faces: NDArray[np.integer]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Texture coordinates of the faces of a part.

    Parameters
    ----------
    mi : Mitsuba, in the variant of the scene
    shape : Mitsuba shape
    positions : (n, 3)
        Of the vertices of the part, in the space of the shape.
    count : int
        Of these, those on its front.
    faces : (F', 3)
        Of these vertices.

    Returns
    -------
    uv : (F', 3, 2)
        Of the corners.
    found : (F',) bool
        Whether they could be had.
    """
    import drjit as dr

    if shape.is_mesh() and shape.vertex_count() == count and shape.has_vertex_texcoords():
        places = np.array(shape.vertex_position(dr.arange(mi.UInt32, count)), dtype=np.float64).T
        own = positions[:count]
        if np.abs(places - own).max() <= 1e-5 * max(float(np.ptp(own, axis=0).max()), 1e-300):
            given = np.array(shape.vertex_texcoord(dr.arange(mi.UInt32, count)), dtype=np.float64).T
            return given[faces % count], np.ones(len(faces), dtype=bool)
    if shape.is_mesh() and not shape.has_vertex_texcoords():
        return np.zeros((len(faces), 3, 2)), np.zeros(len(faces), dtype=bool)
    corners = positions[faces]
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
