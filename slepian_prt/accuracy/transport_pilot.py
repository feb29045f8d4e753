"""Errors and times of transport with any number of rays and any bandlimit, from looking at some of the vertices.

The squared error is taken as a sum of what the bandlimit leaves out and of what few rays get wrong. So a few
combinations are traced, cheap ones first, until what the others would give is known well enough to choose.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from slepian_prt.evaluation.vertex_error import ErrorMetric, VertexError
from slepian_prt.scene.receivers import morton
from slepian_prt.sphere.harmonics import num_coefficients
from slepian_prt.transport.direct import DirectTransfer
from slepian_prt.transport.planned import PlannedScene
from slepian_prt.transport.transfer import Transfer, compute_transfer

SAMPLES = tuple(1 << e for e in range(6, 15))
BANDLIMITS = (*range(1, 11), 12, 15, 20, 25, 30, 35, 40, 45, 50)
# Bandlimits that are looked up to, one after the other.
_LOOKS = (10, 20, 30, 50)

# Vertices to choose by, more for small errors, which few vertices make most of and which take long anyway; as many are
# held out for the verification, and both are timed.
PILOT, LARGE_PILOT, SMALL_ERROR = 3072, 4096, 0.03

# A look that takes more than this part of a run that is good enough is not taken.
_SPARED = 0.12

# Largest table of what triangles of a net integrate to, in bytes.
_LARGEST_TABLE = 1.5e9

# Squared errors of few rays fall with this power of their number: between 1.3 and 1.7 on scans.
_FALLS = 1.5

# Microseconds for a vertex with s rays on n nodes and M harmonics, α s + β M + γ n M, and for the tables of a net,
# δ n M: fitted on two scans and two cores. Only ratios matter: what was timed here scales them.
_ALPHA, _BETA, _GAMMA, _DELTA = 0.083, 0.024, 3.4e-5, 3.1
# The same for compression of a vertex, which grows with M too, if tolerances are about as fine as transport is.
_CODING = 0.29

# What was timed says no more than this about compression.
_SLOWEST = 3.0

# Vertices one by one from all over a mesh share less of the tracer's caches than neighbours do.
_SCATTERED = 0.88


@dataclass(frozen=True)
class TransportTrial:
    """What was found of one combination.

    Attributes
    ----------
    samples, bandlimit : int
    error : VertexError
        At every bandlimit up to that.
    noise : (L+1, lights) or None
        What other turns about the normals would change of the squared errors.
    seconds : float
        For the whole mesh.
    source : DirectTransfer or None
        What traces it; None where vertices depend on each other.
    transfer : Transfer or None
        Where they do: all of it.
    """

    samples: int
    bandlimit: int
    error: VertexError
    noise: NDArray[np.float64] | None
    seconds: float
    source: DirectTransfer | None
    transfer: Transfer | None = None

    def cut(self, bandlimit: int) -> TransportTrial:
        """The same with fewer degrees, where all of it is there."""
        assert self.transfer is not None
        size = num_coefficients(bandlimit)
        vectors = np.ascontiguousarray(self.transfer.vectors[:, :, :size])
        error = VertexError(*(part[: bandlimit + 1] for part in self.error))
        transfer = replace(self.transfer, vectors=vectors, bandlimit=bandlimit)
        return replace(self, bandlimit=bandlimit, error=error, transfer=transfer)


def pilot_vertices(
    planned: PlannedScene, seed: int, size: int = PILOT, known: NDArray | None = None
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Vertices to choose by and others to verify on, one of each from every part of the mesh, at random.

    Without those that are ``known``; both are empty if there are no others.
    """
    receivers = np.flatnonzero(planned.scene.mesh.receivers.active)
    if known is not None:
        receivers = np.setdiff1d(receivers, known)
    if receivers.size < 2:
        return receivers, receivers
    order = receivers[np.argsort(morton(planned.scene.traced_positions[receivers]), kind="stable")]
    parts = min(size, order.size // 2)
    rng = np.random.default_rng(seed)
    bounds = np.linspace(0, order.size, parts + 1).astype(np.int64)
    # Two different places in each part.
    first = (bounds[:-1] + rng.random(parts) * np.diff(bounds)).astype(np.int64)
    step = 1 + (rng.random(parts) * (np.diff(bounds) - 1)).astype(np.int64)
    second = bounds[:-1] + (first - bounds[:-1] + step) % np.diff(bounds)
    return np.sort(order[first]), np.sort(order[second])


class TransportPilot:
    """Errors and times by number of rays and bandlimit.

    Parameters
    ----------
    planned : PlannedScene
    yardstick : ErrorMetric
    timed : (n,)
        Vertices that are traced beside those of the yardstick, for the time.
    samples, bandlimits : tuple of int
        What may be chosen.
    report : told what is looked at
    """

    def __init__(
        self,
        planned: PlannedScene,
        yardstick: ErrorMetric,
        timed: NDArray,
        samples: tuple[int, ...],
        bandlimits: tuple[int, ...],
        report: Callable[[str], None],
    ) -> None:
        self.planned, self.yardstick, self._report = planned, yardstick, report
        self.samples, self.bandlimits = samples, bandlimits
        self._timed = np.concatenate([yardstick.vertices, timed])
        self._looks: dict[int, TransportTrial] = {}  # by number of rays, the one to the highest bandlimit
        self._held: dict[int, TransportTrial] = {}  # of those that traced everything
        self._pace = 1.0  # seconds here over those that the model foresees

    # --- Looking -----------------------------------------------------------------------------------------------------

    def look(self, samples: int, bandlimit: int, *, twice: bool = False) -> TransportTrial:
        """Trace the pilot, ``twice`` to tell noise from the rest; where vertices depend on each other, all of the mesh,
        once for each number of rays."""
        held = self._held.get(samples)
        if held is not None and held.bandlimit >= bandlimit:
            return held.cut(bandlimit)
        self._report(f"pilot, {samples} rays, L = {bandlimit}")
        found = (
            self._by_blocks(samples, bandlimit, twice) if self.planned.by_blocks else self._whole(samples, bandlimit)
        )
        known = self._looks.get(samples)
        if known is None or known.bandlimit < bandlimit or (known.bandlimit == bandlimit and known.noise is None):
            self._looks[samples] = replace(found, source=None, transfer=None)
        if found.transfer is not None:
            self._held[samples] = found
        self._pace = found.seconds / self._model(samples, bandlimit)
        return found

    def _by_blocks(self, samples: int, bandlimit: int, twice: bool) -> TransportTrial:
        planned = self.planned
        begin = time.perf_counter()
        source = self.source(samples, bandlimit)
        source.estimate(self._timed[:64])  # compiles, and makes the tables
        prepared = time.perf_counter()
        vectors = source.estimate(self._timed).vectors
        took = time.perf_counter() - prepared
        count = len(planned.scene.mesh.positions)
        seconds = took * count / self._timed.size * (_SCATTERED if count > self._timed.size else 1.0)
        chosen = self.yardstick.vertices
        own, noise = vectors[: chosen.size], None
        if twice:
            other = replace(source, seed=planned.settings.seed + 1).estimate(chosen).vectors
            noise = 0.5 * self.yardstick.squared_difference(own, other)
        return TransportTrial(samples, bandlimit, self.yardstick.errors(own), noise, seconds + prepared - begin, source)

    def _whole(self, samples: int, bandlimit: int) -> TransportTrial:
        begin = time.perf_counter()
        asked = self.planned.with_settings(samples=samples, bandlimit=bandlimit)
        transfer = compute_transfer(asked)
        seconds = time.perf_counter() - begin
        error = self.yardstick.errors(transfer.vectors[self.yardstick.vertices])
        return TransportTrial(samples, bandlimit, error, None, seconds, None, transfer)

    def source(self, samples: int, bandlimit: int) -> DirectTransfer:
        """What traces so many rays, as the whole run would."""
        planned = self.planned
        nodes = planned.survey.nodes(samples)
        return DirectTransfer(planned.scene, bandlimit, nodes, planned.plan.shadowed, planned.settings.seed)

    # --- Foreseeing --------------------------------------------------------------------------------------------------

    def _model(self, samples: int, bandlimit: int) -> float:
        nodes, size = self.planned.survey.nodes(samples), num_coefficients(bandlimit)
        count = self.planned.plan.shadowed.size
        vertex = _ALPHA * samples + _BETA * size + _GAMMA * nodes * size
        tables = _DELTA * nodes * size if count else 0.0
        return 1e-6 * (vertex * count + _BETA * size * len(self.planned.scene.mesh.positions) + tables) + 1e-3

    def seconds(self, samples: int, bandlimit: int) -> float:
        """Of transport of the whole mesh, roughly; none if that is there."""
        held = self._held.get(samples)
        if held is not None and held.bandlimit >= bandlimit:
            return 0.0
        return self._pace * self._model(samples, bandlimit)

    def fits(self, samples: int, bandlimit: int) -> bool:
        """Whether the tables of the net can be held."""
        return 384.0 * self.planned.survey.nodes(samples) * num_coefficients(bandlimit) <= _LARGEST_TABLE

    @property
    def _finest(self) -> TransportTrial:
        """The look with the most rays."""
        return self._looks[max(self._looks)]

    def noise(self, samples: int, bandlimit: int) -> NDArray[np.float64]:
        """(lights,) squared error that so few rays make, roughly: from how much more rays helped at a low bandlimit,
        and how what changes with the turns about the normals grows with the bandlimit."""
        traced = sorted(self._looks)
        if len(traced) < 2:
            return np.zeros(len(self.yardstick.names))
        fewer, most = self._looks[traced[-2]], self._looks[traced[-1]]
        l = min(fewer.bandlimit, most.bandlimit, bandlimit)
        ratio = (most.samples / fewer.samples) ** _FALLS
        of_most = np.maximum(fewer.error.squared[l] - most.error.squared[l], 0.0) / (ratio - 1.0)
        grown = np.ones_like(of_most)
        if most.noise is not None:
            reached = min(bandlimit, most.bandlimit)
            grown = np.maximum(most.noise[reached] / np.maximum(most.noise[l], 1e-300), 1.0)
        return np.asarray(of_most * grown * (most.samples / samples) ** _FALLS)

    def squared(self, samples: int, bandlimit: int) -> NDArray[np.float64]:
        """(lights,) squared error, measured where that was looked at, else as the sum of its parts."""
        own = self._looks.get(samples)
        if own is not None and own.bandlimit >= bandlimit:
            return own.error.squared[bandlimit]
        reaching = [look for look in self._looks.values() if look.bandlimit >= bandlimit]
        if not reaching:
            return np.full(len(self.yardstick.names), np.inf)
        best = max(reaching, key=lambda look: look.samples)
        without = np.maximum(best.error.squared[bandlimit] - self.noise(best.samples, bandlimit), 0.0)
        return np.asarray(without + self.noise(samples, bandlimit))

    # --- Searching ---------------------------------------------------------------------------------------------------

    def rough(self, samples: int, bandlimit: int) -> float:
        """Seconds of transport and compression of the whole mesh, roughly."""
        coding = (
            1e-6
            * _CODING
            * min(max(self._pace, 1.0), _SLOWEST)
            * num_coefficients(bandlimit)
            * len(self.planned.scene.mesh.positions)
        )
        return self.seconds(samples, bandlimit) + coding

    def explore(self, target: float, good: float, seconds: float = math.inf) -> None:
        """Look until a combination is known whose error is at most ``target``, or none can be.

        If there is one that is ``good``, looks that are dear beside it are spared. Nothing is looked at that would take
        more than ``seconds`` in the whole run.
        """
        lowest = self._first_bandlimit()
        for samples in self.samples[:3:2] if self.planned.by_blocks else self.samples[:1]:
            if samples not in self._looks:
                self.look(samples, lowest, twice=True)
        while not self.feasible(target, seconds):
            move = self._next(target, seconds)
            known = [self.rough(*c) for c in self.feasible(good, seconds)]
            if move is None or (known and self._cost(*move) > _SPARED * min(known)):
                return
            self.look(*move, twice=True)

    def _next(self, target: float, seconds: float) -> tuple[int, int] | None:
        """What to look at next: more rays or more degrees, whichever matters more; more rays only if that can help."""
        bandlimit = max(look.bandlimit for look in self._looks.values())
        most = self._finest.samples
        higher = [l for l in (*_LOOKS, self.bandlimits[-1]) if bandlimit < l <= self.bandlimits[-1]][:1]
        noise = self.noise(most, bandlimit)
        left_out = np.maximum(self.squared(most, bandlimit) - noise, 0.0)
        unknown = len(self._looks) == 1
        by_noise = unknown or bool(np.max(noise) > np.max(left_out))
        helps = unknown or bool(higher) or bool(np.max(left_out) <= target**2)
        more = [s for s in self.samples if s >= 4 * most][: int(helps)]
        moves = [(s, bandlimit) for s in more] + [(most, l) for l in higher]
        moves = [m for m in moves if self.fits(*m) and self.seconds(*m) <= seconds]
        # What is worse is mended first, if it can be.
        return min(moves, key=lambda m: (m[0] > most) != by_noise, default=None)

    def _cost(self, samples: int, bandlimit: int) -> float:
        """Seconds to look."""
        if not self.planned.by_blocks:
            return self.seconds(samples, bandlimit)
        nodes, size = self.planned.survey.nodes(samples), num_coefficients(bandlimit)
        tables = 1e-6 * _DELTA * nodes * size
        part = min(1.0, self._timed.size / len(self.planned.scene.mesh.positions))
        return self._pace * (tables + part * self._model(samples, bandlimit))

    def _first_bandlimit(self) -> int:
        return min(max(_LOOKS[0], self.bandlimits[0]), self.bandlimits[-1])

    def deviation(self, samples: int, bandlimit: int) -> NDArray[np.float64]:
        """(lights,) relative standard errors of the error, as of the look that is nearest."""
        reaching = [look for look in self._looks.values() if look.bandlimit >= bandlimit] or [self._finest]
        nearest = min(reaching, key=lambda look: abs(math.log(look.samples / samples)))
        return nearest.error.standard_error[min(bandlimit, nearest.bandlimit)]

    def feasible(self, target: float, seconds: float = math.inf) -> list[tuple[int, int]]:
        """Combinations (rays, bandlimit) whose error is foreseen to be at most ``target`` under every light."""
        return [
            (s, l)
            for s in self.samples
            for l in self.bandlimits
            if self.fits(s, l) and self.seconds(s, l) <= seconds and np.max(self.squared(s, l)) <= target**2
        ]
