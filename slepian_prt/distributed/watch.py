"""On the scheduler: who comes and who goes, told to one client."""

from __future__ import annotations

from typing import Any

from distributed.diagnostics.plugin import SchedulerPlugin
from distributed.protocol.pickle import dumps

from slepian_prt.distributed.held import forget


class Watch(SchedulerPlugin):
    """Tells a topic of workers that join and that die, until its client leaves.

    Dask's own topic ``all`` cannot be subscribed to: its remarks on copies of data break the connection (2026.8).

    Parameters
    ----------
    topic : str
        Which the names of the values that it shared begin with, too.
    client : str
        The id of the client.
    """

    def __init__(self, topic: str, client: str) -> None:
        self.name, self._client = topic, client

    def add_worker(self, scheduler: Any, worker: str) -> None:
        """One has joined."""
        scheduler.log_event(self.name, {"joined": worker})

    def remove_worker(self, scheduler: Any, worker: str, *, stimulus_id: str, **_: Any) -> None:
        """One has gone, without having been asked to."""
        if not stimulus_id.startswith("retire"):
            scheduler.log_event(self.name, {"died": worker})

    def remove_client(self, scheduler: Any, client: str) -> None:
        """Ours has gone, perhaps killed: nothing of it stays here or on workers."""
        if client == self._client:
            scheduler.remove_plugin(name=self.name)
            message = {"op": "run", "function": dumps(forget), "args": dumps((self.name,)), "kwargs": dumps({})}
            scheduler.loop.add_callback(scheduler.broadcast, msg={**message, "wait": False}, on_error="ignore")
