"""Pictures whose pixels are all in the file: where data end early but cleanly, Pillow makes the rest black or grey."""

from __future__ import annotations

import io
import re
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any

import numpy as np
from numpy.typing import NDArray

# A marker behind the codes of a scan of a JPEG, of which it is no part (ITU-T T.81, B.1.1).
_MARKER = re.compile(rb"\xff[^\x00\xff\xd0-\xd7]")

# Codes of something; no byte of them begins a marker.
_CODES = bytes(range(1, 250, 3)) * 4


def load_whole(image: Any, reopened: Callable[[], AbstractContextManager[Any]]) -> None:
    """Load an image of Pillow's; ``reopened`` opens it again.

    What a decoder has not written keeps the zeros that the image began with, and is in the last rows (the first, of a
    picture stored from below; the last but one, of an interlaced one). Only if there are such pixels, it is decoded
    again over another value, and what then differs is what the file does not have.

    Raises
    ------
    ValueError
        Pixels that are not in the file.
    OSError and others
        Damage that Pillow finds.
    """
    if image.format in ("JPEG", "MPO"):
        image.load()
        _check_scans(image, reopened)
        return
    boxes = [tile[1] for tile in image.tile]
    image.load()
    if image.format == "WEBP" or not boxes:  # its decoder gives whole pictures or fails
        return
    left, top = (min(box[k] for box in boxes) for k in (0, 1))
    right, bottom = (max(box[k] for box in boxes) for k in (2, 3))
    written = slice(top, bottom), slice(left, right)
    pixels = _pixels(image)[written]
    if pixels[[0, 1, -2, -1] if len(pixels) > 1 else [0]].any(axis=2).all():
        return
    with reopened() as second:
        _load_over_ones(second)
        missing = int((_pixels(second)[written] != pixels).any(axis=2).sum())
    if missing:
        whole = pixels.shape[0] * pixels.shape[1]
        raise ValueError(f"its data end after {whole - missing} of {whole} texels")


def _check_scans(image: Any, reopened: Callable[[], AbstractContextManager[Any]]) -> None:
    """Raise ValueError for a JPEG with fewer codes than pixels, which are grey then.

    Decoders ignore codes behind the last pixel. If more of them change the picture, some pixels had none. That is
    looked at if the last pixel is such a grey, so not if just a part of the last block is missing, and where there are
    several scans, which may miss detail alone.
    """
    with reopened() as second:
        second.fp.seek(0)
        content = second.fp.read()
    pixels = _pixels(image)
    last = pixels[-1, -1].astype(int)
    longer, scans = _add_codes(content)
    if scans < 2 and not (np.abs(last - 127.5) < 1.0).all():
        return
    from PIL.JpegImagePlugin import JpegImageFile

    with JpegImageFile(io.BytesIO(longer)) as more:
        more.load()
        differ = np.flatnonzero((_pixels(more) != pixels).any(axis=(1, 2)))
    if differ.size:
        raise ValueError(f"its data end early: of {len(pixels)} rows, those from {differ[0]} on are not all there")


def _add_codes(content: bytes) -> tuple[bytes, int]:
    """A JPEG with codes of something at the end of each of its scans, and how many these are."""
    pieces, begin, at, scans = [], 0, 2, 0
    while content[at : at + 1] == b"\xff" and content[at : at + 2] != b"\xff\xd9":
        after = at + 2 + int.from_bytes(content[at + 2 : at + 4], "big")
        if content[at : at + 2] == b"\xff\xff":  # padding
            after = at + 1
        elif content[at : at + 2] == b"\xff\xda":
            marker = _MARKER.search(content, after)
            after = len(content) if marker is None else marker.start()
            pieces += [content[begin:after], _CODES]
            begin, scans = after, scans + 1
        at = after
    return b"".join([*pieces, content[begin:]]), scans


def _pixels(image: Any) -> NDArray[Any]:
    """(H, W, C) as they are stored."""
    stored = np.asarray(image)
    return stored.reshape(*stored.shape[:2], -1)


def _load_over_ones(image: Any) -> None:
    """Load an image into memory that is not zero before."""
    prepare = image.load_prepare

    def prepare_ones() -> None:
        prepare()
        core = image.im
        core.paste(255 if core.bands == 1 else (255,) * core.bands, (0, 0, *core.size))

    image.load_prepare = prepare_ones
    image.load()
