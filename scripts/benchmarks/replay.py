"""Work that is replayed: tasks that sleep as long as recorded ones took and send as much, and processes to do it."""

from __future__ import annotations

import asyncio
import os
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from subprocess import DEVNULL, Popen
from tempfile import TemporaryDirectory

from benchmarks.common import ROOT

# Workers of one process: threads that sleep, and a loop that answers the scheduler.
_WORKERS_OF_A_PROCESS = 16


@dataclass(frozen=True)
class Kept:
    """What a worker keeps of a traced block: as big for Dask as it was, but never really there."""

    bytes: int

    def __sizeof__(self) -> int:
        return self.bytes


def trace(_: object, item: tuple[float, int]) -> Kept:
    """A block: its seconds, and the bytes that stay."""
    seconds, size = item
    time.sleep(seconds)
    return Kept(size)


def tell(_: object, block: Kept) -> bytes:
    """What the client hears of a block."""
    return bytes(200)


def code(_: object, item: tuple[float, int, list[Kept]]) -> bytes:
    """A piece of the file, of blocks that stay where they are."""
    seconds, size, _blocks = item
    time.sleep(seconds)
    return os.urandom(size)


@contextmanager
def simulated_cluster(workers: int) -> Iterator[tuple[str, int, list[int]]]:
    """A scheduler in a process and workers in a few; its address, its process and theirs."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "scripts")])}
    environment["DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED"] = "False"
    with TemporaryDirectory() as folder, ExitStack() as stack:
        file = Path(folder) / "scheduler.json"

        def start(*arguments: str) -> int:
            command = [sys.executable, *arguments]
            process = stack.enter_context(Popen(command, env=environment, stdout=DEVNULL, stderr=DEVNULL))
            stack.callback(process.kill)
            return process.pid

        scheduler = start("-m", "dask", "scheduler", "--port", "0", "--no-dashboard", "--scheduler-file", str(file))
        hosts = []
        for begin in range(0, workers, _WORKERS_OF_A_PROCESS):
            count = min(_WORKERS_OF_A_PROCESS, workers - begin)
            hosts.append(start("-m", "benchmarks.replay", str(file), str(count), folder))
        while not file.exists():
            time.sleep(0.05)
        yield str(file), scheduler, hosts


async def _host(file: str, count: int, folder: str) -> None:
    from distributed import Worker

    options = {"nthreads": 1, "memory_limit": 0, "dashboard": False, "local_directory": folder}
    workers = [await Worker(scheduler_file=file, **options) for _ in range(count)]
    await asyncio.gather(*(worker.finished() for worker in workers))


if __name__ == "__main__":
    asyncio.run(_host(sys.argv[1], int(sys.argv[2]), sys.argv[3]))
