"""Two transfers on one page: whether they can be, and whether they are of one mesh."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.errors import UserError
from slepian_prt.scene.face_matching import ROUNDED, match_faces
from slepian_prt.scene.mesh import Mesh

# Parts of the largest side that corners of the boxes around two meshes of one model may lie apart: one may be coarser.
_APART = 0.1

# Both may have been rounded.
_TOLERANCE = 2.0 * ROUNDED


def check_pair(first: CompressedTransfer, other: CompressedTransfer) -> None:
    """Raise UserError for what cannot be seen behind one slider."""
    sizes = [None if one.film is None else (one.film.width, one.film.height) for one in (first, other)]
    if sizes[0] != sizes[1]:
        names = ["a model" if size is None else f"a picture of {size[0]} x {size[1]} pixels" for size in sizes]
        raise UserError(f"`compare_with` is {names[1]} and the file {names[0]}; compare two of a kind and size")
    if first.film is None and not _in_one_place(first.mesh, other.mesh):
        raise UserError(
            f"`compare_with` is of {other.name}, whose size or place is not that of {first.name}; compare two "
            "transfers of one model"
        )
    eyes = [np.array(one.view.to_world)[:3, 3] for one in (first, other) if one.toward_view and one.view is not None]
    if len(eyes) == 2 and not np.allclose(eyes[0], eyes[1], rtol=1e-6, atol=1e-9):
        raise UserError("`compare_with` is light toward another camera; compare two toward one camera")


def _in_one_place(mesh: Mesh, other: Mesh) -> bool:
    """Whether two meshes could be of one model: the boxes around them are much the same."""
    boxes = [np.stack([one.positions.min(axis=0), one.positions.max(axis=0)]) for one in (mesh, other)]
    extent = max(float(np.ptp(box, axis=0).max()) for box in boxes)
    return bool(np.abs(boxes[0] - boxes[1]).max() <= _APART * extent)


def label_pair(first: CompressedTransfer, other: CompressedTransfer, names: tuple[str, str]) -> tuple[str, str]:
    """What two transfers are called; of the same name, by their bytes, and of as many by which is which."""
    if names[0] == names[1]:
        own, others = (
            f"{name}, {one.file_bytes_per_vertex:.3g} bytes" for name, one in zip(names, (first, other), strict=True)
        )
        names = own, others
    return names if names[0] != names[1] else (f"{names[0]} (the file)", f"{names[1]} (compared)")


def matching_receivers(mesh: Mesh, other: Mesh) -> NDArray[np.int64] | None:
    """(V,) which vertex of another mesh each vertex is; None where they are not the same mesh, but for rounding.

    Of vertices that no face uses it is any.
    """
    if mesh.faces.shape != other.faces.shape or len(mesh.positions) != len(other.positions):
        return None
    tolerance = _TOLERANCE * float(np.ptp(mesh.positions, axis=0).max(initial=0.0))
    corners, others = mesh.positions[mesh.faces], other.positions[other.faces]
    same = np.zeros(len(mesh.positions), dtype=np.int64)
    if np.abs(corners - others).max(initial=0.0) <= tolerance:
        same[mesh.faces] = other.faces
        return same
    matched = match_faces(corners, others, tolerance)
    if np.any(matched.faces < 0):
        return None
    same[mesh.faces] = matched.of_corners(other.faces)
    return same
