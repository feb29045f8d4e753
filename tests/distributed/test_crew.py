"""Crews of workers: what is shared, what comes back, and what happens to those that die."""

from __future__ import annotations

import logging
import os
import signal
import time
from types import SimpleNamespace

import pytest

from slepian_prt.distributed import admission, examination, held, roster
from slepian_prt.distributed.crew import Crew, open_crew
from slepian_prt.errors import UserError
from tests.distributed import tasks
from tests.distributed.tasks import Table

SHARE = {max(1, len(os.sched_getaffinity(0)) // 2)}
SQUARES = Table(*(number**2 for number in range(30)))


def left_over(client) -> list:
    """Tasks that a scheduler still knows."""
    return client.run_on_scheduler(lambda dask_scheduler: list(dask_scheduler.tasks))


def wait_until(holds, seconds: float = 60.0) -> bool:
    """Whether it holds in the end."""
    end = time.monotonic() + seconds
    while not holds():
        if time.monotonic() > end:
            return False
        time.sleep(0.02)
    return True


def test_functions_get_the_opened_value_and_an_item(crew: Crew):
    assert crew.count == 2
    squares = crew.share(SQUARES)
    found = crew.gather(crew.submit(tasks.look_up_slowly, range(8), squares))
    assert [number for number, _ in found] == [number**2 for number in range(8)]
    assert len({process for _, process in found}) == 2
    told = crew.gather(crew.submit(tasks.opened, range(6), squares))
    assert {each["opened"] - each["closed"] for each in told} == {1}
    crew.release(squares)


def test_another_value_closes_the_last_one_and_release_the_other(crew: Crew):
    def told() -> dict[int, tuple[int, int]]:
        """How many were opened and closed, of each process."""
        every = crew.gather(crew.submit(tasks.opened, range(6)))
        return {each["process"]: (each["opened"], each["closed"]) for each in every}

    before = told()
    both = [crew.share(Table(1)), crew.share(Table(2))]
    for shared in both:
        crew.gather(crew.submit(tasks.wait, [0.05] * 4, shared))
    assert len(before) == 2
    assert told() == {process: (opened + 2, closed + 1) for process, (opened, closed) in before.items()}
    for shared in both:
        crew.release(shared)
    assert told() == {process: (opened + 2, closed + 2) for process, (opened, closed) in before.items()}


def test_one_value_is_brought_once(crew: Crew):
    first = crew.share(Table(7), digest="seven")
    assert crew.share(Table(7), digest="seven") == first
    crew.release(first)


def test_futures_are_items_too_and_big_priorities_come_first(crew: Crew):
    squares = crew.share(SQUARES)
    found = crew.submit(tasks.look_up, range(6), squares)
    sums = crew.submit(tasks.add, [found[:3], found[3:], [found[5], found[5]]])
    assert crew.gather(sums) == [0 + 1 + 4, 9 + 16 + 25, 50]
    blocked = crew.submit(tasks.wait, [0.3, 0.3])
    late = crew.submit(tasks.wait, [0.01] * 8)
    early = crew.submit(tasks.wait, [0.02] * 8, priority=1)
    order = [seconds for _, seconds in crew.results([*blocked, *late, *early]) if seconds < 0.1]
    assert order.index(0.01) >= 6  # two workers: one may be at its first late one while the other is at its last early
    crew.release(squares)


def test_results_may_be_waited_for_while_others_are(crew: Crew):
    squares = crew.share(SQUARES)
    outer = []
    for number, (square, _) in crew.results(crew.submit(tasks.look_up, range(6), squares)):
        outer.append((number, square))
        assert crew.gather(crew.submit(tasks.wait, [0.0, 0.0])) == [0.0, 0.0]
    assert sorted(outer) == [(number, number**2) for number in range(6)]
    crew.release(squares)


def test_each_worker_of_a_machine_has_its_share_of_the_cores(crew: Crew):
    assert set(crew.gather(crew.submit(tasks.threads, range(4)))) == SHARE


def test_values_are_opened_by_two_threads_at_least(crew: Crew):
    """Mitsuba waits for ever when it reads an .exr with a single one."""
    shared = crew.share(tasks.ThreadsToLoad())
    assert set(crew.gather(crew.submit(tasks.same, range(4), shared))) == {max(2, *SHARE)}
    assert set(crew.gather(crew.submit(tasks.threads, range(4)))) == SHARE
    crew.release(shared)


@pytest.mark.parametrize(("item", "kind", "words"), [(1, UserError, "item 1 is none"), (2, ZeroDivisionError, "of a")])
def test_what_a_task_raises_is_raised_here_and_the_rest_is_cancelled(crew: Crew, item, kind, words):
    waiting = crew.submit(tasks.wait, [0.2] * 40)
    refusing = crew.submit(tasks.refuse, [0, item], priority=1)
    with pytest.raises(kind, match=words):
        list(crew.results([*waiting, *refusing]))
    assert all(future.cancelled() for future in waiting[8:])
    del waiting, refusing
    assert wait_until(lambda: not left_over(crew.client))


def test_who_leaves_the_results_cancels_them(crew: Crew):
    waiting = crew.submit(tasks.wait, [0.05] * 100)
    for _ in crew.results(waiting):
        break
    assert waiting[-1].cancelled()


@pytest.mark.slow
def test_a_worker_that_dies_costs_its_unfinished_tasks_only(crew: Crew, caplog):
    caplog.set_level(logging.INFO, "slepian_prt")
    squares, found = crew.share(SQUARES), {}
    for number, (square, process) in crew.results(crew.submit(tasks.look_up_slowly, range(20), squares)):
        found[number] = square
        if len(found) == 4:
            os.kill(process, signal.SIGKILL)
    assert found == {number: number**2 for number in range(20)}
    assert [record.message for record in caplog.records] == ["a worker died; its unfinished blocks are done again"]
    assert wait_until(lambda: crew.count == 2)
    assert set(crew.gather(crew.submit(tasks.threads, range(4)))) == SHARE
    crew.release(squares)


@pytest.mark.slow
def test_all_workers_die_at_once_and_others_get_the_value_again(crew: Crew):
    squares = crew.share(SQUARES)
    futures = crew.submit(tasks.look_up_slowly, range(20), squares)
    for process in crew.client.run(os.getpid).values():
        os.kill(process, signal.SIGKILL)
    assert [number for number, _ in crew.gather(futures)] == [number**2 for number in range(20)]
    assert wait_until(lambda: crew.count == 2)
    crew.release(squares)


def test_workers_that_die_twice_are_started_again(crew: Crew):
    """Dask looks 15 s after a death whether the worker is there, and gives one up that has just died again."""
    import dask

    assert dask.utils.parse_timedelta(dask.config.get("distributed.deploy.lost-worker-timeout")) > 24 * 3600


@pytest.mark.slow
def test_workers_that_always_die_are_given_up(crew: Crew, monkeypatch):
    monkeypatch.setattr(roster, "_FEWEST_DEATHS", 1)
    monkeypatch.setattr(roster, "_DEATHS", 0)
    with pytest.raises(UserError, match=r"^\d+ workers died one after the other and nothing was finished"):
        crew.gather(crew.submit(tasks.die, [0]))
    assert wait_until(lambda: crew.count == 2)


def test_nothing_is_left_in_other_peoples_cluster(cluster):
    with open_crew(client=cluster) as crew:
        shared = crew.share(Table(3))
        assert crew.gather(crew.submit(tasks.look_up, [0], shared)) == [(3, os.getpid())]
        waiting = crew.submit(tasks.wait, [0.2] * 10)
    scheduler = cluster.scheduler
    assert all(future.cancelled() for future in waiting[2:])
    assert wait_until(lambda: not scheduler.tasks and set(scheduler.clients) == {"fire-and-forget"})
    assert not [name for name in scheduler.plugins if str(name).startswith("slepian_prt")]
    assert wait_until(lambda: not held._values and not held._open)


def test_a_client_that_is_killed_leaves_nothing_either(cluster):
    """The scheduler tells the workers to forget, when the connection breaks."""
    with open_crew(client=cluster.scheduler_address) as crew:
        assert crew.gather(crew.submit(tasks.look_up, [0], crew.share(Table(3))))
        assert held._open
        crew.client.sync(crew.client._close, fast=True)
        assert wait_until(lambda: not held._values and not held._open)
        assert not [name for name in cluster.scheduler.plugins if str(name).startswith("slepian_prt")]


def test_a_users_client_stays_open(cluster):
    import distributed

    with distributed.Client(cluster) as client:
        with open_crew(client=client) as crew:
            assert crew.client is client
            assert crew.gather(crew.submit(tasks.wait, [0.0])) == [0.0]
        assert client.status == "running"
        assert client.submit(abs, -3).result() == 3


def test_a_worker_with_another_version_is_refused_by_name(cluster, monkeypatch):
    own = examination.package_versions()
    monkeypatch.setattr(examination, "package_versions", lambda: own | {"mitsuba": "3.9.99"})
    address = next(iter(cluster.scheduler.workers))
    words = f"the worker {address} has mitsuba {own['mitsuba']}, and here is 3.9.99; install the same version there"
    with pytest.raises(UserError, match=words), open_crew(client=cluster):
        pass


def test_a_worker_that_joins_late_with_another_version_gets_no_work(cluster, monkeypatch, caplog):
    caplog.set_level(logging.INFO, "slepian_prt")
    with open_crew(client=cluster) as crew:
        own = examination.package_versions()
        monkeypatch.setattr(examination, "package_versions", lambda: own | {"numpy": "1.0"})
        cluster.scale(2)
        assert wait_until(lambda: "is given no work" in caplog.text)
        assert "it has numpy" in caplog.text
        assert crew.count == 1
        assert len(cluster.scheduler.workers) == 2
        crew.gather(crew.submit(tasks.wait, [0.01] * 6))
        assert [worker.state.executed_count > 0 for _, worker in sorted(cluster.workers.items())] == [True, False]


def test_a_worker_that_joins_late_gets_what_no_other_could_do(cluster):
    with open_crew(client=cluster) as crew:
        cluster.scale(0)
        assert wait_until(lambda: crew.count == 0)
        futures = crew.submit(tasks.wait, [0.0] * 3)
        cluster.scale(1)
        assert crew.gather(futures) == [0.0] * 3


def test_a_worker_of_whom_nobody_heard_is_seen(cluster, monkeypatch):
    """One that joins between the first look and the first news of others."""

    async def hear_nothing(self: roster.Roster, event: tuple) -> None:
        pass

    monkeypatch.setattr(roster.Roster, "_hear", hear_nothing)
    with open_crew(client=cluster) as crew:
        cluster.scale(2)
        assert wait_until(lambda: crew.count == 2)


def test_a_worker_whose_examination_fails_is_examined_again(cluster, monkeypatch):
    with open_crew(client=cluster) as crew:
        examine, faults = admission.examine, [OSError("the connection broke")]

        async def examine_late(*given):
            return await (fail(faults.pop()) if faults else examine(*given))

        monkeypatch.setattr(admission, "examine", examine_late)
        cluster.scale(2)
        assert wait_until(lambda: crew.count == 2)
        assert not faults


def test_no_worker_is_left(cluster, monkeypatch):
    monkeypatch.setattr("slepian_prt.distributed.inflow.GLANCE", 0.02)
    monkeypatch.setattr(roster, "_PATIENCE", {False: 0.05})
    with open_crew(client=cluster) as crew:
        cluster.scale(0)
        assert wait_until(lambda: crew.count == 0)
        with pytest.raises(UserError, match="all workers are gone and none came back"):
            crew.gather(crew.submit(tasks.wait, [0.0]))


def test_all_workers_are_paused(cluster, monkeypatch):
    monkeypatch.setattr("slepian_prt.distributed.inflow.GLANCE", 0.02)
    monkeypatch.setattr(roster, "_PATIENCE", {False: 0.05})
    with open_crew(client=cluster) as crew:
        (worker,) = cluster.workers.values()
        cluster.sync(pause, worker)
        assert wait_until(lambda: crew.count == 0)
        with pytest.raises(UserError, match="all workers are paused by Dask, at the limit of their memory"):
            crew.gather(crew.submit(tasks.wait, [0.0]))


async def pause(worker) -> None:
    worker.periodic_callbacks.clear()
    worker.status = type(worker.status).paused


def test_a_scheduler_that_gives_tasks_up_early_is_asked_again(cluster):
    """Dask's own give a task up that four workers died at, though they were at others."""
    cluster.scale(2)
    cluster.scheduler.allowed_failures = 0
    with open_crew(client=cluster) as crew:
        assert wait_until(lambda: crew.count == 2)
        futures = crew.submit(tasks.wait, [0.05] * 20)
        cluster.sync(cluster.scheduler.remove_worker, crew._addresses()[0], stimulus_id="a-death")
        assert crew.gather(futures) == [0.05] * 20


def test_results_that_are_lost_when_they_are_fetched_are_asked_for_again(cluster, monkeypatch):
    """Their worker dies, they are done again, and the worker that does it finds no shared value at first."""
    with open_crew(client=cluster) as crew:
        shared = crew.share(Table(3))
        gather, lost = crew.client.gather, [held.NotHeldError(shared.name)]

        def gather_late(futures, **how):
            return fail(lost.pop()) if lost else gather(futures, **how)

        monkeypatch.setattr(crew.client, "gather", gather_late)
        assert crew.gather(crew.submit(tasks.look_up, [0, 0], shared)) == [(3, os.getpid())] * 2
        assert not lost


async def fail(error: Exception) -> None:
    raise error


def test_time_in_which_nobody_looked_does_not_count(cluster, monkeypatch):
    with open_crew(client=cluster) as crew:
        cluster.scale(0)
        assert wait_until(lambda: crew.count == 0)
        crew.client.sync(crew._roster.check)
        later = time.monotonic() + 10_000.0
        monkeypatch.setattr(roster, "time", SimpleNamespace(monotonic=lambda: later))
        crew.client.sync(crew._roster.check)


def test_the_scheduler_is_gone(cluster):
    with open_crew(client=cluster.scheduler_address) as crew:
        futures = crew.submit(tasks.wait, [0.2] * 20)
        cluster.close()
        with pytest.raises(UserError, match="the scheduler is gone; start it and the command again"):
            crew.gather(futures)


def test_just_one_way_to_workers_is_given():
    with pytest.raises(UserError, match="nothing is given; give one of"), open_crew():
        pass
    with pytest.raises(UserError, match="`workers` and `scheduler` are given"), open_crew(2, scheduler="tcp://a:1"):
        pass
