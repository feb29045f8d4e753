"""Results of tasks as they come in, some of them fetched ahead of being looked at."""

from __future__ import annotations

import contextlib
import queue
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from slepian_prt.distributed.held import NotHeldError
from slepian_prt.distributed.roster import GLANCE, Roster
from slepian_prt.errors import UserError

if TYPE_CHECKING:
    from distributed import Client, Future

# Fetches at a time, and results in all of them, as long as they are not bigger than so many bytes: one after the other
# a client gets 150 results in a second, whatever their size, since it asks the scheduler and then a worker for each.
_FETCHES, _MOST, _BYTES = 4, 64, 1 << 27

# Seconds between looks at the workers while results come in.
_LOOK = 5.0


class _Fetched(NamedTuple):
    numbers: list[int]
    results: list[Any] | BaseException


class Inflow:
    """What tasks become.

    Parameters
    ----------
    client : distributed.Client
    roster : Roster
    futures : sequence of Future
    bring_again : callable
        Given the name of a shared value that no worker holds any more.
    """

    def __init__(
        self, client: Client, roster: Roster, futures: Sequence[Future], bring_again: Callable[[str], None]
    ) -> None:
        self._client, self._roster, self._futures, self._bring_again = client, roster, futures, bring_again
        self._arrived: queue.SimpleQueue[int | _Fetched] = queue.SimpleQueue()
        self._finished: deque[int] = deque()
        self._fetches = self._coming = 0
        self._room = _FETCHES  # until it is known how big results are
        self._next_look = 0.0

    def results(self) -> Iterator[tuple[int, Any]]:
        """Number and result of each task."""
        left = len(self._futures)
        self._roster.awaited += left
        self._roster.deaths = 0
        try:
            for number in range(left):
                self._watch(number)
            while left:
                for number, result in self._take():
                    left -= 1
                    self._roster.awaited -= 1
                    yield number, result
        finally:
            self._roster.awaited -= left

    def _watch(self, number: int) -> None:
        """Say so when a task is done, or was; a callback of Dask's would come at once for one that is done again."""
        state: Any = self._futures[number]._state

        async def wait() -> None:
            await state.wait()
            self._arrived.put(number)

        loop: Any = self._client.loop
        loop.add_callback(wait)

    def _take(self) -> list[tuple[int, Any]]:
        """Results that have come, perhaps none, once anything has."""
        self._fetch_more()
        arrived = self._next()
        if isinstance(arrived, int):
            if self._is_done(arrived):
                self._finished.append(arrived)
            return []
        numbers, results = arrived
        self._fetches -= 1
        self._coming -= len(numbers)
        from dask.sizeof import sizeof
        from distributed import CancelledError, KilledWorker

        if isinstance(results, NotHeldError | KilledWorker | CancelledError):
            # Workers died that had them, and something stands against doing them again: what, is seen at each.
            for number in numbers:
                self._arrived.put(number)
            return []
        if isinstance(results, BaseException):
            raise results
        self._room = max(1, min(_MOST, _BYTES // max(map(sizeof, results))))
        return list(zip(numbers, results, strict=True))

    def _next(self) -> int | _Fetched:
        while True:
            if time.monotonic() > self._next_look:
                self._client.sync(self._roster.check)
                self._next_look = time.monotonic() + _LOOK
            with contextlib.suppress(queue.Empty):
                return self._arrived.get(timeout=GLANCE)
            self._next_look = 0.0

    def _fetch_more(self) -> None:
        while self._finished and self._fetches < _FETCHES and self._coming < self._room:
            count = min(len(self._finished), self._room - self._coming)
            numbers = [self._finished.popleft() for _ in range(count)]
            self._fetches += 1
            self._coming += count
            loop: Any = self._client.loop
            loop.add_callback(self._fetch, numbers)

    async def _fetch(self, numbers: list[int]) -> None:
        futures = [self._futures[number] for number in numbers]
        results: list[Any] | BaseException
        try:
            gathered: Any = self._client.gather(futures, direct=self._roster.is_direct, asynchronous=True)
            results = await self._roster.wait_for(gathered)
        except BaseException as error:  # raised where results are taken
            results = error
        self._arrived.put(_Fetched(numbers, results))

    def _is_done(self, number: int) -> bool:
        """Whether there is a result; if what stands against it can be put right, it is done again."""
        from distributed import KilledWorker

        future = self._futures[number]
        if future.status == "finished":
            self._roster.deaths = 0
            return True
        if future.status == "cancelled":
            self._roster.check_scheduler_is_there()
            raise UserError("tasks were cancelled by somebody else; start the command again")
        if future.status == "error":
            fault = future.exception()
            if isinstance(fault, NotHeldError):
                self._bring_again(fault.name)
            elif not isinstance(fault, KilledWorker):
                future.result()
            self._client.sync(self._retry, future)
            self._client.sync(self._roster.check)
        self._watch(number)  # also if it is lost, which is what Dask says until it is done again
        return False

    async def _retry(self, future: Future) -> None:
        """As the client does, which asks for the futures of all tasks that are done again, also of those let go."""
        scheduler: Any = self._client.scheduler
        for key in await scheduler.retry(keys=[future.key], client=self._client.id):
            if (state := self._client.futures.get(key)) is not None:
                state.retry()
