"""Rate-distortion optimised rounding: a difference is rounded up only where that is worth its bits."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.codec.contexts import MIDDLE_OCTAVE, Contexts, activities_of, magnitude_bases, usual_sizes
from slepian_prt.compression.codec.models import token_bits
from slepian_prt.compression.codec.prediction import level_activity
from slepian_prt.compression.codec.surface import CapRows, Level

# Squared steps of distortion that a bit is worth, on the finest level, and what of it on coarser ones, whose errors
# are handed down to others: best on two scans at 2 % and 5 %.
_SQUARES_PER_BIT = 0.08
_OF_DEPTHS = (1.0, 0.7, 0.5, 0.35, 0.25)

# Differences smaller than the first are zero, those larger than the second are not, whatever that costs.
_ALWAYS_ZERO, _NEVER_ZERO = 0.5, 1.2
_LARGEST_SHIFT = 0.4


class FrugalRounding:
    """Rounds differences by what the models that will code them make of it.

    Parameters
    ----------
    rows : CapRows
    classes : (caps, width) uint8
        Of the components, nearly: their sizes before such rounding.
    contexts : Contexts
    """

    def __init__(self, rows: CapRows, classes: NDArray[np.uint8], contexts: Contexts) -> None:
        self._caps, self._classes, self._contexts = rows.caps, classes, contexts
        self._usual = usual_sizes(classes)[rows.caps]
        bits = token_bits()
        worth = 0.5 * _SQUARES_PER_BIT * np.array(_OF_DEPTHS)[:, None]
        # By depth and model: rounding to one instead of zero, and to three instead of two.
        self._zero = np.clip(0.5 + worth * (bits[:, 1] - bits[:, 0]), _ALWAYS_ZERO, _NEVER_ZERO)
        self._shift = np.clip(worth * (bits[:, 3] - bits[:, 2]), 0.0, _LARGEST_SHIFT)

    def __call__(self, level: Level, apart: NDArray[np.float64], sizes: NDArray[np.float64]) -> NDArray[np.float64]:
        """Differences (rows, width) in steps, rounded; see `predict_and_round`."""
        caps = self._caps[level.rows]
        activities = activities_of(level_activity(level, sizes), self._usual[level.rows])
        bases = magnitude_bases(activities[:, None], self._classes[caps])
        models = self._contexts.of_magnitudes(bases, MIDDLE_OCTAVE)
        size = np.abs(apart)
        whole = np.maximum(np.floor(size + (0.5 - self._shift[level.depth])[models]), 1.0)
        whole[(size < self._zero[level.depth][models]) | (self._classes[caps] == 0)] = 0.0
        return np.copysign(whole, apart)
