"""What the surface of a model reflects between its vertices: textures, read again from where the model came from.

A transfer file keeps one albedo per vertex, filtered over the faces around it. Pictures and textured meshes want the
texture at the point that is seen; it stays in the model's own file.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError
from slepian_prt.scene.face_matching import ROUNDED, MatchedFaces, match_faces
from slepian_prt.scene.formats.parts import Material, MeshFile, MeshPart, Texture
from slepian_prt.scene.mesh import Mesh, check_faces, degenerate_faces
from slepian_prt.scene.mesh_files import MESH_SUFFIXES, file_albedo, read_parts
from slepian_prt.scene.reflectance.textures import image_size, usable_uv

log = logging.getLogger(__name__)

# Albedo that was computed twice from the same file differs by rounding to float16 at most.
_SAME_ALBEDO = 1e-3


@dataclass(frozen=True, eq=False)
class SurfaceDetail:
    """Reflectance on the faces of a mesh: ``colors`` x texture x (1 - ``metallic`` x metallic texture).

    Attributes
    ----------
    textures : tuple of Texture
    choice : (F,) int32
        Which of them is the reflectance of each face, encoded in sRGB; -1 for none.
    uv : (F, 3, 2) float32
        Texture coordinates of the corners, v down, as in `MeshPart`.
    colors : (F, 3, 3) float32
        Linear factor at the corners.
    metallic : (F,) float32
        Part of each face that is metal, which reflects nothing diffusely.
    metallic_choice : (F,) int32
        Which texture's blue channel, linear, is a factor of that; -1 for none.
    metallic_uv : (F, 3, 2) float32
    """

    textures: tuple[Texture, ...]
    choice: NDArray[np.int32]
    uv: NDArray[np.float32]
    colors: NDArray[np.float32]
    metallic: NDArray[np.float32]
    metallic_choice: NDArray[np.int32]
    metallic_uv: NDArray[np.float32]

    @property
    def is_textured(self) -> bool:
        """Whether any face has a texture."""
        return bool(np.any(self.choice >= 0) or np.any(self.metallic_choice >= 0))


def read_surface_detail(path: Path, mesh: Mesh) -> SurfaceDetail | None:
    """The textures of a mesh file, on the faces of the mesh that was made from it.

    Parameters
    ----------
    path : Path
        Of the mesh file, which exists.
    mesh : Mesh
        As a transfer file holds it.

    Returns
    -------
    None where the file has no textures, or where the albedo was not taken from it.

    Raises
    ------
    UserError
        The file cannot be read, or holds another mesh now.
    """
    if path.suffix.lower() not in MESH_SUFFIXES:
        return None
    file = read_parts(path)
    if not any(_textures_of(part) for part in file.parts):
        return None
    for part in file.parts:
        check_faces(part.faces, len(part.positions), str(path))
    positions, faces = _joined(file)
    kept = np.flatnonzero(~degenerate_faces(positions, faces))
    matched = _match(mesh, positions[faces[kept]])
    if matched is None:
        raise UserError(f"{path}: is another mesh than the one that was precomputed; precompute it again")
    albedo = matched.of_corners(file_albedo(file)[faces[kept]])
    if np.abs(albedo - mesh.albedo[mesh.faces]).max(initial=0.0) > _SAME_ALBEDO:
        log.info("%s: its textures are not drawn, because `albedo` was given instead of them", path)
        return None
    detail = _detail_of(file)
    own: dict[str, Any] = {
        name: getattr(detail, name)[kept][matched.faces] for name in ("choice", "metallic", "metallic_choice")
    }
    own |= {name: matched.of_corners(getattr(detail, name)[kept]) for name in ("uv", "colors", "metallic_uv")}
    return replace(detail, **own)


def _joined(file: MeshFile) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Vertices and faces of all parts, one after the other, as `read_mesh` numbers them."""
    counts = np.array([len(part.positions) for part in file.parts])
    starts = np.cumsum(counts) - counts
    positions = np.concatenate([part.positions for part in file.parts])
    return positions, np.concatenate([part.faces + start for part, start in zip(file.parts, starts, strict=True)])


def _match(mesh: Mesh, others: NDArray[np.float64]) -> MatchedFaces | None:
    """Which of other faces (F, 3, 3) each one of a mesh is; None if they are not the same, but for rounding."""
    corners = mesh.positions[mesh.faces]
    if corners.shape != others.shape:
        return None
    tolerance = ROUNDED * float(np.ptp(others.reshape(-1, 3), axis=0).max(initial=0.0))
    if np.abs(corners - others).max(initial=0.0) <= tolerance:  # in the same order
        return MatchedFaces(np.arange(len(corners)), np.tile(np.arange(3), (len(corners), 1)))
    matched = match_faces(corners, others, tolerance)
    return None if np.any(matched.faces < 0) else matched


def _textures_of(part: MeshPart) -> list[Texture]:
    """What a part has of textures that can be looked up."""
    if part.material is None or part.uv is None:
        return []
    return [texture for texture in (part.material.texture, part.material.metallic_texture) if texture is not None]


def _detail_of(file: MeshFile) -> SurfaceDetail:
    """Detail of all parts; textures that cannot be read count as white, and as no metal."""
    usable: dict[int, tuple[int, Texture]] = {}
    for texture in (texture for part in file.parts for texture in _textures_of(part)):
        if id(texture) in usable:
            continue
        try:
            image_size(texture)
        except UserError as error:
            log.info("%s; it is not drawn", error)
            continue
        usable[id(texture)] = (len(usable), texture)
    numbers = {key: number for key, (number, _) in usable.items()}
    pieces = [_piece(part, numbers) for part in file.parts]
    return SurfaceDetail(
        tuple(texture for _, texture in usable.values()),
        *(np.concatenate([piece[i] for piece in pieces]) for i in range(6)),
    )


def _piece(part: MeshPart, numbers: dict[int, int]) -> tuple[NDArray, ...]:
    """The arrays of `SurfaceDetail` for one part."""
    count, material = len(part.faces), part.material or Material("")
    nowhere = np.zeros((count, 3, 2), dtype=np.float32)
    uv = nowhere if part.uv is None else usable_uv(part.uv).astype(np.float32)
    metallic_uv = uv if part.metallic_uv is None else usable_uv(part.metallic_uv).astype(np.float32)
    has_uv = part.uv is not None
    choice = numbers.get(id(material.texture), -1) if has_uv and material.texture is not None else -1
    metal = numbers.get(id(material.metallic_texture), -1) if has_uv and material.metallic_texture is not None else -1
    lost = material.metallic_texture is not None and metal < 0
    colors = np.broadcast_to(np.array(material.color, dtype=np.float32), (count, 3, 3))
    if part.colors is not None:
        colors = colors * np.nan_to_num(part.colors)[part.faces]
    return (
        np.full(count, choice, dtype=np.int32),
        uv,
        np.ascontiguousarray(colors, dtype=np.float32),
        np.full(count, 0.0 if lost else material.metallic, dtype=np.float32),
        np.full(count, metal, dtype=np.int32),
        metallic_uv,
    )
