"""How the numbers of a PNG are encoded: its chunks before the pixels (W3C, PNG Specification, third edition)."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slepian_prt.errors import UserError
from slepian_prt.lighting.formats.primaries import SRGB

MAGIC = b"\x89PNG\r\n\x1a\n"

Transfer = Callable[[NDArray[np.float64]], NDArray[np.float64]]


@dataclass(frozen=True)
class PngEncoding:
    """What the chunks say.

    Attributes
    ----------
    width, height : int
    depth : int
        Bits of a number.
    decode : callable
        From numbers in [0, 1] to linear light.
    chromaticities : (4, 2), or None
        None for those of sRGB.
    profiled : bool
        Whether an ICC profile counts instead.
    """

    width: int
    height: int
    depth: int
    decode: Transfer
    chromaticities: NDArray[np.float64] | None
    profiled: bool


def decode_srgb(encoded: NDArray[np.float64]) -> NDArray[np.float64]:
    """Linear light from sRGB (IEC 61966-2-1)."""
    return np.asarray(np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4))


def read_encoding(path: Path) -> PngEncoding:
    """What a PNG says of its numbers; of several chunks the first of cICP, iCCP, sRGB counts, and then gAMA with cHRM.

    Raises
    ------
    UserError
        An encoding of another range than an ordinary picture's (PQ, HLG).
    ValueError
        Chunks that are cut short.
    """
    chunks = _read_chunks(path)
    try:
        width, height, depth = struct.unpack_from(">IIB", chunks["IHDR"])
        gamma = struct.unpack(">I", chunks["gAMA"])[0] / 1e5 if "gAMA" in chunks else 0.0
        chromaticities = None
        if "cHRM" in chunks:
            numbers = np.array(struct.unpack(">8I", chunks["cHRM"])) / 1e5
            chromaticities = np.roll(numbers.reshape(4, 2), -1, axis=0)  # white comes first there
        if "cICP" in chunks:
            decode, chromaticities = _of_code_points(path, chunks["cICP"])
            return PngEncoding(width, height, depth, decode, chromaticities, profiled=False)
    except (KeyError, struct.error):
        raise ValueError("its chunks are damaged") from None
    if "iCCP" in chunks or "sRGB" in chunks:
        return PngEncoding(width, height, depth, decode_srgb, None, profiled="iCCP" in chunks)
    decode = _power(1.0 / gamma) if gamma > 0.0 else decode_srgb
    return PngEncoding(width, height, depth, decode, chromaticities, profiled=False)


def _read_chunks(path: Path) -> dict[str, bytes]:
    """The first chunk of each kind, up to the pixels."""
    chunks: dict[str, bytes] = {}
    with path.open("rb") as file:
        file.seek(len(MAGIC))
        while len(head := file.read(8)) == 8:
            size, kind = struct.unpack(">I4s", head)
            if kind in (b"IDAT", b"IEND"):
                break
            if kind in (b"IHDR", b"gAMA", b"cHRM", b"sRGB", b"iCCP", b"cICP"):
                chunks.setdefault(kind.decode("ascii"), file.read(size))
                file.seek(4, 1)
            else:
                file.seek(size + 4, 1)
    return chunks


def _power(exponent: float) -> Transfer:
    return lambda encoded: np.asarray(encoded**exponent)


def _of_code_points(path: Path, chunk: bytes) -> tuple[Transfer, NDArray[np.float64] | None]:
    """What a chunk cICP says in the code points of ITU-T H.273."""
    primaries, transfer = struct.unpack_from("BB", chunk)
    white = [0.3127, 0.3290]
    known = {
        1: SRGB,
        9: np.array([[0.708, 0.292], [0.170, 0.797], [0.131, 0.046], white]),
        12: np.array([[0.680, 0.320], [0.265, 0.690], [0.150, 0.060], white]),
    }
    transfers = {4: _power(2.2), 5: _power(2.8), 8: _power(1.0), 13: decode_srgb}
    if transfer not in transfers or primaries not in known:
        name = {16: "PQ", 18: "HLG"}.get(transfer, f"cICP {primaries}, {transfer}")
        raise UserError(f"{path}: is a PNG encoded as {name}, which is not read; convert it to .exr")
    return transfers[transfer], known[primaries]
