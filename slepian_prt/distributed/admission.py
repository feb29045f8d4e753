"""Who gets work: workers that have what is needed get a mark, a resource of Dask's, that tasks ask for.

The mark also keeps a worker with several threads of Dask to one task at a time: Mitsuba has threads of its own.
"""

from __future__ import annotations

import asyncio
import hashlib
import logging
from collections import Counter
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from slepian_prt.distributed.examination import Equipment, examine, look_around, package_versions, sharing_of
from slepian_prt.distributed.held import use_threads
from slepian_prt.errors import UserError
from slepian_prt.machine.threads import keep_one_blas_thread, most_threads, take_share

if TYPE_CHECKING:
    from distributed import Client

log = logging.getLogger(__name__)


class Admission:
    """Examines the workers of a client, and marks them.

    Parameters
    ----------
    client : distributed.Client
    variant : str
        Of Mitsuba, that workers must be able to run.
    """

    def __init__(self, client: Client, variant: str) -> None:
        self._client, self._variant = client, variant
        here = look_around(variant)
        if here.failure:
            raise UserError(here.failure)
        needed = repr((package_versions(), here.source, here.renderer))
        self.mark = f"slepian_prt-{hashlib.sha256(needed.encode()).hexdigest()[:12]}"
        self._processors = {here.processor}
        self._equipment: dict[str, Equipment] = {}  # of workers that were admitted, by address
        self._sharing: Counter[tuple[str, tuple[int, ...]]] = Counter()
        self._turn = asyncio.Lock()  # the last ones to count workers are the last to say how many threads each has

    async def admit(self, addresses: Iterable[str]) -> dict[str, str]:
        """Mark those workers that have what is needed; what is wrong with the others.

        One that does not answer, because it is about to begin or to end, is neither.
        """
        found = await examine(self._client, addresses, self._variant)
        equipped = {address: what for address, what in found.items() if isinstance(what, Equipment)}
        if equipped:
            async with self._turn:
                await self._equip_sharers(equipped)
            await self._client.run_on_scheduler(_wake, list(equipped))
        self._compare_processors(equipped)
        return {address: what for address, what in found.items() if isinstance(what, str)}

    async def _equip_sharers(self, joined: dict[str, Equipment]) -> None:
        """Mark those that join, and give threads to them and to all whose cores more or fewer workers share now.

        Counted when somebody joins, so that one that stands in for one that died changes nothing.
        """
        scheduler: Any = self._client.scheduler
        living = (await scheduler.identity(n_workers=-1))["workers"]
        self._equipment = {address: has for address, has in (self._equipment | joined).items() if address in living}
        before, self._sharing = self._sharing, sharing_of(self._equipment.values())
        of_each: list[Any] = []
        for address, has in self._equipment.items():
            place = has.machine, has.cores
            if address in joined or self._sharing[place] != before[place]:
                threads = max(1, len(has.cores) // self._sharing[place])
                mark = (_equip, self.mark, threads, self._variant)
                of_each.append(self._client.run(*mark, workers=[address], on_error="ignore"))
        await asyncio.gather(*of_each)

    def _compare_processors(self, equipped: dict[str, Equipment]) -> None:
        before = set(self._processors)
        self._processors |= {each.processor for each in equipped.values()}
        if len(before) == 1 and len(self._processors) > 1:
            log.info(
                "processors differ (%s): results are equal to rounding, not to the bit",
                ", ".join(sorted(self._processors)),
            )


async def _equip(mark: str, threads: int, variant: str, dask_worker: Any = None) -> None:
    """On a worker: threads of Mitsuba, which its next task begins with, of BLAS, and the mark."""
    await asyncio.get_running_loop().run_in_executor(None, _limit_blas)
    threads = most_threads(threads)
    if dask_worker.nanny is not None:  # else the process is not the worker's alone
        take_share(threads)
    if variant.startswith("llvm"):
        use_threads(threads)
    if dask_worker.state.total_resources.get(mark) != 1:
        await dask_worker.set_resources(**{mark: 1})


def _limit_blas() -> None:
    keep_one_blas_thread()


def _wake(addresses: list[str], dask_scheduler: Any = None) -> None:
    """On the scheduler: give tasks that no worker could take to these, which by themselves it looks at when they come.

    As it does for a worker that goes on after a pause.
    """
    for address in addresses:
        if (worker := dask_scheduler.workers.get(address)) is not None:
            runnable = dask_scheduler.bulk_schedule_unrunnable_after_adding_worker(worker)
            dask_scheduler.transitions(runnable, stimulus_id=f"slepian_prt-admitted-{address}")
