"""Two transfers on one page: whether they can be, and whether they are of one mesh."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.errors import UserError
from slepian_prt.scene.face_matching import ROUNDED, match_faces
from slepian_prt.scene.mesh import Mesh

# Both may have been rounded.
_TOLERANCE = 2.0 * ROUNDED


def check_pair(first: CompressedTransfer, other: CompressedTransfer) -> None:
    """Raise UserError for what cannot be seen behind one slider."""
    sizes = [None if one.film is None else (one.film.width, one.film.height) for one in (first, other)]
    if sizes[0] != sizes[1]:
        names = ["a model" if size is None else f"a picture of {size[0]} x {size[1]} pixels" for size in sizes]
        raise UserError(f"`compare_with` is {names[1]} and the file {names[0]}; compare two of a kind and size")
    eyes = [np.array(one.view.to_world)[:3, 3] for one in (first, other) if one.toward_view and one.view is not None]
    if len(eyes) == 2 and not np.allclose(eyes[0], eyes[1], rtol=1e-6, atol=1e-9):
        raise UserError("`compare_with` is light toward another camera; compare two toward one camera")


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
