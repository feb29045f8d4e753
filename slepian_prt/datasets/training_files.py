"""Files that the training code of PIFu and ICON reads: transfer of order 2, and the faces that it belongs to.

Their transfer is t = ∫ V (n·ω)₊ Y_lm dω with harmonics of the direction turned by half a turn about z (their vectors
are (-sin θ cos φ, -sin θ sin φ, cos θ)), so that

    t_theirs = π (-1)^m t_ours,

in the same order l² + l + m and without a permutation of axes. It does not depend on the unit of length, so that one
file does for any ``scale`` of ICON. Both hand the numbers to OpenGL as 64-bit floats.

References
----------
S. Saito et al., PIFu, ICCV 2019: apps/prt_util.py, apps/render_data.py of its code.
Y. Xiu et al., ICON, CVPR 2022: lib/renderer/prt_util.py, scripts/render_single.py of its code.
"""

from __future__ import annotations

import io
from pathlib import PurePosixPath

import numpy as np
from numpy.typing import NDArray

from slepian_prt.sphere.conventions.convert import convert_sh

# Suffixes of the scan and of its folder in the data of PIFu: SUBJECT_OBJ/SUBJECT_100k.obj.
_SCAN, _FOLDER = "_100k", "_OBJ"

_DECIMALS = 8


def their_transfer(vectors: NDArray[np.float32]) -> NDArray[np.float64]:
    """(V, 9) as PIFu and ICON have it, from vectors (V, 9) of ours."""
    return convert_sh(vectors.astype(np.float64), target="pifu", quantity="transfer")


def pifu_files(name: str, vectors: NDArray[np.float32], faces: NDArray[np.int64]) -> dict[str, bytes]:
    """Files of PIFu, by their paths beside the folders of other scans.

    ``apps/render_data.py`` looks for them in SUBJECT_OBJ beside SUBJECT_100k.obj; scans of other names have a folder of
    their name.
    """
    folder = PurePosixPath(pifu_folder(name)) / "bounce"
    return {
        str(folder / "bounce0.txt"): fixed_point(their_transfer(vectors)),
        str(folder / "face.npy"): as_npy(faces),
    }


def pifu_folder(name: str) -> str:
    """Of a scan."""
    return name.removesuffix(_SCAN) + _FOLDER if name.endswith(_SCAN) else name


def icon_files(name: str, vectors: NDArray[np.float32], faces: NDArray[np.int64]) -> dict[str, bytes]:
    """Files of ICON, by their paths beside the folders of other scans, which it then does not compute itself."""
    folder = PurePosixPath(name) / "prt"
    return {
        str(folder / "bounce.npy"): as_npy(their_transfer(vectors)),
        str(folder / "face.npy"): as_npy(faces),
    }


def as_npy(array: NDArray) -> bytes:
    """What `numpy.load` reads."""
    file = io.BytesIO()
    np.save(file, array, allow_pickle=False)
    return file.getvalue()


def fixed_point(numbers: NDArray[np.float64]) -> bytes:
    """Rows of numbers (n, k) between -10 and 10 as text with eight decimals, for `numpy.loadtxt`.

    All digits at once: `numpy.savetxt`, which formats one number after the other, takes as long as the rays.
    """
    scaled = np.rint(np.abs(numbers) * 10.0**_DECIMALS).astype(np.uint32)
    text = np.empty((*numbers.shape, _DECIMALS + 4), dtype=np.uint8)
    text[..., 0] = np.where(numbers < 0.0, ord("-"), ord(" "))
    for place in (*range(_DECIMALS + 2, 2, -1), 1):
        rest = scaled // 10
        text[..., place] = scaled - 10 * rest + ord("0")
        scaled = rest
    text[..., 2] = ord(".")
    text[..., -1] = ord(" ")
    text[:, -1, -1] = ord("\n")
    return text.tobytes()
