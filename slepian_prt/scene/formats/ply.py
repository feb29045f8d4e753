"""PLY files, text and binary."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError
from slepian_prt.scene.formats.assembly import Polygons, Vertices, assemble, check_corners, join_split, single_uv
from slepian_prt.scene.formats.colors import decode_srgb
from slepian_prt.scene.formats.files import find_beside
from slepian_prt.scene.formats.parts import Material, MeshFile, Texture
from slepian_prt.scene.formats.ply_tables import Header, Lists, Table, read_tables

_COLORS = (("red", "green", "blue"), ("diffuse_red", "diffuse_green", "diffuse_blue"), ("r", "g", "b"))

_UV = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"), ("texture_s", "texture_t"))

_CORNERS = ("vertex_indices", "vertex_index")


def read_ply(path: Path) -> MeshFile:
    """Read a PLY file: polygons and triangle strips, with normals, colours and textures.

    Colours that are integers are display values (sRGB), and those that are floats are linear. Texture coordinates may
    be the vertices' or the corners'; v runs up, and the images are those of the comments ``TextureFile``, of which
    each face may choose one (``texnumber``). Where the vertices have texture coordinates and no normals, those of
    equal position are one: their writer split them for the texture, and normals go on across its seams. Without any,
    vertices of equal position stay as they are.

    Raises
    ------
    UserError
        Not a PLY file, one without positions, more or fewer numbers than its header declares, or faces that name
        vertices which do not exist.

    References
    ----------
    G. Turk, The PLY Polygon File Format, 1994.
    """
    header, tables = read_tables(path)
    table = tables.get("vertex", {})
    positions = _scalars(table, ("x", "y", "z"))
    if positions is None:
        raise UserError(f"{path}: its header declares no vertices with x, y and z; export the mesh again")
    vertices = Vertices(positions, _scalars(table, ("nx", "ny", "nz")), _colors(header, table))
    notes: list[str] = []
    materials = _materials(path, header)
    faces = tables.get("face", {})
    polygons = _polygons(path, tables, len(materials), notes)
    check_corners(path, polygons, len(positions))
    given = next((uv for names in _UV if (uv := _scalars(table, names)) is not None), None)
    if polygons.uv is None and given is not None:
        polygons = replace(polygons, uv=single_uv(given)[polygons.corners])
        if vertices.normals is None:
            vertices, polygons = _join_seams(vertices, polygons)
    if polygons.uv is not None:
        polygons = replace(polygons, uv=np.stack([polygons.uv[:, 0], 1 - polygons.uv[:, 1]], axis=1))
    elif materials and len(polygons.sizes):
        notes.append(f"its texture {materials[0].name} left out, as it has no texture coordinates")
        polygons, materials = replace(polygons, materials=None), []
    if materials and polygons.materials is None:
        polygons = replace(polygons, materials=np.zeros(len(polygons.sizes), dtype=np.int64))
    if any(name in faces for names in _COLORS[:2] for name in names):
        notes.append("colours of its faces left out")
    return assemble(path, vertices, polygons, materials, notes)


def _scalars(table: Table, names: tuple[str, ...]) -> NDArray[np.float64] | None:
    columns = [table.get(name) for name in names]
    arrays = [column for column in columns if isinstance(column, np.ndarray)]
    if len(arrays) < len(names):
        return None
    return np.stack([array.astype(np.float64) for array in arrays], axis=1)


def _colors(header: Header, table: Table) -> NDArray[np.float32] | None:
    """(V, 3) linear RGB."""
    types = {p.name: p.type for e in header.elements if e.name == "vertex" for p in reversed(e.properties)}
    for names in _COLORS:
        values = _scalars(table, names)
        if values is None:
            continue
        kind = types[names[0]]
        if kind.startswith("f"):
            return values.astype(np.float32)
        # Wide integers mostly hold bytes all the same.
        wide = np.dtype(kind).itemsize > 1 and values.max(initial=0) > 255
        return decode_srgb(values / (65535 if wide else 255))
    return None


def _materials(path: Path, header: Header) -> list[Material]:
    found = [re.match(r"texturefile:?\s+(.+)", comment, re.IGNORECASE) for comment in header.comments]
    names = [match[1].strip().strip('"') for match in found if match]
    return [Material(Path(name).stem, texture=Texture(name, find_beside(path, name))) for name in names]


def _polygons(path: Path, tables: dict[str, Table], textures: int, notes: list[str]) -> Polygons:
    """Polygons of the faces, with what their corners have, and of the triangle strips."""
    faces = tables.get("face", {})
    corners = _indices(path, faces) or Lists(np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64))
    uv, numbers = None, None
    wedges, chosen = faces.get("texcoord"), faces.get("texnumber")
    if isinstance(wedges, Lists) and wedges.sizes.any():
        if np.array_equal(wedges.sizes, 2 * corners.sizes):
            uv = single_uv(wedges.values.reshape(-1, 2))
        else:
            notes.append("texture coordinates of its faces left out, as some faces have not two for each corner")
    if isinstance(chosen, np.ndarray) and textures:
        inside = (chosen >= 0) & (chosen < textures)
        numbers = np.where(inside, chosen, -1).astype(np.int64)
    strips = _indices(path, tables.get("tristrips", {}))
    if strips is not None:
        triangles = _unroll_strips(strips)
        if not len(corners.sizes):
            return Polygons(np.full(len(triangles), 3, dtype=np.int64), triangles.ravel())
        notes.append(f"{len(triangles)} triangles of strips left out, as the file also has faces")
    return Polygons(corners.sizes, corners.values, uv, numbers)


def _indices(path: Path, table: Table) -> Lists | None:
    lists = next((found for name in _CORNERS if isinstance(found := table.get(name), Lists)), None)
    if lists is None:
        return None
    values = lists.values
    if values.dtype.kind == "f":
        bad = values[~(np.abs(values) < 2**31) | (values != np.trunc(values))]
        if bad.size:
            raise UserError(f"{path}: a face names vertex {bad[0]}, which is no integer; export the mesh again")
    return Lists(lists.sizes, values.astype(np.int64))


def _unroll_strips(strips: Lists) -> NDArray[np.int64]:
    """(T, 3) triangles of strips that -1 starts anew; every other one runs the other way."""
    breaks = np.cumsum(strips.sizes)[:-1]
    corners = np.insert(strips.values.astype(np.int64), breaks, -1)
    places = np.arange(len(corners))
    begins = np.maximum.accumulate(np.where(corners < 0, places + 1, 0))
    rows = np.lib.stride_tricks.sliding_window_view(corners, 3) if len(corners) >= 3 else np.empty((0, 3), np.int64)
    odd = (places - begins)[: len(rows)] % 2 == 1
    triangles = np.where(odd[:, None], rows[:, [1, 0, 2]], rows)
    distinct = (rows[:, 0] != rows[:, 1]) & (rows[:, 1] != rows[:, 2]) & (rows[:, 2] != rows[:, 0])
    return triangles[np.all(rows >= 0, axis=1) & distinct]


def _join_seams(vertices: Vertices, polygons: Polygons) -> tuple[Vertices, Polygons]:
    joined, of = join_split(vertices)
    return joined, replace(polygons, corners=of[polygons.corners])
