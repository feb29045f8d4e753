"""Where Dask's scheduler or our client becomes the limit: recorded work, replayed by up to 64 workers."""

from __future__ import annotations

import heapq
import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import psutil
from benchmarks.common import line
from benchmarks.replay import code, simulated_cluster, tell, trace

from slepian_prt.distributed.crew import Crew, open_crew


@dataclass(frozen=True)
class Recorded:
    """Work as one process of one thread did it: a dragon of 437,645 vertices, L = 10, 1024 rays.

    Attributes
    ----------
    traces, codes : int
        Tasks that trace, and that code.
    trace_seconds, code_seconds : float
        Of each.
    kept_bytes, code_bytes : int
        What a worker keeps of a traced block, and what it sends of a coded piece.
    needed : int
        Traced blocks that a piece is coded from.
    """

    traces: int = 34
    codes: int = 15
    trace_seconds: float = 2.3
    code_seconds: float = 0.35
    kept_bytes: int = 2_200_000
    code_bytes: int = 430_000
    needed: int = 3

    def repeated(self, times: float, speed: float) -> Recorded:
        """So many times the mesh, by processes that are so much faster."""
        return Recorded(
            max(1, round(self.traces * times)),
            max(1, round(self.codes * times)),
            self.trace_seconds / speed,
            self.code_seconds / speed,
            self.kept_bytes,
            self.code_bytes,
            self.needed,
        )

    @property
    def seconds(self) -> float:
        """Of one process."""
        return self.traces * self.trace_seconds + self.codes * self.code_seconds

    def blocks_of(self, piece: int) -> list[int]:
        """Numbers of the blocks that a piece is coded from: neighbours."""
        first = piece * self.traces // self.codes
        return [(first + number) % self.traces for number in range(min(self.needed, self.traces))]

    def least_seconds(self, workers: int) -> float:
        """If nothing but the tasks took time: each worker takes the next that is ready."""
        free = [0.0] * workers
        done = []
        for _ in range(self.traces):
            done.append(heapq.heapreplace(free, free[0] + self.trace_seconds) + self.trace_seconds)
        for piece in range(self.codes):
            begin = max(free[0], *(done[block] for block in self.blocks_of(piece)))
            heapq.heapreplace(free, begin + self.code_seconds)
        return max(free)


@dataclass(frozen=True)
class Replayed:
    """One run.

    Attributes
    ----------
    workers : int
    speed : float
        How much faster than recorded ones they are: for the scheduler and the client they are as so many more.
    tasks : int
    seconds, least_seconds : float
        Of the run; and if nothing but the tasks took time.
    scheduler_seconds, client_seconds, workers_seconds : float
        Of processors, in all: what each of them worked, all workers together.
    """

    workers: int
    speed: float
    tasks: int
    seconds: float
    least_seconds: float
    scheduler_seconds: float
    client_seconds: float
    workers_seconds: float

    @property
    def efficiency(self) -> float:
        """Of the workers, as far as the tasks allow."""
        return self.least_seconds / self.seconds

    @property
    def cores(self) -> float:
        """Of this machine that were busy with it: where they are all, the machine is the limit and not Dask."""
        return (self.scheduler_seconds + self.client_seconds + self.workers_seconds) / self.seconds

    @property
    def equivalent(self) -> float:
        """Workers of recorded speed that would be as much for the scheduler and the client."""
        return self.workers * self.speed


# Seconds that a run would take if nothing but tasks did; and what is run: workers, and how fast they are.
_SECONDS = 15.0
_RUNS = ((1, 1.0), (4, 1.0), (16, 1.0), (64, 1.0), (64, 4.0), (64, 16.0))


def workers() -> None:
    """Recorded work replayed by simulated workers: seconds beside those of the tasks, and who is busy with what."""
    for run in replay_all():
        line(
            f"{run.workers} workers at {run.speed:g} x the speed ({run.equivalent:g}), {run.tasks} tasks",
            f"{run.efficiency:.0%}; of a task the scheduler has {1e3 * run.scheduler_seconds / run.tasks:.2f} ms, the "
            f"client {1e3 * run.client_seconds / run.tasks:.2f} ms, all at once {run.cores:.1f} cores",
        )


def replay_all(recorded: Recorded | None = None) -> Iterator[Replayed]:
    """All runs."""
    return (replay(recorded or Recorded(), count, speed) for count, speed in _RUNS)


def replay(recorded: Recorded, count: int, speed: float) -> Replayed:
    """One run: as much work as takes so many workers some seconds."""
    work = recorded.repeated(_SECONDS * count * speed / recorded.seconds, speed)
    with simulated_cluster(count) as (file, scheduler, hosts), open_crew(scheduler_file=file) as crew:
        while crew.count < count:
            time.sleep(0.1)
        before, begin = _used(scheduler, hosts), time.perf_counter()
        received = _run(work, crew)
        seconds = time.perf_counter() - begin
        used = _used(scheduler, hosts) - before
        assert received == work.codes * work.code_bytes
    tasks = 2 * work.traces + work.codes
    return Replayed(count, speed, tasks, seconds, work.least_seconds(count), *used)


def _run(work: Recorded, crew: Crew) -> int:
    """Trace, tell, code, and receive all pieces, whose bytes are counted."""
    blocks = crew.submit(trace, [(work.trace_seconds, work.kept_bytes)] * work.traces, key="trace")
    told = crew.submit(tell, blocks, priority=2, key="tell")
    items = [
        (work.code_seconds, work.code_bytes, [blocks[block] for block in work.blocks_of(piece)])
        for piece in range(work.codes)
    ]
    coded = crew.submit(code, items, priority=1, key="code")
    del blocks
    received = 0
    for number, result in crew.results([*told, *coded]):
        if number >= work.traces:
            received += len(result)
    return received


def _used(scheduler: int, hosts: list[int]) -> np.ndarray:
    """Seconds of processors of the scheduler, of ourselves, and of all workers."""
    seconds = [sum(psutil.Process(process).cpu_times()[:2]) for process in (scheduler, *hosts)]
    return np.array([seconds[0], time.process_time(), sum(seconds[1:])])
