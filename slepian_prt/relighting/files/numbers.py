"""Relit results as numbers, per vertex or pixel."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slepian_prt.files import atomic_output
from slepian_prt.scene.film import Film
from slepian_prt.scene.mesh import Mesh


def write_radiance(path: str | Path, mesh: Mesh, radiance: NDArray, names: Sequence[str]) -> None:
    """``.npz`` with radiance and the mesh.

    ``radiance`` (V, 3) or (B, V, 3) float32, linear RGB; ``names`` (B,) of the lights; ``positions`` (V, 3) float64,
    ``normals`` (V, 3) float32, ``faces`` (F, 3) int32.
    """
    with atomic_output(path) as file:
        np.savez(
            file,
            radiance=np.asarray(radiance, dtype=np.float32),
            names=np.array(names, dtype=np.str_),
            positions=mesh.positions,
            normals=mesh.normals.astype(np.float32),
            faces=mesh.faces,
        )


def write_film_radiance(path: str | Path, film: Film, radiance: NDArray, names: Sequence[str]) -> None:
    """``.npz`` of pixels.

    ``radiance`` (H, W, 3) or (B, H, W, 3) float32, linear RGB; ``names`` (B,) of the lights; ``coverage`` (H, W), the
    part of each pixel that the scene covers; ``noise`` (H, W) as of `Film`.
    """
    with atomic_output(path) as file:
        np.savez(
            file,
            radiance=np.asarray(film.picture(radiance), dtype=np.float32),
            names=np.array(names, dtype=np.str_),
            coverage=film.picture(film.coverage),
            noise=film.picture(film.noise),
        )
