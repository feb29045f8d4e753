"""Who works for a client now: workers that were admitted, those that join and die, and whether anybody is left."""

from __future__ import annotations

import asyncio
import importlib.metadata
import logging
import time
import uuid
from collections.abc import Awaitable
from typing import TYPE_CHECKING, Any, TypeVar

from slepian_prt.distributed.admission import Admission
from slepian_prt.errors import UserError

if TYPE_CHECKING:
    from distributed import Client

log = logging.getLogger(__name__)

Result = TypeVar("Result")

# Seconds between looks at whether there is anybody who works, while nothing comes in.
GLANCE = 1.0

# Seconds without any worker until the work is given up: of a cluster of ours, which starts another at once; and of
# other people's, whose queue may take some minutes.
_PATIENCE = {True: 60.0, False: 600.0}

# Workers that may die, for each there is, until one task more is finished; and at least so many.
_DEATHS, _FEWEST_DEATHS = 4, 12


class Roster:
    """The workers of a client.

    Attributes
    ----------
    name : str
        Which what is shared on these workers begins with.
    admission : Admission
    is_direct : bool
        Whether workers can be reached from here, or only the scheduler can.
    deaths : int
        Of workers, since a task was finished; set to zero by who finds one that is.
    awaited : int
        Tasks that somebody waits for: without any, nobody hears of deaths.
    """

    def __init__(self, client: Client, variant: str, *, is_ours: bool) -> None:
        self.admission = Admission(client, variant)
        self.is_direct = True
        self.deaths = self.awaited = 0
        self._client, self._is_ours = client, is_ours
        self.name = f"slepian_prt-{uuid.uuid4().hex}"
        self._chores: set[asyncio.Task[None]] = set()
        self._seen: set[str] = set()
        self._is_assembled = False
        self._alone = self._looked = 0.0  # seconds that were seen to pass without workers, and when it was looked

    async def assemble(self) -> None:
        """Examine the workers and, from now on, those that join.

        Raises
        ------
        UserError
            Naming each that has not what is needed, or the scheduler.
        """
        from slepian_prt.distributed.watch import Watch

        await self._check_scheduler()
        self._client.subscribe_topic(self.name, self._hear)
        await self._client.register_plugin(Watch(self.name, self._client.id))
        addresses = await self._first_workers()
        if refused := await self.admission.admit(addresses):
            raise UserError("; ".join(f"the worker {address} {why}" for address, why in refused.items()))
        self._is_assembled = True
        self.is_direct = self._is_ours or await self._reaches(addresses[0])

    async def dissolve(self) -> None:
        """Hear of nobody any more."""
        self._client.unsubscribe_topic(self.name)
        await self._client.unregister_scheduler_plugin(self.name)

    async def addresses(self) -> list[str]:
        """Of workers that are given work, now."""
        return [
            address
            for address, worker in (await self._workers()).items()
            if self.admission.mark in worker["resources"] and worker["status"] == "running"
        ]

    async def is_held(self, name: str) -> bool:
        """Whether any worker has what was brought under that name."""
        scheduler: Any = self._client.scheduler
        return bool((await scheduler.who_has(keys=[name])).get(name))

    async def wait_for(self, work: Awaitable[Result]) -> Result:
        """What needs workers, as long as there are any."""
        task = asyncio.ensure_future(work)
        try:
            while not (await asyncio.wait([task], timeout=GLANCE))[0]:
                await self.check()
            return await task
        except BaseException:
            task.cancel()
            raise

    async def check(self) -> None:
        """Raise UserError where nothing can come any more."""
        self.check_scheduler_is_there()
        workers = (await self._workers()).values()
        able = [worker for worker in workers if self.admission.mark in worker["resources"]]
        if self.deaths > max(_FEWEST_DEATHS, _DEATHS * len(able)):
            raise UserError(
                f"{self.deaths} workers died one after the other and nothing was finished; if they ran out of memory, "
                "use fewer on each machine"
            )
        now = time.monotonic()
        seen, self._looked = min(now - self._looked, 2 * GLANCE), now  # nobody may have looked for long
        is_alone = not any(worker["status"] == "running" for worker in able)
        if is_alone and self._alone == 0.0 and not self._is_ours:
            log.info("no worker is there to go on; waiting %.0f minutes for one", _PATIENCE[False] / 60.0)
        self._alone = self._alone + max(seen, 1e-3) if is_alone else 0.0
        if self._alone > _PATIENCE[self._is_ours]:
            if able:
                raise UserError("all workers are paused by Dask, at the limit of their memory; start them with more")
            raise UserError("all workers are gone and none came back; start others and the command again")

    def check_scheduler_is_there(self) -> None:
        """Raise UserError if the connection to it is lost."""
        if self._client.status != "running":
            raise UserError("the scheduler is gone; start it and the command again")

    async def _workers(self) -> dict[str, Any]:
        scheduler: Any = self._client.scheduler
        workers: dict[str, Any] = (await scheduler.identity(n_workers=-1))["workers"]
        self._seen &= workers.keys()
        if self._is_assembled:  # some were there, but not running, or have come before we could hear of it
            for address, worker in workers.items():
                if worker["status"] == "running" and self.admission.mark not in worker["resources"]:
                    self._look_at(address)
        return workers

    async def _first_workers(self) -> list[str]:
        is_told = False
        while True:
            running = [address for address, each in (await self._workers()).items() if each["status"] == "running"]
            if running:
                return running
            if not is_told:
                log.info("the scheduler has no worker yet; waiting for one")
            is_told = True
            await asyncio.sleep(GLANCE)

    async def _hear(self, event: tuple[float, dict[str, str]]) -> None:
        """What the scheduler says of workers that come and go."""
        message = event[1]
        if "joined" in message:
            self._look_at(message["joined"])
        if "died" in message:
            self.deaths += 1
            if self.awaited:
                log.info("a worker died; its unfinished blocks are done again")

    def _look_at(self, address: str) -> None:
        """Have a worker examined, once."""
        if address not in self._seen:
            self._seen.add(address)
            chore = asyncio.create_task(self._admit_late(address))
            self._chores.add(chore)
            chore.add_done_callback(self._chores.discard)

    async def _admit_late(self, address: str) -> None:
        refused: dict[str, str] = {}
        try:
            refused = await self.admission.admit([address])
        except Exception:  # of the connection, or of a question that the worker cannot answer
            log.debug("the worker %s was not examined", address, exc_info=True)
        finally:
            if not refused:
                self._seen.discard(address)  # without an answer it has no mark, and is looked at again
        for worker, why in refused.items():
            log.info("the worker %s is given no work: it %s", worker, why)

    async def _check_scheduler(self) -> None:
        """It reads tasks too."""
        own = importlib.metadata.version("slepian_prt")
        theirs: Any
        try:
            theirs = await self._client.run_on_scheduler(importlib.metadata.version, "slepian_prt")
        except importlib.metadata.PackageNotFoundError:
            theirs = "none"
        if theirs != own:
            raise UserError(f"slepian_prt is {own} here, and {theirs} where the scheduler runs; install the same there")

    async def _reaches(self, address: str) -> bool:
        from distributed.comm import connect

        try:
            comm = await connect(address, timeout=3, **self._client.connection_args)
        except (OSError, TimeoutError):
            return False
        await comm.close()
        return True
