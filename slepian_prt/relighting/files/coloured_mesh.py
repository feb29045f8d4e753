"""Meshes with a colour at each vertex, as binary ``.ply``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slepian_prt.files import atomic_output
from slepian_prt.relighting.drawing.pictures import encode_srgb
from slepian_prt.relighting.files.painted_mesh import PaintedMesh
from slepian_prt.scene.mesh import Mesh
from slepian_prt.scene.reflectance.textures import encoded_image

# Rounding of a position, relative to the size of the model, from which on float32 does not hold it: that of a model
# beside the origin is a twentieth of it, that of a georeferenced one thousands of times as large.
_MOVED = 1e-6

_NAMES = {"f4": "float", "f8": "double", "u1": "uchar", "i4": "int"}


class TextureOf(NamedTuple):
    """The texture of a whole mesh.

    Attributes
    ----------
    file : str
        Name of the image, beside the mesh.
    uv : (V, 2)
        v up, as readers of ``.ply`` have it.
    """

    file: str
    uv: NDArray[np.float64]


def write_ply(
    path: str | Path,
    mesh: Mesh,
    colours: NDArray[np.uint8],
    texture: TextureOf | None = None,
    properties: Mapping[str, NDArray] | None = None,
) -> None:
    """Write a mesh with normals, sRGB colours (V, 3) and other properties (V,) of floats, complete or not at all.

    Positions are float, or double where float would move them by more than a millionth of the model's size. Texture
    coordinates are ``s`` and ``t``, which Blender, trimesh, Mitsuba and PyMeshLab read.
    """
    more = properties or {}
    real = "f4" if fits_float32(mesh) else "f8"
    kinds = {
        **dict.fromkeys(("x", "y", "z"), real),
        **dict.fromkeys(("nx", "ny", "nz"), "f4"),
        **dict.fromkeys(("red", "green", "blue", "alpha"), "u1"),
        **dict.fromkeys(("s", "t") if texture else (), "f4"),
        **dict.fromkeys(more, "f4"),
    }
    vertices = np.empty(len(mesh.positions), dtype=[(name, f"<{kind}") for name, kind in kinds.items()])
    columns = np.hstack([mesh.positions, mesh.normals, colours, np.full((len(colours), 1), 255)])
    if texture:
        columns = np.hstack([columns, texture.uv])
    for name, values in zip(kinds, [*columns.T, *more.values()], strict=True):
        vertices[name] = values
    faces = np.empty(len(mesh.faces), dtype=[("corners", "u1"), ("indices", "<i4", 3)])
    faces["corners"], faces["indices"] = 3, mesh.faces
    header = [
        "ply",
        "format binary_little_endian 1.0",
        "comment slepian_prt",
        *([f"comment TextureFile {texture.file}"] if texture else []),
        f"element vertex {len(vertices)}",
        *(f"property {_NAMES[kind]} {name}" for name, kind in kinds.items()),
        f"element face {len(faces)}",
        "property list uchar int vertex_indices",
        "end_header",
    ]
    with atomic_output(path) as file:
        file.write(("\n".join(header) + "\n").encode())
        file.write(vertices.tobytes())
        file.write(faces.tobytes())


def as_in_source(mesh: Mesh, values: NDArray) -> tuple[Mesh, NDArray]:
    """A mesh and numbers (V, k) of its vertices with the vertices of the file that it was read from, in their order.

    Of vertices that were split, normal and numbers are the mean; those that were left out are at the origin, and no
    face uses them.
    """
    if mesh.source is None:
        return mesh, values
    before, now = mesh.source.T
    count = int(before.max()) + 1
    copies = np.maximum(np.bincount(before, minlength=count), 1)[:, None]

    def mean(values: NDArray) -> NDArray[np.float64]:
        columns = [np.bincount(before, column[now].astype(np.float64), minlength=count) for column in values.T]
        return np.stack(columns, axis=1) / copies

    normals = mean(mesh.normals)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    positions = np.zeros((count, 3))
    positions[before] = mesh.positions[now]
    first = np.full(len(mesh.positions), count, dtype=np.int64)
    np.minimum.at(first, now, before)
    own = replace(
        mesh,
        positions=positions,
        normals=np.where(length > 0.0, normals / np.maximum(length, 1e-300), 0.0),
        faces=first[mesh.faces].astype(np.int32),
        albedo=mean(mesh.albedo).astype(np.float32),
        source=None,
    )
    return own, mean(values)


def write_textured_ply(path: str | Path, painted: PaintedMesh, folder: str | Path | None = None) -> None:
    """Write a mesh, and beside it the texture that all of it has, as ``…_texture.png`` or ``.jpg``.

    An image that is there under that name with other content stays: the next is ``…_texture_2.png``.

    Parameters
    ----------
    path : path
    painted : PaintedMesh
    folder : path, optional
        Where both files are moved to afterwards, if that is another one.
    """
    texture = painted.pieces[0].texture
    assert texture is not None
    path, mesh = Path(path), painted.mesh
    content, suffix = encoded_image(texture)
    beside = path.parent if folder is None else Path(folder)
    name = _image_name(beside, f"{path.stem}_texture", suffix, content)
    counts = [len(piece.vertices) for piece in painted.pieces]
    starts = np.cumsum(counts) - counts
    vertices = np.concatenate([piece.vertices for piece in painted.pieces])
    faces = np.concatenate([piece.faces + start for piece, start in zip(painted.pieces, starts, strict=True)])
    uv = np.concatenate([piece.uv for piece in painted.pieces if piece.uv is not None]).astype(np.float64)
    colors = encode_srgb(np.concatenate([piece.colors for piece in painted.pieces]))
    split = replace(
        mesh,
        positions=mesh.positions[vertices],
        normals=mesh.normals[vertices],
        faces=faces.astype(np.int32),
        albedo=mesh.albedo[vertices],
    )
    if beside != path.parent or not (beside / name).exists():
        with atomic_output(path.with_name(name)) as file:
            file.write(content)
    place = TextureOf(name, np.column_stack([uv[:, 0], 1.0 - uv[:, 1]]))
    write_ply(path, split, (np.clip(colors, 0.0, 1.0) * 255.0 + 0.5).astype(np.uint8), place)


def _image_name(folder: Path, stem: str, suffix: str, content: bytes) -> str:
    """The first name that is free in a folder, or has just that content."""

    def is_usable(there: Path) -> bool:
        return not there.exists() or (there.is_file() and there.read_bytes() == content)

    names = (f"{stem}{suffix}" if number == 1 else f"{stem}_{number}{suffix}" for number in count(1))
    return next(name for name in names if is_usable(folder / name))


def fits_float32(mesh: Mesh) -> bool:
    """Whether float32 holds the positions, at the size of what faces use: a stray vertex elsewhere does not count."""
    positions = mesh.positions[np.any(mesh.normals != 0.0, axis=1)]
    if len(positions) == 0:
        return True
    size = float(np.linalg.norm(np.ptp(positions, axis=0)))
    with np.errstate(over="ignore"):
        moved = np.abs(positions.astype(np.float32) - positions).max()
    return bool(moved <= _MOVED * size)
