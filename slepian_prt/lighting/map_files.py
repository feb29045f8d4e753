"""Environment maps on disk, read some rows at a time where the format allows, so that the largest need not be held."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError
from slepian_prt.files import check_readable
from slepian_prt.lighting.light_text import is_light_text
from slepian_prt.lighting.map_rows import Checked, Rows, array_rows

__all__ = ["Checked", "Rows", "array_rows", "file_rows"]


def file_rows(path: str | Path) -> Rows:
    """A map from a file: OpenEXR and PFM by blocks of rows; Radiance .hdr, PNG, JPEG and other pictures held encoded.

    The kind is told by the file's content. `formats` says what each kind is taken as.

    Raises
    ------
    UserError
        Missing, unreadable, or not twice as wide as high.
    """
    path = Path(path)
    if is_light_text(path):
        raise UserError(f"{path}: holds harmonics, and a picture is wanted here; name a map")
    wanted = "an environment map (.exr, .hdr or .png)"
    check_readable(path, wanted, f"name {wanted}")
    try:
        with path.open("rb") as file:
            start = file.read(4)
        if not start:
            raise ValueError("the file is empty")
        found = _reader(start)(path)
        found.read(0, 1)  # now, so that damage to what all rows need is found here
    except UserError:
        raise
    except Exception as error:  # the libraries raise RuntimeError for most, but also others
        raise _unreadable(path, error) from None
    return replace(found, read=_guarded(path, found.read))


def _reader(start: bytes) -> Callable[[Path], Rows]:
    """Who reads what files begin with, whatever their names; pictures are told apart by their reader.

    Each is imported when it is needed: that of pictures takes as long as all the rest of relighting.
    """
    if start.startswith(b"\x76\x2f\x31\x01"):
        from slepian_prt.lighting.formats.exr import exr_rows

        return exr_rows
    if start.startswith(b"#?"):
        from slepian_prt.lighting.formats.radiance import radiance_rows

        return radiance_rows
    if start.startswith((b"PF", b"Pf")):
        from slepian_prt.lighting.formats.pfm import pfm_rows

        return pfm_rows
    from slepian_prt.lighting.formats.pictures import picture_rows

    return picture_rows


def _guarded(path: Path, read: Callable[[int, int], NDArray[np.float32]]) -> Callable[[int, int], NDArray[np.float32]]:
    def guarded(begin: int, end: int) -> NDArray[np.float32]:
        try:
            return read(begin, end)
        except Exception as error:
            raise _unreadable(path, error) from None

    return guarded


def _unreadable(path: Path, error: Exception) -> UserError:
    if isinstance(error, PermissionError):
        return UserError(f"{path}: may not be read ({error.strerror}); change its permissions")
    reason = " ".join(str(error).split()) or type(error).__name__
    return UserError(f"{path}: cannot be read as an environment map ({reason}); write it again, best as .exr")
