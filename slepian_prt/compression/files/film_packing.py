"""The pixels of a film as arrays of a file: whole numbers that deflate well, as neighbours in a picture are alike."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.scene.film import Film, film_mesh, pack_axes, unpack_axes
from slepian_prt.scene.mesh import Mesh

# Parts of the background are kept in 16 bits.
_WHOLE = (1 << 16) - 1

# Noise is kept as powers of two, this many to an octave; code 1 stands for 2^(1/8 - 24), code 0 for none.
_PER_OCTAVE = 8
_LOWEST = -24.0


def pack_film(film: Film, mesh: Mesh) -> tuple[dict[str, Any], dict[str, NDArray]]:
    """The entry of the manifest, and arrays; the axes of the pixels are the normals of their mesh."""
    entry = {
        "name": film.name,
        "width": film.width,
        "height": film.height,
        "crop": list(film.crop),
        "size": list(film.size),
        "noise_power": film.noise_power.tolist(),
    }
    background = np.rint(np.clip(film.background.T, 0.0, 1.0) * _WHOLE).astype(np.uint16)
    if np.all(background == background[0]):
        background = background[:1]
    return entry, {
        "film/axes": _differences(pack_axes(mesh.normals)),
        "film/background": _differences(background),
        "film/directions": film.directions,
        "film/noise": _differences(_noise_codes(film.noise)[None]),
    }


def unpack_film(
    entry: dict[str, Any], arrays: dict[str, NDArray], name: str, notes: tuple[str, ...]
) -> tuple[Film, Mesh]:
    """The film that `pack_film` packed, and the mesh of its pixels."""
    width, height = entry["width"], entry["height"]
    axes, background, noise = (_sums(arrays[f"film/{part}"]) for part in ("axes", "background", "noise"))
    directions = arrays["film/directions"]
    count = width * height
    film = Film(
        name=entry["name"],
        width=width,
        height=height,
        crop=tuple(entry["crop"]),
        size=tuple(entry["size"]),
        background=np.ascontiguousarray(np.broadcast_to(background, (3, count)).T / np.float32(_WHOLE)),
        directions=directions,
        noise=_noise_of(noise[0]),
        noise_power=np.array(entry["noise_power"], dtype=np.float64),
    )
    return film, film_mesh(name, width, height, unpack_axes(axes), notes)


def _noise_codes(noise: NDArray) -> NDArray[np.uint8]:
    with np.errstate(divide="ignore"):
        codes = np.rint((np.log2(noise) - _LOWEST) * _PER_OCTAVE)
    return np.where(noise > 0.0, np.clip(codes, 1, 255), 0).astype(np.uint8)


def _noise_of(codes: NDArray[np.uint8]) -> NDArray[np.float32]:
    return np.where(codes > 0, 2.0 ** (codes / _PER_OCTAVE + _LOWEST), 0.0).astype(np.float32)


def _differences(rows: NDArray) -> NDArray:
    """Each number less the one before it in its row, modulo what the type holds."""
    return np.diff(rows, axis=1, prepend=rows.dtype.type(0))


def _sums(rows: NDArray) -> NDArray:
    """What `_differences` was made from."""
    return np.cumsum(rows, axis=1, dtype=rows.dtype)
