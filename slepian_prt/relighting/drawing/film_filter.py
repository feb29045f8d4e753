"""The reconstruction filter of a film: where to sample it, and how far it reaches."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

# Places along the radius that the filter is tabulated at.
_TABULATED = 4096

# What of the filter may lie beyond its reach.
_BEYOND = 0.005


@dataclass(frozen=True, eq=False)
class FilmFilter:
    """A separable filter, in pixels from the middle of one.

    Attributes
    ----------
    places : (n,)
        Ascending, over the whole of its support.
    values : (n,)
        There; negative lobes among them.
    """

    places: NDArray[np.float64]
    values: NDArray[np.float64]

    @classmethod
    def of_film(cls, mi: Any, film: Any) -> FilmFilter:
        """That of Mitsuba's film."""
        reconstruction = film.rfilter()
        radius = float(reconstruction.radius())
        places = np.linspace(-radius, radius, 2 * _TABULATED, endpoint=False) + 0.5 * radius / _TABULATED
        return cls(
            np.asarray(places, dtype=np.float64),
            np.array(reconstruction.eval(mi.Float(places.tolist())), dtype=np.float64),
        )

    @property
    def middle_weight(self) -> float | None:
        """Weight of the middle of a pixel beside its four corners, where these five sum up what is smooth; else None.

        The rule has the filter's own moments up to the third in each direction if its weights are w and (1 - w)/4 and
        (1 - w)/4 is the variance: a Gaussian of half a pixel needs no more than the corners.
        """
        variance = float(np.sum(self.values * self.places**2) / np.sum(self.values))
        weight = 1.0 - 4.0 * variance
        return weight if -0.05 <= weight <= 0.95 else None

    @property
    def reach(self) -> int:
        """How many pixels away an edge still shows in a pixel."""
        part = np.cumsum(np.abs(self.values)) / np.sum(np.abs(self.values))
        farthest = np.abs(self.places[(part > 0.5 * _BEYOND) & (part < 1.0 - 0.5 * _BEYOND)]).max()
        return int(np.ceil(farthest - 0.5))

    def sample(self, u: NDArray) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Places whose density is the filter's magnitude, from numbers in [0, 1), and the filter's signs there."""
        step = self.places[1] - self.places[0]
        ends = np.concatenate([[self.places[0] - 0.5 * step], self.places + 0.5 * step])
        part = np.concatenate([[0.0], np.cumsum(np.abs(self.values))])
        places = np.interp(u, part / part[-1], ends)
        signs = np.sign(self.values)[np.searchsorted(ends[1:-1], places)]
        return places.astype(np.float32), np.where(signs < 0.0, -1.0, 1.0).astype(np.float32)
