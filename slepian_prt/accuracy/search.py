"""What could be chosen, what it would give and take, and the choice."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slepian_prt.accuracy.coding_pilot import Coded, CodingPilot
from slepian_prt.accuracy.goal import Goal
from slepian_prt.accuracy.transport_pilot import TransportPilot, TransportTrial
from slepian_prt.errors import UserError

# Parts of the error asked for that transport alone may make, one contender for each, if what it takes to look at it is
# at most such a part of what the best so far takes.
_PARTS = (0.75, 0.6, 0.9, 0.96)
_GOOD = 0.9
_LOOKING = 0.2
_LEAST_FOR_CODING = 0.2

# Standard errors of the pilot, and of the vertices held out, that are kept free; and what models may be off by.
_SAFE, _LIKELY = 2.0, 0.4
_MODELS_OFF = 0.03
_MOST_FREE = 0.2

# With a time to keep: how much of it is kept free, and transport of how much of the rest is looked at.
_TIME_OFF = 0.12
_FOR_LOOKING = 0.2
_HARDLY_WORSE = 1.1
_FOR_THE_WORK = 0.55
_FOR_TRIALS = 0.7
_TRIES = 4


@dataclass(frozen=True)
class Choice:
    """Rays, bandlimit and tolerance, and what is foreseen of them.

    Attributes
    ----------
    look : TransportTrial
    coded : Coded
    names : tuple of str
        Of the lights.
    transport_error, error : (lights,)
        Relative RMS of relit radiance, before compression and after.
    spread : float
        Largest relative standard error of ``error`` that comes from looking at some vertices only.
    """

    look: TransportTrial
    coded: Coded
    names: tuple[str, ...]
    transport_error: NDArray[np.float64]
    error: NDArray[np.float64]
    spread: float

    @property
    def samples(self) -> int:
        return self.look.samples

    @property
    def bandlimit(self) -> int:
        return self.look.bandlimit

    @property
    def tolerance(self) -> float:
        return self.coded.tolerance

    @property
    def worst(self) -> float:
        """The largest error under any light."""
        return float(self.error.max())

    @property
    def transport_seconds(self) -> float:
        """Zero where all of it has been traced."""
        return self.look.seconds if self.look.transfer is None else 0.0

    @property
    def seconds(self) -> float:
        """Of what is left to do."""
        return self.transport_seconds + self.coded.seconds


class Chooser:
    """Looks at what could be chosen.

    Parameters
    ----------
    transport : TransportPilot
    coding : callable
        Gives the `CodingPilot` of a `TransportTrial`.
    goal : Goal
    started : float
        When the run began, by `time.perf_counter`.
    """

    def __init__(
        self,
        transport: TransportPilot,
        coding: Callable[[TransportTrial], CodingPilot],
        goal: Goal,
        started: float,
    ) -> None:
        self._transport, self._coding, self._goal = transport, coding, goal
        self._started = started
        self.choices: list[Choice] = []

    @property
    def spent(self) -> float:
        """Seconds so far."""
        return time.perf_counter() - self._started

    def choose(self, tightened: float = 1.0) -> Choice:
        """The fastest that meets the error, or the most exact that keeps the time.

        Raises
        ------
        UserError
            Nothing meets the goal.
        """
        goal = self._goal
        if goal.error is not None:
            found = self._for_error(tightened * goal.error)
            if goal.seconds is None or self.spent + found.seconds <= goal.seconds:
                return found
        assert goal.seconds is not None
        return self._for_seconds(goal.seconds)

    # --- A wanted error ----------------------------------------------------------------------------------------------

    def _for_error(self, wanted: float) -> Choice:
        tried: set[tuple[int, int]] = set()
        # Dear looks are spared if there is something good enough, unless that turns out to be none; and if nothing is
        # safe, what is likely is better than nothing.
        for part, good, safe in ((_PARTS[0], _GOOD, _SAFE), (_GOOD, 0.0, _SAFE), (max(_PARTS), 0.0, _LIKELY)):
            self._transport.explore(part * wanted, good * wanted)
            best = self._fastest(wanted, safe, tried)
            if best is not None:
                return best
            tried.clear()
        raise self._cannot(wanted)

    def _fastest(self, wanted: float, safe: float, tried: set[tuple[int, int]]) -> Choice | None:
        """The fastest of some contenders, as many as it pays to look at; ``safe`` in standard errors."""
        transport = self._transport
        best: Choice | None = None
        for part in _PARTS:
            began = self.spent
            for _ in range(_TRIES):
                left = [c for c in transport.feasible(part * wanted) if c not in tried and self._room(*c, wanted, safe)]
                # Transport that takes as long as the best choice in all cannot lead to a better one.
                left = [c for c in left if best is None or transport.seconds(*c) < 0.9 * best.seconds]
                if not left:
                    break
                fastest = min(left, key=lambda c: transport.rough(*c))
                tried.add(fastest)
                found = self._measured(*fastest, wanted, safe)
                if found is not None:
                    if best is None or found.seconds < best.seconds:
                        best = found
                    break
            if best is not None and self.spent - began > _LOOKING * best.seconds:
                break
        return best

    def _measured(self, samples: int, bandlimit: int, wanted: float, safe: float) -> Choice | None:
        """A contender with the coarsest tolerance that meets ``wanted``, or None if there is no room for it."""
        look = self._transport.look(samples, bandlimit)
        rest = _rest(look.error.squared[bandlimit], look.error.standard_error[bandlimit], wanted, safe)
        return None if np.any(rest < (_LEAST_FOR_CODING * wanted) ** 2) else self._completed(look, rest)

    def _room(self, samples: int, bandlimit: int, wanted: float, safe: float) -> bool:
        """Whether transport is foreseen to leave room for compression."""
        transport = self._transport
        rest = _rest(transport.squared(samples, bandlimit), transport.deviation(samples, bandlimit), wanted, safe)
        return bool(np.all(rest >= (_LEAST_FOR_CODING * wanted) ** 2))

    def _completed(self, look: TransportTrial, rest: NDArray) -> Choice:
        squared, deviation = look.error.squared[look.bandlimit], look.error.standard_error[look.bandlimit]
        if look.transfer is not None and look.transfer.bandlimit > look.bandlimit:
            look = look.cut(look.bandlimit)
        coded = self._coding(look).within(rest)
        total = squared + coded.squared
        spread = float(np.max(deviation * squared / np.maximum(total, 1e-300)))
        names = self._transport.yardstick.names
        found = Choice(look, coded, names, np.sqrt(squared), np.sqrt(total), spread)
        self.choices.append(found)
        return found

    def _cannot(self, wanted: float) -> UserError:
        """What can be had, and what limits it."""
        transport = self._transport
        combinations = [(s, l) for s in transport.samples for l in transport.bandlimits if transport.fits(s, l)]
        samples, bandlimit = min(combinations, key=lambda c: float(np.max(transport.squared(*c))))
        squared = transport.squared(samples, bandlimit)
        worst = int(np.argmax(squared))
        noise = float(transport.noise(samples, bandlimit)[worst])
        best = math.sqrt(float(squared[worst]))
        # If more degrees were there and did not help, it is the rays.
        by_rays = noise > 0.5 * squared[worst] or bandlimit < transport.bandlimits[-1]
        limit = f"{samples} rays per vertex leave" if by_rays else f"bandlimit {bandlimit} leaves"
        claimed = max(best, float(transport.yardstick.noise[worst]))
        spread = claimed * float(transport.deviation(samples, bandlimit)[worst])
        offer = math.ceil(1000.0 * (claimed + _SAFE * spread) / (0.95 * max(_PARTS))) / 1000.0
        return UserError(
            f"an error of {wanted:g} cannot be met under {transport.yardstick.names[worst]}: {limit} "
            f"{claimed:.2g} ± {spread:.1g} before compression, which is the least that can be had; ask for "
            f"`max_error={offer:g}` or more, or for smoother light"
        )

    # --- A wanted time -----------------------------------------------------------------------------------------------

    def _for_seconds(self, seconds: float) -> Choice:
        transport = self._transport
        keep = (1.0 - _TIME_OFF) * seconds
        if keep <= self.spent:
            raise UserError(
                f"{seconds:g} seconds cannot be kept: loading, planning and the pilot took {self.spent:.1f}; ask for "
                f"`max_seconds={math.ceil(2.0 * self.spent)}` or more"
            )
        transport.explore(0.0, 0.0, _FOR_LOOKING * (keep - self.spent))
        fitting: list[Choice] = []
        slower = math.inf
        for _ in range(_TRIES):
            left = min(_FOR_THE_WORK * (keep - self.spent), slower)
            within = [c for c in transport.feasible(math.inf, left) if transport.rough(*c) <= left]
            if not within:
                # The fastest there is, with what is left of the time.
                within = [min(transport.feasible(math.inf), key=lambda c: transport.rough(*c))]
            exact = min(within, key=lambda c: float(np.max(transport.squared(*c))))
            # Of those that are hardly worse, the fastest.
            good = _HARDLY_WORSE**2 * float(np.max(transport.squared(*exact)))
            samples, bandlimit = min(
                (c for c in within if np.max(transport.squared(*c)) <= good), key=lambda c: transport.rough(*c)
            )
            look = transport.look(samples, bandlimit)
            found = self._completed(look, np.maximum(look.error.squared[bandlimit], 1e-6))
            fitting = [choice for choice in self.choices if self.spent + choice.seconds <= keep]
            if fitting or len(within) == 1 or self.spent > _FOR_TRIALS * keep:
                break
            slower = 0.4 * min(slower, transport.rough(samples, bandlimit), found.seconds)
        # What was kept free may be used up before nothing is done at all.
        fitting = fitting or [choice for choice in self.choices if self.spent + choice.seconds <= seconds]
        if not fitting:
            least = min(choice.seconds for choice in self.choices)
            raise UserError(
                f"{seconds:g} seconds cannot be kept: the pilot took {self.spent:.1f}, and the fastest that was found "
                f"would take {least:.1f} more; ask for `max_seconds={math.ceil(1.5 * (self.spent + least))}`"
            )
        return min(fitting, key=lambda choice: choice.worst)


def _rest(squared: NDArray, deviation: NDArray, wanted: float, safe: float) -> NDArray[np.float64]:
    """(lights,) what transport leaves of the squared error, with something kept free for what is not known well."""
    free = 1.0 - np.minimum(_MODELS_OFF + safe * deviation * squared / wanted**2, _MOST_FREE)
    return np.asarray((free * wanted) ** 2 - squared)
