"""What compression costs and loses, from coding some of the caps."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from slepian_prt.budget.transport import Look
from slepian_prt.budget.yardstick import Yardstick
from slepian_prt.compression.grouping import Grouping
from slepian_prt.compression.light_prior import LightPrior
from slepian_prt.compression.pilot import pilot_vertices
from slepian_prt.compression.prediction import Expectation
from slepian_prt.compression.settings import Settings
from slepian_prt.compression.store import MemoryStore
from slepian_prt.compression.work import Trial, Work
from slepian_prt.transport.transfer import Ready

# Vertices in the caps that are coded on trial: at least so many, and this part of all.
_TRIED = 2000
_PART_TRIED = 0.04

# How often all caps are coded until the step is right, on average.
_PASSES = 1.7

# A tolerance is tried again if it was off by more than this.
_CLOSE = 0.04

Prior = Callable[[int], LightPrior | None]


@dataclass(frozen=True)
class Coded:
    """What is foreseen of compression with one tolerance.

    Attributes
    ----------
    work : Work
        Ready for all blocks.
    tolerance : float
    squared : (lights,)
        Squared relative errors of relit radiance.
    bytes_per_vertex : float
        Bases and cap indices counted.
    seconds : float
        For the whole mesh.
    """

    work: Work
    tolerance: float
    squared: NDArray[np.float64]
    bytes_per_vertex: float
    seconds: float


class CodingPilot:
    """Compression of transfer that was looked at, on trial.

    Parameters
    ----------
    ready : Ready
    look : Look
    settings : Settings
        All but tolerance and light prior.
    grouping : Grouping
    prior : callable
        Gives the light prior for a bandlimit.
    yardstick : Yardstick
    """

    def __init__(
        self,
        ready: Ready,
        look: Look,
        settings: Settings,
        grouping: Grouping,
        prior: Prior,
        yardstick: Yardstick,
    ) -> None:
        self._yardstick, self._count = yardstick, len(ready.scene.mesh.positions)
        begin = time.perf_counter()
        mesh = ready.scene.mesh if look.transfer is None else look.transfer.mesh
        toward_view = look.transfer is not None and look.transfer.toward_view
        settings = replace(settings, tolerance=0.05, light_prior=prior(look.bandlimit))
        self._work = Work(settings, mesh, grouping, look.bandlimit, ready.job.seed, toward_view=toward_view)
        self._caps = self._work.some_caps(max(_TRIED, round(_PART_TRIED * self._count)))
        self._vertices = np.sort(np.concatenate([grouping.clusters.members[c] for c in self._caps]))
        of_bases = pilot_vertices(grouping.clusters, grouping.axes, ready.job.seed)
        if look.transfer is not None:
            vectors = look.transfer.vectors
            of_bases_vectors, self._vectors = vectors[of_bases], vectors[self._vertices]
        else:
            assert look.source is not None
            found = look.source.of(np.concatenate([of_bases, self._vertices]))[0][:, None, :]
            of_bases_vectors, self._vectors = found[: of_bases.size], found[of_bases.size :]
        self._work.learn(lambda _: of_bases_vectors)
        self.seconds = time.perf_counter() - begin

    def within(self, squared: NDArray) -> Coded:
        """The coarsest tolerance whose loss is at most so much, (lights,) squared relative errors."""
        whole = self._yardstick.of_coding(Expectation(self._work.energies, self._work.energies))
        tolerance = float(np.sqrt(np.min(squared / np.maximum(whole, 1e-300))))
        for _ in range(3):
            tolerance = min(max(tolerance, 1e-5), 0.9)
            found = self._tried(tolerance)
            off = float(np.sqrt(np.min(squared / np.maximum(found.squared, 1e-300))))
            if 1.0 <= off <= 1.0 + 2.0 * _CLOSE or (tolerance >= 0.9 and off >= 1.0):
                break
            tolerance *= min(off, 3.0) * (1.0 - 0.5 * _CLOSE)
        return found

    def _tried(self, tolerance: float) -> Coded:
        begin = time.perf_counter()
        work = self._work.asked(tolerance)
        while True:
            store = MemoryStore()
            nothing = np.zeros(self._vertices.size)
            store.add(0, work.block(self._vertices, self._vectors.copy(), nothing, 0))
            projected = time.perf_counter() - begin
            if not work.widened(store, {}):
                break
        trial: Trial = work.trial(store, self._caps)
        work.start = trial.start
        ratio = self._count / self._vertices.size
        return Coded(
            work,
            tolerance,
            self._yardstick.of_coding(trial.expected),
            trial.bytes + work.overhead / self._count,
            ratio * (0.5 * projected + trial.reading + _PASSES * trial.coding + trial.decoding),
        )
