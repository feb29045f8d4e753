"""Whether a goal was met: the error of compressed transfer at vertices that nothing was chosen by."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slepian_prt.accuracy.trials import Choice
from slepian_prt.accuracy.vertices import NotCounted, count_left_out
from slepian_prt.compression.compressed import CompressedTransfer
from slepian_prt.compression.decoder import reconstruct
from slepian_prt.evaluation.vertex_error import ErrorMetric
from slepian_prt.transport.planned import PlannedScene


@dataclass(frozen=True)
class Verification:
    """What was measured on vertices held out, beside what was expected.

    Attributes
    ----------
    names : tuple of str
        Of the lights.
    vertices : int
        That were held out: drawn at random from all over the mesh.
    left_out : NotCounted
        Of these, how many do not count in the error.
    error, predicted, noise : (lights,)
        Relative RMS over the others; of the reference its own noise.
    seconds, predicted_seconds : float
        From the first to the last but writing the file.
    """

    names: tuple[str, ...]
    vertices: int
    left_out: NotCounted
    error: NDArray[np.float64]
    predicted: NDArray[np.float64]
    noise: NDArray[np.float64]
    seconds: float
    predicted_seconds: float

    @property
    def worst(self) -> float:
        """The largest error under any light."""
        return float(self.error.max())

    @property
    def inside_share(self) -> NDArray[np.float64]:
        """(lights,) part of the vertices held out that lie inside other geometry: about that part of the mesh does."""
        return self.left_out.inside / max(1, self.vertices)


def verify(
    planned: PlannedScene,
    metric: ErrorMetric,
    unseen: NDArray,
    packed: CompressedTransfer,
    choice: Choice,
    *,
    started: float,
    predicted_seconds: float,
) -> Verification:
    """Measure at the vertices of a metric what a choice led to.

    Parameters
    ----------
    planned : PlannedScene
    metric : ErrorMetric
        Of the vertices held out.
    unseen : (n,)
        Vertices that were held out too, but see nothing of the sky and are not in the metric.
    packed : CompressedTransfer
    choice : Choice
    started : float
        When all began, by `time.perf_counter`.
    predicted_seconds : float
    """
    error = np.sqrt(squared_error(metric, packed))
    return Verification(
        names=metric.names,
        vertices=metric.vertices.size + unseen.size,
        left_out=count_left_out(planned, metric, unseen),
        error=error,
        predicted=choice.error,
        noise=metric.noise,
        seconds=time.perf_counter() - started,
        predicted_seconds=predicted_seconds,
    )


def squared_error(metric: ErrorMetric, packed: CompressedTransfer) -> NDArray[np.float64]:
    """(lights,) squared relative errors of compressed transfer at the vertices of a metric."""
    vectors = reconstruct(packed, metric.vertices)
    return metric.errors(vectors).squared[packed.bandlimit]
