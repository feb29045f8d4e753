"""Whether a goal was met: the error of compressed transfer at vertices that nothing was chosen by."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slepian_prt.accuracy.trials import Choice
from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.compression.decoder import reconstruct
from slepian_prt.evaluation.vertex_error import ErrorMetric


@dataclass(frozen=True)
class Verification:
    """What was measured on vertices held out, beside what was expected.

    Attributes
    ----------
    names : tuple of str
        Of the lights.
    vertices : int
        That were held out.
    error, predicted, noise : (lights,)
        Relative RMS; of the reference its own noise.
    seconds, predicted_seconds : float
        From the first to the last but writing the file.
    """

    names: tuple[str, ...]
    vertices: int
    error: NDArray[np.float64]
    predicted: NDArray[np.float64]
    noise: NDArray[np.float64]
    seconds: float
    predicted_seconds: float

    @property
    def worst(self) -> float:
        """The largest error under any light."""
        return float(self.error.max())


def verify(
    metric: ErrorMetric, packed: CompressedTransfer, choice: Choice, started: float, predicted_seconds: float
) -> Verification:
    """Measure at the vertices of a metric what a choice led to; all ``started`` then, by `time.perf_counter`."""
    error = np.sqrt(squared_error(metric, packed))
    seconds = time.perf_counter() - started
    return Verification(
        metric.names, metric.vertices.size, error, choice.error, metric.noise, seconds, predicted_seconds
    )


def squared_error(metric: ErrorMetric, packed: CompressedTransfer) -> NDArray[np.float64]:
    """(lights,) squared relative errors of compressed transfer at the vertices of a metric."""
    vectors = reconstruct(packed, metric.vertices)
    vectors = vectors[:, None, :] if vectors.ndim == 2 else vectors
    return metric.errors(vectors).squared[packed.bandlimit]
