"""The camera of a page, as Python's pictures have it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.relighting.drawing.film_filter import FilmFilter
from slepian_prt.scene.sensors import view_sensor
from slepian_prt.scene.view import View

# Places of a pixel that are looked at, a power of two.
_LOOKS = 64


def camera_entry(packed: Sequence[CompressedTransfer], view: View) -> dict[str, Any]:
    """What the payload says of the camera that the page opens at; transfer toward a camera is drawn from there only."""
    known = ("to_world", "fov", "width", "height", "near", "far")
    locked = any(one.toward_view for one in packed)
    return {name: value for name, value in view.as_dict().items() if name in known} | {"locked": locked}


def antialiasing(mi: Any, view: View) -> list[list[float]]:
    """Places about the middle of a pixel, with weights that sum to one, as its film's filter is: (dx, dy, weight).

    Hammersley's points through the filter: each of 64 columns and rows of equal weight has one.
    """
    film_filter = FilmFilter.of_film(mi, view_sensor(mi, view).film())
    dx, sign_x = film_filter.sample((np.arange(_LOOKS) + 0.5) / _LOOKS)
    dy, sign_y = film_filter.sample(_bits_reversed(_LOOKS) + 0.5 / _LOOKS)
    weights = (sign_x * sign_y).astype(np.float64)
    weights /= weights.sum()
    return np.stack([dx, dy, weights], axis=1).tolist()


def _bits_reversed(count: int) -> NDArray[np.float64]:
    """(count,) 0, 1/2, 1/4, 3/4, … (van der Corput)."""
    numbers, places, size = np.arange(count), np.zeros(count), 0.5
    while numbers.any():
        places += size * (numbers & 1)
        numbers, size = numbers >> 1, size / 2
    return places
