"""Workers on this machine, which end with us and leave no files."""

from __future__ import annotations

import contextlib
import importlib.util
import logging
import os
import shutil
import signal
import tempfile
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker
from pathlib import Path
from typing import TYPE_CHECKING, Any

from slepian_prt.distributed.quiet import kept_environment
from slepian_prt.signals import ENDING, interrupts_held

if TYPE_CHECKING:
    from distributed import LocalCluster

_FOLDER = "slepian-prt-workers-"

# Ports for this machine only: the one where people look for a dashboard, or any for what there is without one.
_DASHBOARD, _NO_DASHBOARD = "127.0.0.1:8787", "127.0.0.1:0"

# Variables that children inherit, besides those of Dask's configuration.
_FOR_CHILDREN = ("DASK_LOGGING__DISTRIBUTED", "PYTHONWARNINGS", "PYTHONHASHSEED")

# How long Dask tries to reach a worker on this machine, which may just have died; it would try for half a minute.
_CONNECT = "10s"

# After this time Dask looks whether a worker that died is back, and if it has just died again gives it up for good: two
# workers that were killed at random every few seconds were gone after a minute.
_LOST = "100 days"

# How often workers may die is decided by whether the work gets on, see `Crew.results`.
_ANY_NUMBER = 10**9


@contextmanager
def local_cluster(workers: int, security: Any = None) -> Iterator[LocalCluster]:
    """So many processes, each with one thread of Dask and without a limit of memory.

    When the with-block ends by an exception, what they are doing is not waited for. When we are killed they end too,
    and their folder is removed by the next that is opened.
    """
    import dask
    from distributed import LocalCluster

    _forget_stale()
    changed = [*dask.config.get("distributed.nanny.pre-spawn-environ"), *_FOR_CHILDREN]
    with kept_environment(changed), contextlib.ExitStack() as stack:
        folder = tempfile.mkdtemp(prefix=f"{_FOLDER}{os.getpid()}-")
        stack.callback(shutil.rmtree, folder, ignore_errors=True)
        settings = {
            "distributed.comm.timeouts.connect": _CONNECT,
            "distributed.deploy.lost-worker-timeout": _LOST,
            "temporary-directory": folder,
        }
        stack.enter_context(dask.config.set(settings))
        # Of the children, from their first moment; the last of them counts semaphores when we are killed.
        os.environ["DASK_LOGGING__DISTRIBUTED"] = "critical"
        ignored = "ignore::UserWarning:multiprocessing.resource_tracker"
        os.environ["PYTHONWARNINGS"] = ",".join(filter(None, (os.environ.get("PYTHONWARNINGS"), ignored)))
        with _unheard_by_children(), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # that the port is in use: another one is taken
            cluster = LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                processes=True,
                memory_limit=0,
                local_directory=folder,
                dashboard_address=_DASHBOARD if has_dashboard() else _NO_DASHBOARD,
                preload=["slepian_prt.distributed.worker_start"],
                silence_logs=logging.CRITICAL + 1,
                security=security,
                scheduler_kwargs={"allowed_failures": _ANY_NUMBER},
            )
            stack.callback(cluster.close)
            stack.push(lambda fault, *_: _kill(cluster) if fault else None)
        yield cluster


def has_dashboard() -> bool:
    """Whether what draws Dask's dashboard is installed."""
    return importlib.util.find_spec("bokeh") is not None


def _kill(cluster: LocalCluster) -> None:
    import psutil

    for nanny in list(cluster.workers.values()):
        nanny.close_gracefully()  # so that it starts no other
        if nanny.pid:
            with contextlib.suppress(psutil.NoSuchProcess):
                psutil.Process(nanny.pid).kill()


@contextmanager
def _unheard_by_children() -> Iterator[None]:
    """Processes that begin in the block, or later from its threads, hear of no signal that ends us, which waits here.

    A terminal interrupts all processes of a command, and tells all when it is closed, and batch systems terminate all;
    it is ours to end those of the cluster.
    """
    if threading.current_thread() is not threading.main_thread() or not hasattr(signal, "pthread_sigmask"):
        yield
        return
    with interrupts_held():
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGHUP})  # threads and their children inherit it
        try:
            resource_tracker.ensure_running()  # which hears of no others, and would undo a mask that they are in
            signal.pthread_sigmask(signal.SIG_BLOCK, ENDING)
            yield
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)


def _forget_stale() -> None:
    """Remove folders of processes that were killed."""
    import psutil

    for folder in Path(tempfile.gettempdir()).glob(f"{_FOLDER}*-*"):
        number = folder.name.removeprefix(_FOLDER).split("-")[0]
        if number.isdecimal() and not psutil.pid_exists(int(number)):
            shutil.rmtree(folder, ignore_errors=True)
