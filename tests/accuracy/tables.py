"""Made-up tables: transport whose error is known in closed form, and compression that always fits."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np

from slepian_prt.accuracy.goal import Goal
from slepian_prt.accuracy.search import Choose, Refuse, Step, decide
from slepian_prt.accuracy.table import CostModel, Table
from slepian_prt.accuracy.trials import MeasureCoding, MeasureTransport, ToleranceTrial, TransportTrial
from slepian_prt.accuracy.tuning import TUNING
from slepian_prt.evaluation.vertex_error import VertexError


@dataclass(frozen=True)
class MadeUp:
    """Transport whose squared error is left_out(l) + noise(s, l): (a / (l+1)²)² + b² s^-1.5 (l+1).

    Attributes
    ----------
    left_out, noise : float
        a and b.
    floor : float
        Relative error that no bandlimit takes away.
    coding_seconds : float
    """

    left_out: float = 1.0
    noise: float = 0.3
    floor: float = 0.0
    coding_seconds: float = 1.0

    def squared(self, samples: int, bandlimit: int) -> float:
        cut = (self.left_out / (bandlimit + 1) ** 2) ** 2 + self.floor**2
        return cut + self.noise_square(samples, bandlimit)

    def noise_square(self, samples: int, bandlimit: int) -> float:
        return self.noise**2 * samples**-1.5 * (bandlimit + 1)

    def trial(self, table: Table, step: MeasureTransport, pace: float = 1.0) -> TransportTrial:
        degrees = range(step.bandlimit + 1)
        squared = np.array([[self.squared(step.samples, l)] for l in degrees])
        noise = None if step.candidate else np.array([[self.noise_square(step.samples, l)] for l in degrees])
        seconds = pace * table.model.transport(step.samples, step.bandlimit)
        cost = pace * table.model.trial(step.samples, step.bandlimit)
        return TransportTrial(step, VertexError(squared, np.full(squared.shape, 0.01)), noise, seconds, cost)

    def measure(self, table: Table, step: MeasureTransport | MeasureCoding) -> Table:
        if isinstance(step, MeasureTransport):
            return table.with_transport(self.trial(table, step))
        return table.with_coding(step, coded(step.allowance, self.coding_seconds), 0.1)


def coded(squared, seconds: float) -> ToleranceTrial:
    return ToleranceTrial(cast(Any, None), cast(Any, None), np.asarray(squared), 4.0, seconds)


def empty(receivers: int = 100_000, by_blocks: bool = True, tried: int = 6144, **changes: Any) -> Table:
    """A table in which nothing is measured yet."""
    directions = {s: s // 2 for s in TUNING.samples}
    model = CostModel(directions, receivers, receivers, tried if by_blocks else receivers, by_blocks)
    table = Table(model, TUNING.samples, TUNING.bandlimits, ("sky",), np.array([0.001]))
    return replace(table, **changes)


def search(world: MadeUp, table: Table, goal: Goal, spent: float = 0.0) -> tuple[list[Step], Table]:
    """All steps to the end, each measured; time passes as the model says."""
    steps: list[Step] = []
    while True:
        steps.append(decide(table, goal, spent))
        if isinstance(steps[-1], Choose | Refuse):
            return steps, table
        table = world.measure(table, steps[-1])
        last = table.transport[-1].cost if isinstance(steps[-1], MeasureTransport) else table.choices[-1].cost
        spent += last
        assert len(steps) < 60
