"""Pictures whose pixels are all in the file: Pillow leaves the others black, where data end early but cleanly."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any

import numpy as np
from numpy.typing import NDArray

# Their decoders give whole pictures or fail.
_ALL_OR_NOTHING = ("JPEG", "MPO", "WEBP")


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
    boxes = [tile[1] for tile in image.tile]
    image.load()
    if image.format in _ALL_OR_NOTHING or not boxes:
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
