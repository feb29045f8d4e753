"""A crew of workers: values that all share, tasks of them, and results as they come in."""

from __future__ import annotations

import contextlib
import time
import uuid
import weakref
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from slepian_prt.distributed.connection import dask_distributed, given_client, local_client, read_scheduler_file
from slepian_prt.distributed.garbage import collect_young, collected_by_this_thread
from slepian_prt.distributed.held import Shared, call, forget, keep
from slepian_prt.distributed.inflow import Inflow
from slepian_prt.distributed.local_cluster import has_dashboard
from slepian_prt.distributed.roster import GLANCE, Roster
from slepian_prt.errors import UserError

if TYPE_CHECKING:
    from distributed import Client, Future

# Times that a value is brought to workers that die meanwhile.
_ATTEMPTS = 5


@contextmanager
def open_crew(
    workers: int | None = None,
    *,
    client: Any = None,
    scheduler: str | None = None,
    scheduler_file: str | Path | None = None,
    security: Any = None,
    variant: str | None = None,
) -> Iterator[Crew]:
    """Workers for the length of a with-block: of a cluster on this machine, or of one that is there.

    Just one of the first four is given. When the block ends, nothing of it is left in a cluster that goes on; when it
    ends by an exception, what is queued is cancelled, and a task that runs ends by itself.

    Parameters
    ----------
    workers : int, optional
        Processes on this machine that end with the block; they share its cores.
    client : distributed.Client, str or cluster, optional
        The user's own, which stays open; or the address of a scheduler, or a cluster as of dask-jobqueue.
    scheduler : str, optional
        The address of a scheduler, as ``tcp://HOST:8786``.
    scheduler_file : path, optional
        The file that it has written its address to.
    security : distributed.Security, optional
        Certificates, for TLS.
    variant : str, optional
        Of Mitsuba, that workers must be able to run; by default the one that work here runs in.

    Raises
    ------
    UserError
        No Dask, no scheduler there, or a worker with other versions than here, which is named.
    """
    sources = {"workers": workers, "client": client, "scheduler": scheduler, "scheduler_file": scheduler_file}
    given = [name for name, value in sources.items() if value is not None]
    if len(given) != 1:
        named = " and ".join(f"`{name}`" for name in given)
        raise UserError(
            f"{f'{named} are' if given else 'nothing is'} given; give one of client, `workers`, `scheduler` and "
            "`scheduler_file`"
        )
    from slepian_prt.renderer.variants import usable_variant

    dask_distributed()
    if scheduler_file is not None:
        scheduler = read_scheduler_file(scheduler_file)
    opened = local_client(workers, security) if workers is not None else given_client(client or scheduler, security)
    with collected_by_this_thread(whole=True), opened as connected:
        roster = Roster(connected, variant or usable_variant(), is_ours=workers is not None)
        crew = Crew(connected, roster)
        try:
            connected.sync(roster.assemble)
            yield crew
        except BaseException:
            with contextlib.suppress(Exception):  # the first fault is the one to hear of
                crew.disband()
            raise
        crew.disband()


