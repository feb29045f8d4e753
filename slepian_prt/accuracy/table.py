"""What was measured on a pilot, and what it lets expect of everything else that could be chosen.

The squared error of transport is taken as a sum of what the bandlimit leaves out and of what few rays get wrong. So a
few combinations of rays and bandlimit are tried, and the others follow. The table holds numbers alone: neither a clock
nor a renderer is behind it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from slepian_prt.accuracy.trials import Choice, MeasureCoding, ToleranceTrial, TransportTrial
from slepian_prt.accuracy.tuning import TUNING, SearchTuning
from slepian_prt.sphere.harmonics import num_coefficients

# Rays and a bandlimit.
Combination = tuple[int, int]


@dataclass(frozen=True)
class CostModel:
    """How seconds grow with rays and bandlimit, on the machine that the constants were fitted on.

    Attributes
    ----------
    directions : mapping from rays to directions that a receiver looks in at first
    receivers, shadowed : int
        All, and those that are traced.
    tried : int
        Receivers that a trial traces: all of them where they depend on each other.
    by_blocks : bool
        Whether they do not.
    tuning : SearchTuning
    """

    directions: Mapping[int, int]
    receivers: int
    shadowed: int
    tried: int
    by_blocks: bool
    tuning: SearchTuning = TUNING

    def transport(self, samples: int, bandlimit: int) -> float:
        """Of all receivers: 1e-6 (α s + β M + γ n M) each, and the tables."""
        t, n, size = self.tuning, self.directions[samples], num_coefficients(bandlimit)
        each = t.ray_cost * samples + t.harmonic_cost * size + t.projection_cost * n * size
        tables = self.tables(samples, bandlimit) if self.shadowed else 0.0
        return 1e-6 * (each * self.shadowed + t.harmonic_cost * size * self.receivers) + tables + 1e-3

    def tables(self, samples: int, bandlimit: int) -> float:
        """Of the tables of a direction set, δ n M."""
        return 1e-6 * self.tuning.table_cost * self.directions[samples] * num_coefficients(bandlimit)

    def trial(self, samples: int, bandlimit: int) -> float:
        """Of a trial of transport."""
        if not self.by_blocks:
            return self.transport(samples, bandlimit)
        part = min(1.0, self.tried / self.receivers)
        return self.tables(samples, bandlimit) + part * self.transport(samples, bandlimit)

    def coding(self, bandlimit: int) -> float:
        """Of compression of all receivers."""
        return 1e-6 * self.tuning.coding_cost * num_coefficients(bandlimit) * self.receivers

    def fits(self, samples: int, bandlimit: int) -> bool:
        """Whether the tables of the direction set can be held."""
        size = self.tuning.table_bytes * self.directions[samples] * num_coefficients(bandlimit)
        return size <= self.tuning.largest_tables


@dataclass(frozen=True, eq=False)
class Table:
    """All trials so far, in their order.

    Attributes
    ----------
    model : CostModel
    samples, bandlimits : tuple of int
        What may be chosen, ascending.
    lights : tuple of str
    reference_noise : (lights,)
        Relative RMS.
    transport : tuple of TransportTrial
    choices : tuple of Choice
        Those combinations that compression was tried of.
    tuning : SearchTuning
    """

    model: CostModel
    samples: tuple[int, ...]
    bandlimits: tuple[int, ...]
    lights: tuple[str, ...]
    reference_noise: NDArray[np.float64]
    transport: tuple[TransportTrial, ...] = ()
    choices: tuple[Choice, ...] = ()
    tuning: SearchTuning = TUNING

    def with_transport(self, trial: TransportTrial) -> Table:
        """With one more trial of transport."""
        return replace(self, transport=(*self.transport, trial))

    def with_coding(self, step: MeasureCoding, coded: ToleranceTrial, cost: float) -> Table:
        """With one more choice."""
        squared = self.squared_error(step.samples, step.bandlimit)
        total = squared + coded.squared
        standard_error = self.standard_error(step.samples, step.bandlimit)
        choice = Choice(
            step,
            coded,
            np.sqrt(squared),
            np.sqrt(total),
            float(np.max(standard_error * squared / np.maximum(total, 1e-300))),
            self.transport_seconds(step.samples, step.bandlimit),
            cost,
        )
        return replace(self, choices=(*self.choices, choice))

    # --- Measured ----------------------------------------------------------------------------------------------------

    @cached_property
    def explored(self) -> dict[int, TransportTrial]:
        """By rays, the trial with the highest bandlimit; of equal ones, one that knows the noise."""
        ranked = sorted(self.transport, key=lambda trial: (trial.bandlimit, trial.noise is not None))
        return {trial.samples: trial for trial in ranked}

    def trial(self, samples: int, bandlimit: int) -> TransportTrial | None:
        """The trial that a choice may be based on: of just that, or where all was traced, of no fewer degrees."""
        if not self.model.by_blocks:
            most = self.explored.get(samples)
            return most if most is not None and most.bandlimit >= bandlimit else None
        same = [trial for trial in self.transport if (trial.samples, trial.bandlimit) == (samples, bandlimit)]
        return same[-1] if same else None

    # --- Expected ----------------------------------------------------------------------------------------------------

    @property
    def pace(self) -> float:
        """Seconds here over those of the model, as of the last trial."""
        if not self.transport:
            return 1.0
        last = self.transport[-1]
        return last.seconds / self.model.transport(last.samples, last.bandlimit)

    def transport_seconds(self, samples: int, bandlimit: int) -> float:
        """Of all receivers: measured if it was, zero if all of it is there, else roughly."""
        trial = self.trial(samples, bandlimit)
        if trial is not None:
            return trial.seconds if self.model.by_blocks else 0.0
        return self.pace * self.model.transport(samples, bandlimit)

    def seconds(self, samples: int, bandlimit: int) -> float:
        """Of transport and compression of all receivers, roughly."""
        pace = min(max(self.pace, 1.0), self.tuning.slowest_coding)
        return self.transport_seconds(samples, bandlimit) + pace * self.model.coding(bandlimit)

    def trial_seconds(self, samples: int, bandlimit: int) -> float:
        """Of a trial of transport, roughly."""
        return self.pace * self.model.trial(samples, bandlimit)

    def noise(self, samples: int, bandlimit: int) -> NDArray[np.float64]:
        """(lights,) squared error that so few rays make, roughly.

        From how much more rays helped at a low bandlimit, and from how what changes with rotations about the normals
        grows with the bandlimit.
        """
        traced = sorted(self.explored)
        if len(traced) < 2:
            return np.zeros(len(self.lights))
        exponent = self.tuning.noise_exponent
        fewer, most = self.explored[traced[-2]], self.explored[traced[-1]]
        l = min(fewer.bandlimit, most.bandlimit, bandlimit)
        ratio = (most.samples / fewer.samples) ** exponent
        of_most = np.maximum(fewer.error.squared[l] - most.error.squared[l], 0.0) / (ratio - 1.0)
        growth = np.ones_like(of_most)
        if most.noise is not None:
            reached = min(bandlimit, most.bandlimit)
            growth = np.maximum(most.noise[reached] / np.maximum(most.noise[l], 1e-300), 1.0)
        return np.asarray(of_most * growth * (most.samples / samples) ** exponent)

    def squared_error(self, samples: int, bandlimit: int) -> NDArray[np.float64]:
        """(lights,) measured where it was, else the sum of its parts; infinite above what was explored."""
        same = self.explored.get(samples)
        if same is not None and same.bandlimit >= bandlimit:
            return same.error.squared[bandlimit]
        reaching = [trial for trial in self.explored.values() if trial.bandlimit >= bandlimit]
        if not reaching:
            return np.full(len(self.lights), np.inf)
        best = max(reaching, key=lambda trial: trial.samples)
        noiseless = np.maximum(best.error.squared[bandlimit] - self.noise(best.samples, bandlimit), 0.0)
        return np.asarray(noiseless + self.noise(samples, bandlimit))

    def standard_error(self, samples: int, bandlimit: int) -> NDArray[np.float64]:
        """(lights,) relative standard errors of the error, as of the trial that is nearest."""
        reaching = [trial for trial in self.explored.values() if trial.bandlimit >= bandlimit]
        reaching = reaching or [self.explored[max(self.explored)]]
        nearest = min(reaching, key=lambda trial: abs(math.log(trial.samples / samples)))
        return nearest.error.standard_error[min(bandlimit, nearest.bandlimit)]

    @cached_property
    def worst_squared(self) -> dict[Combination, float]:
        """Largest squared error under any light, of each combination whose tables fit."""
        return {
            (s, l): float(np.max(self.squared_error(s, l)))
            for s in self.samples
            for l in self.bandlimits
            if self.model.fits(s, l)
        }

    def feasible(self, error: float, seconds: float = math.inf) -> list[Combination]:
        """Combinations whose transport is expected to have at most that error, under every light, and time."""
        return [
            c
            for c, squared in self.worst_squared.items()
            if squared <= error**2 and self.transport_seconds(*c) <= seconds
        ]
