"""Environment maps on disk and in memory, read some rows at a time, so that the largest need not be held."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slepian_prt.errors import UserError
from slepian_prt.renderer.variants import bitmap_module

# More negative energy than this part of the positive is no rounding of an encoder but a broken map.
_NEGATIVE_TOLERANCE = 1e-3

# Texels of a block of rows, and rows that compressed blocks of OpenEXR end at.
_BLOCK = 1 << 21
_EXR_ROWS = 256

_EXR_MAGIC = b"\x76\x2f\x31\x01"


@dataclass(frozen=True)
class Rows:
    """A latitude-longitude map of radiance, by blocks of rows.

    Attributes
    ----------
    name, origin : str
        For users: the map, and where it is from.
    height, width : int
    read : callable
        Gives rows ``begin : end`` as (end - begin, W, 3) float32.
    """

    name: str
    origin: str
    height: int
    width: int
    read: Callable[[int, int], NDArray[np.float32]]

    def __post_init__(self) -> None:
        if self.width != 2 * self.height:
            raise UserError(
                f"{self.origin}: is {self.width} x {self.height} texels; a latitude-longitude map is twice as wide as "
                "high, so convert it (a cube map or light probe needs to be resampled) or crop it"
            )

    def blocks(self) -> Iterator[NDArray[np.float32]]:
        """All rows from the top, a block at a time."""
        rows = max(1, _BLOCK // self.width)
        if rows >= _EXR_ROWS:
            rows -= rows % _EXR_ROWS
        for begin in range(0, self.height, rows):
            yield self.read(begin, min(begin + rows, self.height))


class Checked:
    """The blocks of a map without negative texels; says at the end whether what was negative matters.

    Attributes
    ----------
    clamped : int
        Texels that were set to zero so far.
    """

    def __init__(self, rows: Rows, clamp_negative: bool) -> None:
        self.rows = rows
        self.clamp_negative = clamp_negative
        self.clamped = 0

    def __iter__(self) -> Iterator[NDArray[np.float32]]:
        """
        Raises
        ------
        UserError
            NaN or infinite texels, or (unless ``clamp_negative``) negative ones that matter.
        """
        rows = self.rows
        lost = kept = lowest = 0.0
        first = 0
        for block in rows.blocks():
            finite = np.isfinite(block).all(axis=2)
            if not finite.all():
                row, column = np.argwhere(~finite)[0]
                raise UserError(
                    f"{rows.origin}: texels are NaN or infinite, the first in row {first + row}, column {column}; "
                    "repair the map"
                )
            if (least := float(block.min(initial=0.0))) < 0.0:
                lowest = min(lowest, least)
                self.clamped += int((block < 0.0).any(axis=2).sum())
                sine = _sines(first, block, rows.height)
                lost -= float(np.sum(np.minimum(block, 0.0) * sine))
                block = np.maximum(block, 0.0)
            kept += float(np.einsum("rwc,r->", block, _sines(first, block, rows.height)[:, 0, 0], optimize=True))
            first += len(block)
            yield block
        if lost > _NEGATIVE_TOLERANCE * kept and not self.clamp_negative:
            raise UserError(
                f"{rows.origin}: {self.clamped} texels are negative (down to {lowest:.4g}) and amount to "
                f"{lost / max(kept, 1e-30):.1%} of the light; repair the map, or pass `clamp_negative` to set them to "
                "zero"
            )


def _sines(first: int, block: NDArray, height: int) -> NDArray[np.float64]:
    """(rows, 1, 1) solid angle of the texels of a block, but for a factor."""
    return np.asarray(np.sin((first + np.arange(len(block)) + 0.5) * np.pi / height)[:, None, None])


def array_rows(texels: ArrayLike, name: str, origin: str) -> Rows:
    """An array (H, W), (H, W, 1) or (H, W, 3) of radiance."""
    image = np.asarray(texels)
    if image.ndim == 2:
        image = image[..., None]
    if image.ndim != 3 or image.shape[2] not in (1, 3) or image.shape[0] == 0:
        raise UserError(f"{origin}: an environment map has shape (H, 2H, 3), not {np.shape(texels)}")
    if image.dtype.kind not in "fiub":
        raise UserError(f"{origin}: texels must be real numbers, not {image.dtype}")

    def read(begin: int, end: int) -> NDArray[np.float32]:
        part = image[begin:end].astype(np.float32)
        return np.broadcast_to(part, (*part.shape[:2], 3))

    return Rows(name, origin, image.shape[0], image.shape[1], read)


def file_rows(path: str | Path) -> Rows:
    """A file: .exr by blocks of rows; .hdr, .png, .jpg and others that Mitsuba reads, decoded as a whole.

    Raises
    ------
    UserError
        Missing, unreadable, or not twice as wide as high.
    """
    path = Path(path)
    if path.is_dir():
        raise UserError(f"{path}: is a folder; name an environment map (.exr, .hdr or .png)")
    if not path.is_file():
        raise UserError(f"{path}: no such file; name an environment map (.exr, .hdr or .png)")
    try:
        with path.open("rb") as file:
            is_exr = file.read(4) == _EXR_MAGIC
        found = _exr_rows(path) if is_exr else _bitmap_rows(path)
        found.read(0, 1)  # now, so that damage to what all rows need is found here
    except UserError:
        raise
    except Exception as error:  # the libraries raise RuntimeError for most, but also others
        raise _unreadable(path, error) from None
    return replace(found, read=_guarded(path, found.read))


def _guarded(path: Path, read: Callable[[int, int], NDArray[np.float32]]) -> Callable[[int, int], NDArray[np.float32]]:
    def guarded(begin: int, end: int) -> NDArray[np.float32]:
        try:
            return read(begin, end)
        except Exception as error:
            raise _unreadable(path, error) from None

    return guarded


def _unreadable(path: Path, error: Exception) -> UserError:
    reason = " ".join(str(error).split()) or type(error).__name__
    return UserError(f"{path}: cannot be read as an environment map ({reason}); convert it to .exr")


# --- OpenEXR ---------------------------------------------------------------------------------------------------------


def _exr_rows(path: Path) -> Rows:
    import Imath
    import OpenEXR

    with OpenEXR.File(str(path), header_only=True) as file:
        header = dict(file.header())  # emptied when the file is closed
        sampling = {c.name: (c.xSampling, c.ySampling) for c in header["channels"]}
    names = _colours(list(sampling))
    if any(sampling[name] != (1, 1) for name in names):
        raise ValueError("its colours are subsampled")
    (left, top), (right, bottom) = (corner.tolist() for corner in header["dataWindow"])
    height, width = bottom - top + 1, right - left + 1
    to_srgb = _to_srgb(header.get("chromaticities"))
    image = OpenEXR.InputFile(str(path))
    kind = Imath.PixelType(Imath.PixelType.FLOAT)

    def read(begin: int, end: int) -> NDArray[np.float32]:
        parts = image.channels(names, kind, top + begin, top + end - 1)
        texels = np.stack([np.frombuffer(part, np.float32).reshape(end - begin, width) for part in parts], axis=-1)
        if to_srgb is not None:
            texels = texels @ to_srgb.T.astype(np.float32)
        return np.broadcast_to(texels, (*texels.shape[:2], 3))

    return Rows(path.stem, str(path), height, width, read)


def _colours(names: list[str]) -> list[str]:
    """The channels of red, green and blue, of luminance alone, or those of the only layer that has colours."""
    if {"R", "G", "B"} <= set(names):
        return ["R", "G", "B"]
    if "Y" in names and not {"RY", "BY"} & set(names):
        return ["Y"]
    layers = [name[:-1] for name in names if name.endswith(".R") and {name[:-1] + c for c in "GB"} <= set(names)]
    if len(layers) == 1:
        return [layers[0] + c for c in "RGB"]
    raise ValueError(f"it has the channels {', '.join(names)}, not R, G and B")


def _to_srgb(chromaticities: Any) -> NDArray[np.float64] | None:
    """(3, 3) from the primaries of a file to those of sRGB (ITU-R BT.709); None if they are the same."""
    if chromaticities is None:
        return None
    given = np.array([float(x) for x in np.ravel(np.array(chromaticities, dtype=np.float64))]).reshape(4, 2)
    usual = np.array([[0.64, 0.33], [0.30, 0.60], [0.15, 0.06], [0.3127, 0.3290]])
    if np.abs(given - usual).max() < 1e-3:
        return None

    def to_xyz(xy: NDArray) -> NDArray[np.float64]:
        xyz = np.column_stack([xy, 1.0 - xy.sum(axis=1)]).T / xy[:, 1]
        return np.asarray(xyz[:, :3] * np.linalg.solve(xyz[:, :3], xyz[:, 3]))

    return np.asarray(np.linalg.solve(to_xyz(usual), to_xyz(given)))


# --- Other formats ---------------------------------------------------------------------------------------------------


def _bitmap_rows(path: Path) -> Rows:
    mi = bitmap_module()
    bitmap = mi.Bitmap(str(path))
    width, height = (int(n) for n in bitmap.size())
    encoded = np.array(bitmap, copy=False)

    def read(begin: int, end: int) -> NDArray[np.float32]:
        # A view of some rows as a bitmap of its own, so that only they are converted.
        part = mi.Bitmap(np.ascontiguousarray(encoded[begin:end]), pixel_format=bitmap.pixel_format())
        part.set_srgb_gamma(bitmap.srgb_gamma())
        linear = part.convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32, srgb_gamma=False)
        return np.array(linear)

    return Rows(path.stem, str(path), height, width, read)
