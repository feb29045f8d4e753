"""Trials that a search may want, and what they gave.

The search reads numbers alone; the bases that a trial learnt are carried along for the run.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slepian_prt.compression.encoder import WarmStart
from slepian_prt.compression.learning import LearnedBases
from slepian_prt.evaluation.vertex_error import VertexError


@dataclass(frozen=True)
class MeasureTransport:
    """A trial of transport that is wanted.

    Attributes
    ----------
    samples, bandlimit : int
    share : float or None
        The part of a wanted error that transport may have, where this is a candidate for it.
    candidate : bool
        Whether compression is to be tried next; else this is to learn what other combinations give, and is traced
        twice, to tell noise from the rest.
    """

    samples: int
    bandlimit: int
    share: float | None = None
    candidate: bool = False


@dataclass(frozen=True, eq=False)
class MeasureCoding:
    """A trial of compression that is wanted: of the coarsest tolerance that adds no more than the allowance.

    Attributes
    ----------
    samples, bandlimit : int
    allowance : (lights,)
        What compression may add to the squared relative error.
    share : float or None
        As of `MeasureTransport`; None toward a wanted time.
    """

    samples: int
    bandlimit: int
    allowance: NDArray[np.float64]
    share: float | None = None


@dataclass(frozen=True, eq=False)
class TransportTrial:
    """What one combination of rays and bandlimit gave on the pilot.

    Attributes
    ----------
    step : MeasureTransport
    error : VertexError
        At every bandlimit up to that of the step.
    noise : (L+1, lights) or None
        What other rotations about the normals would change of the squared errors.
    seconds : float
        Expected for all receivers.
    cost : float
        Seconds that the trial itself took.
    """

    step: MeasureTransport
    error: VertexError
    noise: NDArray[np.float64] | None
    seconds: float
    cost: float

    @property
    def samples(self) -> int:
        return self.step.samples

    @property
    def bandlimit(self) -> int:
        return self.step.bandlimit


@dataclass(frozen=True, eq=False)
class ToleranceTrial:
    """What is expected of compression with one tolerance.

    Attributes
    ----------
    learned : LearnedBases
        With that tolerance.
    warm_start : WarmStart
    squared : (lights,)
        What is added to the squared relative error of relit radiance.
    bytes_per_vertex : float
        Bases and cap indices counted.
    seconds : float
        For all receivers.
    """

    learned: LearnedBases
    warm_start: WarmStart
    squared: NDArray[np.float64]
    bytes_per_vertex: float
    seconds: float

    @property
    def tolerance(self) -> float:
        return self.learned.settings.resolved_tolerance


@dataclass(frozen=True, eq=False)
class Choice:
    """Rays, bandlimit and tolerance that could be chosen, and what is expected of them.

    Attributes
    ----------
    step : MeasureCoding
    coded : ToleranceTrial
    transport_error, error : (lights,)
        Relative RMS of relit radiance, before compression and after.
    spread : float
        Largest relative standard error of ``error`` that comes from measuring some vertices only.
    transport_seconds : float
        Zero where all of it has been traced.
    cost : float
        Seconds that the trial of compression took.
    """

    step: MeasureCoding
    coded: ToleranceTrial
    transport_error: NDArray[np.float64]
    error: NDArray[np.float64]
    spread: float
    transport_seconds: float
    cost: float

    @property
    def samples(self) -> int:
        return self.step.samples

    @property
    def bandlimit(self) -> int:
        return self.step.bandlimit

    @property
    def combination(self) -> tuple[int, int]:
        """Rays and bandlimit."""
        return self.step.samples, self.step.bandlimit

    @property
    def tolerance(self) -> float:
        return self.coded.tolerance

    @property
    def worst(self) -> float:
        """The largest error under any light."""
        return float(self.error.max())

    @property
    def seconds(self) -> float:
        """Of what is left to do."""
        return self.transport_seconds + self.coded.seconds