class Crew:
    """Workers that were found to have what is needed; `open_crew` makes it.

    Attributes
    ----------
    client : distributed.Client
    """

    def __init__(self, client: Client, roster: Roster) -> None:
        self.client = client
        self._roster = roster
        self._futures: weakref.WeakSet[Future] = weakref.WeakSet()
        self._values: dict[Shared, Any] = {}
        self._brought: dict[Shared, Future] = {}

    @property
    def count(self) -> int:
        """Workers that are given work, now."""
        return len(self._addresses())

    @property
    def address(self) -> str | None:
        """Of the dashboard, where there is one."""
        return self.client.dashboard_link if has_dashboard() else None

    def share(self, value: Any, digest: str | None = None) -> Shared:
        """Bring a value to all workers, once; the handle to give to tasks.

        A value with a method ``open`` that is a context manager is entered in each worker when the first task needs
        it, and left when a task needs another or the value is released.

        Parameters
        ----------
        value : anything that can be pickled
        digest : str, optional
            Of what it holds: the same is not brought again.
        """
        shared = Shared(f"{self._roster.name}-{digest or uuid.uuid4().hex}")
        if shared not in self._values:
            self._values[shared] = value
            self._bring(shared)
        return shared

    def submit(
        self,
        function: Callable[[Any, Any], Any],
        items: Sequence[Any],
        shared: Shared | None = None,
        *,
        priority: int = 0,
        key: str | None = None,
    ) -> list[Future]:
        """A task ``function(value, item)`` for each item, which must give the same whenever it is called.

        Parameters
        ----------
        function : callable
            Of a module, not a lambda.
        items : sequence
            Futures among them, or in lists and tuples of them, are what they became when the task begins.
        shared : Shared, optional
            The value, opened; without it functions get None.
        priority : int
            Higher ones first.
        key : str, optional
            What the tasks are called on the dashboard.
        """
        name = f"{key or getattr(function, '__name__', 'task')}-{uuid.uuid4().hex}"
        if not items:
            return []
        futures = self.client.map(
            partial(call, function, shared),
            list(items),
            key=[(name, number) for number in range(len(items))],
            priority=priority,
            resources={self._roster.admission.mark: 1},
            pure=True,
        )
        self._futures.update(futures)
        return futures

    def results(self, futures: Sequence[Future]) -> Iterator[tuple[int, Any]]:
        """Number and result of each task as they come in; they come straight from workers that can be reached.

        Tasks of workers that die are done again. When a task fails, or what goes through the results does, all that
        are left are cancelled everywhere.

        Raises
        ------
        UserError
            All workers are gone and none comes, or they die again and again without getting on, or the scheduler is
            gone.
        Exception
            What a task raised, as it was.
        """
        try:
            for found in Inflow(self.client, self._roster, futures, self._bring_again).results():
                yield found
                collect_young()
        except BaseException:
            self.cancel(futures)
            raise

    def gather(self, futures: Sequence[Future]) -> list[Any]:
        """The results of all tasks, in order."""
        found = dict(self.results(futures))
        return [found[number] for number in range(len(futures))]

    def cancel(self, futures: Sequence[Future]) -> None:
        """Take back what has not begun; a task that runs ends by itself, and nobody hears of it."""
        if self.client.status == "running" and futures:
            self.client.cancel(list(futures), force=True)

    def release(self, shared: Shared) -> None:
        """Let workers close and forget a value."""
        self._values.pop(shared, None)
        self._brought.pop(shared, None)
        self._let_go(shared.name)

    def disband(self) -> None:
        """Leave nothing in the cluster."""
        if self.client.status == "running":
            self.client.sync(self._roster.dissolve)
            self.cancel(list(self._futures))
            self._let_go(self._roster.name)

    def _let_go(self, prefix: str) -> None:
        if self.client.status != "running":
            return
        with contextlib.suppress(OSError):  # then there is nobody who holds anything
            self.client.run(forget, prefix, wait=False, workers=self._addresses(), on_error="ignore")

    def _addresses(self) -> list[str]:
        return self.client.sync(self._roster.addresses)

    def _bring_again(self, name: str) -> None:
        if not self.client.sync(self._roster.is_held, name):
            self._bring(Shared(name))

    def _bring(self, shared: Shared) -> None:
        """To all workers, from one to the next; again, if it was lost with workers that died."""
        for attempt in range(_ATTEMPTS):
            while not (workers := self._addresses()):
                self.client.sync(self._roster.check)
                time.sleep(GLANCE)
            try:
                # The name that is in use stays in use: Dask would hear too late of giving it up.
                brought = self.client.scatter(
                    {shared.name: self._values[shared]}, workers=workers, broadcast=True, direct=self._roster.is_direct
                )
                self._brought[shared] = brought[shared.name]
                self.client.run(keep, shared.name, workers=workers, on_error="ignore")
                return
            except (OSError, KeyError, TimeoutError):  # workers died meanwhile
                if attempt == _ATTEMPTS - 1:
                    raise
