"""Wavefront OBJ files with their materials."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError
from slepian_prt.machine.file_content import is_file
from slepian_prt.scene.formats.assembly import Polygons, Vertices, assemble, join_split, single_uv
from slepian_prt.scene.formats.files import find_beside
from slepian_prt.scene.formats.joining import group, join_equal
from slepian_prt.scene.formats.mtl import Mapped, read_mtl
from slepian_prt.scene.formats.obj_tables import Statements, read_statements
from slepian_prt.scene.formats.parts import Material, MeshFile

_FREE_FORM = {"curv", "curv2", "surf"}

# Without a meaning for polygons: parts of free-form surfaces, and how those and others are displayed.
_SILENT = _FREE_FORM | {
    "vp", "cstype", "deg", "bmat", "step", "parm", "trim", "hole", "scrv", "sp", "end", "con", "mg", "bevel",
    "c_interp", "d_interp", "lod", "shadow_obj", "trace_obj", "ctech", "stech", "usemap", "maplib", "p", "l",
}  # fmt: skip


def read_obj(path: Path) -> MeshFile:
    """Read an OBJ file: polygons, with normals, colours of vertices, and the materials of its MTL files.

    A vertex is a position with one of its normals: a position with several becomes several vertices, the first in its
    place and the others at the end; texture coordinates are the corners' and split nothing. In a file without normals
    positions that are equal are one, so that the surface is smooth across seams. Smoothing groups and groups are not
    used. Colours after the coordinates are display values (sRGB), in [0, 1] or in [0, 255].

    Raises
    ------
    UserError
        No OBJ file, numbers that cannot be read, or faces that name what does not exist, with the line.

    References
    ----------
    Wavefront, Object Files (.obj), Advanced Visualizer manual, appendix B, 1992.
    """
    said = read_statements(path)
    kinds = Counter(keyword for _, keyword, _ in said.others)
    free = sorted(_FREE_FORM & set(kinds))
    if not len(said.sizes) and free:
        raise UserError(f"{path}: has free-form surfaces ({', '.join(free)}) and no polygons; export it as polygons")
    if not len(said.sizes) and kinds["p"] + kinds["l"]:
        raise UserError(f"{path}: has points and lines and no faces; light needs surfaces, so export it as polygons")
    if not len(said.positions):
        raise UserError(f"{path}: holds no mesh that can be read; check that it is a .obj file")
    notes = _describe_left_out(kinds, free)
    notes += [f"its faces name {names}, and it has none" for names in said.dangling]
    materials, numbers = _read_materials(path, said, notes)
    vertices, corners = split_at_normals(said) if np.any(said.corners[:, 2] >= 0) else _join_positions(said)
    polygons = Polygons(said.sizes, corners, None, numbers, said.line_of)
    if any(m.material.texture or m.material.metallic_texture for m in materials):
        polygons = _map(polygons, said, materials, notes)
    return assemble(path, vertices, polygons, [m.material for m in materials], notes)


def _describe_left_out(kinds: Counter[str], free: list[str]) -> list[str]:
    notes = []
    if kinds["p"] + kinds["l"]:
        notes.append(f"{kinds['p'] + kinds['l']} points and lines left out")
    if free:
        notes.append(f"{sum(kinds[keyword] for keyword in free)} free-form surfaces ({', '.join(free)}) left out")
    unknown = sorted(set(kinds) - _SILENT - {"usemtl", "mtllib"})
    if unknown:
        shown = ", ".join(repr(keyword[:20]) for keyword in unknown[:3])
        notes.append(f"{sum(kinds[keyword] for keyword in unknown)} lines that begin with {shown} left out")
    return notes


def _read_materials(path: Path, said: Statements, notes: list[str]) -> tuple[list[Mapped], NDArray[np.int64]]:
    """Materials, and that of each polygon; -1 where the file names none, or one that no library has."""
    libraries: dict[str, Mapped] = {}
    names: list[str] = []
    uses = [(-1, "")] + [(line, rest.strip()) for line, keyword, rest in said.others if keyword == "usemtl"]
    for _, keyword, rest in said.others:
        for name in _name_libraries(path, rest) if keyword == "mtllib" else ():
            if name in names:
                continue
            names.append(name)
            library = find_beside(path, name)
            if is_file(library):
                libraries = {**read_mtl(library, notes), **libraries}
            else:
                notes.append(f"its material library {name} is {_why_not(library)}")
    lines = np.array([line for line, _ in uses])
    use = np.searchsorted(lines, said.lines) - 1
    needed = dict.fromkeys(uses[k][1] for k in np.unique(use).tolist() if k)
    known = [name for name in needed if name in libraries]
    unknown = [name for name in needed if name not in libraries]
    if unknown and libraries:
        notes.append(f"{len(unknown)} materials ({', '.join(unknown[:3])}) are in none of its libraries")
    number_of = {name: number for number, name in enumerate(known)}
    numbers = np.array([number_of.get(name, -1) for _, name in uses], dtype=np.int64)
    return [libraries[name] for name in known], numbers[use]


def _why_not(path: Path) -> str:
    """What is wrong with something that is no file."""
    try:
        return ("a folder" if path.is_dir() else "a pipe or a device") if path.exists() else "missing"
    except (OSError, ValueError):  # no file can have that name
        return "missing"


def _name_libraries(path: Path, rest: str) -> list[str]:
    """File names after mtllib: one that may hold spaces, or several."""
    whole = rest.strip().strip('"')
    if not whole or is_file(find_beside(path, whole)):
        return [whole] if whole else []
    return re.findall(r"\S.*?\.mtl(?=\s|$)", whole, re.IGNORECASE) or whole.split()


def _join_positions(said: Statements) -> tuple[Vertices, NDArray[np.int64]]:
    vertices, joined = join_split(Vertices(said.positions, None, said.colors))
    return vertices, joined[said.corners[:, 0]]


def split_at_normals(said: Statements) -> tuple[Vertices, NDArray[np.int64]]:
    """Vertices for pairs of position and normal, and those of the corners."""
    first, same = join_equal(said.normals)
    position, normal = said.corners[:, 0], np.append(same, -1)[said.corners[:, 2]]
    pairs, pair = group(position * (len(first) + 1) + normal + 1)
    place = position[pairs]
    leads = np.unique(place, return_index=True)[1]
    further = np.ones(len(pairs), dtype=bool)
    further[leads] = False
    vertex = place.copy()
    vertex[further] = len(said.positions) + np.arange(np.count_nonzero(further))
    origin = np.concatenate([np.arange(len(said.positions)), place[further]])
    normals = np.zeros((len(origin), 3))
    normals[vertex] = np.concatenate([said.normals[first], np.zeros((1, 3))])[normal[pairs]]
    colors = None if said.colors is None else said.colors[origin]
    source = np.stack([origin, np.arange(len(origin))], axis=1) if further.any() else None
    return Vertices(said.positions[origin], normals, colors, source=source), vertex[pair]


def _map(polygons: Polygons, said: Statements, materials: list[Mapped], notes: list[str]) -> Polygons:
    """Give the corners texture coordinates; polygons that have none lose the texture of their material."""
    assert polygons.materials is not None
    there = said.corners[:, 1] >= 0
    owner = np.repeat(np.arange(len(polygons.sizes)), polygons.sizes)
    bare = np.zeros(len(polygons.sizes), dtype=bool)
    bare[owner[~there]] = True
    numbers = polygons.materials.copy()
    for number, mapped in enumerate(list(materials)):
        chosen = bare & (numbers == number)
        if (mapped.material.texture or mapped.material.metallic_texture) and chosen.any():
            notes.append(f"{np.count_nonzero(chosen)} faces of {mapped.material.name} have no texture coordinates")
            numbers[chosen] = len(materials)
            materials.append(replace(mapped, material=_without_texture(mapped.material)))
    scale = np.array([m.scale for m in materials] + [(1.0, 1.0)])[numbers[owner]]
    offset = np.array([m.offset for m in materials] + [(0.0, 0.0)])[numbers[owner]]
    uv = np.where(there[:, None], np.append(said.uv, np.zeros((1, 2)), axis=0)[said.corners[:, 1]], 0.0)
    uv = uv * scale + offset
    uv[:, 1] = 1 - uv[:, 1]
    return replace(polygons, uv=single_uv(uv), materials=numbers)


def _without_texture(material: Material) -> Material:
    return replace(material, texture=None, metallic_texture=None)
